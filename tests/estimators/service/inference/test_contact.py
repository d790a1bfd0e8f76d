"""Contact: what is one, when it is told, and what a user may choose of it."""

from __future__ import annotations

import time
from dataclasses import replace

import numpy as np
import pytest
from fed_service import DELAY, NAMES, RATE, START, feed, live, messages, service_of

from estimators.service.inference.contact import REPORT_PERIOD, ContactReport, ContactWatchdog
from estimators.service.inference.live_model import LiveModel
from estimators.service.settings import ServiceSettings
from estimators.stream import Stream
from limo_driver.errors import ConfigError, ShapeError
from limo_driver.network.contact_state import Touch
from limo_driver.network.messages import (
    Attachment,
    JointStateCodec,
)


class Unlike:
    """A stream on motion unlike what was learned."""

    def __init__(self, inner, std):
        self._inner, self._std = inner, np.full(2, std)

    def __getattr__(self, name):
        return getattr(self._inner, name)

    def step(self, state, *given):
        estimate, state = self._inner.step(state, *given)
        return replace(estimate, outside=np.ones(2, dtype=bool), std=self._std), state


class TestContact:
    @pytest.mark.parametrize(("std", "told"), [(1.0, True), (3.0, False), (np.nan, False)])
    def test_is_told_of_motion_unlike_what_was_learned_where_it_is_sure(
        self, rigid, learned, motion, std, told
    ) -> None:
        pushed = motion.torque.copy()
        pushed[200:300, 1] -= 8.0
        far = LiveModel("far", Unlike(Stream(learned, RATE, DELAY), std), np.full(2, 1e3))
        service, kept = service_of(rigid, far)
        feed(service, messages(replace(motion, torque=pushed)))
        assert [kind for kind in kept.kinds if kind != "changed"] == (
            ["contact", "contact_end"] if told else []
        )
        assert Touch.FREE not in kept.contacts[-1].joints

    def test_a_push_is_told_when_it_begins_and_ends(self, rigid, learned, motion) -> None:
        pushed = motion.torque.copy()
        pushed[200:300, 1] -= 8.0
        service, kept = service_of(rigid, live(learned))
        feed(service, messages(replace(motion, torque=pushed)))
        assert [kind for kind, _ in kept.events] == ["contact", "contact_end"]
        (_, began), (_, ended) = kept.events
        assert began["joint"] == ended["joint"] == 2
        # A step through the filter overshoots by a tenth.
        assert ended["torque"] == pytest.approx(-8.0, abs=1.0)
        assert ended["lasted"] == pytest.approx(1.0, abs=0.05)
        assert (began["began_stamp"] - START) * 1e-9 == pytest.approx(2.0, abs=0.05)
        assert (ended["ended_stamp"] - START) * 1e-9 == pytest.approx(3.0, abs=0.05)
        latest = (began["state_stamp"] - START) * 1e-9
        assert 2.0 + DELAY < latest < 2.0 + DELAY + 0.15 + 0.1

    def test_goes_on_over_a_short_gap(self, rigid, learned, motion) -> None:
        """Even of a joint that stands, and within the gap."""
        torque, position = motion.torque.copy(), motion.position.copy()
        position[190:, 1] = position[190, 1]
        torque[210:400, 1] -= 8.0
        service, kept = service_of(rigid, live(learned))
        sent = messages(replace(motion, position=position, torque=torque))
        feed(service, [*sent[:206], *sent[213:300], *sent[307:]])
        assert kept.kinds == ["contact", "contact_end"]
        _, ended = kept.events[-1]
        assert (ended["ended_stamp"] - START) * 1e-9 == pytest.approx(4.0, abs=0.1)

    def test_is_none_where_the_joint_has_not_turned_since_a_gap(
        self, rigid, learned, motion
    ) -> None:
        """The joint stands after a gap, on friction of which nobody knows how it stands."""
        torque, position = motion.torque.copy(), motion.position.copy()
        position[200:, 1] = position[200, 1]
        torque[200:, 1] -= 8.0
        service, kept = service_of(rigid, live(learned))
        sent = messages(replace(motion, position=position, torque=torque))
        feed(service, [*sent[:200], *sent[300:]])
        assert kept.kinds == ["reset"]
        assert kept.estimates[-1].outside[1]
        assert kept.contacts[-1].joints[1] is Touch.UNKNOWN

    @pytest.mark.parametrize("how", ["a gap", "no torque"])
    def test_ends_where_memory_begins_anew(self, rigid, motion, how) -> None:
        pushed = motion.torque.copy()
        pushed[200:, 1] -= 8.0
        service, kept = service_of(rigid)
        sent = messages(replace(motion, torque=pushed))
        feed(service, sent[:300])
        assert service.watchdog.active.tolist() == [False, True]
        if how == "a gap":
            feed(service, sent[400:401])
        else:
            nothing = np.empty(0)
            codec, stamp = JointStateCodec(NAMES, "arm"), START + 3_000_000_000
            payload = codec.encode(stamp, motion.position[300], nothing, nothing)
            service.handle(payload, Attachment(300, 300).encode())
        _, ended = next(event for event in kept.events if event[0] == "contact_end")
        assert ended["cut_off"]
        assert (ended["ended_stamp"] - START) * 1e-9 == pytest.approx(2.99 - DELAY)
        assert not service.watchdog.active.any()

    def test_ends_when_states_no_longer_come(self, rigid, motion, monkeypatch) -> None:
        pushed = motion.torque.copy()
        pushed[200:, 1] -= 8.0
        service, kept = service_of(rigid)
        feed(service, messages(replace(motion, torque=pushed))[:300])
        service.end_silent_contacts()
        assert service.watchdog.active.any()
        later = time.monotonic() + 2.0
        monkeypatch.setattr(time, "monotonic", lambda: later)
        service.end_silent_contacts()
        assert not service.watchdog.active.any()
        assert kept.kinds[-1] == "contact_end"

    def test_is_no_part_of_the_error_of_the_model(self, rigid, learned, motion) -> None:
        pushed = motion.torque.copy()
        pushed[200:300, 1] -= 8.0
        with_push, _ = service_of(rigid, live(learned))
        without, _ = service_of(rigid, live(learned))
        feed(with_push, messages(replace(motion, torque=pushed)))
        feed(without, messages(motion))
        assert with_push.window.rms[0] == pytest.approx(without.window.rms[0], rel=0.1)
        assert with_push.window.samples[1] < without.window.samples[1] - 80


class TestWatchdog:
    def test_a_short_push_is_no_contact(self) -> None:
        watchdog = ContactWatchdog(np.array([1.0]), np.array([0.2]))
        told = [watchdog.step(0.1 * k, np.array([2.0 if k in {3, 4} else 0.0])) for k in range(10)]
        assert not any(told)

    def test_ends_only_below_the_release(self) -> None:
        watchdog = ContactWatchdog(np.array([1.0]), np.array([0.2]), release=0.5)
        values = [2.0] * 5 + [0.8] * 5 + [0.3] * 5
        told = [c for k, v in enumerate(values) for c in watchdog.step(0.1 * k, np.array([v]))]
        assert [c.ended is None for c in told] == [True, False]
        assert told[1].ended == pytest.approx(1.0)  # when it fell, not when that was due
        assert not told[1].cut_off
        assert told[1].torque == 2.0

    def test_each_joint_has_a_threshold_of_its_own(self) -> None:
        watchdog = ContactWatchdog(np.array([8.0, 1.0]), np.array([0.2, 0.5]))
        told = [
            (k, c.joint) for k in range(9) for c in watchdog.step(0.1 * k, np.array([4.0, 4.0]))
        ]
        assert told == [(5, 2)]

    def test_ends_where_torque_stays_unknown(self) -> None:
        watchdog = ContactWatchdog(np.array([1.0]), np.array([0.2]))
        values = [2.0] * 5 + [np.nan, 2.0] + [np.nan] * 4
        told = [c for k, v in enumerate(values) for c in watchdog.step(0.1 * k, np.array([v]))]
        assert [c.ended is None for c in told] == [True, False]
        assert told[1].ended == pytest.approx(0.7)
        assert told[1].cut_off

    def test_unknown_torque_begins_nothing(self) -> None:
        watchdog = ContactWatchdog(np.array([1.0]), np.array([0.2]))
        assert not [c for k in range(9) for c in watchdog.step(0.1 * k, np.array([np.nan]))]

    @pytest.mark.parametrize("threshold", [0.0, -1.0, np.nan, np.inf])
    def test_refuses_thresholds_that_cannot_be(self, threshold) -> None:
        with pytest.raises(ConfigError, match="contact threshold"):
            ContactWatchdog(np.array([threshold]), np.array([0.2]))

    def test_refuses_as_many_durations_as_no_joints(self) -> None:
        with pytest.raises(ShapeError, match="duration"):
            ContactWatchdog(np.ones(2), np.ones(3))


class TestSettings:
    def test_of_contact_are_for_all_joints_or_one_by_one(self) -> None:
        torque, duration = ServiceSettings(contact_torque=(8.0, 2.0)).contact(2)
        assert (torque.tolist(), duration.tolist()) == ([8.0, 2.0], [0.15, 0.15])

    def test_of_contact_are_refused_for_other_joints(self) -> None:
        with pytest.raises(ConfigError, match="contact_duration has 3 values, expected one, or"):
            ServiceSettings(contact_duration=(0.1, 0.2, 0.3)).contact(2)
        with pytest.raises(
            ConfigError, match="contact_torque is nan, expected a list of numbers above 0"
        ):
            ServiceSettings(contact_torque=(1.0, np.nan))


class TestReport:
    def test_of_a_push_says_free_then_contact_then_free(self, rigid, learned, motion) -> None:
        pushed = motion.torque.copy()
        pushed[200:300, 1] -= 8.0
        service, kept = service_of(rigid, live(learned))
        feed(service, messages(replace(motion, torque=pushed)))
        second = [state.joints[1] for state in kept.contacts]
        turns = [a for a, b in zip(second, [None, *second], strict=False) if a is not b]
        assert turns == [Touch.UNKNOWN, Touch.FREE, Touch.CONTACT, Touch.FREE]
        began = next(s for s in kept.contacts if s.joints[1] is Touch.CONTACT)
        told = next(facts for kind, facts in kept.events if kind == "contact")
        assert began.stamp_ns + round(1e9 * DELAY) == told["state_stamp"]
        assert began.model == "1"
        assert not began.physics_only

    def test_comes_ten_times_a_second_while_nothing_changes(self, rigid, learned, motion) -> None:
        service, kept = service_of(rigid, live(learned))
        feed(service, messages(motion))
        steps = np.diff([state.stamp_ns for state in kept.contacts]) * 1e-9
        assert steps.max() == pytest.approx(REPORT_PERIOD)
        assert kept.contacts[-1].since_gap == pytest.approx(
            motion.time[-1] - motion.time[0], abs=0.1
        )

    def test_knows_nothing_after_a_gap_until_memory_is_full(self, rigid, learned, motion) -> None:
        service, kept = service_of(rigid, live(learned))
        sent = messages(motion)
        feed(service, sent[:200])
        assert kept.contacts[-1].joints == (Touch.FREE, Touch.FREE)
        told = len(kept.contacts)
        feed(service, sent[300:])
        after = kept.contacts[told:]
        assert after[0].joints == (Touch.UNKNOWN, Touch.UNKNOWN)
        assert after[0].since_gap == 0.0
        free = next(state for state in after if Touch.UNKNOWN not in state.joints)
        assert free.since_gap >= 2.0 * DELAY

    def test_of_physics_without_known_errors_is_unknown_where_nothing_is_felt(
        self, rigid, motion
    ) -> None:
        service, kept = service_of(rigid)
        feed(service, messages(motion))
        assert {touch for state in kept.contacts for touch in state.joints} == {Touch.UNKNOWN}

    def test_of_an_estimate_that_is_unsure_by_its_threshold_is_unknown(self) -> None:
        report = ContactReport(ContactWatchdog(np.array([3.0, 3.0]), np.array([0.1, 0.1])))
        assert report.step(0.0, np.zeros(2), np.array([1.4, 1.6]), known=True)
        assert report.joints == (Touch.FREE, Touch.UNKNOWN)
        assert not report.step(0.01, np.zeros(2), np.array([1.4, 1.6]), known=True)
        assert report.step(0.02, np.array([np.nan, 0.0]), np.ones(2), known=True)
        assert report.joints == (Touch.UNKNOWN, Touch.FREE)
        assert report.since == [0.02, 0.02]
