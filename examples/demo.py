"""Run the whole workflow once: plan, run, identify, learn, evaluate, diagnose; `make demo`.

Runs the commands that a user would type, one after the other, and writes OUT/index.html. Where a
part fails, those that do not need it are run all the same, and the page says which one it was.
"""

from __future__ import annotations

import argparse
import shlex
import signal
import subprocess
import sys
import time
from collections import deque
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from demo_page import CONCEALED, HERE, TRUTH, How, Outcome, Part, page, sections, summary

from limo_driver.errors import LimoError
from limo_driver.outputs import require_folder
from limo_driver.physics import Simulation

if TYPE_CHECKING:
    from collections.abc import Iterable

PATIENCE = 3.0  # [s] for a part to end by Ctrl-C, before it is sent one and, last, killed
SAID = "\nlimo demo: interrupted\n"
INTERRUPTED, BAD_USAGE = 130, 2  # exit statuses
LAST_LINES = 15  # of a part that fails, which the page and the terminal show


def parts(out: Path, scaffolds: int) -> list[Part]:
    """Return what is run, in order."""
    home, truth, examples = (shlex.quote(str(path)) for path in (out, TRUTH, HERE))
    motion, other = f"{home}/train.traj.parquet", f"{home}/test.traj.parquet"
    return [
        Part(
            "plan",
            "Plan locally isotropic motion: small reversals around poses all over the workspace",
            f"limo plan --robot iiwa14 --scaffolds {scaffolds} --seed 1 --out {motion}",
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
            "write an MJCF",
            "Write what was found into an MJCF, with hysteresis as springs that slip in MuJoCo 4",
            f"limo export {home}/diagnosis/sim.yaml --to mjcf --out {home}/mujoco",
            ("diagnose",),
        ),
        Part(
            "write a ROS 2 package",
            "Write the model as a package of ROS 2: torque, wrench and dynamics without Python",
            f"limo export {home}/model --to ros2 --rate 1000 --out {home}/limo_dynamics",
            ("train",),
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
    """Run a part in a process of its own, as a shell would.

    The demo shows a reader the commands, so it is these that have to run, and not what they call.
    """
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
    shown, drawn, outcomes = sections(outcomes, out)
    page(shown, drawn, outcomes).save(index)
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
