"""The table of peers counts names, alarms and closure alike for every tool."""

from pathlib import Path

import diagnosis_peers as peers
import numpy as np
import pytest
from diagnosis_closure import Closure
from diagnosis_judged import Judged


def case(kind, hidden, said, worst=1.0):
    effects = [{"effect": name, "joints": [joint], "equivalent": []} for name, joint in hidden]
    truth = {"kind": kind, "effects": effects, "asked": [3.0], "foretellable": True}
    findings = [{"effect": name, "joints": [joint], "confidence": 1.0} for name, joint in said]
    closure = Closure(np.full(7, 9.0), np.full(7, worst), np.ones(7))
    return Judged(Path("a"), truth, {"verdict": "", "findings": findings}, closure, closure, 3.0)


def row(*judged):
    heading = ("tool", "cases", "median", "close", "right", "precision", "alarms", "seconds")
    return dict(zip(heading, peers.summary("some tool", judged, len(judged)), strict=True))


def test_names_and_alarms_are_counted():
    backlash = ("backlash", 2)
    said = row(
        case("single", [backlash], [backlash], worst=1.1),
        case("single", [backlash], [backlash, ("payload", 7)], worst=2.0),
        case("null", [], [("payload", 7)]),
        case("null", [], []),
    )
    assert said["right"] == "1 of 2"
    assert said["precision"] == "0.50 of 4"
    assert said["alarms"] == "1 of 2"
    assert said["median"] == "1.55"
    assert said["close"] == "50%"


def test_saying_that_something_is_unknown_is_an_alarm_but_no_name():
    said = row(case("null", [], [("unknown", 2)]), case("single", [("backlash", 2)], []))
    assert said["alarms"] == "1 of 1"
    assert said["precision"] == "-"


@pytest.mark.parametrize("name", peers.PEERS)
def test_every_peer_has_a_title(name):
    assert peers.TITLES[name]
