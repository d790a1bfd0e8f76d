"""Base parameters, which motion can show, and how well a motion shows them.

Condition number of the base-parameter regressor of a motion, and its gradient.

cond(K) = sigma_max(K) / sigma_min(K)

K stacks the equations of all joints and samples of a motion; its columns are the base parameters of
the rigid body and the Coulomb and viscous friction of each joint. Nothing is scaled: a column has
its parameter's SI unit (kg, kg m, kg m², N m s/rad, N m), so the number compares motions in these
units. `scaled` divides each column by its norm first.

Source: Gautier and Khalil, "Exciting trajectories for the identification of base inertial
parameters of robots", IJRR 1992.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from estimators.regression.definite import ROUNDING, SymmetricSpectrum
from estimators.rigid_body.regressor import PER_LINK, RegressorChain, fill_regressor
from estimators.rigid_body.terms import JointTerms
from limo_driver.model import RobotModel
from limo_driver.runtime.compiled import compiled
from limo_driver.types import FloatArray, IntArray, Motion

_SAMPLES = 100  # random samples, n equations each
_INDEPENDENT = 1e-8  # part of a unit column that has to be new
_FASTEST = 2.0  # [rad/s] and [rad/s²] of the random motion
SIGN_WIDTH = 0.002  # [rad/s] of the sign of Coulomb friction
_SMOOTH_WIDTH = 0.05  # [rad/s] of it where a slope is wanted
_BLOCK = 4096  # samples whose regressor is held at once
_STEP = 1e-6  # [rad, rad/s, rad/s²] of finite differences


@dataclass(frozen=True)
class BaseParameters:
    """Independent columns of the full regressor, and how the others depend on them.

    The full parameters are 10 for each link, then n for each joint term. For every motion,
    Y phi = Y[:, independent] (phi[independent] + mixing phi[dependent]).
    """

    independent: IntArray  # (b,)
    dependent: IntArray  # (d,)
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
    # Stack all joints' equations of random motion, (n samples, full parameters)
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
    W = np.concatenate([Y, D.reshape(n, _SAMPLES, -1)], axis=2).reshape(n * _SAMPLES, -1)
    scale = np.linalg.norm(W, axis=0)
    scale[scale < _INDEPENDENT * scale.max()] = np.inf  # rounding of a column that is zero
    independent = _independent_columns(W / scale, _order(model, terms))
    dependent = np.setdiff1d(np.arange(W.shape[1]), independent)
    mixing = np.asarray(
        np.linalg.lstsq(W[:, independent], W[:, dependent], rcond=None)[0], dtype=np.float64
    )
    mixing[np.abs(mixing) < _INDEPENDENT] = 0.0
    return BaseParameters(independent, dependent, mixing)


def _order(model: RobotModel, terms: JointTerms) -> IntArray:
    n, links = model.n, np.arange(PER_LINK * model.linkage.links)
    of_terms = links.size + np.arange(n * len(terms.all()))
    late = n if terms.armature else 0
    return np.concatenate(
        [of_terms[: of_terms.size - late], links, of_terms[-late:] if late else []]
    )


def _independent_columns(W: FloatArray, order: IntArray) -> IntArray:
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


@dataclass(frozen=True)
class MotionGradient:
    """A smooth value of a motion, and its derivative by the motion's samples."""

    value: float
    position: FloatArray  # (T, n) [1/rad]
    velocity: FloatArray  # (T, n) [s/rad]
    acceleration: FloatArray  # (T, n) [s²/rad]


class Conditioning:
    """Condition number of one robot's base parameters, with friction, on any motion.

    Args:
        model: The robot.

    """

    def __init__(self, model: RobotModel) -> None:
        self.chain = RegressorChain.of(model)
        self.terms = JointTerms((SIGN_WIDTH,), offset=False, armature=False)
        self.base = find_base_parameters(model, self.terms)

    @property
    def columns(self) -> int:
        """Number of base parameters, friction included."""
        return self.base.rank

    def condition(self, motion: Motion) -> float:
        """Return the condition number of the regressor, SI units, nothing scaled."""
        return _ratio(self._gram(motion))

    def scaled(self, motion: Motion) -> float:
        """Return the condition number with each column divided by its norm."""
        return SymmetricSpectrum.of(self._gram(motion)).condition

    def smooth(self, motion: Motion, sharpness: float) -> MotionGradient:
        """Return a smooth bound of the logarithm of the condition number, and its derivative.

            ln cond <= (ln |lambda|_p + ln |1 / lambda|_p) / 2

        with the eigenvalues lambda of KᵀK and the p-norm of their vector. With G = KᵀK and the
        derivative M of the bound by G, the derivative by one sample x is 2 <K M, dK/dx>.

        Args:
            motion: T samples of n joints.
            sharpness: The norm's p; the larger, the closer to the condition number.
        """
        K = self.regressor(motion, _SMOOTH_WIDTH)
        stacked = K.reshape(-1, self.columns)
        values, vectors = np.linalg.eigh(stacked.T @ stacked)
        values = np.maximum(values, np.finfo(float).eps * values[-1])
        large, small = (values / values[-1]) ** sharpness, (values[0] / values) ** sharpness
        value = np.log(values[-1] / values[0]) / 2
        value += (np.log(large.sum()) + np.log(small.sum())) / (2 * sharpness)
        M = (vectors * (large / large.sum() - small / small.sum()) / (2 * values)) @ vectors.T
        # Contract the derivative of the regressor by the samples with a weight (n, T, b)
        n, T, links = self.chain.n, len(motion), self.chain.width
        full = np.zeros((n, T, links + 2 * n))
        full[:, :, self.base.independent] = 2 * (stacked @ M).reshape(K.shape)
        chain, linkage = self.chain, self.chain.linkage
        rates = [linkage.rates(x) for x in (motion.velocity, motion.acceleration)]
        of_links = linkage.rates(np.moveaxis(full[:, :, :links], 0, -1))
        slope = contract(
            chain.parent, chain.rotation, chain.translation, chain.axis, chain.gravity,
            np.stack([linkage.positions(motion.position), *rates]),
            np.ascontiguousarray(np.moveaxis(of_links, -1, 0)), _STEP,
        )  # fmt: skip
        slope = linkage.torques(slope)
        own = full[:, :, links:].reshape(n, T, 2, n)
        viscous, coulomb = (np.einsum("jtj->tj", own[:, :, term]) for term in range(2))
        turn = 1 / np.cosh(motion.velocity / _SMOOTH_WIDTH) ** 2  # of the smoothed sign
        slope[1] += viscous + coulomb * turn / _SMOOTH_WIDTH
        return MotionGradient(float(value), *slope)

    def _gram(self, motion: Motion) -> FloatArray:
        gram = np.zeros((self.columns, self.columns))
        for start in range(0, len(motion), _BLOCK):
            rows = slice(start, start + _BLOCK)
            state = (motion.position[rows], motion.velocity[rows], motion.acceleration[rows])
            K = self.regressor(Motion(motion.time[rows], *state), SIGN_WIDTH)
            stacked = K.reshape(-1, self.columns)
            gram += stacked.T @ stacked
        return gram

    def regressor(self, motion: Motion, width: float = SIGN_WIDTH) -> FloatArray:
        """Return K, (n, T, b); `width` is that of the sign of Coulomb friction [rad/s]."""
        sign = np.tanh(motion.velocity / width)
        return regressor_of(self.chain, self.terms, self.base, motion, sign)


def regressor_of(
    chain: RegressorChain,
    terms: JointTerms,
    base: BaseParameters,
    motion: Motion,
    sign: FloatArray | None = None,
) -> FloatArray:
    """Return the regressor of the base parameters, (n, T, b).

    Args:
        chain: The arm.
        terms: Of its joints.
        base: Which parameters stand for the others.
        motion: T samples of n joints.
        sign: Of Coulomb friction, (T, n), where it is not that of the terms.
    """
    n, links = chain.n, chain.width
    own = terms.columns(motion.velocity, motion.acceleration, sign)
    K = np.zeros((n, len(motion), links + n * own.shape[2]))
    chain.fill(motion, K)
    for j in range(n):
        K[j, :, links + j :: n] = own[:, j]
    return K[:, :, base.independent]


def _ratio(gram: FloatArray) -> float:
    """Return the condition number of a matrix whose Gram matrix is given."""
    eigenvalues = np.linalg.eigvalsh(gram)
    largest, smallest = float(eigenvalues[-1]), float(eigenvalues[0])
    dependent = smallest <= ROUNDING * len(gram) * largest
    return float("inf") if dependent else float(np.sqrt(largest / smallest))


@compiled(fastmath={"contract", "nsz"})
def contract(
    parent: IntArray,
    rotation: FloatArray,
    translation: FloatArray,
    axis: FloatArray,
    gravity: FloatArray,
    state: FloatArray,
    weight: FloatArray,
    step: float,
) -> FloatArray:
    """Return <weight, dY/dx> for each entry x of the state, (3, T, n), by finite differences.

    Args:
        parent: Of the chain, as are `rotation`, `translation`, `axis` and `gravity`.
        rotation: See there.
        translation: See there.
        axis: See there.
        gravity: See there.
        state: Position, velocity and acceleration, (3, T, n).
        weight: (n, T, 10 n).
        step: Of the differences, in each unit.
    """
    _, T, n = state.shape
    width = weight.shape[2]
    slope = np.zeros((3, T, n))
    Y = np.zeros((n, 3 * n + 1, width))
    moved = np.empty((3, 3 * n + 1, n))
    for t in range(T):
        for k in range(3 * n + 1):
            for x in range(3):  # moved[:, k] = ... would compile the message of its error
                for j in range(n):
                    moved[x, k, j] = state[x, t, j]
            if k > 0:
                moved[(k - 1) // n, k, (k - 1) % n] += step
        fill_regressor(
            parent, rotation, translation, axis, gravity, moved[0], moved[1], moved[2], Y
        )  # fmt: skip
        for k in range(3 * n):
            total = 0.0
            for j in range(n):
                for column in range(PER_LINK * j, width):
                    total += weight[j, t, column] * (Y[j, k + 1, column] - Y[j, 0, column])
            slope[k // n, t, k % n] = total / step
    return slope
