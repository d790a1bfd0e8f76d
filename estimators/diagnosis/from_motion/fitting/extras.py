"""Effects of a joint and its drive beyond the usual ones: kept where they predict better.

The judge is motion that the fit has not seen, simulated forward.
"""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from functools import partial
from itertools import pairwise
from typing import TYPE_CHECKING, Final

import numpy as np

from estimators.diagnosis.from_motion.fitting.joint import (
    GLANCE,
    JointFit,
    errors,
    fit_joint,
    left_out,
)
from estimators.diagnosis.from_motion.fitting.starts import (
    LAGS,
    LimitStart,
    mean_distance,
    start_of_limit,
    with_lag,
)
from estimators.diagnosis.from_motion.simulation import constants as c
from estimators.diagnosis.settings import FEW, HALF, LITTLE, SOME

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping, Sequence

    from estimators.diagnosis.from_motion.simulation.one_joint import LoadedJoint
    from limo_driver.types import FloatArray


@dataclass(frozen=True)
class Extra:
    """An effect that may be there: what it adds to the constants that are fitted."""

    effect: str
    start: Mapping[str, float]  # constants to be fitted, and where from; of a limit, nothing yet
    limit: str = ""  # a constant that is felt where it is reached, and nowhere else
    shape: Mapping[str, float] = field(default_factory=dict)  # of its law, not fitted
    # Parts that are left of constants which a fit without it has raised in its place
    eased: Mapping[str, float] = field(default_factory=dict)
    of: tuple[str, ...] = c.GAINS  # gains of the drives that may have it

    def fits(self, row: FloatArray) -> bool:
        """Say whether a servo can have it.

        Args:
            row: The constants of its joint.
        """
        return c.gain_of(row) in self.of

    def begun(self, parts: Sequence[LoadedJoint], row: FloatArray) -> LimitStart:
        """Return constants and where their fit begins; none where nothing speaks for a limit.

        Args:
            parts: Recorded stretches.
            row: The constants without it.
        """
        known = mean_distance(parts, row)
        if not self.limit:
            return LimitStart(self.start, known, self.easing(row))
        best = start_of_limit(self.limit, parts, c.with_values(row, self.shape))
        return best if best.away < known else LimitStart({}, known)

    def fitted(
        self,
        row: FloatArray,
        parts: Sequence[LoadedJoint],
        names: tuple[str, ...],
        priors: Mapping[str, c.BelievedValue],
    ) -> JointFit | None:
        """Return a fit that has it, or None where nothing speaks for it.

        Args:
            row: The constants without it.
            parts: Recorded stretches.
            names: Of those that are fitted without it.
            priors: What is believed of some of them.
        """
        first = self.begun(parts, row)
        if not (start := first.values):
            return None
        begun = c.with_values(row, {**self.shape, **first.bent, **start})
        if self.shape and not _shows(parts, begun, row, self.shape):
            return None  # the same without that shape is tried
        return fit_joint(parts, begun, (*names, *start), priors, GLANCE)

    def easing(self, row: FloatArray) -> dict[str, float]:
        """Return what is left at first of the constants that took its place.

        Args:
            row: The constants without it.
        """
        return {name: part * c.value_in(row, name) for name, part in self.eased.items()}


PROFILE: Final = Extra(
    "profile_acceleration",
    {},
    "acceleration",
    {"straight": 1.0},
    {"inertia": SOME},
    of=("kp",),
)
EXTRAS: Final = (
    Extra("stribeck_friction", {"stribeck": 0.05, "v_s": 0.05}),
    Extra("load_dependent_friction", {"by_load": 0.4}, eased={c.COULOMB: SOME}),
    Extra("dead_band", {"dead_band": 0.005}, of=("kp",)),
    Extra("profile_speed", {}, "speed", of=("kp",)),
    Extra("profile_acceleration", {}, "acceleration", of=("kp",)),
    PROFILE,
    Extra("torque_limit", {}, "torque_limit"),
    Extra("integral_gain", {"ki": 10.0}, of=("kv",)),
)
_PIECE: Final = 10.0  # [s]
# The profile of hobby servos: LeRobot sets theirs to 254 times 100 steps/s² of 4096 steps a turn.
USUAL_PROFILE: Final = c.BelievedValue(39.0, SOME)  # [rad/s²]


def fit_with_extras(
    parts: Sequence[LoadedJoint],
    row: FloatArray,
    names: tuple[str, ...],
    priors: Mapping[str, c.BelievedValue],
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
    seen, unseen = alternate_pieces(parts)
    found: list[str] = []
    best = _best(seen, row, names, priors)
    score, waiting = _score(unseen, best.row), [one for one in EXTRAS if one.fits(row)]
    while len(found) < FEW:
        # a servo that is mostly at a limit looks like another, of less gain
        kept = (*(name for name in names if name not in c.base_of(row)), *PROFILE.shape)
        other = c.with_values(row, {name: best.value(name) for name in kept})
        bases = [
            (one, base) for one in waiting for base in (best.row, other)[: 1 + bool(one.limit)]
        ]
        with ThreadPoolExecutor() as pool:
            trial = partial(Extra.fitted, parts=seen, names=names, priors=priors)
            begun = list(pool.map(trial, *zip(*bases, strict=True))) if bases else []
        tried = [(one, fit) for (one, _), fit in zip(bases, begun, strict=True) if fit is not None]
        own = [_score(unseen, fit.row) for _, fit in tried]
        scores = [
            _proven(unseen, fit, best, value, score)
            for (_, fit), value in zip(tried, own, strict=True)
        ]
        at = int(np.argmin(scores)) if scores else 0
        if not scores or scores[at] == np.inf:
            break
        # what gains nothing is not tried again
        useful = [one for (one, _), value in zip(tried, own, strict=True) if value < score]
        extra, best = tried[at]
        score, names = scores[at], best.names
        found.append(extra.effect)
        waiting = [one for one in waiting if one in useful and one.effect != extra.effect]
    final = fit_joint(parts, best.row, best.names, priors)
    return left_out(final, parts, priors) if intervals else final, tuple(found)


def _shows(
    parts: Sequence[LoadedJoint], row: FloatArray, before: FloatArray, names: Iterable[str]
) -> bool:
    """Say whether a joint moves otherwise with some constants than with those of before.

    Args:
        parts: Recorded stretches.
        row: All constants.
        before: Those of before.
        names: Of these constants.
    """
    without = c.with_values(row, {name: c.value_in(before, name) for name in names})
    return not np.array_equal(errors(parts, row), errors(parts, without), equal_nan=True)


@dataclass(frozen=True)
class OfAKind:
    """A joint with an effect that another servo of its arm has."""

    fit: JointFit
    found: tuple[str, ...]  # the effects that it has beyond the usual ones
    ratio: float  # of errors on motion not seen, with it over without


def of_a_kind(
    parts: Sequence[LoadedJoint],
    fit: JointFit,
    found: tuple[str, ...],
    priors: Mapping[str, c.BelievedValue],
    *,
    intervals: bool,
) -> OfAKind:
    """Fit a joint with the profile that another servo of its arm has.

    Args:
        parts: Recorded stretches.
        fit: Of the joint without it.
        found: The effects that it has beyond the usual ones.
        priors: What is believed of some of its constants.
        intervals: Whether deviations are taken from motion that is left out.
    """
    believed, start = {**priors, "acceleration": USUAL_PROFILE}, PROFILE.easing(fit.row)
    begun = c.with_values(fit.row, {**PROFILE.shape, **start, "acceleration": USUAL_PROFILE.value})
    seen, unseen = alternate_pieces(parts)
    before = fit_joint(seen, fit.row, fit.names, priors, GLANCE)
    after = fit_joint(seen, begun, (*fit.names, "acceleration"), believed, GLANCE)
    final = fit_joint(parts, after.row, after.names, believed)
    kept = left_out(final, parts, believed) if intervals else final
    ratio = _score(unseen, after.row) / max(_score(unseen, before.row), c.LEAST)
    return OfAKind(kept, (*found, PROFILE.effect), ratio)


def alternate_pieces(
    parts: Sequence[LoadedJoint],
) -> tuple[list[LoadedJoint], list[LoadedJoint]]:
    """Return pieces to fit to, and those kept from it: every other one.

    One stretch may be the only fast one, and show alone what limits a servo: each is cut.
    """
    pieces = [piece for part in parts for piece in _pieces(part)]
    return pieces[0::2], pieces[1::2]


def _pieces(part: LoadedJoint) -> list[LoadedJoint]:
    many = max(2, int((part.time[-1] - part.time[0]) / _PIECE))
    bounds = np.linspace(0, part.time.size, many + 1).astype(int)
    return [part.between(a, b) for a, b in pairwise(bounds.tolist())]


def _best(
    parts: Sequence[LoadedJoint],
    row: FloatArray,
    names: tuple[str, ...],
    priors: Mapping[str, c.BelievedValue],
) -> JointFit:
    """Return the best fit of those that begin with each of the lags."""
    lags = LAGS[c.gain_of(row)]
    begun = [fit_joint(parts, with_lag(row, lag), names, priors, GLANCE) for lag in lags]
    best = min(begun, key=lambda fit: fit.mean_error)
    return fit_joint(parts, best.row, names, priors)


def _proven(
    parts: Sequence[LoadedJoint],
    fit: JointFit,
    before: JointFit,
    own: float,
    score: float,
) -> float:
    """Return the error of a fit on motion that it has not seen; infinite if it proves nothing.

    Its gain has to be that of the new constants: without them, all others as fitted, it is lost.

    Args:
        parts: That motion.
        fit: With the effect.
        before: The fit without it.
        own: Error with it [rad].
        score: Error without it [rad].
    """
    names = [name for name in fit.names if name not in before.names]
    if max(fit.deviation[name] for name in names) > HALF:
        return np.inf
    without = c.with_values(fit.row, {name: before.value(name) for name in names})
    return own if own < (1 - LITTLE) * min(score, _score(parts, without)) else np.inf


def _score(parts: Sequence[LoadedJoint], row: FloatArray) -> float:
    return float(np.abs(errors(parts, row)).mean())
