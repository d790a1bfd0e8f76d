"""Base parameters: the combinations of inertial and joint parameters that torque can reveal."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from estimators.rigid_body.dynamics.regressor import PER_LINK, RegressorChain
from limo_driver.types import FloatArray, Motion

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from estimators.rigid_body.terms import JointTerms
    from limo_driver.model import RobotModel

_SAMPLES = 100  # random samples, n equations each
_INDEPENDENT = 1e-8  # part of a unit column that has to be new
_FASTEST = 2.0  # [rad/s] and [rad/s²] of the random motion


@dataclass(frozen=True)
class BaseParameters:
    """Independent columns of the full regressor, and how the others depend on them.

    The full parameters are 10 for each link, then n for each joint term. For every motion,
    Y phi = Y[:, independent] (phi[independent] + mixing phi[dependent]).
    """

    independent: NDArray[np.int64]  # (b,)
    dependent: NDArray[np.int64]  # (d,)
    mixing: FloatArray  # (b, d)

    @property
    def rank(self) -> int:
        """Number b of base parameters."""
        return self.independent.size

    def reduce(self, full: FloatArray) -> FloatArray:
        """Return the base parameters (b,) of full parameters."""
        return full[self.independent] + self.mixing @ full[self.dependent]

    def expand(self, base: FloatArray) -> FloatArray:
        """Return full parameters that predict the same torque; the dependent ones are zero."""
        full = np.zeros(self.independent.size + self.dependent.size)
        full[self.independent] = base
        return full


def find_base_parameters(model: RobotModel, terms: JointTerms) -> BaseParameters:
    """Find the base parameters of a robot from its geometry, by QR of a random regressor.

    Columns are taken in an order that keeps joint terms before inertias and drops what comes late:
    friction and offset, then the links' parameters, then armature. An armature that cannot be told
    from an inertia is so the one that is dropped.

    Source: Gautier, "Numerical calculation of the base inertial parameters of robots", J. Robotic
    Systems 1991; Khalil and Dombre, "Modeling, Identification and Control of Robots", 2002, ch. 12.
    """
    W = _random_regressor(model, terms)
    scale = np.linalg.norm(W, axis=0)
    scale[scale < _INDEPENDENT * scale.max()] = np.inf  # rounding of a column that is zero
    independent = _independent_columns(W / scale, _order(model, terms))
    dependent = np.setdiff1d(np.arange(W.shape[1]), independent)
    mixing = np.asarray(
        np.linalg.lstsq(W[:, independent], W[:, dependent], rcond=None)[0], dtype=np.float64
    )
    mixing[np.abs(mixing) < _INDEPENDENT] = 0.0
    return BaseParameters(independent, dependent, mixing)


def _order(model: RobotModel, terms: JointTerms) -> NDArray[np.int64]:
    n, links = model.n, np.arange(PER_LINK * model.linkage.links)
    of_terms = links.size + np.arange(n * len(terms.all()))
    late = n if terms.armature else 0
    return np.concatenate(
        [of_terms[: of_terms.size - late], links, of_terms[-late:] if late else []]
    )


def _random_regressor(model: RobotModel, terms: JointTerms) -> FloatArray:
    """Stack all joints' equations of random motion, (n samples, full parameters)."""
    random = np.random.default_rng(0)
    n = model.n
    velocity, acceleration = random.uniform(-_FASTEST, _FASTEST, (2, _SAMPLES, n))
    position = random.uniform(-np.pi, np.pi, (_SAMPLES, n))
    Y = RegressorChain.of(model).regressor(
        Motion(np.arange(float(_SAMPLES)), position, velocity, acceleration)
    )
    own = terms.columns(velocity, acceleration)
    D = np.zeros((n, _SAMPLES, own.shape[2], n))
    for j in range(n):
        D[j, :, :, j] = own[:, j]
    W = np.concatenate([Y, D.reshape(n, _SAMPLES, -1)], axis=2)
    return W.reshape(n * _SAMPLES, -1)


def _independent_columns(W: FloatArray, order: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return the columns, increasing, that are independent of those before them in `order`."""
    Q = np.zeros((W.shape[0], W.shape[1]))
    found: list[int] = []
    for column in order.astype(int):
        new = W[:, column]
        for _ in range(2):  # the second pass removes what rounding left of the first
            basis = Q[:, : len(found)]
            new = new - basis @ (basis.T @ new)
        norm = float(np.linalg.norm(new))
        if norm > _INDEPENDENT:
            Q[:, len(found)] = new / norm
            found.append(column)
    return np.sort(np.array(found))
