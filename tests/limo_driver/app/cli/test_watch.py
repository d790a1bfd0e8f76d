"""What `limo watch` keeps, shows, and drops of what the network brings."""

import io
import json
import time
from random import Random

import pytest
import zenoh
from rich.console import Console
from sessions import wait_until

from limo_driver.app.cli.watch.screen import Watched, page
from limo_driver.network.messages import Event, Level
from limo_driver.network.streaming import Keys, to_json

pytestmark = pytest.mark.waits

STATUS = {
    "arm": "arm",
    "state": "serving",
    "model": "7",
    "rate": 1000.0,
    "delay": 0.1,
    "answered": 998,
    "external_rms": [0.12, None],
    "outside": [499, 0],
    "contact": [True, False],
    "arrivals": {"received": 998, "lost": 2, "late": 0, "duplicated": 0, "restarts": 0},
    "counts": {"malformed": 3, "foreign": 0},
    "latency": {"count": 998, "p50": 3e-4, "p99": 9e-4, "longest": 4e-3, "counts": [0] * 40},
}
VALUES = [None, True, -1, 1e308, "", "[/]", "\x1b[2J", [], [[]], {}, {"a": []}, ["x"]]


class Sample:
    """What a subscriber is given."""

    def __init__(self, key, data):
        self.key_expr, self.payload = key, self
        self._data = data

    def to_bytes(self):
        return self._data


def watched(*, as_json=False):
    return Watched(as_json=as_json)


def take_status(what, status, arm="arm"):
    data = status if isinstance(status, bytes) else json.dumps(status).encode()
    what.take_status(Sample(f"limo/{arm}/status/service", data))


def shown(what):
    console = Console(file=io.StringIO(), width=100)
    console.print(page(what))
    return console.file.getvalue()


def event(text="contact on joint 1", **facts):
    return Event(time.time_ns(), Level.WARN, "contact", text, facts).encode()


class TestPage:
    def test_shows_what_a_service_says(self):
        what = watched()
        take_status(what, STATUS)
        what.take_event(Sample("limo/arm/event", event()))
        page = shown(what)
        for part in ("arm: serving", "1000 Hz, 998 answered", "2 lost", "3 malformed", "0.120",
                     "50 %", "p99 0.90", "arm: contact on joint 1"):  # fmt: skip
            assert part in page
        assert what.malformed == 0

    def test_text_from_the_network_commands_neither_terminal_nor_page(self):
        what = watched()
        take_status(what, STATUS | {"model": "[red]\x1b[2J\x07[/]"})
        what.take_event(Sample("limo/arm/event", event("[/]\x1b]0;title\x07\n" + "x" * 100_000)))
        page = shown(what)
        assert "\x1b" not in page
        assert "\x07" not in page
        assert "[red]" in page
        assert len(page) < 10_000

    def test_shows_whether_the_log_is_written(self):
        what = watched()
        log = {"written": 12_000, "dropped": 0, "failure": None}
        take_status(what, STATUS | {"log": log})
        assert "12000 written, 0 dropped" in shown(what)
        take_status(what, STATUS | {"log": log | {"dropped": 7, "failure": "No space left"}})
        assert "stopped: No space left; 12000 written, 7 dropped" in shown(what)
        for value in VALUES:
            take_status(what, STATUS | {"log": value})
            take_status(what, STATUS | {"log": log | {"written": value}})
            shown(what)
        assert what.malformed > len(VALUES)


class TestStatus:
    @pytest.mark.parametrize("name", [name for name in STATUS if name not in {"arm", "state"}])
    def test_any_value_of_any_field_is_shown_or_counted(self, name):
        what = watched()
        for value in VALUES:
            take_status(what, STATUS | {name: value})
            shown(what)
        take_status(what, {k: v for k, v in STATUS.items() if k != name})
        assert what.malformed >= 1
        take_status(what, STATUS)
        assert "2 lost" in shown(what)

    @pytest.mark.parametrize(
        "data",
        [b"", b"{", b"[]", b"null", b"7", b"\xff", b"[" * 100_000, b'{"arm": NaN}',
         json.dumps(STATUS).encode()[:-9], json.dumps(STATUS | {"rate": float("inf")}).encode(),
         json.dumps(STATUS | {"contact": [True] * 50_000}).encode()],
    )  # fmt: skip
    def test_what_is_no_status_is_counted(self, data):
        what = watched(as_json=True)
        take_status(what, data)
        assert (what.malformed, what.statuses) == (1, {})

    @pytest.mark.parametrize("key", ["**", "limo/**", "limo/*/status/service", "limo/other/s/s"])
    def test_one_that_is_not_of_its_key_is_counted(self, key):
        what = watched()
        what.take_status(Sample(key, to_json(STATUS)))
        assert (what.malformed, what.statuses) == (1, {})

    def test_mutated_ones_are_shown_or_counted(self):
        what, random = watched(), Random(0)  # noqa: S311
        whole = bytearray(to_json(STATUS))
        for _ in range(1000):
            data = whole.copy()
            for _ in range(random.randint(1, 3)):
                data[random.randrange(len(data))] = random.randrange(256)
            take_status(what, bytes(data))
            if what.statuses:
                page(what)
        assert what.malformed > 300
        take_status(what, STATUS)
        assert "2 lost" in shown(what)


class TestEvents:
    def test_what_is_none_is_counted(self):
        what, random = watched(), Random(0)  # noqa: S311
        whole = event()
        for length in range(len(whole) - 4):
            what.take_event(Sample("limo/arm/event", whole[:length]))
        assert what.malformed == len(whole) - 4
        for _ in range(1000):
            what.take_event(Sample("limo/arm/event", random.randbytes(random.randrange(200))))
        assert what.malformed == len(whole) - 4 + 1000
        assert not what.events

    @pytest.mark.parametrize("key", ["**", "limo", "limo/**", "*/arm/event"])
    def test_one_put_on_many_keys_is_of_no_arm(self, key):
        what = watched()
        what.take_event(Sample(key, event()))
        assert (what.malformed, len(what.events)) == (1, 0)

    def test_resets_do_not_bury_a_contact(self):
        what, began = watched(), 10**18
        facts = [
            {"joint": 2, "began_stamp": began},
            {"joint": float("nan"), "began_stamp": 10**400},
        ]
        for given in facts:
            sent = Event(began, Level.WARN, "contact", f"a push {len(given)}", given)
            what.events.append(("arm", sent))
        for k in range(40):
            sent = Event(began, Level.WARN, "reset", f"memory is reset {k}")
            what.events.extend([("arm", sent), ("other", sent)])
        pushed, hostile, reset = what.of("arm")["events"]
        assert (pushed["kind"], pushed["joint"], pushed["began"]) == ("contact", 2, 1e9)
        assert (hostile["joint"], hostile["began"]) == (None, None)
        assert (reset["text"], reset["times"]) == ("memory is reset 39", 40)
        json.dumps([pushed, hostile, reset], allow_nan=False)
        take_status(what, STATUS)
        assert "memory is reset 39 (40 times)" in shown(what)
        assert "a push" in shown(what)

    def test_facts_do_not_replace_what_the_line_says(self, capsys):
        watched(as_json=True).take_event(Sample("limo/arm/event", event(arm="other", joint=1)))
        line = json.loads(capsys.readouterr().out)
        assert (line["arm"], line["joint"]) == ("arm", 1)


def test_goes_on_between_malformed_messages_of_a_real_session(two_sessions):
    first, second = two_sessions
    what, keys, random = watched(), Keys("arm"), Random(0)  # noqa: S311
    subscribers = [
        second.declare_subscriber(keys.status("service"), what.take_status),
        second.declare_subscriber(keys.event, what.take_event),
    ]
    status, told, *_ = publishers = [
        first.declare_publisher(key, congestion_control=zenoh.CongestionControl.BLOCK)
        for key in (keys.status("service"), keys.event, "limo/**", "**")
    ]
    wait_until(lambda: all(publisher.matching_status.matching for publisher in publishers))
    for k in range(50):
        for publisher in publishers:
            publisher.put(random.randbytes(random.randrange(300)))
        status.put(to_json(STATUS | {"answered": k}))
        told.put(event(f"number {k}"))
    wait_until(lambda: what.events and what.events[-1][1].text == "number 49")
    wait_until(lambda: what.statuses and what.statuses["arm"][1]["answered"] == 49)
    assert what.malformed == 300
    for subscriber in subscribers:
        subscriber.undeclare()


@pytest.mark.parametrize(
    ("given", "told"),
    [
        (("--until", "ready"), "a service is never 'ready', expected loading, compiling, waiting"),
        (("--until", "serving", "--timeout", "0"), "--timeout is 0 s, expected above 0"),
        (("--until", "serving", "--timeout", "-1"), "--timeout is -1 s, expected above 0"),
        (("--until", "serving", "--timeout", "nan"), "--timeout is nan, expected a number"),
        (("--until", "serving", "--duration", "1"), "--duration is for watching"),
        (("--timeout", "1"), "--timeout is for --until"),
        (("--until", "serving", "--web", "--arm", "a"), "--web is for watching; --until only"),
        (("--port", "0"), "--port is of the page that --web serves"),
        (("--robot", "iiwa14", "--until", "serving"), "--robot is of what --web or --rerun draws"),
        (("--web",), "--web shows one arm: name it with --arm"),
        (("--until", "serving", "--arm", "a/b"), "the arm's name is 'a/b'"),
    ],
)
def test_what_cannot_be_waited_for_is_told_in_one_line(limo, given, told):
    ended = limo("watch", *given)
    assert ended.returncode == 2
    assert told in ended.stderr
    assert ended.stderr.count("\n") == 1
