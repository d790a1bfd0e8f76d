"""What slowly changed since training is found from errors, and not from a push."""

import numpy as np
import pytest

from estimators.slow_change import ChangeWatch, SlowChange

RATE, SECONDS, STD = 100.0, 60.0, 0.2
TIME = np.arange(int(RATE * SECONDS)) / RATE
VELOCITY = np.sin(2 * np.pi * 0.2 * TIME)[:, None]


TORQUE = 10.0 * np.cos(2 * np.pi * 0.07 * TIME)[:, None]


def changed(error):
    return SlowChange.of(error, np.full(error.shape, STD), VELOCITY, TORQUE, TIME)


def noise(seed=0):
    """Return errors of STD that are alike for about a second."""
    white = np.random.default_rng(seed).normal(0.0, 1.0, TIME.size)
    kernel = np.exp(-np.arange(0.0, 3.0, 1 / RATE) / 0.5)
    found = np.convolve(white, kernel)[: TIME.size, None]
    return STD * found / found.std()


def test_an_offset_and_friction_are_found_and_reported():
    error = 0.8 + 0.5 * np.tanh(VELOCITY / 0.02) + noise()
    found = changed(error)
    assert found.found[0] == pytest.approx([0.8, 0.5, 0.0], abs=0.12)
    lines = found.describe(("lift",), ("N",))
    assert [line.split(":")[0] for line in lines] == [
        "offset since training",
        "friction since training",
    ]
    assert lines[0].endswith(" N at lift")
    left = (error - found.torque)[TIME > 10.0]
    assert left.std() < 1.5 * STD
    assert found.held(error)[0] > 0.9


def test_a_gain_is_reported_as_a_part_of_the_torque():
    found = changed(0.06 * TORQUE + noise())
    assert found.values[0, 2] == pytest.approx(0.06, abs=0.012)
    (line,) = found.describe(("lift",), ("N m",))
    assert line.startswith("gain since training: +")
    assert line.endswith("% at lift")


def test_intervals_hold_19_of_20_errors_of_any_distribution():
    tailed = np.random.default_rng(1).standard_t(2, TIME.size)[:, None]
    for error in (3.0 * noise(), 0.4 * noise(), STD * tailed):
        assert changed(error).held(error)[0] == pytest.approx(0.95, abs=0.04)


def test_errors_as_large_as_the_model_says_show_no_change():
    for seed in range(5):
        found = changed(noise(seed))
        assert found.describe(("lift",), ("N m",)) == ()
        assert found.held(noise(seed))[0] > 0.9


def test_a_row_knows_nothing_of_errors_after_it():
    error = noise()
    before = changed(error)
    error[3000:] += 5.0
    after = changed(error)
    same = int(3000 + 0.5 * RATE)
    np.testing.assert_array_equal(after.torque[:same], before.torque[:same])
    assert np.abs(after.torque[same + 1 :] - before.torque[same + 1 :]).min() > 0.0


def test_a_push_of_a_second_hardly_moves_it():
    error = noise()
    error[4000:4100] += 10.0
    moved = np.abs(changed(error).torque - changed(noise()).torque)
    assert moved.max() < 1.5 * STD


def test_too_narrow_intervals_widen_and_too_wide_ones_narrow():
    wide, narrow = (changed(factor * noise()).std[-1, 0] / STD for factor in (3.0, 0.3))
    assert 2.0 < wide < 4.0
    assert 0.3 < narrow < 0.6


def test_a_joint_whose_torque_is_not_known_stays_as_it_is():
    found = changed(np.full((TIME.size, 1), np.nan))
    assert not found.torque.any()
    assert found.describe(("lift",), ("N m",)) == ()


def followed(error, speed=0.5, seconds=60.0, free=True):
    """Give a watch ten answers a second of a joint that turns to and fro; return all it said."""
    watch, lines = ChangeWatch(("lift",), ("N",)), []
    random = np.random.default_rng(0)
    for time in np.arange(0.0, seconds, 0.1):
        position = np.array([np.sin(speed * time)])
        external = np.array([error(time, np.cos(speed * time))]) + random.normal(0.0, STD, 1)
        state = np.array([STD]), np.array([free]), position
        lines += watch.step(time, external, *state)
    return watch, lines


def test_an_offset_is_reported_live_once_and_stays_in_the_status():
    watch, lines = followed(lambda _time, _velocity: 0.8)
    (line,) = lines
    assert line.startswith("offset since training: +")
    assert line.endswith(" N at lift")
    assert float(watch.lines[0].split()[3]) == pytest.approx(0.8, abs=0.1)


def test_friction_is_not_taken_for_an_offset_live():
    _, lines = followed(lambda _time, velocity: 0.8 * np.sign(velocity))
    assert [line.split(":")[0] for line in lines] == ["friction since training"]


def test_nothing_is_reported_live_of_errors_as_usual_or_while_something_leans_on_the_arm():
    assert followed(lambda _time, _velocity: 0.0)[1] == []
    assert followed(lambda _time, _velocity: 5.0, free=False)[1] == []
