"""What changed on an arm since a model was trained: offset, friction and gain.

From one day to the next, sensors drift and friction follows temperature and grease. No motion held
out from training shows that, so no interval of a model can have it. Where torque is measured, the
errors themselves tell it, slowly: of each joint

    e = o + f tanh(v / w) + g tau / tau_rms + noise,  noise ~ N(0, (k s)²),

with the offset o, the change f of dry friction, that of the gain g by the predicted torque tau, and
the model's own standard deviation s, which is off by a factor k. Offset, friction and gain are what
the errors so far, weighed down by their age, say, with what is believed before any: 0 within two
standard deviations of the model. Errors are alike for about a second; so many rows count as one,
which keeps them slower than a push. The factor is that of conformal inference: it grows by e^.95
with an independent error that its interval missed, and shrinks by e^.05 with one that it held, so
that 95 % are held in the long run whatever their distribution.

What is known for a row comes from errors at least `LAG` before it: no error explains itself.

Source: Kalman, "A new approach to linear filtering and prediction problems", 1960; Gelman et al.,
"Bayesian data analysis", 2013, sec. 3.3 (the factor); Gibbs and Candès, "Adaptive conformal
inference under distribution shift", NeurIPS 2021 (intervals that follow what they held so far).
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np

from estimators.base import DEVIATIONS
from limo_driver.runtime.compiled import compiled

if TYPE_CHECKING:
    from limo_driver.types import BoolArray, FloatArray

LAG: Final = 0.5  # [s] between the last error that is known and the row it is used for
_ALIKE: Final = 1.0  # [s] for which errors are alike
_BEFORE: Final = 2.0  # [standard deviations of the model], of all changes before any error
_FORGOTTEN: Final = 300.0  # [s] after which changes may be any, as before
_MISSES: Final = 0.05  # of the intervals
_WIDEST: Final = float(np.log(4.0))  # logarithm of a factor; after a push, it has to come back
_SIGN_WIDTH: Final = 0.02  # [rad/s]
_NUMBER: Final = re.compile(r"(?<=: )\S+")
_CHANGES: Final = ("offset", "friction", "gain")
_LARGEST: Final = 4.0  # [standard deviations], as which a larger error counts: it is a push
_SURE: Final = 3.0  # standard deviations of a change that is reported
_LONGEST: Final = 0.1  # [s] between rows, that a gap counts as
_PATIENCE: Final = 30.0  # [s] of errors, before which nothing is reported live


@dataclass(frozen=True)
class Changes:
    """What surely changed on n joints."""

    found: FloatArray  # (n, 3) [N m]: offset, friction, gain times the scale
    unsure: FloatArray  # (n, 3) [N m], one standard deviation of each
    usual: FloatArray  # (n,) [N m], standard deviation of the model
    scale: FloatArray  # (n,) [N m], RMS of the predicted torque

    @property
    def values(self) -> FloatArray:
        """Offset and friction [N m], and gain as a part of the torque, (n, 3)."""
        none = np.ones_like(self.scale)
        scale = np.where(self.scale > 0.0, self.scale, np.inf)
        return self.found / np.stack([none, none, scale], axis=1)

    def describe(self, names: tuple[str, ...], units: tuple[str, ...]) -> tuple[str, ...]:
        """Say which joints surely changed by more than the model's own standard deviation.

        Args:
            names: Of the joints, (n,).
            units: Of their torques, (n,).
        """
        lines: list[str] = []
        sure = np.abs(self.found) > np.maximum(_SURE * self.unsure, self.usual[:, None])
        for j, k in np.argwhere(sure):
            own = self.values[j, k]
            value = f"{own:+.1%}" if _CHANGES[k] == "gain" else f"{own:+.2g} {units[j]}"
            lines.append(f"{_CHANGES[k]} since training: {value} at {names[j]}")
        return tuple(lines)


@dataclass(frozen=True)
class SlowChange(Changes):
    """What the errors before each of T rows say; what was found at the end."""

    torque: FloatArray  # (T, n) [N m], offset, friction and gain at the motion of the row
    std: FloatArray  # (T, n) [N m], of the error that is left

    @classmethod
    def of(
        cls,
        error: FloatArray,
        std: FloatArray,
        velocity: FloatArray,
        predicted: FloatArray,
        time: FloatArray,
    ) -> SlowChange:
        """Follow the errors of a model.

        Args:
            error: Measured less predicted torque, both behind one filter, (T, n) [N m]; NaN where
                it is not known.
            std: The model's own standard deviation, (T, n) [N m], above 0.
            velocity: Of the joints, (T, n) [rad/s].
            predicted: Torque, (T, n) [N m].
            time: Of the rows, rising, (T,) [s].
        """
        usual, scale = np.median(std, axis=0), np.sqrt(np.mean(predicted**2, axis=0))
        share = predicted / np.where(scale > 0.0, scale, 1.0)
        torque, left, mean, cov = _follow(error, std, velocity, share, time, usual)
        unsure = np.sqrt(np.diagonal(cov, axis1=1, axis2=2))
        return cls(mean, unsure, usual, scale, torque, left)

    def held(self, error: FloatArray) -> FloatArray:
        """Return the part of errors (T, n) that is within the 95 % intervals, (n,)."""
        within = np.abs(error - self.torque) <= DEVIATIONS * self.std
        return np.asarray(np.mean(within, axis=0), dtype=np.float64)


@compiled(reads=("error", "std", "velocity", "share", "time", "usual"), nogil=True)
def _follow(
    error: FloatArray,
    std: FloatArray,
    velocity: FloatArray,
    share: FloatArray,
    time: FloatArray,
    usual: FloatArray,
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Return torque and deviation of each row (T, n), and the end (n, 3) with its covariance."""
    T, n = error.shape
    torque, left = np.empty((T, n)), np.empty((T, n))
    mean, cov = np.zeros((n, 3)), np.zeros((n, 3, 3))
    h = np.ones(3)
    for j in range(n):
        prior = (_BEFORE * usual[j]) ** 2
        factor = 0.0  # its logarithm
        known = 0  # rows whose errors are
        cov[j] = np.eye(3) * prior
        for t in range(T):
            while known < t and time[known] <= time[t] - LAG:
                step = min(time[known] - time[known - 1], _LONGEST) if known else 0.0
                own = error[known, j]
                if step > 0.0 and np.isfinite(own):
                    h[1], h[2] = np.tanh(velocity[known, j] / _SIGN_WIDTH), share[known, j]
                    learn_change(
                        mean[j], cov[j], own, std[known, j] * np.exp(factor), h, step, prior
                    )
                    missed = abs(own - torque[known, j]) > DEVIATIONS * left[known, j]
                    factor += step / _ALIKE * ((1.0 if missed else 0.0) - _MISSES)
                    factor = min(max(factor, -_WIDEST), _WIDEST)
                known += 1
            h[1], h[2] = np.tanh(velocity[t, j] / _SIGN_WIDTH), share[t, j]
            torque[t, j] = np.dot(h, mean[j])
            left[t, j] = np.sqrt(std[t, j] ** 2 + np.dot(h, cov[j] @ h)) * np.exp(factor)
    return torque, left, mean, cov


@compiled(nogil=True)
def learn_change(
    mean: FloatArray,
    cov: FloatArray,
    error: float,
    std: float,
    h: FloatArray,
    step: float,
    prior: float,
) -> None:
    """Learn from one error of one joint what changed, in place.

    Args:
        mean: Offset, friction and gain so far, (3,) [N m].
        cov: Their covariance, (3, 3).
        error: Measured less predicted torque [N m].
        std: Of it [N m].
        h: What each contributes to the error, (3,).
        step: Time since the error before [s].
        prior: Variance of each before any error [N² m²].
    """
    cov += np.eye(3) * (prior * step / _FORGOTTEN)
    toward = cov @ h
    spread = np.dot(h, toward)
    most = _LARGEST * np.sqrt(std**2 + spread)
    innovation = min(max(error - np.dot(h, mean), -most), most)
    gain = 1.0 / (spread + std**2 * _ALIKE / step)
    mean += toward * (gain * innovation)
    cov -= np.outer(toward, toward) * gain


class ChangeWatch:
    """Follows offset and friction live, a few times a second; a gain needs motion of use to tell.

    Args:
        names: Of the joints, (n,).
        units: Of their torques, (n,); N m if not given.
    """

    def __init__(self, names: tuple[str, ...], units: tuple[str, ...] = ()) -> None:
        n = len(names)
        self._names, self._units = names, units or ("N m",) * n
        self._found, self._cov = np.zeros((n, 3)), np.zeros((n, 3, 3))
        self._usual = np.full(n, np.nan)  # [N m], the model's own standard deviation
        self._learned = np.zeros(n)  # [s] of errors
        self._time, self._position = np.nan, np.zeros(n)  # [s], [rad], of the step before
        self._known: frozenset[str] = frozenset()  # changes that were reported
        learn_change(np.zeros(3), np.eye(3), 0.0, 1.0, np.ones(3), 1.0, 1.0)  # compiles

    def step(
        self,
        time: float,
        external: FloatArray,
        std: FloatArray,
        free: BoolArray,
        position: FloatArray,
    ) -> tuple[str, ...]:
        """Learn from an answer; say what is newly sure.

        Args:
            time: Of the state that was answered [s].
            external: Measured less estimated torque, (n,) [N m]; NaN where none was measured.
            std: Of the estimate, (n,) [N m]; NaN where the model does not say.
            free: Joints of which no contact is known, and velocities are, (n,).
            position: Of the state, (n,) [rad].
        """
        step, moved = time - self._time, position - self._position
        self._time, self._position = time, position.copy()
        for j in np.flatnonzero(free & np.isfinite(external) & (std > 0.0) & (step > 0.0)):
            if np.isnan(self._usual[j]):
                self._usual[j], self._cov[j] = std[j], np.eye(3) * (_BEFORE * std[j]) ** 2
            h = np.array([1.0, np.tanh(moved[j] / step / _SIGN_WIDTH), 0.0])
            prior = (_BEFORE * self._usual[j]) ** 2
            own = self._found[j], self._cov[j], external[j], std[j]
            learn_change(*own, h, min(step, _LONGEST), prior)
            self._learned[j] += min(step, _LONGEST)
        lines, before = {_NUMBER.sub("", line): line for line in self.lines}, self._known
        self._known = before.union(lines)
        return tuple(line for what, line in lines.items() if what not in before)

    @property
    def lines(self) -> tuple[str, ...]:
        """What surely changed since training."""
        unsure = np.sqrt(np.diagonal(self._cov, axis1=1, axis2=2))
        usual = np.where(self._learned > _PATIENCE, self._usual, np.inf)
        changes = Changes(self._found, unsure, usual, usual)
        return changes.describe(self._names, self._units)
