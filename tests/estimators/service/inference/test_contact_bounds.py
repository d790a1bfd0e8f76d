"""Each number of the contact watchdog, held from both sides."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from estimators.service.comparison import Shadow
from estimators.service.inference.contact import Contact, ContactWatchdog
from estimators.service.settings import ServiceSettings
from limo_driver.errors import ConfigError, ShapeError

THRESHOLD = np.array([4.0, 0.5])  # [N m]
DURATION = np.array([0.25, 0.5])  # [s]
STEP = 0.0625  # [s], so that sums have no rounding
each_joint = pytest.mark.parametrize("j", [0, 1])
each_way = pytest.mark.parametrize("sign", [-1.0, 1.0])


def on(j, torque):
    """Return external torques of which only one joint feels something."""
    return np.where(np.arange(2) == j, torque, 0.0)


def pushed(watchdog, j, torques, *, first=0):
    """Feed one torque a step to a joint; return what was told, with the step."""
    return [
        (first + k, contact)
        for k, torque in enumerate(torques)
        for contact in watchdog.step((first + k) * STEP, on(j, torque))
    ]


def steps(seconds):
    return round(seconds / STEP)


def leaning(j, sign, **options):
    """Return a watchdog that knows of a contact, and the steps it has had."""
    watchdog = ContactWatchdog(THRESHOLD, DURATION, **options)
    count = steps(DURATION[j]) + 1
    assert len(pushed(watchdog, j, [sign * 2 * THRESHOLD[j]] * count)) == 1
    return watchdog, count


@each_joint
@each_way
class TestBeginning:
    def test_needs_more_than_the_threshold(self, j, sign):
        for factor, begins in ((0.96, False), (1.0, False), (1 + 1e-12, True), (1.04, True)):
            watchdog = ContactWatchdog(THRESHOLD, DURATION)
            told = pushed(watchdog, j, [sign * THRESHOLD[j] * factor] * 20)
            assert len(told) == begins, factor
            assert watchdog.active.tolist() == on(j, begins).astype(bool).tolist()

    def test_needs_the_duration(self, j, sign):
        count = steps(DURATION[j])
        torque = sign * 1.5 * THRESHOLD[j]
        watchdog = ContactWatchdog(THRESHOLD, DURATION)
        assert pushed(watchdog, j, [0.0, 0.0, *[torque] * count, 0.0, torque, 0.0]) == []
        assert watchdog.present == ()
        watchdog = ContactWatchdog(THRESHOLD, DURATION)
        ((k, contact),) = pushed(watchdog, j, [0.0, 0.0, *[torque] * (count + 3)])
        assert k == 2 + count
        assert contact == Contact(j + 1, 2 * STEP, torque)
        assert (contact.ended, contact.cut_off) == (None, False)
        assert watchdog.present == (contact,)

    @pytest.mark.parametrize("late", [-1e-3, 0.0, 1e-3])
    def test_counts_time_and_not_steps(self, j, sign, late):
        watchdog = ContactWatchdog(THRESHOLD, DURATION)
        torque = on(j, sign * 9.0)
        assert watchdog.step(1.0, torque) == []
        assert len(watchdog.step(1.0 + DURATION[j] + late, torque)) == (late >= 0)

    def test_starts_anew_after_a_pause(self, j, sign):
        torque = sign * 1.5 * THRESHOLD[j]
        nearly = [torque] * steps(DURATION[j])
        watchdog = ContactWatchdog(THRESHOLD, DURATION)
        for pause in (0.0, np.nan, sign * THRESHOLD[j]):
            assert pushed(watchdog, j, [*nearly, pause, *nearly, pause]) == []

    def test_starts_anew_while_another_joint_is_in_contact(self, j, sign):
        watchdog, count = leaning(1 - j, sign)
        both = np.full(2, sign * 9.0)
        other = on(1 - j, sign * 9.0)
        for k in range(steps(DURATION[j])):
            assert watchdog.step((count + k) * STEP, both) == []
        count += steps(DURATION[j])
        assert watchdog.step(count * STEP, other) == []
        for k in range(1, 1 + steps(DURATION[j])):
            assert watchdog.step((count + k) * STEP, both) == []


@each_joint
@each_way
class TestEnd:
    @pytest.mark.parametrize(("options", "release"), [({}, 0.7), ({"release": 0.4}, 0.4)])
    def test_needs_less_than_the_release(self, j, sign, options, release):
        for factor, ends in ((1.04, False), (1.0, False), (1 - 1e-12, True), (0.96, True)):
            watchdog, count = leaning(j, sign, **options)
            told = pushed(watchdog, j, [sign * release * THRESHOLD[j] * factor] * 20, first=count)
            assert len(told) == ends, factor
            assert watchdog.active[j] != ends
            assert bool(watchdog.present) != ends

    def test_needs_the_duration(self, j, sign):
        watchdog, count = leaning(j, sign)
        nearly = steps(DURATION[j])
        again = [0.0] * nearly + [sign * 0.8 * THRESHOLD[j]]
        assert pushed(watchdog, j, again, first=count) == []
        count += len(again)
        ((k, contact),) = pushed(watchdog, j, [0.0] * (nearly + 1), first=count)
        assert k == count + nearly
        assert (contact.ended, contact.cut_off, contact.joint) == (count * STEP, False, j + 1)
        assert contact.began == 0.0

    def test_keeps_the_largest_torque(self, j, sign):
        watchdog, count = leaning(j, sign)
        peak = -sign * 3 * THRESHOLD[j]
        torques = [sign * 2.5 * THRESHOLD[j], peak, -peak, sign * 2.9 * THRESHOLD[j], *[0.0] * 20]
        ((_, contact),) = pushed(watchdog, j, torques, first=count)
        assert contact.torque == peak

    def test_is_cut_off_where_torque_is_not_known(self, j, sign):
        watchdog, count = leaning(j, sign)
        ((_, contact),) = pushed(watchdog, j, [np.nan] * 10, first=count)
        assert (contact.ended, contact.cut_off) == (count * STEP, True)
        assert contact.torque == sign * 2 * THRESHOLD[j]

    def test_comes_with_a_gap(self, j, sign):
        watchdog, count = leaning(j, sign)
        (contact,) = watchdog.restart()
        assert (contact.ended, contact.cut_off) == ((count - 1) * STEP, True)
        assert watchdog.present == ()
        assert not watchdog.active.any()
        assert watchdog.restart() == []
        again = pushed(watchdog, j, [sign * 9.0] * 20, first=100)
        assert [k for k, _ in again] == [100 + steps(DURATION[j])]

    def test_makes_room_for_another(self, j, sign):
        watchdog, count = leaning(j, sign)
        ended = pushed(watchdog, j, [0.0] * 20, first=count)
        assert len(ended) == 1
        ((k, contact),) = pushed(watchdog, j, [sign * 9.0] * 15, first=100)
        assert (k, contact.began) == (100 + steps(DURATION[j]), 100 * STEP)


def test_a_gap_forgets_what_was_about_to_begin() -> None:
    watchdog = ContactWatchdog(THRESHOLD, DURATION)
    pushed(watchdog, 0, [9.0] * 4)
    assert watchdog.restart() == []
    assert pushed(watchdog, 0, [9.0] * 4, first=4) == []


@pytest.mark.parametrize("name", ["threshold", "duration"])
@pytest.mark.parametrize(("value", "fine"), [(5e-324, 1), (0.0, 0), (-1.0, 0), (np.inf, 0)])
def test_what_can_be_is_above_zero(name: str, value: float, fine: int) -> None:
    given = {"threshold": np.ones(3), "duration": np.ones(3)}
    given[name] = np.array([1.0, value, 2.0])
    if fine:
        ContactWatchdog(**given)
    else:
        with pytest.raises(ConfigError, match=f"contact {name} .* has to be above 0 and finite"):
            ContactWatchdog(**given)


@pytest.mark.parametrize("n", [1, 3])
def test_there_are_as_many_thresholds_as_durations(n: int) -> None:
    with pytest.raises(ShapeError, match="duration"):
        ContactWatchdog(np.ones(2), np.ones(n))


def test_motion_within_a_second_of_a_contact_is_not_judged() -> None:
    watchdog = SimpleNamespace(present=(Contact(1, 70.0, 9.0),))
    service = SimpleNamespace(contacts=(Contact(2, 20.0, 9.0, 30.0),), watchdog=watchdog)
    time = np.array([18.96, 19.04, 25.0, 30.96, 31.04, 68.96, 69.04, 500.0])
    free = Shadow._free(SimpleNamespace(_service=service), time)
    assert free.tolist() == [True, False, False, False, True, True, False, False]


def test_a_contact_is_4_newton_metres_for_0_15_seconds_unless_told() -> None:
    torque, duration = ServiceSettings().contact(2)
    assert (torque.tolist(), duration.tolist()) == ([4.0, 4.0], [0.15, 0.15])


def test_a_torque_too_few_or_too_many_is_refused():
    watchdog = ContactWatchdog(THRESHOLD, DURATION)
    with pytest.raises(ShapeError, match=r"external has shape \(3,\), expected \(2,\)"):
        watchdog.step(0.0, np.zeros(3))
