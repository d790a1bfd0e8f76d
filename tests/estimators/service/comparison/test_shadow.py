"""Errors of two models on the states that a service answered."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from fed_service import feed, live, messages, service_of

from estimators.joint_physics import JointPhysics
from estimators.service.comparison import Shadow


@pytest.fixture(scope="module")
def learned(rigid, training_recording) -> JointPhysics:
    return JointPhysics(rigid).fit([training_recording])


@pytest.fixture(scope="module")
def motion(record):
    return record(4, 90.0)


def shadow_over(rigid, learned, motion, first: int = 1000) -> Shadow:
    """A shadow that begins after some states, and sees the others second by second."""
    service, _ = service_of(rigid, live(learned))
    sent = messages(motion)
    feed(service, sent[:first])
    shadow = Shadow(service, live(rigid), live(learned))
    for k in range(first, len(sent), 100):
        feed(service, sent[k : k + 100])
        shadow.take()
    return shadow


@pytest.mark.slow("serves half a minute of states")
def test_the_better_model_is_found_better(rigid, learned, motion) -> None:
    found = shadow_over(rigid, learned, motion).comparison()
    assert found.promote
    assert (found.challenger < found.champion).all()


@pytest.mark.slow("streams a minute and a half through two models")
def test_only_states_that_came_since_are_judged(rigid, learned, motion) -> None:
    # The latest second and a bit may turn out to be a contact.
    assert shadow_over(rigid, learned, motion).seconds == pytest.approx(80.0 - 1.15, abs=1.01)


@pytest.mark.slow("serves a minute of states")
def test_errors_are_those_of_the_service(rigid, learned, motion) -> None:
    service, kept = service_of(rigid, live(learned))
    feed(service, messages(motion))
    shadow = shadow_over(rigid, learned, motion)
    rows = slice(1000, 1000 + round(shadow.seconds * 100))
    expected = np.sqrt(np.mean(np.square(kept.externals[rows]), axis=0))
    np.testing.assert_allclose(shadow.comparison().challenger, expected, rtol=0.05)


@pytest.mark.slow("serves a minute of states")
def test_contact_is_left_out_with_a_margin(rigid, learned, motion) -> None:
    torque = motion.torque.copy()
    torque[3000:3500, 1] -= 8.0
    shadow = shadow_over(rigid, learned, replace(motion, torque=torque))
    free = shadow_over(rigid, learned, motion)
    assert free.seconds - shadow.seconds == pytest.approx(5.0 + 2 * 1.0, abs=0.5)
    np.testing.assert_allclose(
        shadow.comparison().challenger, free.comparison().challenger, rtol=0.2
    )


@pytest.mark.slow("serves half a minute of states")
def test_an_arm_at_rest_says_nothing(rigid, learned, motion) -> None:
    still = replace(motion, position=np.tile(motion.position[:1], (len(motion), 1)))
    shadow = shadow_over(rigid, learned, still)
    assert shadow.seconds == 0.0
    assert shadow.comparison() is None


@pytest.mark.slow("serves half a minute of states")
def test_a_gap_begins_memory_anew(rigid, learned, motion) -> None:
    kept = np.r_[0:3000, 4000:9000]
    shadow = shadow_over(rigid, learned, motion[kept])
    # Of both stretches the latest second and a bit is never judged, in whole seconds.
    assert 70.0 - 0.2 - 2 * (1.15 + 1.0) <= shadow.seconds <= 70.0 - 0.2 - 2 * 1.15
    assert shadow.comparison().promote
