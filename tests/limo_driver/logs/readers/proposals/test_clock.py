"""A clock that runs at half or double, and no velocity says so: asked about, and true ones not."""

import numpy as np
import pytest
from logged import arm, numbered, written

from limo_driver.logs.readers.formats.reading import read_table
from limo_driver.logs.readers.proposals.clock import clock_question
from limo_driver.logs.readers.proposals.proposal import propose
from limo_driver.logs.readers.proposals.times import stated_rates, time_columns
from limo_driver.logs.readers.table import LogTable, table_of

TIME = np.arange(0, 16.0, 0.004)


def moved(speed, seed=3):
    """Position [rad] and torque [N m] of an arm with friction and a payload that no file has."""
    rate = speed * (0.25 + 0.1 * np.arange(7))
    phase = np.outer(2 * np.pi * TIME, rate) + np.arange(7)
    q, v = 0.5 * np.sin(phase), np.pi * rate * np.cos(phase)
    a = -2 * np.pi**2 * rate**2 * np.sin(phase)
    torque = arm().inverse_dynamics(q, v, a) + 0.3 * arm().gravity_torque(q) + 0.4 * a
    torque += 2 * np.tanh(v / 0.02) + np.random.default_rng(seed).normal(0, 0.1, q.shape)
    return q, torque


@pytest.mark.parametrize(
    ("clock", "factor"), [(0.5, "half (`factor: 2`"), (2.0, "double (`factor: 0.5`"), (1.0, "")]
)
def test_weight_and_inertia_tell_a_clock_at_half_or_double(clock, factor):
    q, torque = moved(1.0)
    question = clock_question(clock * TIME, q, torque, arm())
    assert factor in question
    assert bool(question) == bool(factor)


def test_torque_without_any_inertia_says_nothing_of_a_clock():
    q, _ = moved(0.5)
    torque = arm().gravity_torque(q) + np.random.default_rng(0).normal(0, 1e-3, q.shape)
    assert clock_question(TIME, q, torque, arm()) == ""


def test_a_joint_faster_than_its_drive_is_a_question_for_the_clock():
    q, _ = moved(0.5)
    assert clock_question(TIME, q, None, arm()) == ""
    assert "times the largest speed of its drive" in clock_question(TIME / 4, q, None, arm())


def test_a_log_at_half_is_asked_about_and_a_true_one_read():
    q, torque = moved(1.0)
    log = {**numbered("q{}_rad", q), **numbered("tau{}", torque)}
    assert propose(table_of({"t": TIME, **log}), arm()).mapping.undecided == ()
    (question,) = propose(table_of({"t": TIME / 2, **log}), arm()).mapping.undecided
    assert question.startswith("time: weight and inertia of the arm")


@pytest.mark.parametrize(
    ("words", "rates"),
    [
        ("# Sampling rate: 250 Hz", (250,)),
        ("% fs = 1e3", (1000,)),
        ("dt: 4 ms", (250,)),
        ("# sample time: 0.002 s", (500,)),
        ("logged at 1 kHz", (1000,)),
        ("# low-pass filter: 10 Hz", ()),
        ("# robot 7, gain = 3", ()),
    ],
)
def test_words_of_a_file_state_its_rate(words, rates):
    assert stated_rates(LogTable({"t": TIME}, words=(words,))) == pytest.approx(rates)


@pytest.mark.parametrize("clock", [1.0, 2.0])
def test_a_rate_in_a_comment_a_name_or_a_single_value_is_held_against_the_steps(tmp_path, clock):
    columns = {"t": clock * TIME, "q1": np.sin(TIME), "tau1": TIME}
    commented = written(columns, tmp_path / "log.csv", comment="# sampling rate: 250 Hz\n")
    named = written(columns, tmp_path / "run_250Hz.csv")
    np.savez(tmp_path / "log.npz", fs=250.0, **columns)
    for path in (commented, named, tmp_path / "log.npz"):
        questions = time_columns(read_table(path)).questions
        assert bool(questions) == (clock != 1.0)
        assert all("250 rows in a second, and the steps of t make 125" in x for x in questions)


def test_dates_are_held_against_a_time():
    dates = np.datetime64("2026-03-01") + (1e6 * TIME).astype("timedelta64[us]")
    assert time_columns(table_of({"time": TIME, "wall": dates})).questions == ()
    (question,) = time_columns(table_of({"time": 2 * TIME, "wall": dates})).questions
    assert "time or wall?" in question
    assert "`factor: 0.5` under `time:`" in question


def test_stamps_are_held_against_the_time_of_receipt():
    assert time_columns(LogTable({"time": TIME}, received=1.01)).questions == ()
    (question,) = time_columns(LogTable({"time": TIME}, received=0.5)).questions
    assert "the time of receipt" in question
