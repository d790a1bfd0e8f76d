"""The library on concealed cases: what decides a verdict, without what follows it.

Many cases in one process spare each the import of everything, the motion to record next, the replay
on the simulated robot, and the report. Verdict and simulation are the same as those of the command.
"""

from __future__ import annotations

import json
import traceback
from time import process_time
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from pathlib import Path

    from limo_driver.physics import Simulation


def called(name: str, case: Path) -> None:
    """Diagnose a case, and let both simulations predict its held-out motions.

    Args:
        name: Of the folder in the case for the results.
        case: Folder of the case.
    """
    from estimators.diagnosis import diagnose
    from limo_driver.physics import Simulation
    from limo_driver.recordings.recording import Recording

    out = case / name
    out.mkdir(exist_ok=True)
    begin = process_time()
    try:
        before = Simulation.load(case / "sim.yaml")
        recordings = [Recording.load(path) for path in sorted(case.glob("recording_*.parquet"))]
        found = diagnose(before, recordings)
        seconds = process_time() - begin
        found.verdict.save(out / "verdict.json")
        found.after.save(out / "sim.yaml")
        for label, simulation in (("before", before), ("after", found.after)):
            for k in (1, 2):
                predict(simulation, case / f"held_out_{k}.parquet", out / f"{label}_{k}.parquet")
    except Exception:  # noqa: BLE001  # one case that fails ends no benchmark, and is counted
        write_result(out, (2, process_time() - begin, traceback.format_exc()[-2000:]))
        return
    write_result(out, (0, seconds, ""))


def predict(simulation: Simulation, held_out: Path, to: Path) -> None:
    """Write the torques that a simulation predicts of a recorded motion, as the command does."""
    from limo_driver.app.cli.predict import write
    from limo_driver.app.library.learning import predict as predicted
    from limo_driver.recordings.recording import Recording

    recording = Recording.load(held_out)
    write(recording, recording.time, {"torque": predicted(simulation, recording).torque}, to)


def write_result(out: Path, outcome: tuple[int, float, str]) -> None:
    """Write it last: a case with a result is finished."""
    result = dict(zip(("status", "seconds", "message"), outcome, strict=True))
    (out / "result.json").write_text(json.dumps(result, indent=1))
