"""Conclusion: what competed is told with shares of the reducible error, and why it lost."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from estimators.diagnosis.from_torque.fitting.problem import RegressionProblem, fitted
from estimators.diagnosis.from_torque.judgement.conclusion import (
    explanations_of,
    fit_of,
    identified_of,
    not_observable,
    rows_of,
    shifts_of,
    unproven,
)
from estimators.diagnosis.from_torque.judgement.judgement import RemainingResidual
from estimators.diagnosis.from_torque.residuals.noise import Noise
from estimators.diagnosis.from_torque.residuals.observations import Observations
from estimators.diagnosis.held_out import rmse
from estimators.diagnosis.result import CHOSEN
from estimators.diagnosis.settings.fitting import CANDIDATES, CONTRIBUTION
from estimators.diagnosis.stages import quiet
from limo_driver.physics import CoulombFriction, SpringLoad
from limo_driver.recordings.recording import Recording

FLOOR = np.full(2, 0.01)  # [N m]


@pytest.fixture(scope="module")
def problem(rigid, training_recording):
    """An arm with a spring that its simulation lacks, and Coulomb friction a little too low."""
    r = training_recording
    motion = r.motion(10.0)
    known = tuple(CoulombFriction(joint=j, tau_c=1.1) for j in (1, 2))
    true = replace(rigid, effects=(*known, SpringLoad(joint=2, stiffness=8.0, rest=0.0)))
    noise = FLOOR * np.random.default_rng(0).standard_normal(r.position.shape)
    recording = Recording.from_arrays(r.time, r.position, true.predict(motion) + noise)
    return RegressionProblem.of(Observations.of(rigid, [recording], 10.0), quiet)


@pytest.fixture(scope="module")
def noise(problem):
    return Noise.independent(FLOOR, problem.split.fitted)


def spring_of(problem):
    return next(i for i, c in enumerate(problem.candidates) if c.place == ("spring_load", (1,)))


def test_a_set_that_was_taken_back_keeps_its_share_and_nothing_is_no_share(problem, noise):
    found = explanations_of(fitted(problem, (), noise), FLOOR)
    (chosen,) = (item for item in found if item.note == CHOSEN)
    assert chosen.effects == ()
    assert chosen.share == pytest.approx(0.0, abs=1e-9)
    assert found[0].log_evidence > chosen.log_evidence
    assert found[0].share > 0.9


def test_the_chosen_set_is_told_even_where_many_have_more_evidence(problem, noise):
    found = explanations_of(fitted(problem, (), noise), FLOOR, limit=3)
    assert len(found) == 3
    assert [item.log_evidence for item in found] == sorted(
        (item.log_evidence for item in found), reverse=True
    )
    assert sum(item.note == CHOSEN for item in found) == 1


def test_more_evidence_that_motion_held_out_denies_is_said_to(problem, noise):
    chosen = fitted(problem, (spring_of(problem),), noise)
    denied = replace(
        problem, target=np.where(problem.split.held_out, -problem.target, problem.target)
    )
    assert chosen.gain > 0
    found = explanations_of(fitted(denied, (), noise), FLOOR)
    assert found[0].note == "does not hold on motion held out"


@pytest.mark.parametrize(
    ("size", "note"),
    [
        (0.8, "takes too little off motion held out"),
        (1.2, "predicts better as a linear fit; no check made here speaks against it"),
    ],
)
def test_more_evidence_that_takes_off_too_little_is_said_to(problem, noise, size, note):
    """Where what it would take off is so many times what a finding has to, in noise floors."""
    nothing = fitted(problem, (), noise)
    kept = rmse(problem.left(nothing.fitted), problem.split.held_out)
    floor = np.full(2, kept.max() / (size * CONTRIBUTION.material))
    assert explanations_of(nothing, floor)[0].note == note


def test_known_values_move_in_their_own_units(problem, noise):
    chosen = fitted(problem, (spring_of(problem),), noise)
    (dry,) = (s for s in shifts_of(chosen) if s.name.startswith("tau_c of joint 1 "))
    assert (dry.nominal, dry.unit) == (1.0, "N m")
    assert dry.fitted == pytest.approx(1.1, abs=0.02)
    assert dry.sigmas == pytest.approx((dry.fitted - 1.0) / 0.15)
    assert 0.0 < dry.left < 0.1  # of a tolerance, so many rows leave little open


def test_rows_are_counted_from_all_of_them_to_those_that_are_judged(problem):
    count, split = rows_of(problem), problem.split
    assert count.used == len(problem.observed.recordings[0])
    assert count.total == len(problem.observed.kept) > count.held_out > max(count.judged)
    assert count.judged == tuple(split.held_out.sum(axis=0))
    assert count.fitted == tuple(split.fitted.sum(axis=0))
    assert count.usable == tuple(problem.observed.moving.sum(axis=0))
    assert all(0 < part < 1 for part in count.part_judged())


def test_rows_left_out_are_counted_by_reason_over_recordings(problem):
    left = [(("gap", 3),), (("gap", 4), ("jolt", 5))]
    recordings = [
        replace(
            problem.observed.recordings[0],
            left_out=tuple(SimpleNamespace(reason=name, rows=range(n)) for name, n in some),
        )
        for some in left
    ]
    more = replace(problem, observed=replace(problem.observed, recordings=recordings))
    assert rows_of(more).left_out == {"gap": 7, "jolt": 5}


def test_ordinary_members_are_values_to_identify_joint_by_joint():
    candidates = [
        SimpleNamespace(effect=effect, joints=joints)
        for effect, joints in (("viscous_friction", (2,)), ("armature", (0,)), ("armature", (2,)))
    ]
    found = identified_of(SimpleNamespace(candidates=candidates), (0, 1, 2))
    assert [(item.effect, item.joint) for item in found] == [
        ("armature", 1), ("armature", 3), ("viscous_friction", 3),
    ]  # fmt: skip


def test_errors_of_all_rows_have_those_near_rest(problem):
    moving = problem.observed.moving
    proven = np.where(moving, 0.01, 3.0)
    fit = fit_of(problem, proven, FLOOR, FLOOR)
    assert fit.heldout_rmse_after == pytest.approx((0.01, 0.01))
    part = np.array(rows_of(problem).part_judged())
    whole = np.sqrt(part * 0.01**2 + (1 - part) * 3.0**2)
    assert fit.heldout_rmse_after_all_rows == pytest.approx(whole)
    assert min(fit.heldout_rmse_before_all_rows) > 0


def test_what_was_found_is_not_said_to_be_unobservable(problem, noise):
    remaining = RemainingResidual(1e-4 * FLOOR, 0 * FLOOR, 0 * problem.target)
    nothing = {x.effect for x in not_observable(fitted(problem, (), noise), remaining)}
    assert "spring_load" in nothing  # of so low a floor all torques are many
    found = fitted(problem, (spring_of(problem),), noise)
    beside = {x.effect for x in not_observable(found, remaining)}
    assert beside == nothing - {"spring_load"}


def test_what_no_tolerance_is_like_shows_as_soon_as_noise_allows(problem, noise):
    remaining = RemainingResidual(1e-4 * FLOOR, 0 * FLOOR, 0 * problem.target)
    said = not_observable(fitted(problem, (), noise), remaining)
    (drift,) = (item.reason for item in said if item.effect == "torque_drift")
    each = FLOOR / np.sqrt(problem.split.fitted.sum(axis=0))  # [N m], of what all rows have
    least = float(drift.removeprefix("less than ").split()[0])
    assert least == pytest.approx(np.sqrt(2 * CANDIDATES.missing) * each.max(), rel=0.2)


def test_a_joint_that_moves_in_no_stretch_held_out_is_told():
    moving = np.array([[True, True, False], [True, False, False]])
    held_out = np.array([[False, False, False], [True, False, False]])
    given = SimpleNamespace(
        observed=SimpleNamespace(moving=moving), split=SimpleNamespace(held_out=held_out)
    )
    (said,) = unproven(given)
    assert said.startswith("No motion of joint 2 is held out")
    given.split.held_out = moving
    assert list(unproven(given)) == []
