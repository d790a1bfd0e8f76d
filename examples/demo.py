"""See the whole way of the data once: plan, run, identify, learn, evaluate, diagnose; `make demo`.

Runs the commands that a user would type, one after the other, and writes OUT/index.html.
"""

from __future__ import annotations

import argparse
import base64
import html
import json
import os
import shlex
import subprocess
import sys
import time
from dataclasses import dataclass, replace
from pathlib import Path
from string import Template

import stream_and_push

from limo_driver.physics import Payload, QuadraticDrag, Simulation

HERE = Path(os.path.relpath(Path(__file__).parent))
TRUTH = HERE / "iiwa14_hysteretic.yaml"
CONCEALED = (
    Payload(mass=0.8, com=(0.0, 0.02, 0.08), inertia=(2e-3, 0.0, 0.0, 2e-3, 0.0, 1e-3)),
    QuadraticDrag(joint=4, coefficient=6.0),
)


@dataclass(frozen=True)
class Step:
    """One command of the demo and what it was for."""

    purpose: str
    command: str
    seconds: float


def commands(out: Path, scaffolds: int) -> list[tuple[str, str]]:
    """Return the purpose and the text of each command, in order."""
    return [
        (
            "Plan locally isotropic motion: small reversals around poses all over the workspace",
            f"plan --robot iiwa14 --scaffolds {scaffolds} --seed 1 --out {out}/train.traj.parquet "
            f"--picture {out}/plan.png",
        ),
        (
            "Plan a second motion, which nothing will be fitted to",
            f"plan --robot iiwa14 --scaffolds 4 --seed 2 --out {out}/test.traj.parquet",
        ),
        (
            "Run the first on an iiwa 14 with friction, hysteresis and elastic joints, and record",
            f"run --backend mujoco --trajectory {out}/train.traj.parquet --sim {TRUTH} "
            f"--record {out}/train.parquet",
        ),
        (
            "Run the second, with other sensor noise",
            f"run --backend mujoco --trajectory {out}/test.traj.parquet --sim {TRUTH} "
            f"--record {out}/test.parquet --seed 2",
        ),
        (
            "Identify a rigid body with Coulomb and viscous friction from the first recording",
            f"identify {out}/train.parquet --robot iiwa14 --out {out}/sim.yaml",
        ),
        (
            "Learn what the rigid body leaves unexplained, and how sure that is",
            f"train {out}/train.parquet --sim {out}/sim.yaml --model joint-physics "
            f"--bandwidth 20 --out {out}/model",
        ),
        (
            "Evaluate the rigid body and what was learned on the second motion",
            f"evaluate {out}/test.parquet --model {out}/model --sim {out}/sim.yaml "
            f"--out {out}/evaluation",
        ),
        (
            "Run the second motion on an arm in which a payload and a drag are concealed",
            f"run --backend mujoco --trajectory {out}/test.traj.parquet --sim {out}/concealed.yaml "
            f"--record {out}/concealed.parquet --seed 3",
        ),
        (
            "Diagnose that recording with the simulation that knows of neither",
            f"diagnose {out}/concealed.parquet --sim {TRUTH} --out {out}/diagnosis",
        ),
    ]


def conceal(path: Path) -> None:
    """Write the simulation of an arm that has more in it than the diagnosis is told."""
    known = Simulation.load(TRUTH)
    replace(known, effects=(*known.effects, *CONCEALED)).save(path)


def run(purpose: str, command: str) -> Step:
    """Run one limo command in a process of its own, as a shell would; stop where it fails."""
    print(f"\n# {purpose}\n$ limo {command}", flush=True)
    start = time.perf_counter()
    main_of_limo = "from limo_driver.cli import main; main()"
    subprocess.run([sys.executable, "-c", main_of_limo, *shlex.split(command)], check=True)
    return Step(purpose, f"limo {command}", time.perf_counter() - start)


def picture(path: Path, caption: str) -> str:
    """Return an HTML figure with the PNG inside."""
    data = base64.b64encode(path.read_bytes()).decode()
    return (
        f'<figure><img src="data:image/png;base64,{data}" alt="{html.escape(caption)}">'
        f"<figcaption>{html.escape(caption)}</figcaption></figure>"
    )


def figure(value: float | None) -> str:
    """Return a figure of the table; a noise floor can be unknown."""
    return "unknown" if value is None else f"{value:.3f}"


def table(evaluation: dict) -> str:
    """Return the errors per joint as an HTML table."""
    columns = ("rmse_rigid_body", "rmse_hybrid", "noise_floor")
    rows = [
        f"<tr><td>{html.escape(joint)}</td>"
        + "".join(f"<td>{figure(evaluation[key][j])}</td>" for key in columns)
        + f"<td>{evaluation['mse_ratio'][j]:.0f}</td>"
        + f"<td>{evaluation['coverage_of_95_percent'][j]:.0%}</td></tr>"
        for j, joint in enumerate(evaluation["joints"])
    ]
    return (
        "<table><thead><tr><th>joint</th><th>rigid body<br>RMSE [N m]</th>"
        "<th>joint physics<br>RMSE [N m]</th><th>noise floor<br>[N m]</th>"
        "<th>ratio<br>of MSE</th><th>within the<br>95 % interval</th></tr></thead><tbody>"
        + "".join(rows)
        + '<tr class="mean"><td>mean MSE [(N m)²]</td>'
        + f"<td>{evaluation['mean_mse_rigid_body']:.4f}</td>"
        + f"<td>{evaluation['mean_mse_hybrid']:.4f}</td><td></td>"
        + f"<td>{evaluation['mean_mse_ratio']:.0f}</td><td></td></tr></tbody></table>"
    )


def live(out: Path) -> str:
    """Stream the second motion to a service while the arm is pushed; return the figure as HTML."""
    found = stream_and_push.stream(out / "model", out / "test.traj.parquet", out)
    print(f"\n{stream_and_push.summary(found)}")
    stream_and_push.picture(found, out / "live.png")
    began, ended = stream_and_push.PUSH.windows[0]
    told = sorted({event.facts["joint"] for _, event in stream_and_push.contacts(found)})
    return picture(
        out / "live.png",
        f"The same model on a stream of 1 kHz, in a process of its own; someone leans on the arm "
        f"for {ended - began:g} s. Torque as measured and as the motion alone needs it, and "
        f"the difference on all joints. Contact was told on joints {told}. From a state "
        f"taken to its estimate out: {1e3 * found.status['latency']['p50']:.2f} ms (p50).",
    )


def diagnosis(verdict: dict) -> str:
    """Return what was concealed and what was found as an HTML list."""
    concealed = ", ".join(effect.name.replace("_", " ") for effect in CONCEALED)
    found = [
        f"<li>{html.escape(item['effect'].replace('_', ' '))}, joint "
        f"{html.escape(', '.join(map(str, item['joints'])))}: confidence {item['confidence']:.0%}"
        f"<br><span>{html.escape(item['evidence'])}</span></li>"
        for item in verdict["findings"]
    ]
    return (
        f"<p>Concealed in the arm, and told to nobody: {html.escape(concealed)}. Found:</p>"
        f"<ul>{''.join(found) or '<li>nothing</li>'}</ul>"
        '<p><a href="diagnosis/report.html">The whole report</a></p>'
    )


def page(steps: list[Step], streamed: str, out: Path) -> str:
    """Return the demo's page."""
    evaluation = json.loads((out / "evaluation" / "evaluation.json").read_text())
    bandwidth = evaluation["bandwidth"]
    rigid, learned = evaluation["mean_mse_rigid_body"] ** 0.5, evaluation["mean_mse_hybrid"] ** 0.5
    return Template((HERE / "demo.html").read_text()).substitute(
        headline=f"Torque error: {rigid:.2f} N m with a rigid body, {learned:.2f} N m with what "
        "drives do",
        lead="Root mean square over seven joints of a simulated KUKA iiwa 14 whose joints have "
        "friction, hysteresis and elasticity, while it creeps and reverses.",
        table=table(evaluation),
        note="Rigid body: identified, with Coulomb and viscous friction. Measured torque and "
        f"motion went through the same zero-phase low-pass of {bandwidth:g} Hz. Noise floor: what "
        "the torque sensor's noise leaves after that filter; no model can be better. Joint "
        "physics: hysteresis, friction and elasticity of each joint, fitted in closed form; it "
        "says how sure it is, and 95 % of its errors should lie within the interval that it gives.",
        loops=picture(
            out / "evaluation" / "loops.png",
            "Friction torque over position while the joints reverse: measured, rigid body with "
            "Coulomb friction, and joint physics.",
        ),
        torques=picture(
            out / "evaluation" / "torque.png", "Joint torque over time in the same stretch."
        ),
        plan=picture(
            out / "plan.png",
            "Locally isotropic motion: reaching from pose to pose, exploring each with small "
            "random sinusoids on every joint.",
        ),
        live=streamed,
        diagnosis=diagnosis(json.loads((out / "diagnosis" / "verdict.json").read_text())),
        commands="\n".join(
            f"<li>{html.escape(s.purpose)} <span>({s.seconds:.0f} s)</span>"
            f"<pre>{html.escape(s.command)}</pre></li>"
            for s in steps
        ),
        truth=html.escape(str(TRUTH)),
    )


def main() -> None:
    """Run all commands and write the page."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=Path("out/demo"), help="folder to write")
    parser.add_argument("--scaffolds", type=int, default=12, help="poses that training explores")
    options = parser.parse_args()
    options.out.mkdir(parents=True, exist_ok=True)
    conceal(options.out / "concealed.yaml")
    steps = [run(purpose, command) for purpose, command in commands(options.out, options.scaffolds)]
    start = time.perf_counter()
    streamed = live(options.out)
    commands_of_live = "limo serve ... & limo run --stream ...  # examples/stream_and_push.py"
    purpose = "Stream the second motion to a service of that model, and push the arm meanwhile"
    steps.append(Step(purpose, commands_of_live, time.perf_counter() - start))
    index = options.out / "index.html"
    index.write_text(page(steps, streamed, options.out))
    print(f"\n{sum(step.seconds for step in steps):.0f} s in all; open {index}")


if __name__ == "__main__":
    main()
