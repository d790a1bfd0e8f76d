"""Bodies that come out of a fit can be, and are as near to it as such bodies are."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from noisy_recordings import observed

from estimators.diagnosis.from_torque.fitting.bodies import with_possible_bodies
from estimators.diagnosis.from_torque.fitting.problem import (
    RegressionProblem,
    fitted,
    improve,
    lost_by,
    simulated,
)
from estimators.diagnosis.from_torque.hypotheses.catalogue import relative_inertia
from estimators.diagnosis.from_torque.residuals.noise import Noise
from estimators.diagnosis.headline import LINK_INERTIA
from estimators.diagnosis.held_out import rmse
from estimators.diagnosis.stages import quiet
from estimators.regression.evidence import REACH
from estimators.rigid_body.fitting.consistent import nearest_body, pseudo_inertia
from estimators.rigid_body.regressor import PER_LINK, parameters_of
from limo_driver.model.descriptions.geometry import Inertial
from limo_driver.physics import Payload, TorqueGain

CRATE = Payload(mass=3.0, com=(0.0, 0.0, 0.2), inertia=(0.06, 0.0, 0.0, 0.06, 0.0, 0.05))
ROD = Payload(mass=3.0, com=(0.0, 0.0, 0.2), inertia=(0.09, 0.0, 0.0, 0.09, 0.0, 0.0))
NOISE = 0.02  # [N m]
LINK = 0  # 0-based


@pytest.fixture(scope="module")
def seen(two_links_urdf):
    """Make a function that records effects of an arm of two skew joints."""
    return partial(observed, robot=str(two_links_urdf), duration=30.0)


def laid_out(observed):
    """Lay out what competes for what a recording shows beside a simulation."""
    problem = RegressionProblem.of(observed, quiet)
    return problem, Noise.independent(np.full(observed.n, NOISE), problem.split.fitted)


def loaded(observed):
    """Fit a payload; return the problem, the solution and what was fitted, (m, m c, I)."""
    problem, noise = laid_out(observed)
    payload = next(i for i, item in enumerate(problem.candidates) if item.effect == "payload")
    solution = fitted(problem, (payload,), noise)
    return problem, solution, solution.fitted.mean[problem.nuisance.prior.index.size :]


def payload_in(solution):
    return next(e for e in improve(solution).effects if isinstance(e, Payload))


def exists(parameters):
    return np.linalg.eigvalsh(pseudo_inertia(parameters))[0] > 0


def test_a_body_that_exists_stays_as_it_was_fitted():
    """Seven joints show all of its parameters."""
    _, solution, body = loaded(observed(CRATE))
    assert exists(body)
    found = payload_in(solution)
    assert found.mass == pytest.approx(body[0])
    np.testing.assert_allclose(found.com, body[1:4] / body[0])


def test_a_body_that_cannot_exist_costs_no_more_torque_than_it_has_to(seen):
    """Noise makes the inertia of a rod impossible; what the motion shows of its length stays."""
    problem, solution, body = loaded(seen(ROD))
    assert not exists(body)
    found = payload_in(solution)
    assert found.load.is_consistent()
    assert found.mass == pytest.approx(ROD.mass, rel=0.02)
    rows, given = problem.split.held_out, problem.observed.simulation
    off = problem.observed.under(improve(solution)).residual
    point = replace(found, inertia=(0.0,) * 6)
    shrunk = problem.observed.under(replace(given, effects=(point,))).residual
    linear = rmse(problem.left(solution.fitted), rows)
    assert np.all(rmse(off, rows) < 1.1 * linear)
    assert np.any(rmse(shrunk, rows) > 1.5 * linear)


def drawn(problem, solution, torques=None):
    """Return the coefficients of a fit, moved so that every body can exist."""
    observed, fit = problem.observed, solution.fitted
    members = [problem.candidates[member] for member in solution.members]
    return with_possible_bodies(
        observed.simulation.model, observed.extents, members, problem.nuisance.prior, fit,
        torques or (lambda prior: problem.torques(fit, prior)),
    )  # fmt: skip


def test_what_is_known_makes_up_for_a_body_as_far_as_the_fit_left_it_open(seen):
    """Half of it where its torque weighs as much as what is known of it."""
    problem, solution, _ = loaded(seen(ROD))
    count, fit = problem.nuisance.prior.index.size, solution.fitted
    open_to = np.diag(fit.covariance)[:count]
    one = int(np.argmax(open_to))
    products = np.eye(fit.mean.size)
    products[one, one] = 1.0 / open_to[one]
    products[one, count:] = 0.1 * products[one, one]
    change = drawn(problem, solution, lambda _: products) - fit.mean
    assert change[count:].any()
    assert change[one] == pytest.approx(-0.5 * 0.1 * change[count:].sum())


def test_a_load_that_cannot_exist_is_drawn_to_one_that_can(seen):
    problem, solution, body = loaded(seen(ROD))
    assert not exists(body)
    assert exists(drawn(problem, solution)[problem.nuisance.prior.index.size :])


def test_no_coefficient_leaves_its_bounds_where_a_body_is_drawn(seen):
    problem, noise = laid_out(seen(ROD))
    kinds = [(item.effect, item.kind, item.joints) for item in problem.candidates]
    dry = kinds.index(("coulomb_friction", "missing", (1,)))
    solution = fitted(problem, (kinds.index(("payload", "missing", (1,))), dry), noise)
    mean, count = solution.fitted.mean.copy(), problem.nuisance.prior.index.size
    mean[-1], mean[count - 1] = -5.0, -50.0 * problem.nuisance.prior.deviation[-1]
    found = drawn(problem, replace(solution, fitted=replace(solution.fitted, mean=mean)))
    assert found[-1] == 0.0  # friction
    assert found[count - 1] == -REACH * problem.nuisance.prior.deviation[-1]


def test_gravity_gives_no_way_to_an_inertia_where_slow_errors_are_thought_likely(seen):
    problem, _ = laid_out(seen(ROD))
    walk = np.cumsum(np.random.default_rng(1).normal(size=problem.target.shape), axis=0)
    noise = Noise.of(NOISE * walk, problem.split.fitted, problem.observed.segment)
    payload = next(i for i, item in enumerate(problem.candidates) if item.effect == "payload")
    solution = fitted(problem, (payload,), noise)
    assert not exists(solution.fitted.mean[problem.nuisance.prior.index.size :])
    rows = problem.split.held_out
    linear, drawn = problem.left(solution.fitted), simulated(solution)
    assert np.all(rmse(drawn, rows) < 1.1 * rmse(linear, rows))


def feigned(seen):
    """Fit a link to what the sensor of its joint makes of all that lies beyond."""
    problem, noise = laid_out(seen(TorqueGain(joint=1, gain=-0.4)))
    link = next(i for i, x in enumerate(problem.candidates) if x.place == (LINK_INERTIA, (LINK,)))
    return problem, fitted(problem, (link,), noise)


def test_a_body_whose_mass_would_be_out_of_reach_is_drawn_to_where_its_link_is(seen):
    problem, solution = feigned(seen)
    observed = problem.observed
    model, extent = observed.simulation.model, observed.extents.of(LINK)
    change = relative_inertia(model.inertials[model.link_names[LINK]])
    nominal = parameters_of(model.inertials[model.link_names[LINK]])
    count = problem.nuisance.prior.index.size
    own = slice(PER_LINK * LINK, PER_LINK * (LINK + 1))
    mean = solution.fitted.mean
    assert not extent.holds(nominal + change @ (mean[own] + mean[count:]))
    found = improve(solution).inertials[model.link_names[LINK]]
    assert found.is_consistent()
    assert extent.holds(parameters_of(found))


def test_what_only_a_load_out_of_reach_explains_does_not_speak_for_one(seen):
    far = Payload(mass=0.5, com=(0.0, 0.0, 3.0))
    problem, solution, _ = loaded(seen(far))
    (member,) = solution.members
    own = slice(problem.nuisance.prior.index.size, None)
    mean, covariance = solution.fitted.mean[own], solution.fitted.covariance[own, own]
    without = 0.5 * float(mean @ np.linalg.solve(covariance, mean))  # [nat], and no load at all
    assert 0.9 * without < lost_by(solution)[member] < without
    for near in (CRATE, ROD):
        problem, solution, _ = loaded(seen(near))
        assert not lost_by(solution)


def test_a_load_that_is_stated_may_have_another_mass(seen):
    """A simulation that was improved has the load that was found, and is diagnosed again."""
    heavier = replace(CRATE, mass=4.0)
    recorded = seen(heavier)
    problem, noise = laid_out(recorded.under(replace(recorded.simulation, effects=(CRATE,))))
    kinds = [(item.effect, item.kind) for item in problem.candidates]
    stated = kinds.index((Payload.name, "wrong_parameter"))
    solution = fitted(problem, (stated,), noise)
    assert payload_in(solution).mass == pytest.approx(4.0, rel=0.05)


def test_the_nearest_body_is_nearer_than_its_neighbours():
    random = np.random.default_rng(3)
    body = parameters_of(Inertial(2.0, (0.1, 0.0, 0.2), (0.02, 0.0, 0.0, 0.03, 0.0, 0.025)))
    root = random.normal(size=(10, 10))
    metric = 1e4 * (root @ root.T + np.eye(10))
    np.testing.assert_allclose(nearest_body(body, metric), body, atol=1e-4)
    wrong = body - np.array([0.0, 0.0, 0.0, 0.0, 0.2, 0.0, 0.2, 0.0, 0.0, 0.0])
    assert not exists(wrong)
    nearest = nearest_body(wrong, metric)
    assert exists(nearest)

    def distance(parameters):
        return (parameters - wrong) @ metric @ (parameters - wrong)

    for _ in range(100):  # all that lies between two bodies that exist is one, too
        lower = 0.3 * random.normal(size=(4, 4))
        J = lower @ lower.T
        moment = np.trace(J[:3, :3]) * np.eye(3) - J[:3, :3]
        other = np.array([J[3, 3], *J[:3, 3], *moment[[0, 0, 1, 0, 1, 2], [0, 1, 1, 2, 2, 2]]])
        for part in (0.03, 0.3, 1.0):
            assert distance(nearest + part * (other - nearest)) > distance(nearest)
