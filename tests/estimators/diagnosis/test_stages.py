"""Stages: progress never goes back, and what fails beside a verdict does not end it."""

from __future__ import annotations

import pytest

from estimators.diagnosis.stages import (
    Attempts,
    Budget,
    Failure,
    end_if_late,
    forward,
    quiet,
)


def test_progress_never_goes_back_and_tells_every_stage():
    told = []
    tell = forward(lambda stage, done: told.append((stage, done)))
    for stage, done in (("a", 0.0), ("b", 0.7), ("a", 0.4), ("c", 0.8), ("done", 1.0)):
        tell(stage, done)
    assert told == [("a", 0.0), ("b", 0.7), ("a", 0.7), ("c", 0.8), ("done", 1.0)]


def test_progress_of_a_part_of_the_work_ends_there():
    told = []
    tell = forward(lambda _, done: told.append(done), 0.5)
    tell("a", 0.5)
    tell("b", 1.0)
    tell("done", 1.0)  # of the part, and not of the work
    assert told == [0.25, 0.5]


def test_a_stage_that_fails_leaves_its_error_and_the_others_go_on():
    attempts = Attempts()
    assert attempts.at("intervals", lambda: 1 / 0, "none") == "none"
    assert attempts.at("tests", lambda: 2, 0) == 2
    (failure,) = attempts.failures
    assert isinstance(failure.error, ZeroDivisionError)
    assert str(failure) == "intervals (ZeroDivisionError: division by zero)"
    assert failure.note().endswith(f"is missing: {failure}.")


def test_ctrl_c_is_no_failure():
    def stopped():
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        Attempts().at("intervals", stopped, None)


def test_a_failure_without_words_is_said_by_its_name():
    assert str(Failure("report", ValueError())) == "report (ValueError)"


def test_a_budget_breaks_off_what_can_be_done_without_and_nothing_else():
    budget = Budget(3600.0)
    tell = budget.watched(quiet)

    def spend(then):
        tell("before", 0.1)
        budget.seconds = 0.0
        tell("after", 0.2)
        return then

    assert budget.within("one", lambda: 1, 0) == 1
    assert budget.note() == ""
    assert budget.within("two", lambda: budget.within("three", lambda: spend(2), 0), 0) == 0
    assert spend(3) == 3  # outside of such stages
    assert budget.within("four", lambda: pytest.fail("was begun"), 0) == 0
    assert "three; four" in budget.note()


def test_a_loop_that_asks_for_the_time_ends_inside_of_such_a_stage_alone():
    budget, attempts = Budget(3600.0), Attempts()

    def spend():
        end_if_late()
        budget.seconds = 0.0
        attempts.at("no failure of a part of it", end_if_late, None)
        pytest.fail("went on")

    end_if_late()
    assert budget.within("one", spend, "otherwise") == "otherwise"
    assert attempts.failures == []
    end_if_late()  # outside again
