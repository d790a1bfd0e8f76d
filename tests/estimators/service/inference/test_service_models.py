"""Models that fail, and models that take turns."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from fed_service import DELAY, RATE, feed, in_python, live, messages, service_of
from lanes import sampled

from estimators.joint_physics import JointPhysics
from estimators.service.inference.live_model import LiveModel
from estimators.stream import Stream
from limo_driver.errors import DivergedError

if TYPE_CHECKING:
    from estimators.stream import LiveEstimate, StreamState


class Failing:
    """A stream that fails after some steps: by an error, or by torque that is not finite."""

    def __init__(self, inner: Stream, after: int, how: str) -> None:
        self.inner, self.left, self.how = inner, after, how
        self.delay, self.longest_step = inner.delay, inner.longest_step
        self.longest_gap = inner.longest_gap

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
    @sampled("how", ["error", "not finite"], "streams seconds each")
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

    @sampled("after", [0, 1, 30], "streams seconds each")
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


class TestSwap:
    def test_tells_by_how_much_torque_stepped(self, rigid, learned, motion) -> None:
        sent = messages(motion)
        service, kept = service_of(rigid, live(learned))
        feed(service, sent[:400])
        for first, model in ((400, live(learned, "2")), (450, live(rigid, "3"))):
            service.swap(model)
            feed(service, sent[first : first + 50])
        alone, kept_alone = service_of(rigid, live(learned))
        feed(alone, sent)
        same, other = (facts for kind, facts in kept.events if kind == "step")
        assert (same["before"], same["version"], other["version"]) == ("1", "2", "3")
        assert same["step"] == [0.0, 0.0]
        expected = np.abs(kept.torque[450] - kept_alone.torque[450])
        np.testing.assert_allclose(other["step"], expected, rtol=1e-6)
        assert expected.max() > 1e-3

    def test_from_c_to_python_and_back_primes_memory(self, rigid, learned, motion) -> None:
        sent = messages(motion)
        service, kept = service_of(rigid, live(learned))
        feed(service, sent[:400])
        service.swap(live(learned, "2", runs=in_python))
        feed(service, sent[400:450])
        service.swap(live(learned, "3"))
        feed(service, sent[450:])
        alone, kept_alone = service_of(rigid, live(learned))
        feed(alone, sent)
        np.testing.assert_allclose(kept.torque, kept_alone.torque, atol=1e-6)

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

    @pytest.mark.slow("learns a model of its own")
    def test_other_weights_inherit_memory_that_no_history_reaches(
        self, rigid, learned, motion, training_recording
    ) -> None:
        other = JointPhysics(rigid).fit([training_recording[slice(0, 1500)]])
        sent = messages(motion)
        service, kept = service_of(rigid, live(learned), history=0.5)
        feed(service, sent[:400])
        service.swap(live(other, "2"))
        feed(service, sent[400:])
        alone, kept_alone = service_of(rigid, live(other))
        feed(alone, sent)
        np.testing.assert_array_equal(kept.torque[400:], kept_alone.torque[400:])
        assert not np.allclose(kept.torque[:400], kept_alone.torque[:400], atol=1e-4)

    @pytest.mark.slow("learns two models of its own")
    def test_another_simulation_does_not(
        self, rigid, true_arm, learned, training_recording
    ) -> None:
        own = Stream(learned, RATE, DELAY)
        assert own.remembers_like(Stream(learned, RATE, DELAY))
        fitted = [
            m.fit([training_recording]) for m in (JointPhysics(true_arm), JointPhysics(rigid, 5.0))
        ]
        for other in (rigid, *fitted):
            assert not own.remembers_like(Stream(other, RATE, DELAY))
        assert not own.remembers_like(Stream(learned, RATE, 2 * DELAY))

    def test_before_the_first_state_is_possible(self, rigid, learned, motion) -> None:
        service, kept = service_of(rigid)
        service.swap(live(learned))
        feed(service, messages(motion)[:3])
        assert len(kept.estimates) == 3
