"""External torque as far as it is known: what a consumer may act on, and since when it may."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from fed_service import DELAY, NAMES, START, Kept, feed, live, messages, service_of

from limo_driver.network.messages import Attachment, JointStateCodec


def torque(kept: Kept) -> np.ndarray:
    return np.array([news.torque for news in kept.known_of])


def test_is_the_external_torque_of_joints_that_move_as_learned(rigid, learned, motion) -> None:
    pushed = motion.torque.copy()
    pushed[200:300, 1] -= 8.0
    service, kept = service_of(rigid, live(learned))
    feed(service, messages(replace(motion, torque=pushed)))
    found, told = torque(kept), np.array([estimate.external for estimate in kept.estimates])
    known = ~np.array([estimate.outside for estimate in kept.estimates])
    assert known[100:].mean() > 0.9
    np.testing.assert_array_equal(found[known], told[known])
    assert np.isnan(found[~known]).all()
    std = np.array([news.std for news in kept.known_of])
    np.testing.assert_array_equal(np.isnan(std), np.isnan(found))
    assert found[250, 1] == pytest.approx(-8.0, abs=1.0)
    news = kept.known_of[250]
    assert (news.model, news.physics_only) == ("1", False)
    assert news.stamp_ns == kept.estimates[250].stamp_ns
    assert news.since_gap == pytest.approx((news.stamp_ns - START) * 1e-9 + DELAY)


def test_is_unknown_after_a_gap_until_memory_is_full_and_joints_have_turned(
    rigid, learned, motion
) -> None:
    service, kept = service_of(rigid, live(learned))
    sent = messages(motion)
    feed(service, [*sent[:200], *sent[300:]])
    assert not np.isnan(kept.known_of[199].torque).any()
    assert kept.known_of[200].since_gap == 0.0
    assert kept.estimates[200].reset
    assert kept.estimates[200].since_gap == 1e-3
    after = kept.known_of[200:]
    first = next(news for news in after if not np.isnan(news.torque).all())
    assert first.since_gap >= 2.0 * DELAY
    assert not np.isnan(after[-1].torque).any()


def test_is_unknown_without_measured_torque(rigid, learned, motion) -> None:
    service, kept = service_of(rigid, live(learned))
    codec, nothing = JointStateCodec(NAMES), motion.torque[0, :0]
    for k, position in enumerate(motion.position):
        state = codec.encode(START + 10_000_000 * k, position, 0 * position, nothing)
        service.handle(state, Attachment(k, k).encode())
    assert len(kept.known_of) == len(motion)
    assert np.isnan(torque(kept)).all()


def test_stays_known_through_a_swap_and_says_who_estimates(rigid, learned, motion) -> None:
    service, kept = service_of(rigid, live(learned))
    sent = messages(motion)
    feed(service, sent[:200])
    service.swap(live(learned, "2"))
    feed(service, sent[200:])
    assert [news.model for news in kept.known_of] == ["1"] * 200 + ["2"] * (len(sent) - 200)
    assert not np.isnan(torque(kept)[190:]).any()
    assert np.diff([news.since_gap for news in kept.known_of]) == pytest.approx(0.01)
    told = [estimate.since_gap for estimate in kept.estimates]
    assert told[1:] == pytest.approx([news.since_gap for news in kept.known_of][1:], abs=1e-3)


def test_is_unknown_of_physics_whose_errors_nobody_knows(rigid, motion) -> None:
    service, kept = service_of(rigid)
    feed(service, messages(motion))
    assert all(news.physics_only for news in kept.known_of)
    assert np.isnan(torque(kept)).all()
