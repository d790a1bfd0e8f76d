"""Which members of a set stay: what a simulation can follow, the simpler, and a load of equals."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from types import SimpleNamespace

import numpy as np
import pytest
from noisy_recordings import observed

from estimators.diagnosis.from_torque.fitting import settling, simplicity, solving
from estimators.diagnosis.from_torque.fitting.contribution import error_removed
from estimators.diagnosis.from_torque.fitting.problem import RegressionProblem, fitted, simulated
from estimators.diagnosis.from_torque.fitting.settling import (
    _in_errors,
    _not_recorded,
    _of_one_width,
    _runaway,
    pruned,
    suspects,
)
from estimators.diagnosis.from_torque.fitting.simplicity import loaded, simplified
from estimators.diagnosis.from_torque.fitting.solving import _Search
from estimators.diagnosis.from_torque.judgement.judgement import acts_most
from estimators.diagnosis.from_torque.residuals.noise import Noise
from estimators.diagnosis.held_out import rmse
from estimators.diagnosis.settings.fitting import CONTRIBUTION
from estimators.diagnosis.stages import quiet
from limo_driver.physics import (
    Backlash,
    CoulombFriction,
    JointElasticity,
    LoadDependentFriction,
    Payload,
    PositionDependentFriction,
    SpringLoad,
    Tolerances,
    TorqueGain,
    TorqueOffset,
    ViscousFriction,
)

BODY = Payload(mass=1.5, com=(0.0, 0.0, 0.1), inertia=(0.01, 0.0, 0.0, 0.01, 0.0, 0.01))


@pytest.fixture(scope="module")
def seen(arm):
    """Make a function that records effects of an arm of two joints."""
    return partial(observed, robot=str(arm), duration=30.0)


@pytest.fixture(scope="module")
def problem_of(seen):
    """Make a function that lays out what competes where there are some effects."""
    return lambda *effects: laid_out(seen(*effects))


def laid_out(observed):
    """Lay out what competes, with the noise that is left once the effects are known."""
    problem = RegressionProblem.of(observed, quiet)
    return problem, Noise.independent(np.full(observed.n, 0.02), problem.split.fitted)


def place_of(problem, effect, joint):
    """Return the candidate of an effect at a joint (1-based) with most columns; the widest."""
    there = [
        (candidate.prior.index.size, float(candidate.prior.deviation.max()), i)
        for i, candidate in enumerate(problem.candidates)
        if candidate.place == (effect, (joint - 1,))
    ]
    return max(there)[-1]


@pytest.fixture(scope="module")
def carrying(problem_of):
    return problem_of(BODY)


def test_a_member_that_no_simulation_can_follow_goes_and_what_it_carries_stays(carrying):
    problem, noise = carrying
    payload, soft = place_of(problem, "payload", 2), place_of(problem, "joint_elasticity", 1)
    # little of it is missed, and still it is not to blame: the simulation adds it as it stands
    offset = place_of(problem, "torque_offset", 2)
    solution = fitted(problem, (payload, soft, offset), noise)
    mean = solution.fitted.mean.copy()
    at = problem.nuisance.prior.index.size
    own = [i for m in solution.members for i in [m] * problem.candidates[m].prior.index.size]
    (coefficient,) = [at + k for k, member in enumerate(own) if member == soft]
    (gear,) = problem.candidates[soft].hypothesis.realise(np.array([1.0]))
    assert isinstance(gear, JointElasticity)
    mean[coefficient] = gear.stiffness / 10.0  # 10 N m/rad, under a load of ten newton metres
    runaway = replace(solution, fitted=replace(solution.fitted, mean=mean))
    assert _runaway(runaway) == soft
    assert _Search(quiet, None).of_possible_links(runaway) is runaway  # it has no link
    assert pruned(runaway).members == (payload,)


def test_deviations_of_joints_add_up_in_squares():
    left = np.array([[1.0, 0.5]])
    problem = SimpleNamespace(split=SimpleNamespace(fitted=left > 0), left=lambda _: left)
    one = SimpleNamespace(problem=problem, fitted=None)
    assert _in_errors(one, np.array([[3.0, 2.0]])) == pytest.approx(3.0**2 + 4.0**2)


def test_what_sensors_add_is_left_by_the_simulation_of_a_fit(problem_of):
    problem, noise = problem_of(TorqueOffset(joint=1, offset=0.05))
    solution, rows = fitted(problem, (), noise), problem.split.fitted
    added = rmse(problem.sensed(solution.fitted), rows)
    its = simulated(solution) - problem.left_without_sensors(solution.fitted)
    assert (rmse(its, rows) < 0.01 * added).all()


@pytest.mark.parametrize(
    ("members", "gone", "left"),
    [((2, 3), 2, (3, 0, 1)), ((2, 3), 3, (2,)), ((0, 1, 3), 0, (1, 3)), ((0, 2), 2, (0, 1))],
)
def test_a_joint_that_loses_a_law_of_friction_has_plain_friction_again(members, gone, left):
    """But none that was taken out as such, and none for what is no friction."""
    effects = ("coulomb_friction", "viscous_friction", "presliding_hysteresis", "spring_load")
    candidates = [
        SimpleNamespace(effect=effect, joints=(0,), place=(effect, (0,)), slot=effect)
        for effect in effects
    ]
    problem = SimpleNamespace(candidates=candidates, base=(0, 1))
    assert RegressionProblem.less(problem, members, (gone,)) == left


def test_lines_are_looked_for_beside_those_that_a_set_has(monkeypatch):
    found = (
        None,
        SimpleNamespace(effect="torque_ripple", joints=(1,), settings=(7.0,)),
        SimpleNamespace(effect="backlash", joints=(0,), settings=(0.1,)),
    )
    problem = SimpleNamespace(
        candidates=[SimpleNamespace(hypothesis=item) for item in found],
        observed=None, left=lambda fit: fit, with_candidates=list,
    )  # fmt: skip
    known = []
    monkeypatch.setattr(
        solving, "ripples", lambda _, left, lines: known.append((left, lines)) or ()
    )
    solving._scanned(SimpleNamespace(problem=problem, members=(0, 1, 2), fitted="left"))
    assert known == [("left", {1: (7.0,)})]


@pytest.mark.slow("fits the bodies of an arm of seven joints")
def test_links_that_would_be_no_bodies_give_way_to_what_can_be():
    """Two sensors tell half of the torque: more mass would have to be gone than is there."""
    gains = (TorqueGain(joint=2, gain=-0.5), TorqueGain(joint=4, gain=-0.5))
    problem, noise = laid_out(observed(*gains))
    links = tuple(place_of(problem, "link_inertia", joint) for joint in (2, 3, 4, 5))
    solution = fitted(problem, links, noise)
    other = _Search(quiet, None).of_possible_links(solution)
    found = {other.problem.candidates[i].place for i in other.members}
    assert found >= {("torque_gain", (1,)), ("torque_gain", (3,))}
    assert "link_inertia" not in {effect for effect, _ in found}


def test_a_link_that_is_wrong_stays_where_it_can_be_what_it_says(carrying):
    problem, noise = carrying
    solution = fitted(problem, (place_of(problem, "link_inertia", 2),), noise)
    assert _Search(quiet, None).of_possible_links(solution) is solution


def test_what_a_member_does_elsewhere_by_what_is_beside_it_is_not_its_own(carrying):
    problem, noise = carrying
    payload = place_of(problem, "payload", 2)
    drag = place_of(problem, "spring_load", 1)
    solution = fitted(problem, tuple(sorted((payload, drag))), noise)
    floor = np.array([1e9, 1e-9])  # joint 2 would come first by far
    assert acts_most(solution, drag, floor) == 0


@pytest.mark.slow("fits an arm of seven joints each")
@pytest.mark.parametrize(("offset", "stays"), [(0.008, False), (0.014, True)])
def test_what_sensors_would_take_at_their_limit_is_no_idle_member(offset, stays):
    """No simulation has what sensors add: it would err by an offset that seems to matter little."""
    problem, noise = laid_out(observed(TorqueOffset(joint=3, offset=offset)))
    solution = fitted(problem, (place_of(problem, "torque_offset", 3),), noise)
    (member,) = solution.members
    assert error_removed(solution, member) < CONTRIBUTION.material
    assert pruned(solution).members == ((member,) if stays else ())


def test_of_two_that_predict_alike_the_simpler_stays(problem_of):
    problem, noise = problem_of(TorqueOffset(joint=1, offset=0.4))
    offset, spring = place_of(problem, "torque_offset", 1), place_of(problem, "spring_load", 1)
    assert simplified(fitted(problem, (spring,), noise)).members == (offset,)
    assert simplified(fitted(problem, (offset,), noise)).members == (offset,)


def test_stated_friction_that_is_but_sharper_goes_where_friction_along_the_range_takes_it(seen):
    """Between two that take from one another what they add, only one is anything."""
    knots, stated = tuple(np.linspace(-2.0, 2.0, 14)), CoulombFriction(joint=1, tau_c=1.0)
    heights = tuple(0.5 * np.exp(-np.square(knots) / 0.3))
    bump = PositionDependentFriction(joint=1, positions=knots, excess=heights, v_eps=1e-3)
    recorded = seen(replace(stated, v_eps=1e-3), bump)
    believed = replace(
        recorded.simulation,
        effects=(replace(stated, v_eps=2e-3),),
        tolerances=Tolerances(friction=0.1),
    )
    problem, noise = laid_out(recorded.under(believed))
    (sharper, *_) = (
        i
        for i, item in enumerate(problem.candidates)
        if item.place == ("coulomb_friction", (0,)) and item.other_width
    )
    along = place_of(problem, "position_dependent_friction", 1)
    both = fitted(problem, (sharper, along), noise)
    one = _of_one_width(both, quiet)
    (kept,) = one.members
    assert one.problem.candidates[kept].effect == "position_dependent_friction"
    alone = fitted(problem, (sharper,), noise)
    assert _of_one_width(alone, quiet) is alone


EVERY = np.ones((4, 2), dtype=bool)  # row of two joints


def errors(at_second):
    """Errors of 1 N m at the first joint, and of some at the second."""
    return np.where(EVERY, [1.0, at_second], 0.0)


@pytest.mark.parametrize(("lacking", "stay"), [(1.11, (1,)), (1.13, (0, 1))])
def test_friction_that_is_but_sharper_stays_where_a_joint_errs_clearly_more_without(
    monkeypatch, lacking, stay
):
    left = {(1,): errors(lacking), (1, 0): errors(1.0)}
    kinds, friction = ("wrong_parameter", "missing"), "position_dependent_friction"
    candidates = [
        SimpleNamespace(other_width=k == 0, kind=kind, effect=friction, joints=(1,))
        for k, kind in enumerate(kinds)
    ]
    problem = SimpleNamespace(
        candidates=candidates, split=SimpleNamespace(fitted=EVERY), left=lambda fit: fit
    )
    monkeypatch.setattr(settling, "refined", lambda solution, _: solution)
    monkeypatch.setattr(
        settling,
        "fitted",
        lambda problem, members, noise: SimpleNamespace(
            problem=problem, members=members, noise=noise, fitted=left[members]
        ),
    )
    both = SimpleNamespace(problem=problem, members=(0, 1), noise=None)
    assert _of_one_width(both, quiet).members == stay


@pytest.mark.parametrize("held_out", [True, False])
@pytest.mark.parametrize(("more", "well"), [(1.11, True), (1.13, False)])
def test_fewer_do_as_well_where_no_joint_errs_clearly_more(monkeypatch, more, well, held_out):
    """Neither on motion held out nor on all of it."""
    one, other = errors(1.0), errors(more)
    turns = (one, other if held_out else one)
    monkeypatch.setattr(simplicity, "in_turn", lambda *_: (turns, EVERY))
    problem = SimpleNamespace(observed=SimpleNamespace(moving=EVERY), left=lambda fit: fit)
    some, fewer = (
        SimpleNamespace(problem=problem, members=(), fitted=fit)
        for fit in (one, one if held_out else other)
    )
    assert simplicity._does_as_well(some, fewer) is well


def test_friction_of_one_joint_stays_where_that_of_two_coupled_predicts_alike(problem_of):
    problem, noise = problem_of(CoulombFriction(joint=1, tau_c=0.5))
    (coupling, *_) = (
        i
        for i, item in enumerate(problem.candidates)
        if item.effect == "joint_coupling" and 0 in item.joints and item.prior.index.size > 1
    )
    (kept,) = simplified(fitted(problem, (coupling,), noise)).members
    assert problem.candidates[kept].joints == (0,)


def test_what_is_more_than_the_simpler_explains_keeps_its_name(problem_of):
    problem, noise = problem_of(SpringLoad(joint=1, stiffness=2.0, rest=0.3))
    knots = place_of(problem, "spring_load", 1)
    (kept,) = simplified(fitted(problem, (knots,), noise)).members
    assert problem.candidates[kept].effect == "spring_load"


def test_two_of_a_joint_give_way_to_one_that_does_as_well_and_stay_where_none_does(problem_of):
    pressed = LoadDependentFriction(joint=1, coefficient=0.2, variant="negative")
    spring = SpringLoad(joint=1, stiffness=3.0, rest=0.3)
    problem, noise = problem_of(pressed)
    absolute, negative = (
        next(
            i
            for i, item in enumerate(problem.candidates)
            if item.effect == pressed.name and item.hypothesis.terms[0].variant == variant
            if item.joints == (0,)
        )
        for variant in ("absolute", "negative")
    )
    gain = place_of(problem, "torque_gain", 1)
    both = fitted(problem, (absolute, gain), noise)
    assert simplified(both).members == (negative,)

    more, noise = problem_of(pressed, spring)
    (linear,) = (
        i
        for i, item in enumerate(more.candidates)
        if item.place == (spring.name, (0,)) and isinstance(item.hypothesis.terms[1], TorqueOffset)
    )
    both = fitted(more, (negative, linear), noise)
    assert {more.candidates[i].effect for i in simplified(both).members} == {
        pressed.name,
        spring.name,
    }


def test_a_load_has_the_name_of_the_wrong_last_link_that_it_equals(carrying):
    problem, noise = carrying
    link, other = place_of(problem, "link_inertia", 2), place_of(problem, "link_inertia", 1)
    payload = place_of(problem, "payload", 2)
    (named,) = loaded(fitted(problem, (link,), noise)).members
    assert problem.candidates[named].place == problem.candidates[payload].place
    assert loaded(fitted(problem, (other,), noise)).members == (other,)


def test_a_small_load_is_likelier_as_one_that_is_expected_to_be_small(problem_of):
    small = Payload(mass=0.05, com=(0.0, 0.0, 0.1), inertia=(3e-4, 0.0, 0.0, 3e-4, 0.0, 3e-4))
    problem, noise = problem_of(small)
    solution = fitted(problem, (), noise)
    loads = [i for i, item in enumerate(problem.candidates) if item.effect == "payload"]
    widest, narrowest = sorted(loads, key=lambda i: -problem.candidates[i].prior.deviation[0])
    assert solution.search.gain((narrowest,)) > solution.search.gain((widest,)) + 3.0


def test_how_sharp_a_sign_is_makes_no_friction_simpler_than_another(problem_of):
    problem, noise = problem_of(CoulombFriction(joint=1, tau_c=0.5))
    coulomb = place_of(problem, "coulomb_friction", 1)
    assert simplified(fitted(problem, (coulomb,), noise)).members == (coulomb,)


def test_friction_has_to_bring_nothing_to_be_believed_where_none_is_stated(seen, problem_of):
    problem, _ = problem_of()
    stated = replace(seen().simulation, effects=(CoulombFriction(joint=1, tau_c=0.5),))
    other, _ = laid_out(seen().under(stated))

    def prior_penalty(problem, effect, joint):
        return problem.candidates[place_of(problem, effect, joint)].prior_penalty

    assert prior_penalty(problem, "coulomb_friction", 1) == 0.0
    assert prior_penalty(other, "coulomb_friction", 2) == 0.0
    assert prior_penalty(other, "coulomb_friction", 1) > 0.0
    assert prior_penalty(problem, "spring_load", 1) == prior_penalty(other, "spring_load", 1) > 5.0


def test_a_last_link_that_lacks_mass_carries_no_load(seen):
    given = seen().simulation
    body = given.model.inertials["lower"].joined(BODY.load)
    problem, noise = laid_out(seen().under(replace(given, inertials={"lower": body})))
    lighter = fitted(problem, (place_of(problem, "link_inertia", 2),), noise)
    assert loaded(lighter) is lighter


@pytest.mark.parametrize(("stated", "suspicious"), [(12.7, False), (15.0, True)])
def test_a_value_is_suspicious_where_data_put_it_surely_beyond_its_tolerance(
    seen, stated, suspicious
):
    """Three deviations of a tenth allow 10 N m s/rad to be stated as 14.3 at most."""
    rubbing = ViscousFriction(joint=2, f_v=stated)
    recorded = seen(ViscousFriction(joint=2, f_v=10.0))
    given = replace(recorded.simulation, effects=(rubbing,), tolerances=Tolerances(friction=0.1))
    problem, noise = laid_out(recorded.under(given))
    found = suspects(fitted(problem, (), noise), joints=())
    assert found == ({("viscous_friction", (1,))} if suspicious else set())


@pytest.mark.parametrize(
    ("recorded", "has_play"), [("all", True), ("half", True), ("turned", False), ("none", False)]
)
def test_impacts_of_play_have_to_be_in_what_was_recorded_above_the_bandwidth(
    seen, recorded, has_play
):
    """As sharp and the way of the law, where the drive recoils in some of them."""
    play = replace(seen().simulation, effects=(Backlash(joint=2, gap=0.01),))
    fit = seen().under(play)
    bare = fit.predict(seen().simulation)
    part = {"all": 1.0, "half": 1.02, "turned": -0.9, "none": 0.0}[recorded]
    law = part * (fit.predict(play) - bare)
    if recorded == "half":
        law[fit.motion.time % 4.0 > 2.0] = 0.0
    vars(fit)["recorded"] = bare + law
    problem = SimpleNamespace(
        under=lambda _: fit, candidates=[SimpleNamespace(place=("backlash", (1,)))]
    )

    silent = _not_recorded(SimpleNamespace(problem=problem, members=(0,)))

    assert silent == (set() if has_play else {("backlash", (1,))})
