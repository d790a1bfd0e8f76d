"""Region: the speeds, loads, positions and times in which a torque has most of its energy."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from estimators.diagnosis.settings.judgement import REGION
from estimators.diagnosis.verdict import Where
from estimators.diagnosis.wording import rounded

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from estimators.diagnosis.from_torque.residuals.observations import Observations
    from limo_driver.types import FloatArray


_SPEED = ("at low speed", "at high speed")
_REVERSAL = ("soon after reversals", "long after reversals")
_LOAD = ("at low load", "at high load")


def where_of(observed: Observations, torque: FloatArray, joint: int) -> Where:
    """Say where a torque of one joint has most of its energy, compared with where the joint was.

    Args:
        observed: Recordings and simulation, K slow rows.
        torque: What is found, or left, (K,) [N m].
        joint: 0-based.
    """
    rows = np.flatnonzero(observed.moving[:, joint])
    energy = torque[rows] ** 2
    figure = f"joint-{joint + 1}"
    if not rows.size or energy.sum() <= 0:
        return Where(region=f"joint {joint + 1}", figure=figure)
    samples = observed.kept[rows]
    said = [
        *_side(_SPEED, "rad/s", np.abs(observed.slow.velocity[rows, joint]), energy),
        *_side(_REVERSAL, "rad", observed.since_reversal[samples, joint], energy),
        *_side(_LOAD, "N m", np.abs(observed.load[samples, joint]), energy),
        *_range(observed.slow.position[rows, joint], energy),
    ]
    recordings, time = _stretches(observed, rows, energy)
    if time:
        said.append("most of it in a short part of the time")
    text = f"joint {joint + 1}" + (": " + ", ".join(said) if said else ", all over the motion")
    return Where(time=time, recording=recordings, region=text, figure=figure)


def _side(names: tuple[str, str], unit: str, values: FloatArray, energy: FloatArray) -> list[str]:
    """Say whether the energy lies at small or at large values (R,), if it does.

    Args:
        names: Of small and of large values.
        unit: Of them.
        values: In which each row was.
        energy: Of each row.
    """
    order = np.argsort(values, kind="stable")
    total = np.cumsum(energy[order])
    half = float(values[order][min(np.searchsorted(total, 0.5 * total[-1]), len(order) - 1)])
    usual = float(np.median(values))
    if usual <= 0 or REGION.narrow < half / usual < REGION.wide:
        return []
    name, side = (names[0], "below") if half < usual else (names[1], "above")
    return [f"{name} (half of it {side} {rounded(half, 2)} {unit})"]


def _range(position: FloatArray, energy: FloatArray) -> list[str]:
    """Say which narrow range of positions (R,) has half the energy, if one does."""
    order = np.argsort(position, kind="stable")
    first, last = _narrowest(energy[order], 0.5)
    if (last - first) > REGION.part * len(order):
        return []
    low, high = position[order][[first, last - 1]]
    return [f"near one position (half of it between {low:.3f} and {high:.3f} rad)"]


def _stretches(
    observed: Observations, rows: NDArray[np.intp], energy: FloatArray
) -> tuple[tuple[int, ...], tuple[tuple[float, float], ...]]:
    """Return the stretch of time in each of the fewest recordings that have most of the energy.

    Nothing if it is spread over the motion. Recordings are counted from 1.
    """
    of = observed.recording[rows]
    held = np.bincount(of, energy, len(observed.recordings)) / energy.sum()
    found: list[tuple[int, tuple[float, float]]] = []
    used = 0
    for recording in np.argsort(-held, kind="stable"):
        if sum(held[k - 1] for k, _ in found) >= REGION.all:
            break
        own = np.flatnonzero(of == recording)
        first, last = _narrowest(energy[own], REGION.most)
        used += last - first
        time = observed.slow.time[rows[own[[first, last - 1]]]]
        found.append((int(recording) + 1, (float(time[0]), float(time[1]))))
    if used > REGION.brief * len(rows):
        return (), ()
    return tuple(k for k, _ in sorted(found)), tuple(time for _, time in sorted(found))


def _narrowest(energy: FloatArray, part: float) -> tuple[int, int]:
    """Return the fewest rows in a row, first to before last, that have a part of the energy."""
    total = np.concatenate([[0.0], np.cumsum(energy)])
    ends = np.searchsorted(total, total[:-1] + part * total[-1] * (1 - 1e-9))
    lengths = np.where(ends < total.size, ends - np.arange(energy.size), energy.size + 1)
    first = int(np.argmin(lengths))
    return first, int(first + min(lengths[first], energy.size - first))
