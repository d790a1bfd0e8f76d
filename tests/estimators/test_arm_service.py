"""One arm served: what it answers, what it refuses, and how models take turns."""

from __future__ import annotations

import time
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

from estimators.joint_physics import JointPhysics
from estimators.service.arm_service import ArmService, ServedArm
from estimators.service.history import History
from estimators.service.live_model import LiveModel
from estimators.service.settings import ServiceSettings
from estimators.service.watchdog import ContactWatchdog
from estimators.stream import Stream
from limo_driver.errors import ConfigError, DivergedError, ShapeError
from limo_driver.messages import (
    Attachment,
    JointStateCodec,
    decode_joint_state,
    decode_torque_estimate,
)
from limo_driver.physics import ExternalContact, Simulation
from limo_driver.recording import Recording
from limo_driver.types import Motion

if TYPE_CHECKING:
    from collections.abc import Sequence

    from estimators.stream import LiveEstimate, StreamState
    from limo_driver.messages import TorqueEstimate

RATE, DELAY = 100.0, 0.1
NAMES = ("shoulder", "elbow")
START = 1_700_000_000_000_000_000  # [ns]


class Kept:
    """An outlet that keeps everything."""

    def __init__(self) -> None:
        self.estimates: list[TorqueEstimate] = []
        self.attachments: list[Attachment] = []
        self.externals: list[np.ndarray] = []
        self.states: list[bytes] = []
        self.events: list[tuple[str, dict[str, Any]]] = []

    def estimate(self, payload: bytes, attachment: bytes, stamp_ns: int) -> None:
        self.estimates.append(decode_torque_estimate(payload))
        self.attachments.append(Attachment.decode(attachment))
        assert self.estimates[-1].stamp_ns == stamp_ns

    external_wanted = True

    def external(self, payload: bytes, _attachment: bytes) -> None:
        self.externals.append(decode_joint_state(payload).torque)

    def state(self, payload: bytes, _stamp_ns: int, _sequence: int) -> None:
        self.states.append(payload)

    def event(self, kind: str, _text: str, _level: int = 20, **facts: object) -> None:
        self.events.append((kind, facts))

    @property
    def kinds(self) -> list[str]:
        return [kind for kind, _ in self.events]

    @property
    def torque(self) -> np.ndarray:
        return np.array([estimate.torque for estimate in self.estimates])


@pytest.fixture(scope="session")
def learned(rigid: Simulation, training_recording: Recording) -> JointPhysics:
    return JointPhysics(rigid).fit([training_recording])


@pytest.fixture
def motion(test_recording: Recording) -> Recording:
    return test_recording[slice(0, 600)]


def live(model: Any, version: str = "1", bound: float = 1e3) -> LiveModel:
    return LiveModel(version, Stream(model, RATE, DELAY), np.full(2, bound))


def service_of(rigid: Simulation, model: LiveModel | None = None) -> tuple[ArmService, Kept]:
    kept = Kept()
    physics = LiveModel("physics", Stream(rigid, RATE, DELAY), np.full(2, 1e3), physics_only=True)
    watchdog = ContactWatchdog(np.full(2, 3.0), np.full(2, 0.15))
    service = ArmService(ServedArm("arm", NAMES, RATE, 60.0), physics, watchdog, kept)
    if model is not None:
        service.model = model
    return service, kept


def messages(
    recording: Recording, *, names: Sequence[str] = NAMES, first: int = 0
) -> list[tuple[bytes, bytes]]:
    codec = JointStateCodec(names, "arm")
    begin = recording.time[0]
    return [
        (
            codec.encode(
                START + round(1e9 * (recording.time[t] - begin)) + first * 10_000_000,
                recording.position[t],
                0 * recording.position[t],
                recording.torque[t],
            ),
            Attachment(first + t, t).encode(),
        )
        for t in range(len(recording))
    ]


def feed(service: ArmService, sent: Sequence[tuple[bytes, bytes]]) -> None:
    for payload, attachment in sent:
        service.handle(payload, attachment)


class TestAnswers:
    def test_are_those_of_the_stream(self, rigid, learned, motion) -> None:
        service, kept = service_of(rigid, live(learned))
        feed(service, messages(motion))
        stream = Stream(learned, RATE, DELAY)
        expected, _ = stream.advance(
            stream.init(), motion.time - motion.time[0], motion.position, motion.torque
        )
        np.testing.assert_allclose(kept.torque, expected.torque, atol=1e-6)
        std = np.array([estimate.std for estimate in kept.estimates])
        np.testing.assert_allclose(std, expected.std, rtol=1e-4)
        np.testing.assert_allclose(kept.externals, expected.measured - expected.torque, atol=1e-6)

    def test_say_whose_they_are_and_of_when(self, rigid, learned, motion) -> None:
        service, kept = service_of(rigid, live(learned, "7"))
        feed(service, messages(motion))
        assert {estimate.model for estimate in kept.estimates} == {"7"}
        assert not any(estimate.fallback for estimate in kept.estimates)
        assert [a.sequence for a in kept.attachments] == list(range(600))
        assert kept.estimates[0].stamp_ns == START - 100_000_000
        # Memory is full after two delays.
        assert [e.reset for e in kept.estimates] == [True] * 20 + [False] * 580

    def test_keep_every_state_as_it_came(self, rigid, motion) -> None:
        service, kept = service_of(rigid)
        sent = messages(motion)
        feed(service, sent)
        assert kept.states == [payload for payload, _ in sent]

    def test_of_states_without_torque_have_no_external_torque(self, rigid, motion) -> None:
        service, kept = service_of(rigid)
        codec, nothing = JointStateCodec(NAMES, "arm"), np.empty(0)
        for t in range(30):
            payload = codec.encode(START + t * 10_000_000, motion.position[t], nothing, nothing)
            service.handle(payload, Attachment(t, t).encode())
        assert len(kept.estimates) == 30
        assert np.isnan(kept.externals).all()
        assert np.isfinite(kept.torque).all()


class TestLosses:
    def test_a_short_gap_is_bridged(self, rigid, learned, motion) -> None:
        service, kept = service_of(rigid, live(learned))
        sent = messages(motion)
        feed(service, sent[:300] + sent[302:])
        assert service.arrivals.counts["lost"] == 2
        assert "reset" not in kept.kinds
        assert not any(estimate.reset for estimate in kept.estimates[20:])

    def test_a_long_gap_begins_memory_anew_and_says_so(self, rigid, learned, motion) -> None:
        service, kept = service_of(rigid, live(learned))
        sent = messages(motion)
        feed(service, sent[:300] + sent[400:])
        assert kept.kinds.count("reset") == 1
        assert [e.reset for e in kept.estimates[300:]] == [True] * 20 + [False] * 180
        fresh, kept_fresh = service_of(rigid, live(learned))
        feed(fresh, sent[400:])
        np.testing.assert_allclose(kept.torque[300:], kept_fresh.torque, atol=1e-6)

    def test_many_gaps_are_told_once_a_second_with_their_number(
        self, rigid, motion, monkeypatch
    ) -> None:
        service, kept = service_of(rigid)
        sent = messages(motion)
        feed(service, [sent[t] for t in range(0, 400, 20)])
        assert service.counts["resets"] == 19
        assert kept.events == [("reset", {"count": 1})]
        monkeypatch.setattr("estimators.service.arm_service._RESET_PAUSE", 0.0)
        service._next_reset = 0.0
        feed(service, [sent[420]])
        assert kept.events[1:] == [("reset", {"count": 19})]

    def test_duplicates_and_late_states_are_not_answered(self, rigid, motion) -> None:
        service, kept = service_of(rigid)
        sent = messages(motion)
        order = [0, 1, 1, 2, 5, 3, 4, 6]
        feed(service, [sent[t] for t in order])
        assert [a.sequence for a in kept.attachments] == [0, 1, 2, 5, 6]
        assert service.arrivals.counts["duplicated"] == 1
        assert service.arrivals.counts["late"] == 2
        assert service.arrivals.counts["lost"] == 0

    def test_stale_states_are_counted_and_not_answered(self, rigid, motion) -> None:
        service, kept = service_of(rigid)
        (first, about), (second, _), *_ = messages(motion)
        service.handle(first, about)
        service.handle(second, Attachment(1, 1, stale=True).encode())
        assert len(kept.estimates) == 1
        assert service.counts["stale"] == 1

    def test_a_driver_that_began_anew_is_followed(self, rigid, motion) -> None:
        service, kept = service_of(rigid)
        sent = messages(motion)
        feed(service, sent[:50])
        later = replace(motion, time=motion.time + 60.0)
        codec = JointStateCodec(NAMES, "arm")
        for t in range(50):
            stamp = START + 60_000_000_000 + t * 10_000_000
            payload = codec.encode(stamp, later.position[t], 0 * later.position[t], later.torque[t])
            service.handle(payload, Attachment(t, t).encode())
        assert len(kept.estimates) == 100
        assert service.arrivals.counts["restarts"] == 1
        assert kept.kinds == ["reset"]


class TestMalformed:
    @pytest.mark.parametrize(
        ("spoil", "count"),
        [
            (lambda payload, about: (payload[:40], about), "malformed"),
            (lambda payload, about: (payload, about[:5]), "malformed"),
            (lambda _payload, _about: (b"", b""), "malformed"),
            (lambda payload, about: (payload, b"\xff" + about[1:]), "malformed"),
        ],
    )
    def test_states_are_counted_and_dropped(self, rigid, motion, spoil, count) -> None:
        service, kept = service_of(rigid)
        sent = messages(motion)
        feed(service, [*sent[:10], spoil(*sent[10]), *sent[10:20]])
        assert len(kept.estimates) == 20
        assert service.counts[count] == 1

    def test_values_that_are_not_finite_are_dropped(self, rigid, motion) -> None:
        service, kept = service_of(rigid)
        position = motion.position.copy()
        position[5, 1] = np.nan
        torque = motion.torque.copy()
        torque[7, 0] = np.inf
        codec = JointStateCodec(NAMES, "arm")
        for t in range(20):
            payload = codec.encode(START + t * 10_000_000, position[t], 0 * position[t], torque[t])
            service.handle(payload, Attachment(t, t).encode())
        assert len(kept.estimates) == 18
        assert service.counts["malformed"] == 2

    def test_states_of_other_joints_are_refused_once_in_words(self, rigid, motion) -> None:
        service, kept = service_of(rigid)
        feed(service, messages(motion, names=("elbow", "shoulder"))[:5])
        assert service.counts["foreign"] == 5
        assert kept.kinds == ["refused"]
        assert not kept.estimates

    def test_positions_that_no_arm_has_do_not_end_the_service(self, rigid, learned, motion) -> None:
        service, kept = service_of(rigid, live(learned))
        sent = messages(motion)
        codec = JointStateCodec(NAMES, "arm")
        wild = codec.encode(START + 100_000_000, np.full(2, 1e300), np.zeros(2), np.zeros(2))
        feed(service, [*sent[:10], (wild, sent[10][1]), *sent[11:200]])
        assert np.isfinite(kept.torque).all()
        assert len(kept.estimates) >= 198


class TestBound:
    def test_a_learned_part_is_clipped_and_counted(self, rigid, learned, motion) -> None:
        free, kept_free = service_of(rigid, live(learned))
        tight, kept_tight = service_of(rigid, live(learned, bound=0.05))
        physics, kept_physics = service_of(rigid)
        for service in (free, tight, physics):
            feed(service, messages(motion))
        difference = np.abs(kept_tight.torque - kept_physics.torque)
        assert difference.max() == pytest.approx(0.05)
        assert np.abs(kept_free.torque - kept_physics.torque).max() > 0.1
        assert tight.window.clipped > 0
        assert free.window.clipped == 0

    def test_physics_says_that_it_is_alone(self, rigid, motion) -> None:
        service, kept = service_of(rigid)
        feed(service, messages(motion)[:5])
        assert all(estimate.fallback for estimate in kept.estimates)


class Failing:
    """A stream that fails after some steps: by an error, or by torque that is not finite."""

    def __init__(self, inner: Stream, after: int, how: str) -> None:
        self.inner, self.left, self.how = inner, after, how
        self.delay, self.differentiator = inner.delay, inner.differentiator

    def init(self) -> StreamState:
        return self.inner.init()

    def step(self, state: Any, *given: Any) -> tuple[LiveEstimate, StreamState]:
        self.left -= 1
        if self.left < 0 and self.how == "error":
            raise DivergedError("the network left the finite numbers")
        estimate, state = self.inner.step(state, *given)
        if self.left < 0:
            estimate = replace(estimate, learned=np.full(2, np.nan))
        return estimate, state


class TestFallback:
    @pytest.mark.parametrize("how", ["error", "not finite"])
    def test_physics_takes_over_without_a_missing_answer(self, rigid, learned, motion, how) -> None:
        failing = Failing(Stream(learned, RATE, DELAY), 300, how)
        service, kept = service_of(rigid, LiveModel("bad", failing, np.full(2, 1e3)))
        feed(service, messages(motion))
        assert len(kept.estimates) == 600
        assert [e.fallback for e in kept.estimates] == [False] * 300 + [True] * 300
        assert kept.kinds.count("fallback") == 1
        physics, kept_physics = service_of(rigid)
        feed(physics, messages(motion))
        # Its memory was made from the last second.
        np.testing.assert_allclose(kept.torque[320:], kept_physics.torque[320:], atol=1e-6)

    @pytest.mark.parametrize("after", [0, 1, 30])
    def test_also_of_a_model_that_fails_at_once(self, rigid, learned, motion, after) -> None:
        failing = Failing(Stream(learned, RATE, DELAY), after, "error")
        service, kept = service_of(rigid, LiveModel("bad", failing, np.full(2, 1e3)))
        feed(service, messages(motion))
        assert len(kept.estimates) == 600
        assert "unanswered" not in service.counts
        assert kept.kinds == ["fallback"]
        physics, kept_physics = service_of(rigid)
        feed(physics, messages(motion))
        np.testing.assert_allclose(kept.torque[after:], kept_physics.torque[after:], atol=1e-6)


class TestUnturned:
    def test_joints_are_flagged_until_they_have_turned(self, rigid, learned, motion) -> None:
        service, kept = service_of(rigid, live(learned))
        feed(service, messages(motion))
        outside = np.array([estimate.outside for estimate in kept.estimates])
        for j in range(2):
            q = motion.position[:, j]
            turned = np.maximum.accumulate(q) - np.minimum.accumulate(q) >= 0.05
            assert outside[~turned, j].all()
            assert outside[turned, j].mean() < 0.3
            assert service.window.samples[j] <= turned.sum()

    def test_a_joint_at_rest_is_watched_all_the_same(self, rigid, learned, motion) -> None:
        still = np.repeat(motion.position[:1], 600, axis=0)
        torque = rigid.predict(replace(motion, position=still).motion(10.0))
        torque[300:, 1] -= 8.0
        service, kept = service_of(rigid, live(learned))
        feed(service, messages(replace(motion, position=still, torque=torque)))
        assert "contact" in kept.kinds
        assert all(estimate.outside.all() for estimate in kept.estimates)
        assert not service.window.samples.any()


class TestSwap:
    def test_between_equal_models_changes_nothing(self, rigid, learned, motion) -> None:
        service, kept = service_of(rigid, live(learned, "1"))
        sent = messages(motion)
        feed(service, sent[:400])
        before = service.swap(live(learned, "2"))
        feed(service, sent[400:])
        assert before.version == "1"
        assert [e.model for e in kept.estimates] == ["1"] * 400 + ["2"] * 200
        alone, kept_alone = service_of(rigid, live(learned, "1"))
        feed(alone, sent)
        np.testing.assert_allclose(kept.torque, kept_alone.torque, atol=1e-6)

    def test_primes_memory_from_where_it_began(self, rigid, learned, motion) -> None:
        service, kept = service_of(rigid)
        sent = messages(motion)
        feed(service, sent[:200] + sent[300:450])
        service.swap(live(learned))
        feed(service, sent[450:])
        all_along, kept_all = service_of(rigid, live(learned))
        feed(all_along, sent[:200] + sent[300:])
        np.testing.assert_allclose(kept.torque[350:], kept_all.torque[350:], atol=1e-6)

    def test_before_the_first_state_is_possible(self, rigid, learned, motion) -> None:
        service, kept = service_of(rigid)
        service.swap(live(learned))
        feed(service, messages(motion)[:3])
        assert len(kept.estimates) == 3


class TestSign:
    def test_of_external_torque_is_that_of_the_drives_which_resist_a_push(self, rigid) -> None:
        position, force = np.array([0.3, -0.9]), np.array([12.0, 0.0, -7.0])
        time_ = np.arange(100) / RATE
        still = np.tile(position, (time_.size, 1))
        push = ExternalContact(windows=((-1.0, 9.0),), wrench=((*force, 0.0, 0.0, 0.0),))
        pushed = Simulation(rigid.robot, (*rigid.effects, push))
        torque = pushed.predict(Motion(time_, still, 0 * still, 0 * still))
        service, kept = service_of(rigid)
        feed(service, messages(Recording.from_arrays(time_, still, torque)))
        # Two links of the plane x, z; the flange is at the elbow, 0.3 m along the first.
        away = 0.3 * np.array([np.cos(position[0]), -np.sin(position[0])])
        jacobian = np.array([[away[1], 0.0], [0.0, 0.0], [-away[0], 0.0]])
        np.testing.assert_allclose(kept.externals[-1], -jacobian.T @ force, atol=1e-6)


class TestContact:
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
        with pytest.raises(ConfigError, match="contact_torque = nan has to be above 0"):
            ServiceSettings(contact_torque=(1.0, np.nan))


class TestHistory:
    def test_keeps_the_latest_states(self) -> None:
        history = History(1, 10)
        for k in range(10_000):
            history.append(0.1 * k, np.array([k]), np.array([-k]))
        assert history.first == 9990
        rows = history.since(history.first, 4)
        np.testing.assert_array_equal(rows.position[:, 0], [9990, 9991, 9992, 9993])
        np.testing.assert_array_equal(rows.torque[:, 0], [-9990, -9991, -9992, -9993])

    def test_says_what_is_no_longer_kept(self) -> None:
        history = History(1, 10)
        for k in range(10_000):
            history.append(0.1 * k, np.array([k]), None)
        with pytest.raises(IndexError, match="no longer kept"):
            history.since(0)
        assert history.since(history.first).torque is None

    def test_begins_anew(self) -> None:
        history = History(1, 10)
        for k in range(5):
            history.append(0.1 * k, np.array([k]), None)
        history.restart()
        assert history.first == 5
        assert not len(history.since(5).time)
