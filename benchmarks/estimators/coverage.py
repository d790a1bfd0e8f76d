"""How often measured torque is within the 95 % interval of a model, on other motion of real arms.

The folder with the recordings is named by LIMO_DATA, or is ../shared/data. Each model learns from
the first recordings of a case and is judged on the last. Of each joint: the part of the rows within
the interval that the model has without any torque, the same where offset, friction and size of the
errors follow those half a second before and earlier (`estimators/evaluation_result.py`), how wide
both are, and how much of the rows outside of the interval, and of those within, is flagged as
unlike what was learned.

    python benchmarks/estimators/coverage.py [--model auto | joint-physics | gru | ...] [CASE ...]
"""

from __future__ import annotations

import argparse
import os
from pathlib import Path
from typing import TYPE_CHECKING, Any

os.environ.setdefault("OMP_NUM_THREADS", "1")

import numpy as np

import limo_driver as limo
from estimators.base import DEVIATIONS
from estimators.hybrid.training.settings import usual_settings
from estimators.neural import NETWORKS
from limo_driver.recordings.recording import Recording

if TYPE_CHECKING:
    from estimators.evaluation import Evaluation
    from limo_driver.physics import Simulation
    from limo_driver.types import FloatArray

DATA = Path(os.environ.get("LIMO_DATA", Path(__file__).parents[2] / ".." / "shared" / "data"))
LWR, UR = "kuka_lwr4/kuka_lwr4.urdf", "ur10e/ur10e.urdf"
CASES = {
    "UR10e, 14 harmonics, 15": (UR, ["ur10e/unloaded_14harm"], "ur10e/unloaded_15harm"),
    "UR10e, 15 harmonics, 14": (UR, ["ur10e/unloaded_15harm"], "ur10e/unloaded_14harm"),
    "LWR4+, run 2, 3": (LWR, ["kuka_lwr4/measurements_2"], "kuka_lwr4/measurements_3"),
    "LWR4+, run 3, 1": (LWR, ["kuka_lwr4/measurements_3"], "kuka_lwr4/measurements_1"),
    "LWR4+, runs 2 and 3, 1": (
        LWR,
        ["kuka_lwr4/measurements_2", "kuka_lwr4/measurements_3"],
        "kuka_lwr4/measurements_1",
    ),
}
# of the error over the simulation's, geometric mean over joints and worst joint, at most
BARS = {"UR10e, 14 harmonics, 15": (0.70, 1.0), "LWR4+, run 2, 3": (0.75, 1.0)}
LEAST, MOST = 0.9, 0.99  # of the rows, within a 95 % interval
CAUGHT, SPARED = (
    0.8,
    0.05,
)  # or else of those outside flagged, at least, and of those within, at most
LONGEST = 1.3  # times the model's own interval


def trained(name: str, simulation: Simulation, recordings: list[Recording]) -> Any:  # noqa: ANN401
    """Train a model by its name, with usual settings."""
    settings = usual_settings("drive", name) if name in NETWORKS else None
    return limo.train(simulation, recordings, name, settings=settings)


def flagged(found: Evaluation) -> tuple[FloatArray, FloatArray]:
    """Return the parts of the rows outside of the interval, and of those within, that are flagged.

    Args:
        found: Of a recording.
    """
    rows = found.scored
    error = np.abs(found.measured - found.estimate.torque)[rows]
    within, outside = error <= DEVIATIONS * found.estimate.std[rows], found.estimate.outside[rows]
    parts = (
        np.sum(outside & own, axis=0) / np.maximum(own.sum(axis=0), 1) for own in (~within, within)
    )
    missed, held = parts
    return missed, held


def show(name: str, values: FloatArray, digits: int = 2) -> None:
    """Print a row."""
    print(f"  {name:38}" + "".join(f"{value:8.{digits}f}" for value in values))


def judge(found: Evaluation, bar: tuple[float, float] | None) -> tuple[int, int]:
    """Print the figures of an evaluation; return in how many joints each interval holds."""
    change = found.change
    if change is None:
        raise SystemExit(f"{found.model} does not know its errors")
    wide = np.median(change.std / found.estimate.std[found.scored], axis=0)
    missed, held = flagged(found)
    left = found.hybrid.rmse / found.rigid_body.rmse
    show("RMSE over the simulation's", left)
    mean, worst = np.exp(np.mean(np.log(left))), left.max()
    aim = f" (bar {bar[0]:.2f} and {bar[1]:.2f})" if bar else ""
    print(f"  geometric mean {mean:.3f}, worst {worst:.2f}{aim}")
    show("within the interval", found.coverage)
    show("of those outside of it, flagged", missed)
    show("of those within, flagged", held)
    show("within, with what changed", found.coverage_with_change)
    show("width, over the model's own", wide)
    for line in found.changed:
        print(f"  {line}")
    good = [
        (part >= LEAST) & (part <= MOST) for part in (found.coverage, found.coverage_with_change)
    ]
    caught = (missed >= CAUGHT) & (held <= SPARED)
    return int((good[0] | caught).sum()), int(((good[1] & (wide <= LONGEST)) | caught).sum())


def main() -> None:
    """Print coverage by joint, and in how many joints of all it is as it should be."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("cases", nargs="*", help="beginnings of their names; all if none is given")
    parser.add_argument("--model", default="auto", choices=["auto", "joint-physics", *NETWORKS])
    given = parser.parse_args()
    if not DATA.is_dir():
        parser.error(f"no recordings in {DATA}; name their folder in LIMO_DATA")
    total, alone, changed, least = 0, 0, 0, 1.0
    for name, (urdf, learned, test) in CASES.items():
        if given.cases and not name.startswith(tuple(given.cases)):
            continue
        recordings = [Recording.load(DATA / f"{one}.parquet") for one in learned]
        simulation = limo.identify(DATA / urdf, recordings).simulation
        model = trained(given.model, simulation, recordings)
        found = limo.evaluate(model, Recording.load(DATA / f"{test}.parquet"))
        print(f"{name}: {model.name}, learned from all but the last named")
        own, followed = judge(found, BARS.get(name))
        total, alone, changed = total + found.recording.n, alone + own, changed + followed
        least = min(least, float(found.coverage_with_change.min()))
        print(flush=True)
    flags = f"or {CAUGHT:.0%} of the rows outside flagged and at most {SPARED:.0%} of those within"
    print(f"joints covered {LEAST:.0%} to {MOST:.0%}, {flags} (bar: all):")
    print(f"  {alone} of {total} by the model alone")
    print(f"  {changed} of {total} with what changed, at most {LONGEST:g} times as wide")
    print(f"least covered joint with what changed: {least:.0%}")


if __name__ == "__main__":
    main()
