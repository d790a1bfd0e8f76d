"""What a service answers: torque, whose, of when, how sure, within which bound."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from fed_service import (
    DELAY,
    NAMES,
    RATE,
    START,
    feed,
    in_python,
    live,
    messages,
    service_of,
)

from estimators.embedded.compiled_stream import CompiledStream
from estimators.stream import Stream
from limo_driver.network.contact_state import Touch
from limo_driver.network.messages import (
    Attachment,
    JointStateCodec,
)
from limo_driver.physics import ExternalContact, Simulation
from limo_driver.recordings.recording import Recording
from limo_driver.types import Motion


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
        np.testing.assert_allclose(std[20:], expected.std[20:], rtol=1e-4)
        np.testing.assert_allclose(kept.externals, expected.measured - expected.torque, atol=1e-6)

    def test_are_the_same_in_c_and_in_python(self, rigid, learned, motion) -> None:
        pushed = np.array(motion.torque)
        pushed[300:400, 1] += 8.0
        sent = messages(replace(motion, torque=pushed))
        sent = sent[:120] + sent[125:450] + sent[470:]  # some bridged, and a gap
        heard = []
        for runs in (CompiledStream, in_python):
            service, kept = service_of(rigid, live(learned, bound=0.2, runs=runs))
            feed(service, sent)
            heard.append(kept)
            assert service.window.clipped > 0
        own, python = heard
        scale = np.abs(python.torque).max()
        np.testing.assert_allclose(own.torque, python.torque, rtol=0.0, atol=1e-6 * scale)
        for one, other in zip(own.estimates, python.estimates, strict=True):
            np.testing.assert_allclose(one.std, other.std, rtol=1e-6, equal_nan=True)
            np.testing.assert_allclose(one.external, other.external, atol=1e-6 * scale)
            np.testing.assert_array_equal(one.outside, other.outside)
            assert (one.stamp_ns, one.reset) == (other.stamp_ns, other.reset)
        assert own.attachments == python.attachments
        assert own.kinds == python.kinds
        assert set(own.kinds) == {"contact", "contact_end", "reset"}

    def test_say_whose_they_are_and_of_when(self, rigid, learned, motion) -> None:
        service, kept = service_of(rigid, live(learned, "7"))
        feed(service, messages(motion))
        assert {estimate.model for estimate in kept.estimates} == {"7"}
        assert not any(estimate.fallback for estimate in kept.estimates)
        assert [a.sequence for a in kept.attachments] == list(range(600))
        assert kept.estimates[0].stamp_ns == START - 100_000_000
        # Memory is full after two delays.
        assert [e.reset for e in kept.estimates] == [True] * 20 + [False] * 580
        assert all(np.isnan(e.std).all() == e.reset for e in kept.estimates)
        assert all(e.outside.all() for e in kept.estimates[:20])

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

    def test_of_a_joint_at_rest_ever_since_nobody_knows(self, rigid, learned, motion) -> None:
        still = np.repeat(motion.position[:1], 600, axis=0)
        torque = rigid.predict(replace(motion, position=still).motion(10.0))
        torque[300:, 1] -= 8.0
        service, kept = service_of(rigid, live(learned))
        feed(service, messages(replace(motion, position=still, torque=torque)))
        assert "contact" not in kept.kinds
        assert {touch for state in kept.contacts for touch in state.joints} == {Touch.UNKNOWN}
        assert all(estimate.outside.all() for estimate in kept.estimates)
        assert not service.window.samples.any()


class TestBound:
    def test_a_learned_part_is_clipped_and_counted(self, rigid, learned, motion) -> None:
        free, kept_free = service_of(rigid, live(learned))
        tight, kept_tight = service_of(rigid, live(learned, bound=0.05))
        none, kept_none = service_of(rigid, live(learned, bound=1e-12))
        for service in (free, tight, none):
            feed(service, messages(motion))
        difference = np.abs(kept_tight.torque - kept_none.torque)
        assert difference.max() == pytest.approx(0.05)
        assert np.abs(kept_free.torque - kept_none.torque).max() > 0.1
        assert tight.window.clipped > 0
        assert free.window.clipped == 0

    def test_physics_says_that_it_is_alone(self, rigid, motion) -> None:
        service, kept = service_of(rigid)
        feed(service, messages(motion)[:5])
        assert all(estimate.fallback for estimate in kept.estimates)
