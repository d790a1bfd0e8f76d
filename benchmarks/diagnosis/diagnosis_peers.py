"""What other tools reach on the concealed cases that `limo diagnose` is scored on.

    python benchmarks/diagnosis/diagnosis.py make --seeds 0:75 --kind single --out out/concealed
    python benchmarks/diagnosis/diagnosis_peers.py out/concealed \
        [--peers identify,sysid,pysindy,trees]

identify   `limo identify` fits every inertia, friction, armature and offset anew
sysid      mujoco.sysid fits ten inertial parameters a link and damping, frictionloss and armature
           a joint to recorded torques through MuJoCo's inverse dynamics
pysindy    a PySINDy ensemble of sparse regressions on each joint's residual, after links and
           friction inside their tolerances were fitted to it
trees      boosted trees on the same: no names, a bound on what its inputs predict

`pip install -e ".[bench]" -c constraints.txt` brings all of them. None of them names anything, so
the rules are ours: a parameter is named where it leaves twice its tolerance, friction and armature
only if the change also exceeds the joint's noise; mujoco.sysid's have to leave their 95 % interval
besides; a term of PySINDy where nine tenths of the ensemble keep it. What a peer predicts and
names is written to `peers/NAME/` in each case, and judged as `limo diagnose` is.
"""

from __future__ import annotations

import json
import os
import subprocess
from pathlib import Path  # typer reads the annotations
from time import perf_counter
from typing import TYPE_CHECKING, Annotated

os.environ.setdefault("OMP_NUM_THREADS", "1")

import numpy as np
import typer
from diagnosis_judged import UNKNOWN, Judged, judge, names
from diagnosis_peer_base import BAND, Answer, Task
from diagnosis_peer_fits import identify, pysindy, trees
from diagnosis_peer_sysid import sysid
from rich.console import Console
from rich.progress import track
from rich.table import Table

from limo_driver.app.cli.predict import write
from limo_driver.errors import LimoError
from limo_driver.physics import Simulation
from limo_driver.recordings.recording import Recording

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

PEERS: dict[str, Callable[[Task], Answer]] = {
    "identify": identify, "sysid": sysid, "pysindy": pysindy, "trees": trees,
}  # fmt: skip
TITLES = {"identify": "identify everything", "sysid": "mujoco.sysid", "pysindy": "PySINDy ensemble",
          "trees": "boosted trees"}  # fmt: skip


def run(case: Path, name: str) -> None:
    """Let a peer answer a case; what it says is written as `limo diagnose` would."""
    out = case / "peers" / name
    if (out / "result.json").exists():
        return
    out.mkdir(parents=True, exist_ok=True)
    begin = perf_counter()
    nominal = Simulation.load(case / "sim.yaml")
    try:
        answer = PEERS[name](Task(case, nominal))
    except (LimoError, ValueError, np.linalg.LinAlgError, subprocess.CalledProcessError) as error:
        failed = {"status": 1, "seconds": perf_counter() - begin, "message": str(error)}
        (out / "result.json").write_text(json.dumps(failed))
        return
    seconds = perf_counter() - begin
    for k in (1, 2):
        recording = Recording.load(case / f"held_out_{k}.parquet")
        before = nominal.predict(recording, BAND)
        write(recording, recording.time, {"torque": before}, out / f"before_{k}.parquet")
        after = answer.predict(recording)
        write(recording, recording.time, {"torque": after}, out / f"after_{k}.parquet")
    verdict = "explained" if answer.findings else "consistent"
    said = {"verdict": verdict, "findings": answer.findings}
    (out / "verdict.json").write_text(json.dumps(said, indent=1))
    (out / "result.json").write_text(json.dumps({"status": 0, "seconds": seconds}))


def summary(title: str, judged: Sequence[Judged], asked: int) -> list[str]:
    """Return one row of the table: closure and names over known effects, alarms on nulls.

    Saying that something is unknown is no name; on a null it is an alarm.
    """
    known = [c for c in judged if c.kind not in ("null", "unknown")]
    nulls = [c for c in judged if c.kind == "null"]
    told = [c.closure for c in known if c.truth["foretellable"]]
    worst = np.array([c.worst if c else np.inf for c in told])
    hits = [any(names(f, e) for e in c.effects) for c in judged for f in c.findings
            if c.kind != "unknown" and f["effect"] != UNKNOWN]  # fmt: skip
    alarms = sum(bool(c.findings) for c in nulls)
    return [
        title,
        f"{len(judged)} of {asked}",
        f"{np.median(worst):.2f}" if told else "-",
        f"{np.mean(worst <= 1.2):.0%}" if told else "-",
        f"{sum(c.exactly_right for c in known)} of {len(known)}",
        f"{np.mean(hits):.2f} of {len(hits)}" if hits else "-",
        f"{alarms} of {len(nulls)}",
        f"{np.median([c.seconds for c in judged]):.1f}" if judged else "-",
    ]


def main(
    folders: Annotated[list[Path], typer.Argument(help="Folders of cases.")],
    peers: Annotated[str, typer.Option(help="Which, divided by commas.")] = ",".join(PEERS),
    limo: Annotated[str, typer.Option(help="Folder in each case with limo's results.")] = "out",
) -> None:
    """Run peers on concealed cases and print what they reach beside what limo reaches."""
    wanted = peers.split(",")
    if strangers := set(wanted) - set(PEERS):
        raise typer.BadParameter(f"{', '.join(strangers)}; there are: {', '.join(PEERS)}")
    cases = sorted(path.parents[1] for f in folders for path in f.glob("*/hidden/truth.json"))
    if not cases:
        raise typer.BadParameter(f"no case in {', '.join(map(str, folders))}")
    for name in wanted:
        for case in track(cases, name, console=Console(stderr=True)):
            run(case, name)
    table = Table(
        "tool", "cases", "closure, median", "<= 1.2", "exactly right", "precision of names",
        "false alarms on nulls", "seconds a case", title=f"{len(cases)} concealed cases",
    )  # fmt: skip
    rows = [("limo diagnose", limo), *((TITLES[name], f"peers/{name}") for name in wanted)]
    for title, out in rows:
        finished = [case for case in cases if (case / out / "result.json").exists()]
        table.add_row(*summary(title, [judge(case, out) for case in finished], len(cases)))
    Console(width=140, highlight=False).print(table)


if __name__ == "__main__":
    typer.run(main)
