"""EvaluationResult: the torques that were measured and predicted over a recording."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np

from estimators.base import DEVIATIONS, Estimate
from estimators.slow_change import SlowChange
from limo_driver.model.units import unit_of
from limo_driver.runtime.display import Displayed

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from limo_driver.model import RobotModel
    from limo_driver.recordings.recording import Recording
    from limo_driver.types import BoolArray, FloatArray, Motion


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
    scored: BoolArray  # (T,)
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
        predicted = self.estimate.torque[self.scored]
        return SlowChange.of(self._residual, std, velocity, predicted, time)

    @property
    def coverage_with_change(self) -> FloatArray:
        """Likewise, where offset, friction, gain and interval follow the errors before, (n,)."""
        if self.change is None:
            return np.full(len(self.joint_names), np.nan)
        within = self.change.held(self._residual)
        return np.where(self.recording.measured_joints, within, np.nan)

    @property
    def changed(self) -> tuple[str, ...]:
        """Offset, friction and gain that surely changed since training, in words."""
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
            names = ("offset", "friction_change", "gain_change")
            per_joint |= dict(zip(names, self.change.values.T, strict=True))
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
