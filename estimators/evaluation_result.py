"""EvaluationResult: the torques that were measured and predicted over a recording.

What changed on an arm since a model was trained: offset, friction and size of the errors.

From one day to the next, sensors drift and friction follows temperature and grease. No motion held
out from training shows that, so no interval of a model can have it. Where torque is measured, the
errors themselves tell it, slowly: of each joint

    e = o + f tanh(v / w) + noise,  noise ~ N(0, k s²),

with the offset o, the change f of dry friction, and the model's own standard deviation s, which is
off by a factor √k. All three are what the errors so far, weighed down by their age, say, with what
is believed before any: o and f are 0 within two standard deviations of the model, and k is 1 as if
ten independent errors had shown it. Errors are alike for about a second; so many rows count as one
error, which keeps all three slower than a push.

What is known for a row comes from errors at least `LAG` before it: no error explains itself.

Source: Kalman, "A new approach to linear filtering and prediction problems", 1960; Gelman et al.,
"Bayesian data analysis", 2013, sec. 3.3 (the factor); Gibbs and Candès, "Adaptive conformal
inference under distribution shift", NeurIPS 2021 (intervals that follow what they held so far).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from estimators.base import DEVIATIONS
from limo_driver.model.units import unit_of
from limo_driver.runtime.compiled import compiled
from limo_driver.runtime.display import Displayed

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from numpy.typing import NDArray

    from estimators.base import Estimate
    from limo_driver.model import RobotModel
    from limo_driver.recordings.recording import Recording
    from limo_driver.types import FloatArray, Motion

LAG: Final = 0.5  # [s] between the last error that is known and the row it is used for
_ALIKE: Final = 1.0  # [s] for which errors are alike
_BEFORE: Final = 2.0  # [standard deviations of the model], of offset and friction before any error
_BELIEVED: Final = 10.0  # independent errors that the model's own deviation is worth
_FORGOTTEN: Final = 300.0  # [s] after which offset and friction may be any, as before
_MEMORY: Final = 30.0  # independent errors that the factor remembers
_SIGN_WIDTH: Final = 0.02  # [rad/s]
_LARGEST: Final = 4.0  # [standard deviations], as which a larger error counts: it is a push
_SURE: Final = 3.0  # standard deviations of a change that is reported
_LONGEST: Final = 0.1  # [s] between rows, that a gap counts as


@dataclass(frozen=True)
class SlowChange:
    """What the errors before each of T rows say of n joints."""

    torque: FloatArray  # (T, n) [N m], offset and friction at the motion of the row
    std: FloatArray  # (T, n) [N m], of the error that is left
    offset: FloatArray  # (n,) [N m], at the end
    friction: FloatArray  # (n,) [N m], likewise
    unsure: FloatArray  # (n, 2) [N m], one standard deviation of both
    usual: FloatArray  # (n,) [N m], the model's own, in the median

    @classmethod
    def of(
        cls, error: FloatArray, std: FloatArray, velocity: FloatArray, time: FloatArray
    ) -> SlowChange:
        """Follow the errors of a model.

        Args:
            error: Measured less predicted torque, both behind one filter, (T, n) [N m]; NaN where
                it is not known.
            std: The model's own standard deviation, (T, n) [N m], above 0.
            velocity: Of the joints, (T, n) [rad/s].
            time: Of the rows, rising, (T,) [s].
        """
        usual = np.median(std, axis=0)
        found, left, end, unsure = _follow(error, std, velocity, time, usual)
        return cls(found, left, end[:, 0], end[:, 1], unsure, usual)

    def describe(self, names: tuple[str, ...], units: tuple[str, ...]) -> tuple[str, ...]:
        """Say which joints surely changed by more than the model's own standard deviation.

        Args:
            names: Of the joints, (n,).
            units: Of their torques, (n,).
        """
        values = np.stack([self.offset, self.friction], axis=1)
        sure = np.abs(values) > np.maximum(_SURE * self.unsure, self.usual[:, None])
        return tuple(
            f"{what} since training: {values[j, k]:+.2g} {units[j]} at {name}"
            for j, name in enumerate(names)
            for k, what in enumerate(("offset", "friction"))
            if sure[j, k]
        )

    def held(self, error: FloatArray) -> FloatArray:
        """Return the part of errors (T, n) that is within the 95 % intervals, (n,)."""
        within = np.abs(error - self.torque) <= DEVIATIONS * self.std
        return np.asarray(np.mean(within, axis=0), dtype=np.float64)


@compiled(reads=("error", "std", "velocity", "time", "usual"), nogil=True)
def _follow(
    error: FloatArray,
    std: FloatArray,
    velocity: FloatArray,
    time: FloatArray,
    usual: FloatArray,
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Return torque and deviation of each row (T, n), and the end with its deviations (n, 2)."""
    T, n = error.shape
    torque, left = np.empty((T, n)), np.empty((T, n))
    end, unsure = np.empty((n, 2)), np.empty((n, 2))
    for j in range(n):
        prior = (_BEFORE * usual[j]) ** 2
        o, f, a, b, c = 0.0, 0.0, prior, 0.0, prior  # mean and covariance [[a, b], [b, c]]
        count, total = _BELIEVED, _BELIEVED
        known = 0  # rows whose errors are
        for t in range(T):
            while known < t and time[known] <= time[t] - LAG:
                step = min(time[known] - time[known - 1], _LONGEST) if known else 0.0
                own = error[known, j]
                if step > 0.0 and np.isfinite(own):
                    worth = step / _ALIKE
                    a, c = a + prior * step / _FORGOTTEN, c + prior * step / _FORGOTTEN
                    s = np.tanh(velocity[known, j] / _SIGN_WIDTH)
                    ah, ch = a + b * s, b + c * s
                    noise = std[known, j] ** 2 * total / count
                    spread = ah + s * ch
                    deviation = np.sqrt(noise + spread)
                    innovation = own - o - f * s
                    most = _LARGEST * deviation
                    innovation = min(max(innovation, -most), most)
                    gain = 1.0 / (spread + noise / worth)
                    o, f = o + ah * gain * innovation, f + ch * gain * innovation
                    a, b, c = a - ah * ah * gain, b - ah * ch * gain, c - ch * ch * gain
                    keep = 1.0 - worth / _MEMORY
                    square = innovation**2 / (std[known, j] ** 2 + spread)
                    count, total = keep * count + worth, keep * total + worth * square
                known += 1
            s = np.tanh(velocity[t, j] / _SIGN_WIDTH)
            torque[t, j] = o + f * s
            left[t, j] = np.sqrt(std[t, j] ** 2 * total / count + a + 2.0 * b * s + c * s * s)
        end[j, 0], end[j, 1] = o, f
        unsure[j, 0], unsure[j, 1] = np.sqrt(a), np.sqrt(c)
    return torque, left, end, unsure


@dataclass(frozen=True)
class Errors:
    """Errors of one predictor, of each joint."""

    rmse: FloatArray  # (n,) [N m]; NaN for joints whose torque was not measured

    @property
    def mse(self) -> FloatArray:
        """Mean squared error, (n,) [(N m)²]."""
        return self.rmse**2

    @property
    def mean_mse(self) -> float:
        """Mean squared error over the joints whose torque was measured [(N m)²]."""
        return float(np.nanmean(self.mse))


@dataclass(frozen=True, repr=False)
class EvaluationResult(Displayed):
    """Torques measured and predicted over a recording, and their errors.

    All torques went through the zero-phase low-pass that the measured one went through in training:
    what only the filter makes of a torque is no error of who predicts it. Rows near the end of a
    stretch, whose derivatives are unsure, are not scored.
    """

    model: str  # name of the estimator
    recording: Recording
    motion: Motion
    measured: FloatArray  # (T, n) [N m], filtered; NaN for joints whose torque was not measured
    estimate: Estimate  # filtered
    frictionless: FloatArray  # (T, n) [N m], of the simulation without its joint physics, filtered
    scored: NDArray[np.bool_]  # (T,)
    bandwidth: float  # [Hz]
    robot: RobotModel
    joint_names: tuple[str, ...]
    noise_floor: FloatArray  # (n,) [N m], of the noise left in `measured`; NaN where unknown
    trained_on: bool  # the model, on this very file; its errors elsewhere are larger

    @property
    def rigid_body(self) -> Errors:
        """Errors of the simulation alone."""
        return self._errors(self.estimate.simulation)

    @property
    def contribution(self) -> FloatArray:
        """RMS of the torque that the network adds, (n,) [N m]."""
        return np.sqrt(np.mean(self.estimate.learned[self.scored] ** 2, axis=0))

    @property
    def hybrid(self) -> Errors:
        """Errors of the hybrid."""
        return self._errors(self.estimate.torque)

    @property
    def coverage(self) -> FloatArray:
        """Part of the rows within 1.96 standard deviations, (n,); NaN where these are unknown."""
        std = self.estimate.std[self.scored]
        within = np.mean(np.abs(self._residual) <= DEVIATIONS * std, axis=0)
        known = np.isfinite(std).all(axis=0) & self.recording.measured_joints
        return np.where(known, within, np.nan)

    @cached_property
    def change(self) -> SlowChange | None:
        """What slowly changed since training; None where a model does not know its errors."""
        std = self.estimate.std[self.scored]
        if not (np.isfinite(std) & (std > 0)).all():
            return None
        velocity, time = self.motion.velocity[self.scored], self.recording.time[self.scored]
        return SlowChange.of(self._residual, std, velocity, time)

    @property
    def coverage_with_change(self) -> FloatArray:
        """Likewise, where offset, friction and size of the errors follow those before, (n,)."""
        if self.change is None:
            return np.full(len(self.joint_names), np.nan)
        within = self.change.held(self._residual)
        return np.where(self.recording.measured_joints, within, np.nan)

    @property
    def changed(self) -> tuple[str, ...]:
        """Offsets and friction that surely changed since training, in words."""
        return () if self.change is None else self.change.describe(self.joint_names, self.units)

    @property
    def units(self) -> tuple[str, ...]:
        """Units of the joints' torques: N of those that slide."""
        return tuple(unit_of("N m", self.robot.sliding, j) for j in range(self.robot.n))

    @property
    def _residual(self) -> FloatArray:
        """Measured less predicted torque of the scored rows, (T, n) [N m]."""
        return (self.measured - self.estimate.torque)[self.scored]

    @property
    def outside(self) -> FloatArray:
        """Part of the rows whose motion is unlike what was learned, (n,)."""
        return np.asarray(self.estimate.outside[self.scored].mean(axis=0), dtype=np.float64)

    @property
    def mse_ratio(self) -> FloatArray:
        """MSE of the rigid body over that of the hybrid, (n,)."""
        return self.rigid_body.mse / self.hybrid.mse

    @property
    def mean_mse_ratio(self) -> float:
        """The same with both MSE averaged over the joints first, as in the paper's table."""
        return self.rigid_body.mean_mse / self.hybrid.mean_mse

    def _errors(self, predicted: FloatArray) -> Errors:
        residual = (self.measured - predicted)[self.scored]
        return Errors(np.sqrt(np.mean(residual**2, axis=0)))

    def headline(self) -> str:
        """Say how much less the error is than that of the rigid body."""
        unit = unit_of("N m", self.robot.sliding)
        return (
            f"{self.model}: mean MSE {self.hybrid.mean_mse:.3g} ({unit})², rigid body "
            f"{self.rigid_body.mean_mse:.3g} ({unit})², over {int(self.scored.sum())} samples"
            + (f" of {self.recording.source}" if self.recording.source else "")
            + (", which it was trained on" if self.trained_on else "")
        )

    def figures(self) -> Mapping[str, Sequence[object]]:
        """Return the errors of each joint beside the noise floor."""
        unit = unit_of("N m", self.robot.sliding)
        return {
            "joint": self.joint_names,
            f"RMSE of the rigid body [{unit}]": self.rigid_body.rmse.tolist(),
            f"of the model [{unit}]": self.hybrid.rmse.tolist(),
            f"noise floor [{unit}]": self.noise_floor.tolist(),
            "within the 95 % interval": _percents(self.coverage),
            "with what changed": _percents(self.coverage_with_change),
        }

    def as_values(self) -> dict[str, Any]:
        """Return the figures as JSON values."""
        per_joint = {
            "rmse_rigid_body": self.rigid_body.rmse,
            "rms_network": self.contribution,
            "rmse_hybrid": self.hybrid.rmse,
            "mse_rigid_body": self.rigid_body.mse,
            "mse_hybrid": self.hybrid.mse,
            "mse_ratio": self.mse_ratio,
            "noise_floor": self.noise_floor,
            "coverage_of_95_percent": self.coverage,
            "coverage_with_change": self.coverage_with_change,
            "outside": self.outside,
        }
        if self.change is not None:
            per_joint |= {"offset": self.change.offset, "friction_change": self.change.friction}
        return {
            "schema": 1,
            "model": self.model,
            "recording": self.recording.source,
            "trained_on": self.trained_on,
            "bandwidth": self.bandwidth,
            "samples": int(self.scored.sum()),
            "joints": list(self.joint_names),
            "torque_units": list(self.units),
            **{
                name: [float(v) if np.isfinite(v) else None for v in values]
                for name, values in per_joint.items()
            },
            "changed": list(self.changed),
            "mean_mse_rigid_body": self.rigid_body.mean_mse,
            "mean_mse_hybrid": self.hybrid.mean_mse,
            "mean_mse_ratio": self.mean_mse_ratio,
        }


def _percents(parts: FloatArray) -> list[str]:
    return ["-" if np.isnan(part) else f"{part:.0%}" for part in parts]
