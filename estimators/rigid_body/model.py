"""RigidBodyModel: tau = Y_b(q, dq, ddq) phi_b, with friction; the first stage of the paper."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Self

import numpy as np

from estimators.base import Estimate
from estimators.rigid_body.base_parameters import find_base_parameters
from estimators.rigid_body.fitting.least_squares import choose_sign_widths, fit_base
from estimators.rigid_body.fitting.normal_equations import CHUNK, Rows, accumulate
from estimators.rigid_body.identification import nominal_parameters
from estimators.rigid_body.regressor import RegressorChain
from estimators.rigid_body.terms import JointTerms
from limo_driver.errors import NotFittedError, ShapeError
from limo_driver.model import RobotModel
from limo_driver.recordings.recording import Recording
from limo_driver.types import FloatArray, JointSample, Motion


class RigidBodyModel:
    """Torque of the rigid body with Coulomb and viscous friction, by least squares.

    Args:
        robot: Built-in name or URDF file.
        terms: What is modelled beside the inertias.
        rows: Which rows the fit uses; its bandwidth is also that of `predict`.
    """

    def __init__(
        self,
        robot: str | Path = "iiwa14",
        terms: JointTerms | None = None,
        rows: Rows | None = None,
    ) -> None:
        self.robot = robot
        self.terms = terms or JointTerms(offset=False, armature=False)
        self.rows = rows or Rows()

    def fit(self, recordings: Sequence[Recording]) -> Self:
        """Fit the base parameters.

        Raises:
            RecordingError: A recording is of another robot, or no row is left.
        """
        model = RobotModel.load(self.robot)
        self.base_ = find_base_parameters(model, self.terms)
        nominal = nominal_parameters(model, self.terms)
        sums = accumulate(model, self.terms, recordings, self.rows)
        choice = choose_sign_widths(sums, self.terms, self.base_, nominal)
        self.terms_ = choice.terms
        self.fit_ = fit_base(choice.equations, self.base_, nominal)
        self.parameters_ = self.base_.expand(self.fit_.parameters)
        self.chain_ = RegressorChain.of(model)
        return self

    def predict(self, recording: Recording) -> FloatArray:
        """Predict the torque of a recorded motion, (T, n) [N m].

        Raises:
            NotFittedError: `fit` has not been called.
        """
        return self.torque(recording.motion(self.rows.bandwidth))

    def torque(self, motion: Motion) -> FloatArray:
        """Return the torque of a motion, (T, n) [N m].

        Raises:
            NotFittedError: `fit` has not been called.
            ShapeError: The motion has another number of joints.
        """
        self._require_fitted()
        n = self.chain_.n
        if motion.n != n:
            raise ShapeError("motion", motion.position.shape, f"(T, {n})")
        links = self.chain_.width
        body, own = self.parameters_[:links], self.parameters_[links:]
        torque = np.empty(motion.position.shape)
        Y = np.zeros((n, min(CHUNK, len(motion)), links))
        for start in range(0, len(motion), CHUNK):
            chunk = motion[start : start + CHUNK]
            self.chain_.fill(chunk, Y)
            torque[start : start + CHUNK] = (Y[:, : len(chunk)] @ body).T
        columns = self.terms_.columns(motion.velocity, motion.acceleration)
        return torque + np.einsum("tjk,kj->tj", columns, own.reshape(-1, n))

    @property
    def n(self) -> int:
        """Number of joints.

        Raises:
            NotFittedError: `fit` has not been called.
        """
        self._require_fitted()
        return self.chain_.n

    @property
    def bandwidth(self) -> float:
        """Bandwidth of the filters on motion and torque [Hz]."""
        return self.rows.bandwidth

    def init(self, rate: float | None = None) -> None:  # noqa: ARG002  # any will do
        """Return no memory: the model has none.

        Raises:
            NotFittedError: `fit` has not been called.
        """
        self._require_fitted()

    def step(self, state: None, sample: JointSample) -> tuple[FloatArray, None]:
        """Return the torque (n,) [N m] of one sample.

        Raises:
            NotFittedError: `fit` has not been called.
        """
        return self.torque(sample.motion())[0], state

    def advance(self, state: None, motion: Motion) -> tuple[Estimate, None]:
        """Estimate T samples, see `LiveEstimator`; how sure that is, nobody knows.

        Raises:
            NotFittedError: `fit` has not been called.
            ShapeError: The motion has another number of joints.
        """
        return Estimate.unsure(self.torque(motion)), state

    def _require_fitted(self) -> None:
        if not hasattr(self, "parameters_"):
            raise NotFittedError("RigidBodyModel")
