"""States that are lost, late, malformed, or of another rate."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from fed_service import NAMES, RATE, START, feed, live, messages, service_of

from limo_driver.network.messages import (
    Attachment,
    JointStateCodec,
)


class TestLosses:
    def test_a_short_gap_is_bridged(self, rigid, learned, motion) -> None:
        service, kept = service_of(rigid, live(learned))
        sent = messages(motion)
        feed(service, sent[:300] + sent[302:])
        assert service.arrivals.counts["lost"] == 2
        assert "reset" not in kept.kinds
        assert not any(estimate.reset for estimate in kept.estimates[20:])

    @pytest.mark.parametrize("lost", [7, 18])
    def test_memory_outlives_a_gap_of_less_than_a_fifth_of_a_second(
        self, rigid, learned, motion, lost
    ) -> None:
        """What the filter tells does not, until it is full."""
        service, kept = service_of(rigid, live(learned))
        sent = messages(motion)
        feed(service, sent[:300] + sent[300 + lost :])
        assert "reset" not in kept.kinds
        flags = [estimate.reset for estimate in kept.estimates[300:]]
        assert all(flags[:20])
        assert not any(flags[21:])  # the 20th state after is where rounding puts it
        assert all(np.isnan(news.torque).all() for news in kept.known_of[300:320])
        whole, kept_whole = service_of(rigid, live(learned))
        feed(whole, sent)
        expected = kept_whole.torque[320 + lost :]
        np.testing.assert_allclose(kept.torque[320:], expected, atol=0.02)

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
        feed(service, [sent[t] for t in range(0, 500, 25)])
        assert service.counts["resets"] == 19
        assert kept.events == [("reset", {"count": 1})]
        monkeypatch.setattr("estimators.service.inference.arm_service._RESET_PAUSE", 0.0)
        service._next_reset = 0.0
        feed(service, [sent[520]])
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


class TestAnotherRate:
    @pytest.mark.parametrize("factor", [0.4, 2.5])
    def test_is_not_answered_as_if_it_were_the_one_that_is_served(
        self, rigid, learned, motion, factor
    ) -> None:
        service, kept = service_of(rigid, live(learned))
        feed(service, messages(motion[:400]))
        later = replace(motion, time=motion.time / factor)
        codec, begin = JointStateCodec(NAMES, "arm"), 4.0
        for t in range(400):
            stamp = START + round(1e9 * (begin + later.time[t] - later.time[0]))
            payload = codec.encode(stamp, motion.position[t], np.empty(0), motion.torque[t])
            service.handle(payload, Attachment(400 + t, t).encode())
        assert service.other_rate == pytest.approx(RATE * factor)
        assert 450 < len(kept.estimates) < 620
        doubted = kept.estimates[404:]
        assert all(estimate.outside.all() for estimate in doubted)
        assert np.isnan([estimate.std for estimate in doubted]).all()
        assert np.isfinite([estimate.std for estimate in kept.estimates[20:400]]).all()
        assert "contact" not in kept.kinds
