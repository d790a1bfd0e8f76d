"""Scenario files: every entry checked with its line, and every fault as it says."""

import struct

import pytest
from bus_master import enable

from backends.can.config import ArmConfig
from backends.can.simulator.scenario import BusScenario
from limo_driver.errors import ConfigError

NODE, OTHER = 11, 12


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "is empty; it needs `faults:`"),
        ("seed: 1", "line 1: lacks `faults:`"),
        ("faults: 3", "line 1: faults is '3', expected a list of mappings"),
        (
            "faults:\n- {fault: fire}",
            "line 2: faults: number 1: fault is 'fire', expected one of lose_frames, ",
        ),
        ("faults:\n- {at: 3}", "line 2: faults: number 1: lacks `fault:`"),
        ("faults:\n\n- {fault: bus_off}", "line 3: faults: bus_off: lacks joint"),
        (
            "faults:\n- {fault: bus_off, joint: 3}",
            "line 2: faults: bus_off: joint is 3, expected a joint from 1 to 2",
        ),
        (
            "faults:\n- {fault: bus_off, joint: 0}",
            "line 2: faults: bus_off: joint is 0, expected a joint from 1",
        ),
        (
            "faults:\n- fault: bus_off\n  joint: 1\n  until: 3",
            "line 4: faults: bus_off: has no 'until'",
        ),
        (
            "faults:\n- {fault: lose_frames, probability: 2}",
            "probability is 2, expected a number from 0 to 1",
        ),
        (
            "faults:\n- {fault: lose_frames, probability: x}",
            "probability is 'x', expected a number",
        ),
        (
            "faults:\n- fault: lose_frames\n  probability: 1\n  way: up",
            "line 4: faults: lose_frames: way is 'up', expected one of to_drives, from_drives, bo",
        ),
        (
            "faults:\n- {fault: wrong_node, joint: 1, node: 12}",
            "node is 12, expected another than that of joint 2",
        ),
        (
            "faults:\n- {fault: swap_joints, joint: 1, other: 1}",
            "other is 1, expected another joint",
        ),
        ("faults:\n- {fault: babble, data: xyz}", "expected up to 8 bytes in hexadecimal"),
        ("seed: -1\nfaults: []", "line 1: seed is -1, expected a whole number of 0 or more"),
        ("faults: [", "is no YAML"),
    ],
)
def test_a_mistake_is_reported_at_its_line(arm_yaml, tmp_path, text, message):
    joints = ArmConfig.load(arm_yaml()).joints
    path = tmp_path / "scenario.yaml"
    path.write_text(text)
    with pytest.raises(ConfigError) as refused:
        BusScenario.load(path, joints)
    assert str(path) in str(refused.value)
    assert message in str(refused.value)


def test_a_wrong_node_is_found_under_its_other_id_only(master):
    drives = master("faults: [{fault: wrong_node, joint: 1, node: 33}]")
    assert drives.say(0x600 + NODE, bytes([0x40, 0, 0x10, 0, 0, 0, 0, 0])) == []
    assert drives.read(33, 0x1018, 4) == 7001


def test_swapped_joints_answer_under_each_others_id(master):
    drives = master("faults: [{fault: swap_joints, joint: 1, other: 2}]", position=[0.4, -0.3])
    assert drives.read(OTHER, 0x1018, 4) == 7001
    assert drives.read(OTHER, 0x6064, signed=True) > 0  # joint 1, where node 12 should be


def test_frames_are_lost_one_way_and_for_a_time(master):
    drives = master(
        "faults: [{fault: lose_frames, probability: 1, way: from_drives, joint: 1,"
        " at: 0.1, lasts: 0.1}]"
    )
    enable(drives, NODE)
    enable(drives, OTHER)
    drives.wait(0.12)
    request = bytes([0x40, 0, 0x10, 0, 0, 0, 0, 0])
    assert drives.say(0x600 + NODE, request) == []
    assert drives.say(0x600 + OTHER, request) != []
    drives.wait(0.1)
    assert drives.say(0x600 + NODE, request) != []
    assert drives.station.counts.lost > 0


def test_a_drive_that_comes_back_from_bus_off_says_so(master):
    drives = master("faults: [{fault: bus_off, joint: 1, at: 0.05, lasts: 0.1}]")
    enable(drives, NODE)
    said = drives.wait(0.3)
    assert (0x080 + NODE, struct.pack("<HB5x", 0x8140, 0x11)) in said
    assert drives.station.counts.faults == ["bus_off"]


def test_a_drive_fault_is_an_emergency_with_its_code(master):
    drives = master("faults: [{fault: drive_fault, joint: 1, at: 0.05, code: 0x3210}]")
    enable(drives, NODE)
    assert (0x080 + NODE, struct.pack("<HB5x", 0x3210, 1)) in drives.wait(0.2)
    drives.wait(1.0)
    assert drives.read(NODE, 0x603F) == 0x3210
    assert drives.read(NODE, 0x6041) & 0x4F == 0x08


def test_a_babbling_node_sends_at_its_rate(master):
    drives = master("faults: [{fault: babble, id: 0x7F1, rate: 1000, data: '0102', lasts: 0.5}]")
    enable(drives, NODE)
    drives.wait(1.0)
    babble = [frame for frame in drives.heard if frame == (0x7F1, b"\1\2")]
    assert len(babble) == pytest.approx(500, abs=25)
