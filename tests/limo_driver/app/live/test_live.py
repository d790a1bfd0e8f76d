"""The live page: what the network says of an arm, in a browser of this machine and no other."""

from __future__ import annotations

import http.client
import json
import re
import threading
from contextlib import contextmanager

import numpy as np
import pytest
from audit import violations
from browser import browser, program
from sessions import sessions_of_two, wait_until

from limo_driver.app.live.web import ArmFeed, LiveServer
from limo_driver.model import RobotModel
from limo_driver.network.messages import JointStateCodec, TorqueEstimateCodec
from limo_driver.network.streaming import Keys, declare_stream

pytestmark = pytest.mark.waits

N = 7
KEYS = Keys("arm")
POSE = np.array([0.1, 0.5, -0.2, -1.0, 0.3, 0.8, 0.0])
FORCE = np.array([0.0, 12.0, -5.0])
STATUS = {"state": "serving", "model": "7", "rate": 1000.0, "answered": 998, "delay": 0.1,
          "contact": [False, True, *[False] * 5],
          "arrivals": {"received": 100, "lost": 2558}}  # fmt: skip
EVENTS = [
    *({"kind": "contact", "text": f"joint {j} is pushed", "t": 1.0, "times": 1, "joint": j,
       "began": 1.0, "ended": None} for j in (2, 4)),
    {"kind": "reset", "text": "memory is reset", "t": 1.0, "times": 14, "joint": None,
     "began": None, "ended": None},
]  # fmt: skip


@pytest.fixture(scope="module")
def model():
    return RobotModel.load("iiwa14")


@pytest.fixture
def followed(tmp_path, model):
    """A feed, and a function that publishes a state and an estimate to it."""
    names = model.joint_names
    with sessions_of_two(tmp_path) as (here, there):
        feed = ArmFeed(here, KEYS, model, lambda: {"status": STATUS, "events": EVENTS})
        states, estimates = (declare_stream(there, key) for key in (KEYS.joints, KEYS.estimate))
        external = -model.flange_jacobian(POSE)[:3].T @ FORCE

        def publish(k=0, joints=names, outside=False, **flags):
            n = len(joints)
            zero = np.zeros(n)
            stamp, values = 10**9 + 10**6 * k, (zero + 1.0, zero + 0.1, np.resize(external, n))
            states.put(JointStateCodec(joints).encode(stamp, np.resize(POSE, n), zero, zero))
            estimates.put(
                TorqueEstimateCodec(joints).encode(
                    stamp, *values, np.full(n, outside), model="7", **flags
                )
            )

        yield feed, publish
        feed.close()


def heard(feed, publish, name, **given):
    """Publish until the feed has something, which is when the two know each other."""
    seen = {}

    def has():
        publish(**given)
        seen.update(feed.snapshot())
        return name in seen

    wait_until(has)
    return seen


def test_a_feed_has_state_estimate_interval_and_force(followed):
    feed, publish = followed
    assert feed.snapshot()["age"] is None
    heard(feed, publish, "position")
    shown = heard(feed, publish, "force")
    assert shown["position"] == POSE.tolist()
    assert shown["interval"] == pytest.approx([0.196] * N)
    assert np.array(shown["measured"]) == pytest.approx(1.0 + np.array(shown["external"]), abs=1e-3)
    assert shown["force"] == pytest.approx(FORCE, abs=0.3)
    assert shown["status"]["model"] == "7"
    json.dumps(shown, allow_nan=False)


def test_what_a_filter_says_while_it_fills_is_no_value(followed):
    feed, publish = followed
    heard(feed, publish, "force")
    shown = {}

    def is_lost():
        publish(reset=True)
        shown.update(feed.snapshot())
        return shown["torque"] == [None] * N

    wait_until(is_lost)
    assert [shown[name] for name in ("measured", "external", "interval")] == [[None] * N] * 3
    assert shown["force"] is None


def test_nothing_is_felt_where_motion_is_unlike_what_was_learned(followed):
    feed, publish = followed
    assert None not in heard(feed, publish, "force")["felt"]
    shown = {}

    def is_outside():
        publish(outside=True)
        shown.update(feed.snapshot())
        return shown["outside"] == [True] * N

    wait_until(is_outside)
    assert shown["force"] is None
    assert shown["felt"] == [None] * N
    assert None not in shown["external"]


@pytest.mark.parametrize(
    ("joints", "said"),
    [
        (("a", "b"), "its joints are a, b, those of iiwa14 "),
        (tuple(f"other_{j}" for j in range(N)), "its joints are other_0, other_1, "),
        (tuple(f"j{j}" for j in range(12)), "j7 and 4 more"),
    ],
)
def test_no_robot_of_other_joints_is_drawn_instead(followed, joints, said):
    feed, publish = followed
    assert heard(feed, publish, "position")["drawn"]
    shown = {}

    def is_said():
        publish(joints=joints)
        shown.update(now := feed.snapshot())
        return "problem" in now

    wait_until(is_said)
    assert re.search(said, shown["problem"])
    assert "--robot" in shown["problem"]
    assert not shown["drawn"]
    assert "position" not in feed.snapshot()
    wait_until(lambda: feed.snapshot()["names"] == list(joints))
    assert heard(feed, publish, "position")["drawn"]


def test_nothing_is_asked_for_once_the_page_is_closed(model):
    """A browser may still hang on to it then."""
    asked, wait, closing = threading.Event(), threading.Event(), threading.Event()
    after = []

    def snapshot():
        after.append(closing.is_set())
        asked.set()
        wait.wait(60.0)
        return {}

    server = LiveServer("arm", model, snapshot)
    port = int(server.address.rstrip("/").rpartition(":")[2])
    tab = http.client.HTTPConnection("127.0.0.1", port)
    tab.request("GET", "/live", headers={"Host": f"127.0.0.1:{port}"})
    assert asked.wait(60.0)
    ending = threading.Thread(target=server.close)
    ending.start()
    assert ending.is_alive()  # it waits for the one that was begun
    wait.set()
    ending.join(60.0)
    assert not ending.is_alive()
    closing.set()
    count = len(after)
    tab.getresponse().read()
    tab.close()
    assert len(after) == count
    assert not any(after)


@contextmanager
def served(model, snapshot):
    server = LiveServer("arm", model, snapshot)
    try:
        yield server
    finally:
        server.close()


def test_only_this_machine_is_answered_under_its_own_name(model):
    with served(model, dict) as server:
        port = int(server.address.rstrip("/").rpartition(":")[2])
        answers = {}
        for host in ("127.0.0.1", "localhost", "evil.example"):
            asked = http.client.HTTPConnection("127.0.0.1", port)
            asked.request("GET", "/", headers={"Host": f"{host}:{port}"})
            answers[host] = asked.getresponse().status
            asked.close()
    assert answers == {"127.0.0.1": 200, "localhost": 200, "evil.example": 403}


@pytest.mark.slow("starts a browser")
@pytest.mark.skipif(program() is None, reason="no Chromium is installed on this machine")
def test_a_browser_shows_the_arm_as_it_moves(followed, model):
    feed, publish = followed
    heard(feed, publish, "force")
    stop = threading.Event()

    def stream():
        k = 0
        while not stop.wait(0.005):
            k += 1
            publish(k)

    source = threading.Thread(target=stream)
    source.start()
    try:
        with served(model, feed.snapshot) as server, browser() as tab:
            tab.look(server.address)
            tab.wait("Number(document.body.dataset.frames) > 5")
            text = tab.value("document.body.innerText")
            assert tab.errors == []
            assert tab.value("document.querySelectorAll('canvas.strip').length") == N
            live = "Number(document.body.dataset.frames) > 5"
            assert violations(tab, server.address, 1400, dark=False, ready=live) == []
            assert violations(tab, server.address, 390, dark=True, ready=live) == []
            long = "[...document.querySelectorAll('.facts > div')]"
            assert tab.value(f"{long}.every((part) => part.tabIndex === 0)")  # keys scroll them
            tab.wait("document.querySelectorAll('canvas.strip.pushed').length")
            assert tab.value("document.querySelectorAll('canvas.strip.pushed').length") == 2
            tab.value("document.getElementById('pause').click()")
            held = tab.value("document.getElementById('when').value")
            frames = tab.value("document.body.dataset.frames")
            tab.wait(f"Number(document.body.dataset.frames) > {frames} + 5")
            assert tab.value("document.getElementById('when').value") == held
            assert tab.value("document.getElementById('pause').textContent") == "Live"
            for width, height in ((1400, 900), (390, 844)):
                tab.look(server.address, width, height)
                tab.wait("document.querySelector('#events li')")
                below = "[...document.querySelectorAll('.strip, .stage, #events li')]"
                below += ".map((item) => item.getBoundingClientRect().bottom)"
                assert max(tab.value(below)) <= height
    finally:
        stop.set()
        source.join()
    assert "model 7, lost 2558 of 2658 (96 %)" in text
    for said in ("± 0.20 N m", "joint 2 is pushed", "(14 times)", "joint 1", "1000 Hz"):
        assert said in text
