"""What is judged of a fit: whether it harmed, and what no recording can tell apart."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from noisy_recordings import NOISE, observed

from estimators.diagnosis.from_torque.fitting.contribution import contribution, contribution_of_all
from estimators.diagnosis.from_torque.fitting.problem import RegressionProblem, fitted
from estimators.diagnosis.from_torque.judgement import judgement
from estimators.diagnosis.from_torque.judgement.findings import findings_of
from estimators.diagnosis.from_torque.judgement.judgement import (
    RemainingResidual,
    abstained,
    acts_most,
    equivalents,
    harmed,
    identical,
    margin,
    other_links,
    remaining_residual,
    remarks,
    trusted_gains,
)
from estimators.diagnosis.from_torque.residuals.noise import Noise
from estimators.diagnosis.from_torque.residuals.observations import Observations
from estimators.diagnosis.held_out import rmse
from estimators.diagnosis.result import Shift
from estimators.diagnosis.settings.fitting import SEARCH
from estimators.diagnosis.stages import quiet
from limo_driver.physics import (
    CoulombFriction,
    GravityDirection,
    Simulation,
    SpringLoad,
    Tolerances,
)
from limo_driver.recordings.recording import Recording

FLOOR = np.full(2, 0.1)


def problem_of(effect="viscous_friction", joints=(0,)):
    split = SimpleNamespace(held_out=np.ones((100, 2), dtype=bool))
    simulation = SimpleNamespace(effects=(), model=SimpleNamespace(n=2))
    observed = SimpleNamespace(n=2, residual=np.full((100, 2), 0.2), simulation=simulation)
    candidates = [SimpleNamespace(effect=effect, joints=joints)]
    return SimpleNamespace(split=split, observed=observed, candidates=candidates, base=())


@pytest.mark.parametrize(("error", "joints"), [(0.1, ()), (0.24, ()), (0.26, (1,))])
def test_a_fit_harms_where_one_joint_is_predicted_clearly_worse(error, joints):
    proven = np.column_stack([np.full(100, 0.1), np.full(100, error)])
    assert harmed(problem_of(), proven, RemainingResidual(FLOOR, 0 * FLOOR, 0 * proven)) == joints


@pytest.mark.parametrize(
    ("effect", "joint", "same"),
    [
        ("payload", 1, ("link_inertia",)),
        ("link_inertia", 1, ("payload",)),
        ("link_inertia", 0, ()),
        ("torque_offset", 0, ("asymmetric_friction",)),
        ("viscous_friction", 0, ()),
    ],
)
def test_what_no_recording_tells_apart_is_named_together(effect, joint, same):
    assert identical(problem_of(effect, (joint,)), 0) == same


def test_a_link_that_errs_in_several_ways_is_told_once():
    places = [("payload", (2,)), ("link_inertia", (1,)), ("link_inertia", (0,))]
    places += [("link_inertia", (1,)), ("viscous_friction", (1,)), ("link_inertia", (2,))]
    candidates = [SimpleNamespace(effect=effect, joints=joints) for effect, joints in places]
    search = SimpleNamespace(gain=lambda _members: 0.0)
    problem = SimpleNamespace(candidates=candidates)
    solution = SimpleNamespace(problem=problem, search=search, members=(0,))
    assert other_links(solution, 0) == (1, 0)


def test_what_a_law_does_not_get_right_is_imprecision_beside_much_and_unknown_beside_little():
    """Both joints keep the same residual; at the first one, effects explain 99.6 % of the error."""
    bare, fitted = np.tile([1.0, 0.2], (100, 1)), np.full((100, 2), 0.06)
    problem = problem_of()
    problem.left = {"nothing": bare, "all": fitted}.get
    evidence = SimpleNamespace(posterior=lambda _prior: "nothing")
    search = SimpleNamespace(evidence=evidence, prior=lambda members: members)
    solution = SimpleNamespace(problem=problem, search=search, fitted="all", members=())
    remaining = RemainingResidual(FLOOR, np.full(2, 0.06), fitted)
    assert abstained(solution, remaining) == ((), (1,))
    quiet = RemainingResidual(FLOOR, np.full(2, 0.04), fitted)
    assert abstained(solution, quiet) == ((), ())


@pytest.fixture(scope="module")
def sprung(rigid, training_recording):
    """A spring at joint 2, found, and the mean square that it removes there [N² m²]."""
    motion, random = training_recording.motion(10.0), np.random.default_rng(3)
    true = replace(rigid, effects=(*rigid.effects, SpringLoad(joint=2, stiffness=2.0, rest=0.3)))
    torque = true.predict(motion) + NOISE * random.standard_normal(motion.position.shape)
    recording = replace(training_recording, torque=torque)
    problem = RegressionProblem.of(Observations.of(rigid, [recording], 10.0), quiet)
    places = [candidate.place for candidate in problem.candidates]
    member = places.index((SpringLoad.name, (1,)))
    solution = fitted(problem, (member,), Noise.independent(FLOOR, problem.split.fitted))
    return problem, solution, contribution_of_all(solution)[1]


@pytest.mark.parametrize(
    ("explained", "floor", "named", "unknown"),
    [
        (0.995, 0.01, True, False),  # what is left is imprecision of the law
        (0.97, 0.01, True, True),
        (0.90, 0.01, False, True),  # a wrong name often explains that much
        (0.90, 1.0, True, True),  # of little that is left
        (0.70, 1.0, False, True),
        (0.70, 100.0, True, False),  # which may be noise
    ],
)
def test_a_name_is_kept_back_where_much_is_left_that_it_does_not_explain(
    sprung, explained, floor, named, unknown
):
    """Of the error of a joint, a part is explained, and a black box predicts the rest."""
    problem, solution, removed = sprung
    left = np.sqrt(removed * (1.0 / explained - 1.0))
    floors = np.array([1.0, 1.2 * floor * left])
    remaining = RemainingResidual(floors, np.array([0.0, left]), 0.0 * problem.target)
    stay, joints = abstained(solution, remaining)
    assert stay == (solution.members if named else ())
    assert joints == ((1,) if unknown else ())


def test_a_name_is_kept_back_that_only_mends_what_moved_values_did(sprung, monkeypatch):
    """Joint 3 of an arm erred by 0.224 as given, 0.297 with values moved, and 0.222 with a load."""
    problem, solution, _ = sprung
    left = problem.left(solution.fitted)
    remaining = RemainingResidual(np.ones(2), np.zeros(2), left)
    for given, named in ((0.9 * left, ()), (2.0 * left, solution.members)):
        monkeypatch.setattr(judgement, "_residual_before", lambda *_, given=given: given)
        assert abstained(solution, remaining) == (named, ())


@pytest.mark.parametrize(
    ("joints", "unknown", "size", "part"),
    [
        ((5,), [3, 4, 6], 0.99, True),  # a spring of a Franka's wrist, whose links were wrong
        ((5,), [3, 4, 6], 1.01, False),
        ((), [3, 4], 0.7, True),  # of the whole arm
        ((5,), [4, 5], 0.7, False),
        ((0,), [0], 0.9, False),
    ],
)
def test_a_slight_effect_is_but_a_part_of_what_nothing_explains_at_several_other_joints(
    monkeypatch, joints, unknown, size, part
):
    monkeypatch.setattr(judgement, "error_removed", lambda *_: size)
    solution = SimpleNamespace(problem=problem_of("spring_load", joints))
    assert judgement._is_part_of_more(solution, 0, unknown) == part


def test_a_finding_is_told_by_what_it_removes_and_by_how_far_it_leads(sprung):
    problem, solution, _ = sprung
    (member,), after = solution.members, np.array([0.1, 0.2])
    remaining = RemainingResidual(FLOOR, 0 * FLOOR, 0 * problem.target)
    (found,) = findings_of(solution, (member,), remaining, 10 * FLOOR, after)
    removed = contribution(solution, member)
    assert found.heldout_rmse.before == pytest.approx(np.sqrt(after**2 + removed))
    assert found.heldout_rmse.after == tuple(after)
    same = equivalents(solution, member)
    assert found.signs["lead"] == margin(solution, member, same)


def test_the_best_of_each_place_that_brings_as_much_would_do_as_well():
    """But for its own place, and those that are taken."""
    places = ["own", "drag", "drag", "spring", "little", "taken", "own", "taken"]
    evidence = [10.0, 7.0, 9.0, 9.5, 5.0, 12.0, 9.9, 11.0]  # [nat], beside what is taken
    candidates = [SimpleNamespace(place=place, own=k) for k, place in enumerate(places)]
    search = SimpleNamespace(gain=lambda members: evidence[members[-1]])
    problem = SimpleNamespace(candidates=candidates)
    solution = SimpleNamespace(problem=problem, search=search, members=(5, 0))
    found = equivalents(solution, 0)
    assert [item.own for item in found] == [3, 2]


@pytest.mark.parametrize(
    ("nothing", "rival", "lead"), [(-4.0, 7.0, 3.0), (8.0, 7.0, 2.0), (-4.0, -5.0, 14.0)]
)
def test_a_name_leads_over_the_best_of_what_else_could_be_said(nothing, rival, lead):
    """Another effect in its place, or none."""
    places = [("payload", (0,)), ("backlash", (0,)), ("spring_load", (0,)), ("backlash", (1,))]
    candidates = [SimpleNamespace(effect=e, joints=on, place=(e, on)) for e, on in places]
    evidence = {(0,): 10.0, (1,): rival, (2,): 9.5, (3,): -9.0, (): nothing}
    search = SimpleNamespace(gain=lambda members: evidence[tuple(members)])
    problem = SimpleNamespace(candidates=candidates, observed=SimpleNamespace(n=2))
    same = [candidates[2]]  # said beside it, as what does as well
    solution = SimpleNamespace(problem=problem, search=search, members=(0,))
    assert margin(solution, 0, same) == lead


@pytest.mark.parametrize(
    ("effect", "named"),
    [
        (GravityDirection(gravity=(0.4, -0.3, -9.797)), True),
        (SpringLoad(joint=2, stiffness=2.0, rest=0.3), False),
    ],
)
def test_what_acts_on_the_whole_arm_is_named_beside_something_unknown_at_one_joint(
    two_links_urdf, effect, named
):
    """A torque of one joint alone only stands in for it there."""
    problem = RegressionProblem.of(
        observed(effect, robot=str(two_links_urdf), duration=30.0), quiet
    )
    noise = Noise.independent(np.full(2, NOISE), problem.split.fitted)
    there = (i for i, item in enumerate(problem.candidates) if item.effect == effect.name)
    member = max(there, key=lambda i: fitted(problem, (i,), noise).gain)
    solution, floor = fitted(problem, (member,), noise), np.full(2, NOISE)
    if named:  # in squares of the noise floors
        size = np.sqrt(contribution(solution, member))
        less, more = np.argsort(size)
        assert size[more] > 1.2 * size[less]
        assert acts_most(solution, member, size * np.where(size > size[less], 1.2, 1.0)) == less
    most = acts_most(solution, member, floor)
    predictable = np.where(np.arange(2) == most, 10.0, 0.0)  # [N m], of much more than is explained
    remaining = RemainingResidual(floor, predictable, 0.0 * problem.target)
    assert abstained(solution, remaining) == ((member,) if named else (), (most,))


def test_the_predictable_part_is_kept_as_a_series(rigid, training_recording):
    observed = Observations.of(rigid, [training_recording], 10.0)
    rows, noise = observed.moving, np.random.default_rng(0).standard_normal(observed.moving.shape)
    planted = np.column_stack([np.tanh(observed.slow.velocity[:, 0] / 0.04), 0 * noise[:, 0]])
    found = remaining_residual(observed, planted + 0.1 * noise)
    assert found.floor == pytest.approx(0.1, rel=0.1)
    assert found.predictable[0] == pytest.approx(rmse(planted, rows)[0], rel=0.05)
    assert found.predictable[1] < 0.05
    assert np.corrcoef(found.series[rows[:, 0], 0], planted[rows[:, 0], 0])[0, 1] > 0.98
    assert np.abs(found.series[:, 1]).max() < 0.1


def test_a_black_box_that_fails_predicts_nothing_and_says_so(
    rigid, training_recording, monkeypatch
):
    def failing(*_):
        raise np.linalg.LinAlgError("Singular matrix")

    monkeypatch.setattr(
        "estimators.diagnosis.from_torque.judgement.judgement.predictable_part", failing
    )
    observed = Observations.of(rigid, [training_recording], 10.0)
    left = 0.1 * np.random.default_rng(0).standard_normal(observed.moving.shape)
    found = remaining_residual(observed, left)
    assert not found.clearly_predictable.any()
    assert not RemainingResidual(0 * FLOOR, 0 * FLOOR, 0 * left).clearly_predictable.any()
    (failure,) = found.failures
    assert "LinAlgError: Singular matrix" in str(failure)


def test_a_reader_is_told_which_sensors_are_off_and_what_stopped_the_search():
    shifts = (
        Shift("tau_c of joint 2", 2.2, 3.0, "N m", 2.4),
        Shift("lag of sensor 5", 0, -9e-4, "s", -3.0),
        Shift("mass", 0, 0.01, "kg", 0.5),
    )
    said = tuple(remarks(shifts, members=SEARCH.largest, harmful=False, passing=()))
    assert "tau_c" not in said[0]  # the table of stated values has it
    assert "lag of sensor 5 by -3.0 standard deviations (its limit)" in said[0]
    assert "Lags of sensors are not written into the improved simulation" in said[0]
    assert "mass" not in said[0]
    assert f"stopped at {SEARCH.largest} effects" in said[1]
    assert tuple(remarks((), members=1, harmful=False, passing=())) == ()


@pytest.mark.parametrize("recordings", [1, 2])
def test_whether_recordings_belong_together_is_asked_of_several(recordings):
    (said,) = remarks((), members=1, harmful=True, passing=(), recordings=recordings)
    assert ("belong together" in said) == (recordings > 1)


@pytest.mark.parametrize(
    ("share", "gain", "found", "told"),
    [
        (0.06, 0.0, "payload", "a wrong gain looks like payload."),
        (0.06, 0.0, "spring_load", ""),
        (0.06, 0.1, "payload", ""),  # which is what the note asks for
        (0.002, 0.0, "payload", ""),  # a sensor behind the gear has no such gain
    ],
)
def test_a_body_found_in_torques_of_drives_comes_with_a_word_on_their_gains(
    share, gain, found, told
):
    known = Simulation("iiwa14", tolerances=Tolerances(gain=gain))
    friction = enumerate((share * known.model.limits.torque).tolist(), start=1)
    simulation = replace(
        known, effects=tuple(CoulombFriction(joint=j, tau_c=most) for j, most in friction)
    )
    t = np.arange(0, 20, 0.01)
    position = 0.4 * np.sin(np.outer(t, 0.3 + 0.1 * np.arange(7)))
    recording = Recording.from_arrays(t, position, np.cos(position))
    notes = [*trusted_gains([SimpleNamespace(effect=found)], simulation, [recording])]
    assert [told in note and "tolerance of gains" in note for note in notes] == [True] * bool(told)
