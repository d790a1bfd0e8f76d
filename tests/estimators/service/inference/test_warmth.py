"""What is rehearsed has no effect, and a state that comes meanwhile is answered as it would be."""

from __future__ import annotations

import time
from types import SimpleNamespace

import numpy as np
import pytest
import zenoh
from fed_service import NAMES, RATE, START, feed, live, messages, service_of
from sessions import sessions_of_two, wait_until

from estimators.service.arm_server import ArmServer
from estimators.service.inference import forecast as forecasts
from estimators.service.inference.bulletin import Bulletin
from estimators.service.inference.forecast import Due, Forecast
from estimators.service.inference.inbox import Inbox
from estimators.service.inference.warmth import Alarm, Warmth
from estimators.service.settings import ServiceSettings
from limo_driver.errors import DivergedError
from limo_driver.network.keys import Keys
from limo_driver.network.messages import Attachment, JointStateCodec


class Bytes:
    """An outlet that keeps what is sent as it is."""

    external_wanted = True

    def __init__(self):
        self.sent, self.states, self.events = [], [], []

    def estimate(self, payload, attachment, stamp_ns):
        self.sent.append((payload, attachment, stamp_ns))

    def external(self, payload, attachment):
        self.sent.append((payload, attachment))

    def state(self, *given):
        self.states.append(given)

    def event(self, kind, text, *_given, **_facts):
        self.events.append((kind, text))


def kept_of(service):
    """Everything that a service keeps and counts, but for how long answers took."""
    rows = service.history.since(service.history.first)
    return (
        [array.tolist() for array in (rows.time, rows.position, rows.torque)],
        dict(service.counts),
        dict(service.arrivals.counts),
        (service.latency.count, service.age.count, service.window.count),
        service.window.squares.tolist(),
        service.other_rate,
        service.watchdog.active.tolist(),
    )


def answered(service, outlet, sent, *, rehearse, swap=None):
    """Feed states to a service, each after rehearsals, and return what came of it."""
    service._outlet = outlet
    for k, state in enumerate(sent):
        if k == 300 and swap is not None:
            service.swap(swap)
        for _ in range(rehearse if k else 0):
            list(service.rehearse(*sent[k - 1]))
        service.handle(*state)
    return outlet.sent, outlet.states, outlet.events, kept_of(service)


class TestRehearsal:
    @pytest.mark.parametrize("rehearse", [1, 3])
    def test_changes_no_byte_and_counts_nothing(self, rigid, learned, motion, rehearse):
        sent = messages(motion)
        sent = [*sent[:100], *sent[180:]]  # memory begins anew
        found = [
            answered(service_of(rigid, live(learned))[0], Bytes(), sent, rehearse=times)
            for times in (0, rehearse)
        ]
        assert len(found[0][0]) == 2 * len(sent)
        assert found[0] == found[1]

    def test_nor_where_another_model_takes_over(self, rigid, learned, motion):
        found = [
            answered(
                service_of(rigid)[0], Bytes(), messages(motion), rehearse=times,
                swap=live(learned, "2"),
            )
            for times in (0, 2)
        ]  # fmt: skip
        assert b"\x02\x00\x00\x002\x00" in found[0][0][-2][0]
        assert found[0] == found[1]

    def test_of_a_model_that_fails_is_no_failure_of_the_stream(self, rigid, learned, motion):
        service, kept = service_of(rigid, live(learned))
        sent = messages(motion)
        feed(service, sent[:100])

        def fail(*_given):
            raise DivergedError("the network left the finite numbers")

        stream = service.model.stream
        stream.step, step = fail, stream.step
        with pytest.raises(DivergedError):
            list(service.rehearse(*sent[99]))
        stream.step = step
        feed(service, sent[100:110])
        assert kept.kinds == []
        assert not any(estimate.fallback for estimate in kept.estimates)


class Ring:
    """A handler where samples come while it is looked at."""

    def __init__(self, *, after=0):
        self.left = after

    def look(self):
        self.left -= 1
        return "state" if self.left < 0 else None


def warmth_of(parts, seconds=60.0, failure=None):
    """What rehearses in parts for a state that is due within some seconds, and what was done."""
    done = []

    def rehearse():
        for part in range(parts):
            done.append(part)
            if failure is not None:
                raise failure
            yield

    now = time.perf_counter()
    forecast = Forecast()
    forecast.due = Due(now, now + seconds, 1.0)
    return Warmth(rehearse, forecast, SimpleNamespace(rung=forecast.due, source="me")), done


class TestWarmth:
    def test_a_state_that_is_there_is_taken_after_the_part_under_way(self):
        warmth, done = warmth_of(3)
        assert warmth.wait(Ring().look)[0] == "state"
        assert done == [0]

    def test_a_state_that_comes_later_is_looked_for_after_the_rehearsal(self):
        warmth, done = warmth_of(3)
        before = time.perf_counter()
        state, at = warmth.wait(Ring(after=8).look)
        assert state == "state"
        assert done[:3] == [0, 1, 2]
        assert before <= at <= time.perf_counter()

    def test_one_that_never_comes_is_given_up(self):
        warmth, done = warmth_of(2, seconds=0.01)
        assert warmth.wait(lambda: None)[0] is None
        assert set(done) == {0, 1}

    def test_nothing_is_rehearsed_for_one_that_came_before(self):
        warmth, done = warmth_of(2)
        warmth._forecast.due = Due(0.0, 1.0, 1.0)  # the next
        assert warmth.wait(Ring().look)[0] is None
        assert done == []

    def test_a_model_that_cannot_answer_is_tried_again(self):
        warmth, done = warmth_of(2, failure=DivergedError("not finite"))
        for _ in range(2):
            assert warmth.wait(Ring().look)[0] == "state"
        assert done == [0, 0]

    def test_a_mistake_in_it_ends_rehearsals_and_not_the_stream(self):
        warmth, done = warmth_of(2, failure=ZeroDivisionError())
        assert warmth.wait(Ring().look)[0] == "state"
        assert warmth.wait(Ring().look)[0] is None
        assert done == [0]


class TestInbox:
    def test_what_wakes_is_no_state_and_nobody_is_asked_of_it(self):
        class Sample(SimpleNamespace):
            @property
            def source_info(self):
                return SimpleNamespace(source_id=self.source)

        wake = Sample(source="me")
        states = [Sample(source="driver", number=k) for k in range(3)]
        there = [wake, states[0], wake, states[1], wake]
        ring = SimpleNamespace(
            recv=lambda: there.pop(0), try_recv=lambda: there.pop(0) if there else None
        )
        asked = []
        warmth, done = warmth_of(1)
        inbox = Inbox(ring, lambda source: bool(asked.append(source)), warmth)
        assert inbox.next().sample is states[0]
        assert inbox.next().sample is states[1]
        there[:] = [wake, states[2]]
        assert inbox.next().sample is states[2]
        assert asked == ["driver"] * 3
        assert done


def test_what_wakes_never_leaves_the_process(tmp_path):
    with sessions_of_two(tmp_path) as (own, other):
        key, forecast = "limo/arm/state/joints", Forecast()
        here, there = [], []
        own.declare_subscriber(key, here.append)
        other.declare_subscriber("**", there.append)
        with Alarm(own, key, forecast) as alarm:
            now = time.perf_counter()
            forecast.due = Due(now, now + 60.0, 120.0)
            wait_until(lambda: here)
            assert alarm.rung is forecast.due
            own.put("limo/last", b"")
            wait_until(lambda: there)
        assert [str(sample.key_expr) for sample in there] == ["limo/last"]
        assert [str(sample.source_info.source_id) for sample in here] == [alarm.source]


def test_nobody_is_woken_once_the_network_is_gone(tmp_path):
    with sessions_of_two(tmp_path) as (own, _):
        forecast = Forecast()
        alarm = Alarm(own, "limo/arm/state/joints", forecast)
        own.close()
        now = time.perf_counter()
        forecast.due = Due(now, now + 60.0, 120.0)
        wait_until(lambda: not alarm._thread.is_alive())
        assert alarm.rung is forecast.due


@pytest.mark.parametrize("share", [0.0, 0.5])
def test_a_service_answers_a_stream_with_the_same_bytes(
    tmp_path, monkeypatch, rigid, learned, motion, share
):
    """States come in real time, the last of them at once, early or late."""
    monkeypatch.setattr(forecasts, "_SHARE", share)
    expected = Bytes()
    sent = messages(motion)[:150]
    models = SimpleNamespace(
        physics=learned.simulation, candidates=("1",), load=lambda _: learned, close=lambda: None
    )
    settings = ServiceSettings(rate=RATE, bound=1e3, contact_torque=1e3)
    heard, rehearsals = [], []
    with sessions_of_two(tmp_path) as (own, other):
        other.declare_subscriber("limo/arm/torque/estimate", heard.append)
        driver = other.declare_publisher("limo/arm/state/joints")
        source = zenoh.SourceInfo(driver.id, 0)
        server = ArmServer(own, Bulletin(Keys("arm"), lambda _: None), models, settings, None)
        try:
            early = JointStateCodec(NAMES, "arm").encode(
                START - 10**9, motion.position[0], *np.zeros((2, 2))
            )
            wait_until(lambda: driver.matching_status.matching)
            driver.put(early, attachment=Attachment(-100, 0).encode(), source_info=source)
            wait_until(lambda: server.service is not None and server.answering)
            rehearse = server.service.rehearse
            server.service.rehearse = lambda *given: rehearsals.append(0) or rehearse(*given)
            service, _ = service_of(rigid, live(learned, "1"))
            service._outlet = expected
            feed(service, sent)
            began = time.perf_counter()
            for k, (payload, attachment) in enumerate(sent):
                shift = 0.0 if k < 100 else 0.004 * (-1) ** k
                time.sleep(max(began + 0.01 * k + shift - time.perf_counter(), 0.0))
                driver.put(payload, attachment=attachment, source_info=source)
            wait_until(lambda: len(heard) == len(sent))
            counts = dict(server.service.counts), dict(server.service.arrivals.counts)
        finally:
            server.close()
    told = [sample.payload.to_bytes() for sample in heard]
    assert told == [estimate[0] for estimate in expected.sent if len(estimate) > 2]
    assert counts == (dict(service.counts), dict(service.arrivals.counts))
    assert bool(rehearsals) == (share > 0.0)
