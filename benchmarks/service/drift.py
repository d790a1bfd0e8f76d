"""False alarms of the drift detector, and how soon it tells a doubled residual.

    python benchmarks/service/drift.py [--days 5]

The logarithm of the mean squared residual of a joint, second by second, is simulated as a
first-order autoregression. Its scatter and correlation are those of `joint-physics` on recordings
of real arms, motion held out: 0.6 to 1.35, and at most 0.5 from one second to the next.
"""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING

import numpy as np
from scipy.signal import lfilter

from estimators.service.retraining.drift import DriftDetector

if TYPE_CHECKING:
    from limo_driver.types import FloatArray

CASES = ((0.7, 0.2), (1.0, 0.4), (1.35, 0.5))  # scatter, correlation
SECONDS_A_DAY = 86_400
DOUBLED = np.log(4.0)  # of the mean square
TRIALS = 200
WATCHED = 600  # [s] before the residual doubles
LATEST = 300  # [s] after it, in which that is told or missed
BARS = (1.0, 60.0)  # false alarms a day, seconds until a doubled residual is told (median)


def residual(
    random: np.random.Generator, scatter: float, correlation: float, count: int
) -> FloatArray:
    """Return the logarithm of the mean square of `count` seconds."""
    noise = random.standard_normal(count) * scatter * np.sqrt(1 - correlation**2)
    start = [correlation * scatter * random.standard_normal()]
    return lfilter([1.0], [1.0, -correlation], noise, zi=start)[0]


def told(values: FloatArray) -> list[int]:
    """Return the seconds at which drift is told."""
    detector, usable = DriftDetector(1), np.array([True])
    return [t for t, x in enumerate(np.exp(values)) if detector.step(np.array([x]), usable)]


def main() -> None:
    """Measure, and print beside the bars."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--days", type=float, default=5.0, help="simulated for each case")
    days = parser.parse_args().days
    random = np.random.default_rng(1)
    print(f"one joint, {days:g} days and {TRIALS} doublings each; bars: {BARS}")
    print("scatter  correlation  false alarms a day  doubled: median [s]  95 % [s]  not told")
    for scatter, correlation in CASES:
        alarms = told(residual(random, scatter, correlation, int(days * SECONDS_A_DAY)))
        took = []
        for _ in range(TRIALS):
            values = residual(random, scatter, correlation, WATCHED + LATEST)
            values[WATCHED:] += DOUBLED
            after = [t - WATCHED for t in told(values) if t >= WATCHED]
            took.append(after[0] + 1 if after else np.inf)
        median, late = np.percentile(took, (50, 95), method="higher")
        missed = int(np.isinf(took).sum())
        print(
            f"{scatter:7.2f}{correlation:13.2f}{len(alarms) / days:20.2f}"
            f"{median:21.0f}{late:10.0f}{missed:10}"
        )


if __name__ == "__main__":
    main()
