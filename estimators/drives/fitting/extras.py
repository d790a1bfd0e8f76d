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

from estimators.drives.fitting.constants import BASE, value_in, with_values
from estimators.drives.fitting.joint import JointFit, errors, fit_joint, left_out
from estimators.drives.fitting.limits import begun_at
from estimators.drives.fitting.starts import LAGS, away, lagging

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from estimators.drives.fitting.constants import BelievedValue
    from estimators.drives.simulation.one_joint import LoadedJoint
    from limo_driver.types import FloatArray


@dataclass(frozen=True)
class Extra:
    """An effect that may be there: what it adds to the constants that are fitted."""

    effect: str
    start: Mapping[str, float]  # constants to be fitted, and where from; of a limit, nothing yet
    limit: str = ""  # a constant that is felt where it is reached, and nowhere else

    def begun(self, parts: Sequence[LoadedJoint], row: FloatArray) -> Mapping[str, float]:
        """Return constants and where their fit begins; none where nothing speaks for a limit.

        Args:
            parts: Recorded stretches.
            row: The constants without it.
        """
        if not self.limit:
            return self.start
        best = begun_at(self.limit, parts, row)
        return best.values if best.away < away(parts, row) else {}


EXTRAS: Final = (
    Extra("stribeck_friction", {"stribeck": 0.05, "v_s": 0.05}),
    Extra("load_dependent_friction", {"by_load": 0.1}),
    Extra("dead_band", {"dead_band": 0.005}),
    Extra("profile_speed", {}, "speed"),
    Extra("profile_acceleration", {}, "acceleration"),
    Extra("torque_limit", {}, "torque_limit"),
)
MOST: Final = 3  # of one joint
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
        tried = list[tuple[Extra, JointFit]]()
        scores = list[float]()
        for extra in EXTRAS:
            if extra.effect in found:
                continue
            # a servo that is mostly at a limit looks like another, of less gain
            begun_with = {name: best.value(name) for name in names if name not in BASE}
            others = (with_values(row, begun_with),) if extra.limit else ()
            for base in (best.row, *others):
                if not (start := extra.begun(seen, base)):
                    continue
                begun = with_values(base, start)
                fit = fit_joint(seen, begun, (*names, *start), priors, _SCREENING)
                tried.append((extra, fit))
                scores.append(_proven(unseen, fit, best.row, list(start), score))
        at = int(np.argmin(scores)) if scores else 0
        if not scores or scores[at] == np.inf:
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
    begun = [fit_joint(parts, lagging(row, lag), names, priors, _SCREENING) for lag in LAGS]
    best = min(begun, key=lambda fit: fit.mean_error)
    return fit_joint(parts, best.row, names, priors)


def _proven(
    parts: Sequence[LoadedJoint],
    fit: JointFit,
    before: FloatArray,
    names: Sequence[str],
    score: float,
) -> float:
    """Return the error of a fit on motion that it has not seen; infinite if it proves nothing.

    Its gain has to be that of the new constants: without them, all others as fitted, it is lost.

    Args:
        parts: That motion.
        fit: With the effect.
        before: Constants of the fit without it.
        names: What the effect adds.
        score: Error without it.
    """
    if max(fit.deviation[name] for name in names) > _SURE:
        return np.inf
    own = _score(parts, fit.row)
    without = with_values(fit.row, {name: value_in(before, name) for name in names})
    return own if own < _GAIN * min(score, _score(parts, without)) else np.inf


def _score(parts: Sequence[LoadedJoint], row: FloatArray) -> float:
    return float(np.abs(errors(parts, row)).mean())
