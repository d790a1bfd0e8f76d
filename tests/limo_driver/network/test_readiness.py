"""How far a service is, between two real sessions: waited for in time, in vain, and before it."""

import json
import math
import threading

import numpy as np
import pytest
from sessions import sessions_of_two, wait_until

from limo_driver.errors import ConfigError, ServiceNotReadyError
from limo_driver.network.messages import TorqueEstimateCodec
from limo_driver.network.readiness import (
    FirstEstimate,
    ServicePhase,
    ServiceWatch,
    wait_until_serving,
)
from limo_driver.network.streaming import Keys, claim, declare_history, to_json

pytestmark = pytest.mark.waits

LONG = 60.0  # [s], for what comes; no test waits that long
ORDER = ("loading", "compiling", "waiting", "preparing", "serving")


def say(publisher, phase, state=None, arm="arm"):
    publisher.put(to_json({"arm": arm, "phase": phase, "state": state or phase}))


@pytest.fixture
def both(tmp_path):
    with sessions_of_two(tmp_path) as (service, asking):
        yield service, asking


@pytest.fixture
def status(both):
    return declare_history(both[0], Keys("arm").status("service"), kept=1)


class TestPhases:
    @pytest.mark.parametrize("name", ORDER)
    def test_each_is_reached_by_those_that_follow_it(self, name):
        wanted = ServicePhase.named(name)
        reached = [phase for phase in ORDER if ServicePhase(phase).has_reached(wanted)]
        assert reached == list(ORDER[ORDER.index(name) :])

    @pytest.mark.parametrize("aside", [ServicePhase.REFUSED, ServicePhase.SILENT])
    def test_one_that_answers_nothing_is_ready_for_states(self, aside):
        assert aside.has_reached(ServicePhase.WAITING)
        assert not aside.has_reached(ServicePhase.PREPARING)

    @pytest.mark.parametrize("name", ["ready", "", "SERVING", "refused", "silent"])
    def test_others_cannot_be_waited_for(self, name, both):
        with pytest.raises(ConfigError, match=r"never .* expected loading, compiling, waiting"):
            wait_until_serving(both[1], "arm", until=name)


class TestWaiting:
    def test_ends_at_once_where_it_was_said_before(self, both, status):
        say(status, "waiting", "waiting for joint states")
        heard = wait_until_serving(both[1], "arm", until="compiling", timeout=LONG)
        assert (heard.arm, heard.phase) == ("arm", ServicePhase.WAITING)
        assert heard.state == "waiting for joint states"

    def test_goes_on_until_it_is_said(self, both, status):
        with ServiceWatch(both[1], "arm") as watch:
            found = []
            waiting = threading.Thread(target=lambda: found.append(watch.wait(timeout=LONG)))
            waiting.start()
            for phase in ORDER:
                assert not found
                say(status, phase)
            waiting.join(LONG)
        assert found[0].phase is ServicePhase.SERVING

    def test_any_arm_will_do_where_none_is_named(self, both):
        other = declare_history(both[0], Keys("other").status("service"), kept=1)
        say(other, "serving", arm="other")
        assert wait_until_serving(both[1], "*", timeout=LONG).arm == "other"
        with pytest.raises(
            ServiceNotReadyError, match=r"of arm 'arm' .* none was heard; start one"
        ):
            wait_until_serving(both[1], "arm", timeout=0.01)

    def test_says_who_was_heard_last_and_what_it_said(self, both, status):
        name = claim(both[0], Keys("arm"), "service")
        say(status, "compiling", "compiling 12 of 31")
        with ServiceWatch(both[1], "arm") as watch:
            watch.wait("compiling", LONG)
            with pytest.raises(ServiceNotReadyError) as ended:
                watch.wait("serving", 0.01)
            text = str(ended.value)
            assert text.startswith("no service of arm 'arm' was serving within 0.01 s: the service")
            assert "said 'compiling 12 of 31' 0." in text
            assert "gone" not in text
            assert (ended.value.until, ended.value.waited) == ("serving", 0.01)
            assert isinstance(ended.value, TimeoutError)
            name.undeclare()
            with pytest.raises(ServiceNotReadyError, match="and is gone since"):
                watch.wait("serving", 0.01)

    def test_says_that_a_service_is_there_and_silent(self, both):
        name = claim(both[0], Keys("arm"), "service")
        with pytest.raises(ServiceNotReadyError, match="its name is on the network, but it said"):
            wait_until_serving(both[1], "arm", timeout=0.01)
        name.undeclare()

    @pytest.mark.parametrize("timeout", [0.0, -1.0, math.nan, -math.inf])
    def test_needs_a_time(self, both, timeout):
        with pytest.raises(ConfigError, match="expected above 0"):
            wait_until_serving(both[1], "arm", timeout=timeout)
        with pytest.raises(ConfigError, match="expected above 0"):
            FirstEstimate(both[1], "arm", timeout)

    def test_may_last_for_ever(self, both, status):
        say(status, "serving")
        assert wait_until_serving(both[1], "arm", timeout=math.inf).phase == "serving"

    def test_needs_a_name_that_can_be_part_of_a_key(self, both):
        with pytest.raises(ConfigError, match="the arm's name is 'a/b'"):
            wait_until_serving(both[1], "a/b")

    @pytest.mark.parametrize(
        "data",
        [b"", b"{", b"[]", b"7", b"\xff", b"{}", b'{"phase": "serving"}', b"[" * 100_000,
         b'{"phase": [], "state": ""}', b'{"phase": "ready", "state": "ready"}',
         json.dumps({"phase": "serving", "state": "x" * 70_000}).encode()],
    )  # fmt: skip
    def test_what_is_no_status_says_nothing(self, both, status, data):
        with ServiceWatch(both[1], "arm") as watch:
            say(status, "loading")
            watch.wait("loading", LONG)
            status.put(data)
            both[0].put("limo/**", to_json({"phase": "serving", "state": "of nobody"}))
            say(status, "compiling")
            assert watch.wait("compiling", LONG).phase is ServicePhase.COMPILING


class TestFirstEstimate:
    codec = TorqueEstimateCodec(("a", "b"))

    def estimate(self, *, reset):
        zero, outside = np.zeros(2), np.zeros(2, dtype=bool)
        return self.codec.encode(1, zero, zero, zero, outside, reset=reset)

    def test_comes_when_memory_is_full(self, both):
        estimates = both[0].declare_publisher(Keys("arm").estimate)
        with FirstEstimate(both[1], "arm", LONG) as come:
            wait_until(lambda: estimates.matching_status.matching)
            for payload in (b"", b"nonsense", self.estimate(reset=True)):
                estimates.put(payload)
                assert not come()

            def sends():
                estimates.put(self.estimate(reset=False))
                return come()

            wait_until(sends)
            assert come()

    def test_that_does_not_come_is_told_with_what_the_service_said(self, both, status):
        say(status, "compiling")
        with ServiceWatch(both[1], "arm") as watch, FirstEstimate(both[1], "arm", 1e-9) as come:
            watch.wait("compiling", LONG)
            wait_until(lambda: come._watch._heard)
            with pytest.raises(ServiceNotReadyError, match=r"serving within 1e-09 s.*'compiling'"):
                come()
