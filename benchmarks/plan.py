"""Figures of `limo plan`: planning time, path deviation, distance to the limits, duration.

Run it with `python benchmarks/plan.py`; it plans 150 scaffolds for the iiwa 14 and prints each
figure beside its bar. The first run also compiles, and says so.
"""

from __future__ import annotations

import sys
from time import perf_counter
from typing import TYPE_CHECKING

import numpy as np

from limo_driver.model import RobotModel
from limopa import Plan, PlanRequest, plan, summarise
from limopa.statistics import path_deviation

if TYPE_CHECKING:
    from limo_driver.trajectory import Trajectory

SCAFFOLDS = 150


def worst_deviation(planned: Plan) -> float:
    """Return how far any exploring phase leaves its sinusoids [rad], seen at 1 kHz."""
    segments = planned.trajectory.segments
    return max(
        path_deviation(planned, phase, slice(segment.start, segment.stop))
        for phase, segment in zip(planned.phases, segments, strict=True)
        if phase.kind == "exploring"
    )


def worst_ratio_at_1_khz(motion: Trajectory, model: RobotModel) -> tuple[float, float, float]:
    """Return the largest velocity, acceleration and jerk relative to the limits, at 1 kHz."""
    worst = np.zeros(3)
    limits = (model.limits.velocity, model.limits.acceleration, model.limits.jerk)
    for start in np.arange(0.0, motion.duration, 100.0):
        at = np.minimum(start + 1e-3 * np.arange(100_002), motion.duration)
        seen = motion.evaluate(at)
        values = (seen.velocity, seen.acceleration, np.diff(seen.acceleration, axis=0) / 1e-3)
        ratios = [float((np.abs(v) / b).max()) for v, b in zip(values, limits, strict=True)]
        worst = np.maximum(worst, ratios)
    return float(worst[0]), float(worst[1]), float(worst[2])


def main(seed: int = 1) -> None:
    """Plan, measure, print."""
    begin = perf_counter()
    model = RobotModel.load("iiwa14")
    plan(model, PlanRequest(scaffolds=1), seed)
    print(f"warm-up with one scaffold (compiles the first time): {perf_counter() - begin:.1f} s")

    begin = perf_counter()
    planned = plan(model, PlanRequest(scaffolds=SCAFFOLDS), seed)
    spent = perf_counter() - begin
    statistics = summarise(planned, model)
    peaks = planned.trajectory.peaks().over(model.limits)
    velocity, acceleration, jerk = worst_ratio_at_1_khz(planned.trajectory, model)

    print(f"{'figure':<58}{'measured':>12}   bar")
    rows = [
        (f"planning {SCAFFOLDS} scaffolds [s]", spent, "<= 60"),
        ("waypoints", statistics.waypoints, "about 337 500"),
        ("duration of the motion [h]", statistics.duration / 3600, "about 1 (paper)"),
        ("mean exploring phase [s]", statistics.exploring_duration.mean, "20 to 25"),
        ("deviation from the sinusoids at 1 kHz [rad]", worst_deviation(planned), "<= 1e-4"),
        ("velocity / limit, anywhere between samples", peaks.velocity.max(), "<= 1"),
        ("acceleration / limit, anywhere between samples", peaks.acceleration.max(), "<= 1"),
        ("jerk / limit, anywhere between samples", peaks.jerk.max(), "<= 1"),
        ("velocity / limit at 1 kHz", velocity, "<= 1"),
        ("acceleration / limit at 1 kHz", acceleration, "<= 1"),
        ("jerk / limit by differences at 1 kHz", jerk, "<= 1"),
    ]
    for name, value, bar in rows:
        print(f"{name:<58}{value:>12.6g}   {bar}")


if __name__ == "__main__":
    main(*map(int, sys.argv[1:2]))
