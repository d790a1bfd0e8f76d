"""The time of a log, where some of it is missing; columns in which nothing stands."""

import numpy as np
import pytest

from limo_driver.errors import RecordingError
from limo_driver.logs.readers.proposals.proposal import propose
from limo_driver.logs.readers.proposals.times import time_columns
from limo_driver.logs.readers.table import table_of
from limo_driver.model import RobotModel

TIME = 0.004 * np.arange(400)


def test_a_row_without_time_is_no_reason_to_find_none():
    time = TIME.copy()
    time[[7, 200]] = np.nan
    found = time_columns(table_of({"t": time, "q": TIME}))
    assert (found.columns.columns, found.columns.unit, found.questions) == (("t",), ("s",), ())


def test_a_time_of_another_length_is_named():
    found = time_columns(table_of({"t": TIME[:-5], "q": TIME, "tau": TIME}))
    assert "none was found (t holds an array of shape (395,) beside " in found.questions[0]


def test_why_a_column_named_like_a_time_is_none_is_said():
    time = TIME[::-1]
    found = time_columns(table_of({"time": time, "q": TIME**2, "tau": TIME**2}))
    assert found.why == "time does not go forward"
    assert found.columns.columns == ()
    none = time_columns(table_of({"q": TIME**2, "tau": TIME**2}))
    assert none.why == "no column is named like a time"


def test_columns_without_any_number_are_none():
    q = np.full((400, 7), np.nan)
    table = table_of({"t": TIME, "q": q, "tau": np.ones_like(q)})
    with pytest.raises(RecordingError, match="has no positions of the 7 joints of iiwa14"):
        propose(table, RobotModel.load("iiwa14"))


def test_poses_held_one_after_the_other_may_be_seconds_apart_and_motion_is_not():
    random = np.random.default_rng(3)
    time = np.cumsum(random.uniform(15.0, 20.0, 61))
    held = time_columns(table_of({"t": time, "q": random.uniform(-1.0, 1.0, (61, 3))}))
    assert held.columns.unit == ("s",)
    assert "in ms, but from row to row the columns jump" in held.questions[0]
    assert "is it in s?" in held.questions[0]
    moved = time_columns(table_of({"t": time, "q": np.sin(time[:, None] * [2e-3, 3e-3, 5e-3])}))
    assert (moved.columns.unit, moved.questions) == (("ms",), ())
