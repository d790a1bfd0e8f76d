"""Effects of a joint and its drive beyond the usual ones: kept where they predict better.

The judge is motion that the fit has not seen, simulated forward.
"""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from functools import partial
from itertools import pairwise
from typing import TYPE_CHECKING, Final

import numpy as np

from estimators.drives.fitting.joint import DAMPING, errors, fit_joint, left_out, with_values

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from estimators.drives.fitting.joint import BelievedValue, JointFit
    from estimators.drives.simulation.one_joint import LoadedJoint
    from limo_driver.types import FloatArray


@dataclass(frozen=True)
class Extra:
    """An effect that may be there: what it adds to the constants that are fitted."""

    effect: str
    start: Mapping[str, float]  # constants to be fitted, and where from


EXTRAS: Final = (
    Extra("stribeck_friction", {"stribeck": 0.05, "v_s": 0.05}),
    Extra("load_dependent_friction", {"by_load": 0.1}),
    Extra("dead_band", {"dead_band": 0.005}),
    Extra("profile_speed", {"speed": 1.0}),
)
# A lag is a delay or damping: what a fit finds depends on which of them it begins with.
_STARTS: Final = ({"delay": 0.004, DAMPING: 1.0}, {"delay": 0.04, DAMPING: 0.4})
MOST: Final = 2  # of one joint
_GAIN: Final = 0.97  # of the error on motion not seen, which an effect has to get below
_SURE: Final = 0.4  # of the logarithm of a constant; a deviation beyond says that it is not seen
_SCREENING: Final = 8  # evaluations
_PIECE: Final = 10.0  # [s], where there are too few stretches to keep some apart


def grown(
    parts: Sequence[LoadedJoint],
    row: FloatArray,
    names: tuple[str, ...],
    priors: Mapping[str, BelievedValue],
    *,
    intervals: bool,
) -> tuple[JointFit, tuple[str, ...]]:
    """Fit a joint with the effects that its motion supports.

    Args:
        parts: Recorded stretches.
        row: Constants to start from.
        names: Of those that are fitted in any case.
        priors: What is believed of some of them.
        intervals: Whether deviations are taken from motion that is left out.

    Returns:
        The fit to all stretches, and the effects that it has beyond the usual ones.
    """
    seen, unseen = apart(parts)
    found: list[str] = []
    best = _best(seen, row, names, priors)
    score = _score(unseen, best.row)
    while len(found) < MOST:
        tried = [
            (
                extra,
                fit_joint(
                    seen,
                    with_values(best.row, extra.start),
                    (*names, *extra.start),
                    priors,
                    _SCREENING,
                ),
            )
            for extra in EXTRAS
            if extra.effect not in found
        ]
        scores = [
            _score(unseen, fit.row)
            if max(fit.deviation[name] for name in extra.start) < _SURE
            else np.inf
            for extra, fit in tried
        ]
        at = int(np.argmin(scores))
        if scores[at] > _GAIN * score:
            break
        extra, best = tried[at]
        score, names = scores[at], best.names
        found.append(extra.effect)
    final = _best(parts, best.row, best.names, priors)
    return left_out(final, parts, priors) if intervals else final, tuple(found)


def every_joint(
    parts: Sequence[Sequence[LoadedJoint]],
    rows: FloatArray,
    names: tuple[str, ...],
    priors: Sequence[Mapping[str, BelievedValue]],
    *,
    intervals: bool,
) -> list[tuple[JointFit, tuple[str, ...]]]:
    """Fit several joints side by side; the compiled loops let each other run."""
    with ThreadPoolExecutor() as pool:
        return list(
            pool.map(partial(grown, intervals=intervals), parts, rows, [names] * len(parts), priors)
        )


def apart(
    parts: Sequence[LoadedJoint],
) -> tuple[list[LoadedJoint], list[LoadedJoint]]:
    """Return stretches to fit to, and those kept from it: every other one."""
    if len(parts) < 4:  # noqa: PLR2004  # two of each
        parts = [piece for part in parts for piece in _pieces(part)]
    return list(parts[0::2]), list(parts[1::2]) or list(parts)


def _pieces(part: LoadedJoint) -> list[LoadedJoint]:
    many = max(2, int((part.time[-1] - part.time[0]) / _PIECE))
    bounds = np.linspace(0, part.time.size, many + 1).astype(int)
    arrays = {name: getattr(part, name) for name in part.__dataclass_fields__}
    return [
        replace(part, **{name: values[a:b] for name, values in arrays.items()})
        for a, b in pairwise(bounds)
    ]


def _best(
    parts: Sequence[LoadedJoint],
    row: FloatArray,
    names: tuple[str, ...],
    priors: Mapping[str, BelievedValue],
) -> JointFit:
    """Return the best fit of those that begin with each of the lags."""
    begun = [
        fit_joint(parts, with_values(row, start), names, priors, _SCREENING) for start in _STARTS
    ]
    best = min(begun, key=lambda fit: fit.mean_error)
    return fit_joint(parts, best.row, names, priors)


def _score(parts: Sequence[LoadedJoint], row: FloatArray) -> float:
    return float(np.abs(errors(parts, row)).mean())
