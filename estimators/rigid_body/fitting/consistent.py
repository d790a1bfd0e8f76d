"""Physically consistent parameters: inertias that a body can have, and friction that dissipates.

A body exists for the parameters of a link if its pseudo-inertia J (4 × 4), the second moment of its
density, is positive definite. The fit minimises

    ½ Σ_j w_j |Y_j phi - tau_j|² + Σ_i D(J_i, J_i0) / tolerance²,
    D(J, J0) = tr(J0⁻¹ J) - log det(J0⁻¹ J) - 4,

which is convex in phi. D is ½ |relative change|² near the nominal J0 and infinite where J ceases to
be positive definite: combinations that the data do not reveal stay at the nominal body, and no
other constraint is needed. Parameters that cannot be negative are held at zero where they would be.
Where the extent of a body is known, ∫ρ (r² - |x - c|²) stands beside its pseudo-inertia as one more
entry of its diagonal: a body whose mass would have to lie elsewhere is as far as one that is none.

As a density, exp(-D / tolerance²) is a Wishart distribution about J0. So the tolerance itself can
be found from the data: it is the one under which they are most likely (Laplace's approximation).

Source: Wensing, Kim and Slotine, "Linear matrix inequalities for physically consistent inertial
parameter identification", RA-L 2018; Lee, Wensing and Park, "Geometric robot dynamic
identification: a convex programming approach", T-RO 2020.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import lgamma, log, pi
from typing import TYPE_CHECKING

import numpy as np

from estimators.regression.definite import RegularisedInverse, root_of
from estimators.rigid_body.regressor import PER_LINK
from limo_driver.errors import DivergedError
from limo_driver.model.descriptions.geometry import Inertial

if TYPE_CHECKING:
    from estimators.rigid_body.fitting.extent import Extent
    from limo_driver.types import BoolArray, FloatArray

_ITERATIONS = 2000  # contradictory data, such as torques without inertia, took 400
_DECREMENT = 1e-10  # Newton decrement at which the minimum is reached
_SQUARED = 1e-4  # the same, below which a step squares it, unless the gradient is rounding alone
_NEARLY = 0.1  # the same, over the precision, on the way to the minimum
_NEAR = 1.5  # Newton steps to where a body ceases to exist, at which the way starts
_STIFFER = 4.0  # ratio of the precisions of one step of the way and the next
_SHORT = 0.9  # part of the way to where a body ceases to exist that a step may go
_LIGHTEST = 0.05  # [kg], smallest nominal mass taken seriously
_SMALLEST = 0.01  # [m], smallest nominal radius of gyration taken seriously
_RELEASE = 1e-6  # gradient at which a parameter held at zero is set free again
_HARDLY_KNOWN = 10.0  # relative deviation of a nominal body that only has to exist
_ROUNDING = 1e-12  # [m²] that nothing is divided by less than
_WEAKEST_PRIOR = 1e-8  # [1/unit²] on joint terms, so that what nothing reveals is zero


@dataclass(frozen=True)
class Quadratic:
    """½ phiᵀ gram phi - productᵀ phi, in the full parameters (p,)."""

    gram: FloatArray  # (p, p)
    product: FloatArray  # (p,)
    spread: FloatArray  # (p, p), covariance of `product`; `gram` where the cost is a likelihood

    def without(self, known: FloatArray) -> Quadratic:
        """Return the cost of what is to be added to known parameters (p,)."""
        return replace(self, product=self.product - self.gram @ known)


@dataclass(frozen=True)
class ConsistentFit:
    """Full parameters that a robot can have."""

    parameters: FloatArray  # (p,)
    spread: FloatArray  # D (m, p), with Dᵀ D their covariance; 0 where held at zero
    log_evidence: float  # log-likelihood of the data under the tolerance, plus a constant

    @property
    def deviation(self) -> FloatArray:
        """Standard deviations (p,); 0 where held at zero."""
        return np.linalg.norm(self.spread, axis=0)


def fit_consistent(
    data: Quadratic,
    nominal: FloatArray,
    links: int,
    tolerance: float,
    positive: BoolArray,
    absent: BoolArray,
    start: FloatArray | None = None,
    extent: Extent | None = None,
) -> ConsistentFit:
    """Minimise the cost above.

    Args:
        data: Weighted normal equations.
        nominal: Full parameters (p,), those of existing bodies (`thickened`) first.
        links: Number of links; their parameters come first.
        tolerance: Relative standard deviation of the nominal inertias.
        positive: Joint terms that cannot be negative, (p,).
        absent: Parameters that stay at zero, (p,).
        start: Parameters (p,) near the minimum, of bodies that exist; found if not given.
        extent: In which the mass of every link has to lie, where that is known.

    Raises:
        DivergedError: No minimum was found.
    """
    problem = _Problem.of(data, nominal, links, tolerance, _basis_in(extent))
    held = absent.copy()
    phi = problem.approach(np.where(held, 0.0, nominal), ~held) if start is None else start
    for _ in range(nominal.size):
        phi = problem.minimise(np.where(held, 0.0, phi), ~held)
        negative = positive & ~held & (phi < 0)
        released = held & ~absent & (problem.gradient(phi) < -_RELEASE)
        if not negative.any() and not released.any():
            return ConsistentFit(
                phi, problem.spread(phi, ~held), problem.log_evidence(phi, ~absent)
            )
        held = (held | negative) if negative.any() else (held & ~released)
    raise DivergedError("the friction parameters found no consistent set of signs")


def nearest_body(
    parameters: FloatArray,
    metric: FloatArray,
    extent: Extent | None = None,
    start: FloatArray | None = None,
) -> FloatArray:
    """Return the parameters (10,) of the body that exists and is nearest to the ones given.

    It keeps off the bound of what exists by a small part of what the metric calls a deviation.

    Args:
        parameters: Of one link, (m, m c, I at the joint frame), (10,).
        metric: Positive definite, such as the inverse of their covariance, (10, 10).
        extent: In which its mass has to lie, where that is known.
        start: A body (10,) to begin with, that need not exist; the one given if not given.

    Raises:
        DivergedError: No minimum was found.
    """
    none = np.zeros(PER_LINK, dtype=bool)
    data = Quadratic(metric, metric @ parameters, metric)
    near = thickened(parameters if start is None else start)
    near = near if extent is None else _inside(extent, near)
    fit = fit_consistent(data, near, 1, _HARDLY_KNOWN, none, none, extent=extent)
    return fit.parameters


@dataclass(frozen=True)
class _Problem:
    """The cost, its derivatives and its minimum over some of the parameters."""

    data: Quadratic
    links: int
    precision: float  # of the bodies, 1 / tolerance²
    nominal_inverse: FloatArray  # (links, 4, 4)
    nominal_logdet: float  # of those inverses, summed
    ridge: FloatArray  # (p,)
    basis: FloatArray  # (10, d, d), of what has to be positive definite of each link

    @classmethod
    def of(
        cls,
        data: Quadratic,
        nominal: FloatArray,
        links: int,
        tolerance: float,
        basis: FloatArray,
    ) -> _Problem:
        nominals = _spanned(nominal[: PER_LINK * links].reshape(links, PER_LINK), basis)
        inverse = np.asarray(np.linalg.inv(nominals), dtype=np.float64)
        logdet = float(np.linalg.slogdet(inverse)[1].sum())
        ridge = np.zeros(nominal.size)
        ridge[PER_LINK * links :] = _WEAKEST_PRIOR
        return cls(data, links, 1.0 / tolerance**2, inverse, logdet, ridge, basis)

    def bodies(self, phi: FloatArray) -> FloatArray:
        """Return what has to be positive definite (links, d, d) of parameters (p,)."""
        return _spanned(phi[: PER_LINK * self.links].reshape(self.links, PER_LINK), self.basis)

    def value(self, phi: FloatArray) -> float:
        J = self.bodies(phi)
        logdet = np.linalg.slogdet(J)[1]
        cost = 0.5 * phi @ self.data.gram @ phi - self.data.product @ phi
        cost += 0.5 * self.ridge @ phi**2
        cost -= self.precision * (self.nominal_logdet + self.basis.shape[1] * self.links)
        cost += self.precision * (np.sum(self.nominal_inverse * J) - logdet.sum())
        return float(cost)

    def gradient(self, phi: FloatArray) -> FloatArray:
        gradient = self.data.gram @ phi - self.data.product + self.ridge * phi
        slope = self.nominal_inverse - np.linalg.inv(self.bodies(phi))
        of_bodies = slope.reshape(self.links, -1) @ self.basis.reshape(PER_LINK, -1).T
        gradient[: PER_LINK * self.links] += self.precision * of_bodies.ravel()
        return gradient

    def hessian(self, phi: FloatArray) -> FloatArray:
        hessian = self.data.gram + np.diag(self.ridge)
        size, each = PER_LINK * self.links, np.arange(self.links)
        root = metric_root(phi[:size].reshape(self.links, PER_LINK), self.basis)
        metrics = root.swapaxes(-1, -2) @ root
        blocks = hessian[:size, :size].reshape(self.links, PER_LINK, self.links, PER_LINK)
        blocks[each, :, each] += self.precision * metrics
        hessian[:size, :size] = blocks.reshape(size, size)
        return hessian

    def spread(self, phi: FloatArray, free: BoolArray) -> FloatArray:
        """Return D (m, p), with Dᵀ D the covariance of the parameters at the minimum."""
        inverse = self._inverse(phi, free)
        of_data = root_of(self.data.spread[np.ix_(free, free)])
        spread = inverse.spread(of_data)
        result = np.zeros((len(spread), phi.size))
        result[:, free] = spread
        return result

    def _inverse(self, phi: FloatArray, free: BoolArray) -> RegularisedInverse:
        """Return the inverse of the Hessian in the free parameters."""
        size, each = PER_LINK * self.links, np.arange(self.links)
        roots = metric_root(phi[:size].reshape(self.links, PER_LINK), self.basis)
        prior = np.zeros((self.links, roots.shape[1], self.links, PER_LINK))
        prior[each, :, each] = np.sqrt(self.precision) * roots
        of_bodies = np.zeros((prior.shape[0] * prior.shape[1], phi.size))
        of_bodies[:, :size] = prior.reshape(len(of_bodies), size)
        F = np.concatenate([of_bodies, np.diag(np.sqrt(self.ridge))[size:]])
        return RegularisedInverse.of(self.data.gram[np.ix_(free, free)], F[:, free])

    def log_evidence(self, phi: FloatArray, present: BoolArray) -> float:
        """Integrate likelihood and prior over the parameters by Laplace's approximation.

        The prior of one link has the normaliser exp(4 a) a^(-4 b) Γ₄(b), with a = 1 / tolerance²
        and b = a + 5/2. Parameters held at zero count with the curvature they have there, so that
        the evidence does not jump when one is released.
        """
        a = self.precision
        b = a + 2.5
        log_gamma = 3 * log(pi) + sum(lgamma(b - k / 2) for k in range(4))
        normaliser = 4 * a - 4 * b * log(a) + log_gamma
        volume = 0.5 * self._inverse(phi, present).log_determinant
        return -self.value(phi) - self.links * normaliser + volume

    def _scaled(self, phi: FloatArray, free: BoolArray) -> tuple[FloatArray, FloatArray]:
        """Return the Hessian with a diagonal of ones, and the scale that made it so."""
        H = self.hessian(phi)[np.ix_(free, free)]
        scale = 1.0 / np.sqrt(np.diag(H))
        return H * np.outer(scale, scale), scale

    def approach(self, nominal: FloatArray, free: BoolArray) -> FloatArray:
        """Follow the minimum in the free parameters from stiffer bodies nearly to the wanted ones.

        Straight from the nominal bodies, Newton's steps may end at bodies that hardly exist, and
        get stuck there. Bodies so stiff that they hardly move are near; loosening, they stay near.

        Source: Boyd and Vandenberghe, "Convex Optimization", 2004, sec. 11.3 (barrier method).
        """
        phi, stiffer = nominal, self
        while _reach(stiffer.changes(phi, stiffer.step(phi, free, stiffer.gradient(phi)))) < _NEAR:
            stiffer = replace(stiffer, precision=_STIFFER * stiffer.precision)
        while stiffer.precision > self.precision:
            phi = stiffer.minimise(phi, free, _NEARLY * stiffer.precision)
            stiffer = replace(stiffer, precision=stiffer.precision / _STIFFER)
        return phi

    def step(self, phi: FloatArray, free: BoolArray, gradient: FloatArray) -> FloatArray:
        """Return Newton's step (p,) in the free parameters, down a gradient (p,)."""
        step = np.zeros(phi.size)
        H, scale = self._scaled(phi, free)
        try:
            step[free] = -scale * np.linalg.solve(H, scale * gradient[free])
        except np.linalg.LinAlgError:
            raise DivergedError("the consistent inertias lost all digits") from None
        return step

    def changes(self, phi: FloatArray, step: FloatArray) -> FloatArray:
        """Return by how much a step changes bodies, relative to themselves, (links, d), rising."""
        lower = _inverse_lower(self.bodies(phi))
        turned = lower @ self.bodies(step) @ lower.swapaxes(1, 2)
        return np.asarray(np.linalg.eigvalsh(turned), dtype=np.float64)

    def minimise(self, phi: FloatArray, free: BoolArray, until: float = _DECREMENT) -> FloatArray:
        """Take damped Newton steps in the free parameters until the decrement is small.

        By how much a step lowers the cost is no difference of two costs: of exact data, a cost is
        so large that the last digits of the minimum would be lost in it.
        """
        before = np.inf
        for _ in range(_ITERATIONS):
            gradient = self.gradient(phi)
            step = self.step(phi, free, gradient)
            slope = float(step @ gradient)
            if -slope < until or before <= -slope < _SQUARED:
                return phi
            changes = self.changes(phi, step)
            curvature = float(step @ self.data.gram @ step + self.ridge @ step**2)
            length = min(1.0, _SHORT * _reach(changes))
            while not (
                self._more(length, slope, curvature, changes) < 1e-4 * length * slope
                and self._exist(phi + length * step)
            ):
                length *= 0.5
                if length < 1e-12:  # noqa: PLR2004  # rounding is all that is left
                    return phi
            phi, before = phi + length * step, -slope
        raise DivergedError("the consistent inertias did not converge")

    def _exist(self, phi: FloatArray) -> bool:
        """Say whether bodies are beyond rounding ones that exist."""
        sizes = np.linalg.eigvalsh(self.bodies(phi))
        return bool((sizes[:, 0] > np.finfo(float).eps * sizes[:, -1]).all())

    def _more(self, length: float, slope: float, curvature: float, changes: FloatArray) -> float:
        """Return what so much of a step adds to the cost; its slope there is that of all of it."""
        part = length * changes
        of_bodies = float((part - np.log1p(part)).sum())
        return length * slope + 0.5 * length**2 * curvature + self.precision * of_bodies


def _reach(changes: FloatArray) -> float:
    """Return how many steps of such changes (links, d) lead to where a body ceases to exist."""
    least = float(changes[:, 0].min())
    return -1.0 / least if least < 0 else np.inf


def pseudo_inertia(parameters: FloatArray) -> FloatArray:
    """Return J (..., 4, 4) of (m, m c, I at the joint frame) of links, (..., 10)."""
    return _spanned(parameters, _BASIS)


def metric_root(parameters: FloatArray, basis: FloatArray | None = None) -> FloatArray:
    """Return R (..., d², 10), with Rᵀ R the metric at bodies of own parameters (..., 10).

    Raises:
        DivergedError: A body hardly exists.
    """
    basis = _BASIS if basis is None else basis
    lower = _inverse_lower(_spanned(parameters, basis))[..., None, :, :]
    turned = lower @ basis @ lower.swapaxes(-1, -2)
    return turned.reshape(*turned.shape[:-2], -1).swapaxes(-1, -2)


def _inverse_lower(bodies: FloatArray) -> FloatArray:
    """Return L⁻¹ (..., d, d) with L Lᵀ what has to be positive definite (..., d, d)."""
    try:
        return np.asarray(np.linalg.inv(np.linalg.cholesky(bodies)), dtype=np.float64)
    except np.linalg.LinAlgError:
        raise DivergedError("the consistent inertias lost all digits") from None


def _basis() -> FloatArray:
    """Return ∂J/∂parameter, (10, 4, 4); J = [[½ tr(I) 1 - I, m c], [m cᵀ, m]]."""
    basis = np.zeros((PER_LINK, 4, 4))
    basis[0, 3, 3] = 1.0
    for k in range(3):
        basis[1 + k, k, 3] = basis[1 + k, 3, k] = 1.0
    for p, (a, b) in enumerate(((0, 0), (0, 1), (1, 1), (0, 2), (1, 2), (2, 2))):
        I = np.zeros((3, 3))  # noqa: E741
        I[a, b] = I[b, a] = 1.0
        basis[4 + p, :3, :3] = 0.5 * np.trace(I) * np.eye(3) - I
    return basis


_BASIS = _basis()


def _spanned(parameters: FloatArray, basis: FloatArray) -> FloatArray:
    """Return the sums (..., d, d) of a basis (10, d, d) times parameters (..., 10)."""
    flat = parameters @ basis.reshape(PER_LINK, -1)
    return flat.reshape(*parameters.shape[:-1], *basis.shape[1:])


def _basis_in(extent: Extent | None) -> FloatArray:
    """Return what has to be positive definite of a body that lies in an extent, (10, d, d)."""
    if extent is None:
        return _BASIS
    basis = np.zeros((PER_LINK, 5, 5))
    basis[:, :4, :4], basis[:, 4, 4] = _BASIS, extent.slope
    return basis


def _inside(extent: Extent, parameters: FloatArray) -> FloatArray:
    """Return a body (10,) like the one given, drawn together and in until an extent holds it."""
    J = pseudo_inertia(parameters)
    mass, com = float(J[3, 3]), J[:3, 3] / J[3, 3]
    spread = J[:3, :3] / mass - np.outer(com, com)
    within = 0.25 * extent.radius**2  # of each part, so that half of what there is stays free
    away = com - extent.centre
    nearer = min(1.0, float(np.sqrt(within / max(away @ away, _ROUNDING))))
    smaller = min(1.0, within / float(np.trace(spread)))
    return _parameters_of(mass, extent.centre + nearer * away, smaller * mass * spread)


def _parameters_of(mass: float, com: FloatArray, spread: FloatArray) -> FloatArray:
    """Return the parameters (10,) of mass, centre and second moments (3, 3) about it."""
    moment = spread + mass * np.outer(com, com)
    I = np.trace(moment) * np.eye(3) - moment  # noqa: E741
    return np.array([mass, *(mass * com), I[0, 0], I[0, 1], I[1, 1], I[0, 2], I[1, 2], I[2, 2]])


def thickened(parameters: FloatArray) -> FloatArray:
    """Return the parameters (10,) of a body near the one given that certainly exists.

    Nominal bodies in a URDF may be points, rods, or lack mass; the fit needs room around them.
    """
    J = pseudo_inertia(parameters)
    mass = max(float(J[3, 3]), _LIGHTEST)
    com = J[:3, 3] / J[3, 3] if J[3, 3] > 0 else np.zeros(3)
    values, vectors = np.linalg.eigh(J[:3, :3] - J[3, 3] * np.outer(com, com))
    spread = (vectors * np.maximum(values, mass * _SMALLEST**2)) @ vectors.T
    return _parameters_of(mass, com, spread)


def inertial_of(parameters: FloatArray) -> Inertial:
    """Return mass, centre of mass and inertia about it of one link's parameters (10,)."""
    m = float(parameters[0])
    c = parameters[1:4] / m
    xx, xy, yy, xz, yz, zz = parameters[4:]
    at_origin = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
    at_com = at_origin - m * (c @ c * np.eye(3) - np.outer(c, c))
    x, y, z = c.tolist()
    return Inertial(m, (x, y, z), tuple(at_com[np.triu_indices(3)].tolist()))
