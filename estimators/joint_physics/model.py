"""JointPhysics: torque linear in the physics of each joint, with a standard deviation."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from estimators.base import Estimate
from estimators.hybrid import TorqueParts
from estimators.joint_physics.calibration import Calibration, calibrate, leverage_of
from estimators.joint_physics.columns import Columns
from estimators.joint_physics.evidence import fit
from estimators.joint_physics.normal_equations import FOLDS, NormalEquations
from estimators.model_folder import provenance
from limo_driver.errors import NotFittedError, ShapeError

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping, Sequence
    from pathlib import Path
    from typing import Self

    from numpy.typing import NDArray

    from estimators.joint_physics.columns import Rows
    from limo_driver.physics import Simulation
    from limo_driver.recording import Recording
    from limo_driver.types import FloatArray, JointSample, Motion

_ROWS: Final = 1024  # whose columns are held at a time


@dataclass(frozen=True)
class FittedPhysics:
    """What the data of n joints say about the weights of K columns each."""

    weights: FloatArray  # (n, K)
    root: FloatArray  # (n, K, K), R with covariance Rᵀ R of the weights
    calibration: Calibration
    record: Mapping[str, Any] = field(default_factory=dict)  # data and errors, as JSON

    @classmethod
    def of(
        cls, sums: NormalEquations, columns: Columns, recordings: Sequence[Recording]
    ) -> FittedPhysics:
        """Fit the weights, and calibrate their uncertainty on folds that were left out."""
        whole = [sums.evidence(j) for j in range(columns.n)]
        fits = [
            fit(
                everything,
                [sums.evidence(j, without=fold) for fold in range(FOLDS)],
                columns.family,
            )
            for j, everything in enumerate(whole)
        ]
        rmse = {
            "simulation": [float(np.sqrt(own.energy / own.rows)) for own in whole],
            "held_out": [float(np.sqrt(found.held_out)) for found in fits],
        }
        return cls(
            np.stack([found.posterior.weights for found in fits]),
            np.stack([found.posterior.root for found in fits]),
            calibrate(sums.judged, fits),
            {"recordings": [provenance(recording) for recording in recordings], "rmse": rmse},
        )

    def torque(self, rows: Rows) -> FloatArray:
        """Return what T rows add to the simulation, (T, n) [N m]."""
        return np.matmul(rows.columns, self.weights[:, :, None])[:, :, 0].T


@dataclass(frozen=True)
class JointPhysicsState:
    """Memory after a sample."""

    simulation: tuple[Any, ...]
    columns: FloatArray


class JointPhysics:
    """Predict tau_j = tau_S,j + x_j · w_j, x_j the physics of joint j, and how sure that is.

    tau_S is the prediction of a simulation, normally an identified one. What it leaves is fitted by
    Bayesian linear regression in columns that physics suggests, so that little data is enough and
    motion larger than that of the data is predicted as physics continues, see `Columns`.

    Args:
        simulation: Gives tau_S, and with its rigid body the columns.
        bandwidth: Of the zero-phase filters on motion and torque [Hz].
    """

    name = "joint-physics"

    def __init__(self, simulation: Simulation, bandwidth: float = 10.0) -> None:
        self.simulation = simulation
        self.bandwidth = bandwidth
        self.columns = Columns(simulation.body, bandwidth)
        self.fitted_: FittedPhysics | None = None

    @classmethod
    def load(cls, folder: Path | str) -> JointPhysics:
        """Read a model folder; runs no code from it.

        Raises:
            ModelStoreError: The folder is incomplete or does not fit together, by name.
        """
        from estimators.joint_physics.store import load

        return load(folder)

    def save(self, folder: Path | str) -> None:
        """Write the model folder: weights, manifest and the simulation."""
        from estimators.joint_physics.store import save

        save(self, folder)

    @property
    def fitted(self) -> FittedPhysics:
        """What `fit` found.

        Raises:
            NotFittedError: Nothing was fitted or loaded.
        """
        if self.fitted_ is None:
            raise NotFittedError(self.name)
        return self.fitted_

    def fit(self, recordings: Sequence[Recording]) -> Self:
        """Fit the weights to what the simulation leaves of the filtered torque.

        Raises:
            RecordingError: There is none, one is of another robot, or they are too short.
        """
        sums = NormalEquations.of(self.simulation, self.columns, recordings)
        self.fitted_ = FittedPhysics.of(sums, self.columns, recordings)
        return self

    def predict(self, recording: Recording) -> FloatArray:
        """Predict the torque of a recorded motion, (T, n) [N m]; its torque is not looked at.

        Raises:
            NotFittedError: Nothing was fitted or loaded.
            ShapeError: The recording has another number of joints.
        """
        return self._over(recording, lambda torque, rows: (torque + self.fitted.torque(rows),))[0]

    def parts(self, recording: Recording) -> TorqueParts:
        """Predict as `predict` does, and keep the parts: simulation, and what is added to it."""
        parts = self._over(recording, lambda torque, rows: (torque, self.fitted.torque(rows)))
        return TorqueParts(*parts)

    def estimate(self, recording: Recording) -> Estimate:
        """Predict the torque of a recorded motion, its standard deviation, and where it is unsure.

        Raises:
            NotFittedError: Nothing was fitted or loaded.
            ShapeError: The recording has another number of joints.
        """
        torque, std, outside = self._over(recording, self._estimate)
        return Estimate(torque, std, outside)

    def init(self) -> JointPhysicsState:
        """Return the memory before the first sample.

        Raises:
            NotFittedError: Nothing was fitted or loaded.
        """
        _ = self.fitted
        return JointPhysicsState(self.simulation.init(), self.columns.init())

    def step(
        self, state: JointPhysicsState, sample: JointSample
    ) -> tuple[FloatArray, JointPhysicsState]:
        """Predict the torque of the next sample, (n,) [N m], and return the memory after it.

        Raises:
            NotFittedError: Nothing was fitted or loaded.
            ShapeError: The sample has another number of joints.
        """
        fitted = self.fitted
        torque, rows, after = self._advance(state, sample.motion())
        return (torque + fitted.torque(rows))[0], after

    def estimate_step(
        self, state: JointPhysicsState, sample: JointSample
    ) -> tuple[Estimate, JointPhysicsState]:
        """Do as `step` does, with standard deviation and flag of each joint, (n,)."""
        torque, rows, after = self._advance(state, sample.motion())
        return Estimate(*(values[0] for values in self._estimate(torque, rows))), after

    def _estimate(self, torque: FloatArray, rows: Rows) -> tuple[NDArray[Any], ...]:
        fitted = self.fitted
        leverage = np.stack(
            [leverage_of(x, R) for x, R in zip(rows.columns, fitted.root, strict=True)], axis=1
        )
        std, outside = fitted.calibration.std(leverage), fitted.calibration.outside(leverage)
        return torque + fitted.torque(rows), std, outside | ~rows.settled

    def _over(
        self,
        recording: Recording,
        values: Callable[[FloatArray, Rows], tuple[NDArray[Any], ...]],
    ) -> tuple[NDArray[Any], ...]:
        """Evaluate `values` of torque and columns over a recording, chunk by chunk."""
        self._check_joints(recording.position.shape)
        motion = recording.motion(self.bandwidth)
        parts = [
            values(*chunk) for rows in recording.segments for chunk in self._chunks(motion[rows])
        ]
        return tuple(np.concatenate(part) for part in zip(*parts, strict=True))

    def _chunks(self, motion: Motion) -> Iterator[tuple[FloatArray, Rows]]:
        state = self.init()
        for start in range(0, len(motion), _ROWS):
            torque, rows, state = self._advance(state, motion[start : start + _ROWS])
            yield torque, rows

    def _advance(
        self, state: JointPhysicsState, motion: Motion
    ) -> tuple[FloatArray, Rows, JointPhysicsState]:
        self._check_joints(motion.position.shape)
        torque, simulation = self.simulation.advance(state.simulation, motion)
        rows, columns = self.columns.advance(state.columns, motion, torque)
        return torque, rows, JointPhysicsState(simulation, columns)

    def _check_joints(self, shape: tuple[int, ...]) -> None:
        n = self.columns.n
        if shape[-1] != n:
            raise ShapeError("position", shape, f"(T, {n})")
