"""arm.yaml: what is read, and what is refused at which line."""

import re
from pathlib import Path

import numpy as np
import pytest

from backends.can.config import ArmConfig, Bus, Cia402Joint, DamiaoJoint
from limo_driver.errors import ConfigError

EXAMPLES = Path(__file__).parents[3] / "examples"
JOINTS = "\n".join(
    f"  - {{node: {11 + j}, counts_per_turn: 524288, rated_torque: 100}}" for j in range(7)
)
HEAD = "bus: {interface: virtual, channel: here}\nrobot: iiwa14\n"


def read(tmp_path, text):
    path = tmp_path / "arm.yaml"
    path.write_text(text)
    return ArmConfig.load(path)


@pytest.mark.parametrize(
    ("name", "kind"), [("can_cia402.yaml", Cia402Joint), ("can_damiao.yaml", DamiaoJoint)]
)
def test_examples_are_read(name, kind):
    arm = ArmConfig.load(EXAMPLES / name)
    assert arm.rate == 250
    assert arm.bus.options["hop_limit"] == 0
    assert {type(joint) for joint in arm.joints} == {kind}
    assert arm.model.n == 7


def test_what_is_left_out_has_its_default(tmp_path):
    arm = read(tmp_path, HEAD + "joints:\n" + JOINTS)
    assert arm.convention == "cia402"
    assert arm.rate == 250
    assert arm.joints[0].direction == 1
    assert arm.temperature is None


def test_hexadecimal_and_exponents_are_read(tmp_path):
    text = HEAD + "watchdog: 1e-1\nmaster: 0x7E\ntemperature: {object: 0x2031}\njoints:\n" + JOINTS
    arm = read(tmp_path, text)
    assert (arm.watchdog, arm.master) == (0.1, 0x7E)
    assert arm.temperature is not None
    assert arm.temperature.object == 0x2031


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("robot: iiwa14", "robot: panda9", "neither built in"),
        ("robot: iiwa14", "robots: iiwa14", "line 2: has no 'robots'"),
        ("robot: iiwa14\n", "", "lacks robot"),
        (
            "here}",
            "here, options: {a: 2026-13-45}}",
            "line 1: bus: options: a is '2026-13-45'",
        ),
        ("here}", "here, options: {a: !x y}}", "line 1: bus: options: a is 'y', expected a text"),
        ("node: 13", "node: 12", "joints 2 and 3 have the same node 12"),
        ("node: 13", "node: 127", "master is 127"),
        (
            "node: 13",
            "node: 128",
            "line 6: joints: number 3: node is 128, expected a whole number from 1 to 127",
        ),
        ("node: 13", "node: 1.5", "line 6: .* node is '1.5', expected a whole number"),
        ("node: 13", "nod: 13", "line 6: joints: number 3: has no 'nod'"),
        ("node: 13, ", "", "line 6: joints: number 3: lacks node"),
        ("node: 13", "node: 13, direction: 2", "direction is 2, expected one of 1, -1"),
        ("node: 13", "node: 13, offset: .nan", "offset is '.nan', expected a number"),
        ("node: 13", "node: 13, offset: nan", "offset is nan rad, expected a number"),
        ("node: 13", "node: 13, gear: 1e5", "joint 3: .* rad from its zero are .* counts"),
        (
            "rated_torque: 100",
            "rated_torque: 0",
            "rated_torque is 0 N m, expected a number above 0",
        ),
        ("robot", "rate: 0\nrobot", "line 2: rate is 0 Hz, expected a number from 1 to 4000 Hz"),
        (
            "robot",
            "convention: ethercat\nrobot",
            "line 2: convention is 'ethercat', expected one of cia402, damiao",
        ),
        ("robot", "on_lost: fly\nrobot", "line 2: on_lost is 'fly', expected one of quick_stop"),
        ("robot", "watchdog: 0.004\nrobot", "line 2: watchdog is 0.004 s, expected at least two"),
        (
            "channel: here",
            "channel: here, fd: yes",
            "line 1: bus: fd is 'yes', expected true or false",
        ),
        (
            "channel: here",
            "channel: here, bitrate: 2e6",
            "bitrate is 2000000 bit/s, expected a whole number from 10000",
        ),
        ("channel: here", "canal: here", "line 1: bus: has no 'canal'"),
        (
            "channel: here",
            "channel: here, fd: true, data_bitrate: 500000",
            "expected at least the bitrate",
        ),
        (
            "  - {node: 17, counts_per_turn: 524288, rated_torque: 100}",
            "",
            "has 6 entries, but iiwa14 has 7",
        ),
    ],
)
def test_mistakes_are_named_with_their_line(tmp_path, old, new, message):
    text = HEAD + "joints:\n" + JOINTS
    assert old in text
    with pytest.raises(ConfigError, match=message) as caught:
        read(tmp_path, text.replace(old, new))
    assert "arm.yaml" in str(caught.value)


@pytest.mark.parametrize("text", ["", "[1, 2]", "joints: 3", "a: [", "bus: 1\nrobot: 2\njoints: 3"])
def test_no_arm_at_all(tmp_path, text):
    with pytest.raises(ConfigError):
        read(tmp_path, text)


@pytest.mark.parametrize("value", ["1000000", 1e6, True])
def test_a_value_of_another_type_is_named(value):
    with pytest.raises(ConfigError, match=r"bitrate is .*, expected a whole number"):
        Bus(interface="virtual", channel="here", bitrate=value)


@pytest.mark.parametrize("entry", ["on_lost: quick_stop", "temperature: {object: 0x2031}"])
def test_what_a_convention_does_not_have_is_refused(tmp_path, entry):
    text = (EXAMPLES / "can_damiao.yaml").read_text() + entry
    with pytest.raises(ConfigError, match=r"line \d+: \w+: is for CiA 402 drives; damiao motors"):
        read(tmp_path, text)


@pytest.mark.parametrize("what", ["effort", "velocity"])
def test_an_arm_that_states_no_limit_is_not_run(tmp_path, two_links_urdf, what):
    """A motor would be told no torque, that of gravity included, and the arm would fall."""
    text = re.sub(f'{what}="[^"]*"', f'{what}="0"', Path(two_links_urdf).read_text())
    (tmp_path / "arm.urdf").write_text(text)
    head = "bus: {interface: virtual, channel: here}\nrobot: arm.urdf\nconvention: damiao\n"
    arm = read(tmp_path, f"{head}joints:\n  - {{node: 1}}\n  - {{node: 2}}\n")
    quantity = {"effort": "torque", "velocity": "velocity"}[what]
    with pytest.raises(ConfigError, match=rf"joint 1 \(\w+\) has no limit of {quantity}"):
        arm.spec(np.ones(2))
