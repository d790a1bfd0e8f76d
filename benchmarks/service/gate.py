"""How often the gate promotes by luck, and how often it drops a challenger that is better.

    python benchmarks/service/gate.py [--trials 300]

A verdict is looked for after 1, 2, 4, 8, 16 and 30 minutes, as a service does. Mean squares of
blocks of 5 s scatter as those of real arms do: a part that both models share, and one of their own,
correlated from block to block. Beside the gate stands one that takes each look for the only one,
and drops what seems worse on any joint.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated

import numpy as np
import typer

from estimators.service.gate import compare

if TYPE_CHECKING:
    from limo_driver.types import FloatArray

LOOKS = (12, 24, 48, 96, 192, 360)  # blocks
JOINTS, ROWS = 7, 5  # rows of a block that are independent
SHARED = 1.0  # standard deviation of the logarithm of a block's mean square, alike for both
CASES = (  # squared error of three joints beside the champion's, scatter of its own, correlation
    (1.0, 0.5, 0.0),
    (1.0, 0.5, 0.4),
    (1.0, 1.0, 0.4),
    (0.25, 0.5, 0.4),
    (0.25, 1.0, 0.4),
)
BARS = {1.0: "promoted at most 10 %", 0.25: "promoted at least 85 %"}


def scatter(random: np.random.Generator, size: float, correlation: float) -> FloatArray:
    """Return logarithms that follow each other as a first-order autoregression, (K, n)."""
    steps = random.standard_normal((LOOKS[-1], JOINTS)) * size
    for k in range(1, len(steps)):
        steps[k] = correlation * steps[k - 1] + np.sqrt(1 - correlation**2) * steps[k]
    return steps


def errors(
    random: np.random.Generator, better: float, own: float, correlation: float
) -> tuple[FloatArray, FloatArray]:
    """Return errors of champion and challenger, (T, n) each."""
    shared, found = scatter(random, SHARED, correlation), []
    for factor in (1.0, better):
        logs = shared + scatter(random, own, correlation)
        logs[:, :3] += np.log(factor)
        rows = np.exp(0.5 * logs)[:, None] * random.standard_normal((LOOKS[-1], ROWS, JOINTS))
        found.append(rows.reshape(-1, JOINTS))
    return found[0], found[1]


def verdict(champion: FloatArray, challenger: FloatArray, *, counted: bool) -> str:
    """Return what becomes of a challenger."""
    for blocks in LOOKS:
        rows = slice(0, ROWS * blocks)
        found = compare(champion[rows], challenger[rows], ROWS, len(LOOKS) if counted else 1)
        if found.promote:
            return "promoted"
        if found.drop or (not counted and found.enough and found.worse):
            return "dropped"
    return "undecided"


def main(trials: Annotated[int, typer.Option(help="For each case.")] = 300) -> None:
    """Measure, and print beside the bars."""
    random = np.random.default_rng(1)
    print(f"{trials} challengers each, {JOINTS} joints, squared error of three as stated")
    print("squared error  scatter  correlation   promoted, dropped   each look the only one   bar")
    for better, own, correlation in CASES:
        drawn = [errors(random, better, own, correlation) for _ in range(trials)]
        told = []
        for counted in (True, False):
            ends = [verdict(*pair, counted=counted) for pair in drawn]
            shares = [100 * ends.count(end) / trials for end in ("promoted", "dropped")]
            told.append(f"{shares[0]:5.1f} % {shares[1]:5.1f} %")
        print(
            f"{better:13g}  {own:7g}  {correlation:11g}   {told[0]:18s}  {told[1]:22s}   "
            f"{BARS[better]}"
        )


if __name__ == "__main__":
    typer.run(main)
