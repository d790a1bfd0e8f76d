"""See the whole way of the data once: plan, run, identify, learn, evaluate, diagnose; `make demo`.

Runs the commands that a user would type, one after the other, and writes OUT/index.html. Where a
part fails, those that do not need it are run all the same, and the page says which one it was.
"""

from __future__ import annotations

import argparse
import base64
import html
import json
import os
import shlex
import signal
import subprocess
import sys
import time
from collections import Counter, deque
from contextlib import suppress
from dataclasses import dataclass, replace
from enum import StrEnum
from pathlib import Path
from string import Template
from typing import TYPE_CHECKING

import stream_and_push

from limo_driver.errors import LimoError
from limo_driver.outputs import require_folder
from limo_driver.physics import Payload, QuadraticDrag, Simulation

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable

MISSING = '<span class="failed">missing, see above</span>'
PATIENCE = 3.0  # [s] for a part to end by Ctrl-C, before it is sent one and, last, killed
SAID = "\nlimo demo: interrupted\n"
INTERRUPTED, BAD_USAGE = 130, 2  # exit statuses
LAST_LINES = 15  # of a part that fails, which the page and the terminal show
HERE = Path(os.path.relpath(Path(__file__).parent))
TRUTH = HERE / "iiwa14_hysteretic.yaml"
CONCEALED = (
    Payload(mass=0.8, com=(0.0, 0.02, 0.08), inertia=(2e-3, 0.0, 0.0, 2e-3, 0.0, 1e-3)),
    QuadraticDrag(joint=4, coefficient=6.0),
)


@dataclass(frozen=True)
class Part:
    """One command of the demo, what it is for, and which parts it goes on from."""

    name: str
    purpose: str
    command: str  # of limo, or of an example
    needs: tuple[str, ...] = ()


class How(StrEnum):
    """How a part ended."""

    DONE = "done"
    FAILED = "failed"
    LEFT_OUT = "left out"
    INTERRUPTED = "interrupted"


@dataclass(frozen=True)
class Outcome:
    """How a part went."""

    part: Part
    seconds: float
    failure: str = ""  # its last lines, or why it was left out; empty where it went well
    how: How = How.DONE


def parts(out: Path, scaffolds: int) -> list[Part]:
    """Return what is run, in order."""
    home, truth, examples = (shlex.quote(str(path)) for path in (out, TRUTH, HERE))
    motion, other = f"{home}/train.traj.parquet", f"{home}/test.traj.parquet"
    return [
        Part(
            "plan",
            "Plan locally isotropic motion: small reversals around poses all over the workspace",
            f"limo plan --robot iiwa14 --scaffolds {scaffolds} --seed 1 --out {motion} "
            f"--picture {home}/plan.png",
        ),
        Part(
            "plan other motion",
            "Plan a second motion, which nothing will be fitted to",
            f"limo plan --robot iiwa14 --scaffolds 4 --seed 2 --out {other}",
        ),
        Part(
            "run",
            "Run the first on an iiwa 14 with friction, hysteresis and elastic joints, and record",
            f"limo run --backend mujoco --trajectory {motion} --sim {truth} "
            f"--record {home}/train.parquet",
            ("plan",),
        ),
        Part(
            "run other motion",
            "Run the second, with other sensor noise",
            f"limo run --backend mujoco --trajectory {other} --sim {truth} "
            f"--record {home}/test.parquet --seed 2",
            ("plan other motion",),
        ),
        Part(
            "identify",
            "Identify a rigid body with Coulomb and viscous friction from the first recording",
            f"limo identify {home}/train.parquet --robot iiwa14 --out {home}/sim.yaml",
            ("run",),
        ),
        Part(
            "train",
            "Learn what the rigid body leaves unexplained, and how sure that is",
            f"limo train {home}/train.parquet --sim {home}/sim.yaml --model joint-physics "
            f"--bandwidth 20 --out {home}/model",
            ("identify",),
        ),
        Part(
            "evaluate",
            "Evaluate the rigid body and what was learned on the second motion",
            f"limo evaluate {home}/test.parquet --model {home}/model --sim {home}/sim.yaml "
            f"--out {home}/evaluation",
            ("train", "run other motion"),
        ),
        Part(
            "run with something concealed",
            "Run the second motion on an arm in which a payload and a drag are concealed",
            f"limo run --backend mujoco --trajectory {other} --sim {home}/concealed.yaml "
            f"--record {home}/concealed.parquet --seed 3",
            ("plan other motion",),
        ),
        Part(
            "diagnose",
            "Diagnose that recording with the simulation that knows of neither",
            f"limo diagnose {home}/concealed.parquet --sim {truth} --out {home}/diagnosis",
            ("run with something concealed",),
        ),
        Part(
            "stream",
            "Stream the second motion to a service of that model, and push the arm meanwhile",
            f"python {examples}/stream_and_push.py --model {home}/model --motion {other} "
            f"--out {home}",
            ("train", "plan other motion"),
        ),
    ]


def conceal(path: Path) -> None:
    """Write the simulation of an arm that has more in it than the diagnosis is told."""
    known = Simulation.load(TRUTH)
    replace(known, effects=(*known.effects, *CONCEALED)).save(path)


def run_all(wanted: list[Part]) -> list[Outcome]:
    """Run one part after the other; where one fails, go on with what does not need it.

    After Ctrl-C, the rest is left out.
    """
    outcomes: dict[str, Outcome] = {}
    for part in wanted:
        lost = [name for name in part.needs if outcomes[name].failure]
        if interrupted(outcomes.values()):
            outcomes[part.name] = Outcome(part, 0.0, "left out", How.LEFT_OUT)
        elif lost:
            why = f"left out: it needs {' and '.join(lost)}"
            outcomes[part.name] = Outcome(part, 0.0, why, How.LEFT_OUT)
        else:
            outcomes[part.name] = run(part)
    return list(outcomes.values())


def interrupted(outcomes: Iterable[Outcome]) -> bool:
    """Say whether Ctrl-C was pressed while a part ran."""
    return any(one.how is How.INTERRUPTED for one in outcomes)


def run(part: Part) -> Outcome:
    """Run a part in a process of its own, as a shell would."""
    print(f"\n# {part.purpose}\n$ {part.command}", flush=True)
    program, *words = shlex.split(part.command)
    main_of_limo = ["-c", "from limo_driver.cli import main; main()"]
    start, said = time.perf_counter(), deque[str](maxlen=LAST_LINES)
    with subprocess.Popen(
        [sys.executable, *(main_of_limo if program == "limo" else []), *words],
        stderr=subprocess.PIPE,
        text=True,
        errors="replace",
    ) as process:
        try:
            for line in process.stderr or ():
                sys.stderr.write(line)
                said.append(line)
            process.wait()
        except KeyboardInterrupt:
            end(process)
            return Outcome(part, time.perf_counter() - start, "interrupted", How.INTERRUPTED)
    seconds = time.perf_counter() - start
    if process.returncode == 0:
        return Outcome(part, seconds)
    last = "".join(said).strip() or "it said nothing"
    return Outcome(part, seconds, f"exit status {process.returncode}\n{last}", How.FAILED)


def end(process: subprocess.Popen[str]) -> None:
    """Wait until an interrupted part has ended; from a terminal, Ctrl-C reached it, too."""
    for number in (signal.SIGINT, signal.SIGKILL):
        with suppress(subprocess.TimeoutExpired, KeyboardInterrupt):
            process.communicate(timeout=PATIENCE)
            return
        process.send_signal(number)
    process.communicate()


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
    """Return the figure of the stream as HTML."""
    found = stream_and_push.Live.read(out / "live")
    began, ended = stream_and_push.PUSH.windows[0]
    told = sorted({event.facts["joint"] for _, event in stream_and_push.contacts(found)})
    return picture(
        out / "live.png",
        f"The same model on a stream of 1 kHz, in a process of its own; someone leans on the arm "
        f"for {ended - began:g} s. Torque as measured and as the motion alone needs it, and "
        f"the difference on all joints. Contact was told on joints {told}. From a state "
        f"taken to its estimate out: {1e3 * found.status['latency']['p50']:.2f} ms (p50).",
    )


def diagnosis(out: Path) -> str:
    """Return what was concealed and what was found as an HTML list."""
    verdict = json.loads((out / "diagnosis" / "verdict.json").read_text())
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


def summary(outcomes: list[Outcome]) -> str:
    """Return how many parts failed and were left out."""
    count = Counter(one.how for one in outcomes)
    if count[How.INTERRUPTED]:
        failed = f", {count[How.FAILED]} failed" if count[How.FAILED] else ""
        return f"Interrupted: {count[How.DONE]} of {len(outcomes)} parts were done{failed}"
    text = f"{count[How.FAILED]} of {len(outcomes)} parts failed"
    if not count[How.LEFT_OUT]:
        return text
    need, were = ("needs", "was") if count[How.LEFT_OUT] == 1 else ("need", "were")
    them = "it" if count[How.FAILED] == 1 else "them"
    return f"{text}, {count[How.LEFT_OUT]} that {need} {them} {were} left out"


def failures(outcomes: list[Outcome]) -> str:
    """Return which parts failed, and their last lines, as HTML; empty where all went well."""
    failed = [
        f"<li>{html.escape(one.part.purpose)}<pre>$ {html.escape(one.part.command)}\n"
        f"{html.escape(one.failure)}</pre></li>"
        for one in outcomes
        if one.failure
    ]
    if not failed:
        return ""
    return (
        f'<section class="failed"><h2>{summary(outcomes)}</h2><ol>{"".join(failed)}</ol></section>'
    )


def note(evaluation: dict) -> str:
    """Return what the columns of the table are, as HTML."""
    return (
        '<p class="note">Rigid body: identified, with Coulomb and viscous friction. Measured '
        "torque and motion went through the same zero-phase low-pass of "
        f"{evaluation['bandwidth']:g} Hz. Noise floor: what the torque sensor's noise leaves after "
        "that filter; no model can be better. Joint physics: hysteresis, friction and elasticity "
        "of each joint, fitted in closed form; it says how sure it is, and 95 % of its errors "
        "should lie within the interval that it gives.</p>"
    )


def evaluation_of(out: Path) -> dict:
    """Return what `limo evaluate` found."""
    return json.loads((out / "evaluation" / "evaluation.json").read_text())


def headline(out: Path) -> str:
    """Return the result in one line."""
    evaluation = evaluation_of(out)
    rigid, learned = evaluation["mean_mse_rigid_body"] ** 0.5, evaluation["mean_mse_hybrid"] ** 0.5
    return f"Torque error: {rigid:.2f} N m with a rigid body, {learned:.2f} N m with what drives do"


SECTIONS: dict[str, tuple[str, Callable[[Path], str]]] = {  # the part that each shows, and how
    "headline": ("evaluate", headline),
    "table": ("evaluate", lambda out: table(evaluation_of(out)) + note(evaluation_of(out))),
    "loops": (
        "evaluate",
        lambda out: picture(
            out / "evaluation" / "loops.png",
            "Friction torque over position while the joints reverse: measured, rigid body with "
            "Coulomb friction, and joint physics.",
        ),
    ),
    "torques": (
        "evaluate",
        lambda out: picture(
            out / "evaluation" / "torque.png", "Joint torque over time in the same stretch."
        ),
    ),
    "plan": (
        "plan",
        lambda out: picture(
            out / "plan.png",
            "Locally isotropic motion: reaching from pose to pose, exploring each with small "
            "random sinusoids on every joint.",
        ),
    ),
    "live": ("stream", live),
    "diagnosis": ("diagnose", diagnosis),
}


def sections(outcomes: list[Outcome], out: Path) -> tuple[dict[str, str], list[Outcome]]:
    """Return the sections of the page, and the outcomes with those that cannot be shown failed."""
    known = {one.part.name: one for one in outcomes}
    shown = {}
    for name, (part, show) in SECTIONS.items():
        if not known[part].failure:
            try:
                shown[name] = show(out)
            except (OSError, LookupError, ValueError, LimoError) as error:
                failure = f"what it left cannot be shown: {error!r}"
                known[part] = replace(known[part], failure=failure, how=How.FAILED)
        if known[part].failure:
            shown[name] = MISSING if name != "headline" else "The demo did not get through"
    return shown, list(known.values())


def page(shown: dict[str, str], outcomes: list[Outcome]) -> str:
    """Return the demo's page."""
    return Template((HERE / "demo.html").read_text()).substitute(
        shown,
        failures=failures(outcomes),
        lead="Root mean square over seven joints of a simulated KUKA iiwa 14 whose joints have "
        "friction, hysteresis and elasticity, while it creeps and reverses.",
        commands="\n".join(
            f"<li>{html.escape(one.part.purpose)} "
            f"<span>({one.how.value if one.failure else f'{one.seconds:.0f} s'})</span>"
            f"<pre>{html.escape(one.part.command)}</pre></li>"
            for one in outcomes
        ),
        truth=html.escape(str(TRUTH)),
    )


def main() -> None:
    """Run all parts and write the page; the exit status says whether all went well."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=Path("out/demo"), help="folder to write")
    parser.add_argument("--scaffolds", type=int, default=12, help="poses that training explores")
    options = parser.parse_args()
    try:
        require_folder(options.out, "the demo")
        conceal(options.out / "concealed.yaml")
        finish(run_all(parts(options.out, options.scaffolds)), options.out)
    except LimoError as error:
        sys.stderr.write(f"limo demo: {error}\n")
        sys.exit(BAD_USAGE)
    except KeyboardInterrupt:  # between parts, or while the page is written
        sys.stderr.write(SAID)
        sys.exit(INTERRUPTED)


def finish(outcomes: list[Outcome], out: Path) -> None:
    """Write the page and say how it went; exit with 1 where a part failed, 130 after Ctrl-C."""
    index = out / "index.html"
    shown, outcomes = sections(outcomes, out)
    index.write_text(page(shown, outcomes))
    print(f"\n{sum(one.seconds for one in outcomes):.0f} s in all; open {index}", flush=True)
    if interrupted(outcomes):
        sys.stderr.write(SAID)
        sys.exit(INTERRUPTED)
    failed = [one for one in outcomes if one.failure]
    if not failed:
        return
    sys.stderr.write(f"\n{summary(outcomes)}:\n")
    for one in failed:
        sys.stderr.write(f"\n{one.part.purpose}\n$ {one.part.command}\n{one.failure}\n")
    sys.exit(1)


if __name__ == "__main__":
    main()
