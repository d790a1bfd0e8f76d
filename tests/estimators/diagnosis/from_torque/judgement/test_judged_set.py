"""A judged set: what it names is no worse on motion held out than what any arm has."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from estimators.diagnosis.from_torque.fitting.problem import RegressionProblem, fitted
from estimators.diagnosis.from_torque.fitting.solving import noise_of_everything
from estimators.diagnosis.from_torque.judgement.judged_set import JudgedSet
from estimators.diagnosis.from_torque.judgement.judgement import worse_at
from estimators.diagnosis.from_torque.residuals.observations import Observations
from estimators.diagnosis.held_out import rmse
from estimators.diagnosis.stages import quiet
from limo_driver.physics import (
    CoulombFriction,
    PreslidingHysteresis,
    Simulation,
    SpringLoad,
    Tolerances,
    ViscousFriction,
)


@pytest.fixture(scope="module")
def problem(arm, training_recording):
    bare, random = Simulation(str(arm)), np.random.default_rng(5)
    dry = (CoulombFriction(joint=j, tau_c=1.0 * j, v_eps=0.003) for j in (1, 2))
    true = replace(bare, effects=(*dry, ViscousFriction(joint=1, f_v=2.0)))
    torque = true.predict(training_recording)
    noisy = replace(training_recording, torque=torque + 0.02 * random.standard_normal(torque.shape))
    return RegressionProblem.of(Observations.of(bare, [noisy], 10.0), quiet)


def judged(problem, members):
    return JudgedSet.of(fitted(problem, members, noise_of_everything(problem)))


def places(one):
    return one.places(one.solution.members)


def test_what_is_worse_than_ordinary_friction_gives_way_to_it(problem):
    spring = next(
        i for i, item in enumerate(problem.candidates) if item.place == (SpringLoad.name, (1,))
    )
    wrong, rows = judged(problem, (spring,)), problem.split.held_out
    ordinary = rmse(judged(problem, problem.base).proven, rows)
    assert (rmse(wrong.proven, rows) > 3 * ordinary).all()
    found = wrong.beyond_ordinary()
    assert (rmse(found.proven, rows) < 1.1 * ordinary).all()
    assert {(CoulombFriction.name, (0,)), (CoulombFriction.name, (1,))} <= places(found)


def test_what_is_no_worse_stays(problem):
    ordinary = judged(problem, problem.base)
    assert ordinary.beyond_ordinary() is ordinary


def test_a_law_that_is_doubtful_gives_way_to_plain_friction_and_nothing_else_does(problem):
    """Of a joint that rubs, dry friction was lost with the name of another law of it."""
    law, dry = (PreslidingHysteresis.name, (0,)), (CoulombFriction.name, (0,))
    spring = (SpringLoad.name, (1,))
    found, other = (
        next(i for i, item in enumerate(problem.candidates) if item.place == place)
        for place in (law, spring)
    )
    rest = tuple(i for i in problem.base if problem.candidates[i].joints == (1,))
    doubtful = judged(problem, (*rest, found, other))  # its own law is all that joint 1 has
    plain = doubtful.with_plain_friction([found, other])
    assert {law, dry, spring} & places(plain) == {dry, spring}
    assert dry in plain.places(plain.named)
    assert plain.with_plain_friction([other]) is plain


@pytest.fixture(scope="module")
def right(arm, training_recording):
    """A simulation that has nothing wrong, beside what it predicts and some noise."""
    true, random = Simulation(str(arm)), np.random.default_rng(5)
    torque = true.predict(training_recording)
    noisy = replace(training_recording, torque=torque + 0.2 * random.standard_normal(torque.shape))
    return RegressionProblem.of(Observations.of(true, [noisy], 10.0), quiet)


@pytest.mark.parametrize("changed", [0.9, 0.97])
def test_values_moved_where_they_are_surely_worse_stay_as_stated(right, changed):
    """Also where that is too little to be clear at a joint, and without any member."""
    observed, nothing = right.observed, fitted(right, (), noise_of_everything(right))
    link = observed.simulation.model.link_names[0]
    body = observed.simulation.model.inertials[link]
    lighter = replace(body, mass=changed * body.mass)
    moved = observed.under(replace(observed.simulation, inertials={link: lighter}))
    worse = JudgedSet.judge(nothing, moved)
    assert worse._harmed == (0,)  # joint 2 does not feel that link
    found, as_given = worse.without_harmful_members()
    assert as_given
    np.testing.assert_array_equal(found.proven, observed.residual)


@pytest.fixture(scope="module")
def rubbing(arm, training_recording):
    """Joint 2 rubs three times as much as the simulation states, within its tolerance."""
    stated, random = Simulation(str(arm)), np.random.default_rng(5)
    rub = ViscousFriction(joint=1, f_v=0.5)
    stated = replace(stated, effects=(rub, ViscousFriction(joint=2, f_v=1.0)))
    stated = replace(stated, tolerances=replace(stated.tolerances, friction=1.0))
    true = replace(stated, effects=(rub, ViscousFriction(joint=2, f_v=3.0)))
    torque = true.predict(training_recording)
    noisy = replace(training_recording, torque=torque + 0.2 * random.standard_normal(torque.shape))
    return RegressionProblem.of(Observations.of(stated, [noisy], 10.0), quiet), true


def beside(rubbing, lighter, f_v, first=0.5):
    """Judge what a fit may have come to: a first link that is lighter, and friction of joints."""
    problem, true = rubbing
    observed, nothing = problem.observed, fitted(problem, (), noise_of_everything(problem))
    link = true.model.link_names[0]
    body = true.model.inertials[link]
    found = replace(
        true,
        effects=(ViscousFriction(joint=1, f_v=first), ViscousFriction(joint=2, f_v=f_v)),
        inertials={link: replace(body, mass=lighter * body.mass)},
    )
    return JudgedSet.judge(nothing, observed.under(found))


def test_values_of_one_joint_stay_where_bodies_harm_another(rubbing):
    problem, _ = rubbing
    rows, harmful = problem.split.held_out, beside(rubbing, 0.8, 3.0)
    assert rmse(harmful.proven, rows)[0] > 2 * rmse(problem.observed.residual, rows)[0]
    found, as_given = harmful.without_harmful_members()
    assert not as_given
    left, given = rmse(found.proven, rows), rmse(problem.observed.residual, rows)
    assert left[0] < 1.1 * given[0]
    assert left[1] < 0.5 * given[1]


def test_the_lesser_harm_stays_where_nothing_less_can_be(rubbing):
    """Without tolerances there is but what was found, which makes the arm better, or nothing."""
    problem, true = rubbing
    exact = replace(problem.observed.simulation, tolerances=Tolerances(inertia=0.0, friction=0.0))
    exact = RegressionProblem.of(problem.observed.under(exact), quiet)
    harmful = beside((exact, true), 0.9, 3.0)
    rows, given = exact.split.held_out, exact.observed.residual
    found, as_given = harmful.without_harmful_members()
    assert not as_given
    assert rmse(found.proven, rows)[0] > 1.2 * rmse(given, rows)[0]
    assert rmse(found.proven, rows)[1] < 0.5 * rmse(given, rows)[1]
    less, _ = beside(rubbing, 0.9, 3.0).without_harmful_members()
    assert rmse(less.proven, rows)[0] < 1.1 * rmse(given, rows)[0]


def test_only_what_acts_on_a_harmed_joint_alone_is_as_stated(rubbing):
    harmful = beside(rubbing, 1.0, 3.0, first=6.0)
    found, as_given = harmful.without_harmful_members()
    assert not as_given
    assert {effect.joint: effect.f_v for effect in found.beside.simulation.effects} == {
        1: 0.5,
        2: 3.0,
    }


def test_a_set_that_serves_takes_the_place_of_one_that_harms(rubbing):
    """Although that follows a joint further, which it would lose together with what harms."""
    harmful, serving = beside(rubbing, 0.8, 3.0), beside(rubbing, 1.0, 1.8)
    assert not harmful.improves_held_out
    assert serving.improves_held_out
    assert not beside(rubbing, 1.0, 1.0).improves_held_out  # it is as given, no better and no worse
    assert worse_at(serving.problem, serving.proven, harmful.proven, harmful.remaining) == (1,)
    assert harmful.or_better(serving) is serving
    assert serving.or_better(harmful) is serving


def test_of_two_sets_that_serve_none_is_worse_at_a_joint(rubbing):
    better, serving = beside(rubbing, 1.0, 3.0), beside(rubbing, 1.0, 1.8)
    assert better.or_better(serving) is better
    assert serving.or_better(better) is better
