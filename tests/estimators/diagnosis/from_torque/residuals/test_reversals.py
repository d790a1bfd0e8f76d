"""Reversals: where joints turn, and how large their errors usually are there."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pytest

from estimators.diagnosis.from_torque.residuals.observations import Observations
from estimators.diagnosis.from_torque.residuals.reversals import (
    about_reversals,
    steadily_moving,
    usual_about_reversals,
)
from estimators.diagnosis.settings.judgement import PUSHES
from limo_driver.physics import Simulation
from limo_driver.recordings.recording import Recording

if TYPE_CHECKING:
    from limo_driver.types import FloatArray

SIMULATION = Simulation("iiwa14")


def swinging(seconds: float, rest: float = np.inf) -> Observations:
    """Record joints that swing at 0.3 to 0.43 Hz; after some seconds the arm rests for one."""
    time = np.arange(0.0, seconds, 0.01)
    moved = np.cumsum((time < rest) | (time > rest + 1.0)) * 0.01
    rate = 2 * np.pi * np.array([0.31, 0.37, 0.43, 0.29, 0.35, 0.41, 0.33])
    position = 0.6 * np.sin(rate * moved[:, None] + np.arange(7.0))
    return Observations.of(
        SIMULATION, [Recording.from_arrays(time, position, np.zeros_like(position))], 10.0
    )


def errors_about(o: Observations, at_turns: float) -> FloatArray:
    """Return errors (K, n) of about one, and of so many about reversals."""
    errors = np.random.default_rng(1).choice([-1.0, 1.0], size=o.residual.shape)
    errors[about_reversals(o)] *= at_turns
    return errors


def test_errors_about_a_reversal_are_usual_where_other_reversals_leave_as_much() -> None:
    o = swinging(40.0)
    turns, steady = about_reversals(o), steadily_moving(o)
    errors = errors_about(o, 3.0)
    usual = usual_about_reversals(o, errors, steady, turns)

    assert not (turns & steady).any()
    assert usual[~turns] == pytest.approx(1.0)
    assert usual[turns] == pytest.approx(3.0 / 1.4826)


def test_what_one_reversal_leaves_says_nothing_of_what_is_usual_at_it() -> None:
    o = swinging(40.0)
    turns, steady = about_reversals(o), steadily_moving(o)
    errors = errors_about(o, 3.0)
    odd = turns[:, 2] & (np.abs(o.slow.time - 20.0) < 0.9)
    assert odd.any()
    errors[odd, 2] *= 100.0

    usual = usual_about_reversals(o, errors, steady, turns)

    assert usual[odd, 2] == pytest.approx(3.0 / 1.4826)


def test_errors_smaller_than_in_steady_motion_are_held_against_those() -> None:
    o = swinging(40.0)

    usual = usual_about_reversals(o, errors_about(o, 0.1), steadily_moving(o), about_reversals(o))

    assert usual == pytest.approx(1.0)


def test_nothing_is_usual_where_a_joint_turned_too_seldom() -> None:
    o = swinging(6.0)
    turns = about_reversals(o)

    usual = usual_about_reversals(o, errors_about(o, 3.0), steadily_moving(o), turns)

    assert turns.any()
    assert np.isinf(usual[turns]).all()


def test_a_moment_in_which_no_joint_moves_is_an_end_of_motion_and_no_reversal() -> None:
    turns = about_reversals(o := swinging(30.0, rest=14.0))
    still = ~o.moving.any(axis=1)
    rests = o.slow.time[still]
    near = (o.slow.time > rests[0] - PUSHES.ends) & (o.slow.time < rests[-1] + PUSHES.ends)

    assert rests.size
    assert not turns[near].any()
    assert turns[~near].any(axis=0).all()
