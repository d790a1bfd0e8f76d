"""Scales of set-points and bounds of entries of an arm on a CAN bus, held from both sides."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from arms import arm_config

from backends.can.cia402.codec import TARGETS, TORQUE, Codec, OperatingMode
from backends.can.config import Bus, Cia402Joint, DamiaoJoint, Temperature
from backends.can.damiao.codec import MitCommand, Ranges, decode_command, encode_command
from limo_driver.errors import ConfigError

each_way = pytest.mark.parametrize("sign", [-1, 1])


class TestScaling:
    JOINTS = (
        Cia402Joint(node=1, counts_per_turn=1000.0, gear=10.0, rated_torque=50.0, direction=-1,
                    offset=0.5, torque_ratio=2.0),
        Cia402Joint(node=2, counts_per_turn=2.0**32, gear=1.0, rated_torque=0.001),
    )  # fmt: skip
    CODEC = Codec(JOINTS, [25_000, 1])

    def test_counts(self):
        turn = -10_000 / math.tau
        (data, _) = self.CODEC.targets(np.array([1.5, 0.0]), [0x0F, 0x06])
        assert TARGETS.unpack(data) == (0x0F, round(turn), 0)
        assert self.CODEC.positions([round(turn), 0])[0] == pytest.approx(1.5, abs=1e-3)
        assert self.CODEC.velocities([round(turn), 0])[0] == pytest.approx(1.0, abs=1e-3)

    @each_way
    def test_counts_are_cut_to_32_bits(self, sign):
        for share, most in ((0.4999, 0.4999 * 2**32), (0.51, 2**31 - 1)):
            (_, data) = self.CODEC.targets(np.array([0.0, sign * share * math.tau]), [15, 15])
            assert TARGETS.unpack(data)[1] == pytest.approx(sign * most, abs=1)

    @each_way
    def test_torques_are_cut_to_16_bits(self, sign):
        for torque, per_mille in ((0.032, 32_000), (0.0327668, 32767), (0.04, 32767)):
            (_, data) = self.CODEC.torques(np.array([0.0, sign * torque]), OperatingMode.TORQUE)
            assert TORQUE.unpack(data) == (sign * per_mille, OperatingMode.TORQUE)

    def test_torque_is_a_thousandth_of_the_rating(self):
        """Object 6076 is 25 N m at the motor, which are 50 at the joint."""
        assert self.CODEC.torque_resolution == pytest.approx([0.05, 1e-6], rel=1e-12)
        (data, _) = self.CODEC.torques(np.array([10.0, 0.0]), OperatingMode.TORQUE)
        assert TORQUE.unpack(data)[0] == -200
        assert self.CODEC.measured_torques([-200, 0])[0] == pytest.approx(10.0)

    @each_way
    @pytest.mark.parametrize(
        ("name", "most", "step"),
        [
            ("position", 12.5, 25 / 65535),
            ("velocity", 30.0, 60 / 4095),
            ("torque", 10.0, 20 / 4095),
        ],
    )
    def test_values_of_damiao_motors_are_cut_to_their_ranges(self, name, most, step, sign):
        rest = MitCommand(0.0, 0.0, 0.0, 0.0, 0.0)
        for given, taken in ((0.96 * most, 0.96 * most), (most, most), (1.04 * most, most)):
            data = encode_command(replace(rest, **{name: sign * given}), Ranges(12.5, 30.0, 10.0))
            found = getattr(decode_command(data, Ranges(12.5, 30.0, 10.0)), name)
            assert found == pytest.approx(sign * taken, abs=0.51 * step)

    @pytest.mark.parametrize(("name", "most"), [("stiffness", 500.0), ("damping", 5.0)])
    def test_gains_of_damiao_motors_are_cut_to_500_and_5(self, name, most):
        rest, ranges = MitCommand(0.0, 0.0, 0.0, 0.0, 0.0), Ranges(12.5, 30.0, 10.0)
        for given, code in ((-1.0, 0), (0.96 * most, 3931), (most, 4095), (1.04 * most, 4095)):
            data = encode_command(replace(rest, **{name: given}), ranges)
            word = int.from_bytes(data, "big")
            assert word >> (24 if name == "stiffness" else 12) & 0xFFF == code


JOINT = {"node": 11, "counts_per_turn": 4096, "rated_torque": 10.0}
MOTOR = {"node": 1}
BUS = {"interface": "virtual", "channel": "none"}


@pytest.mark.parametrize(
    ("kind", "given", "name", "fine", "refused"),
    [
        (Bus, BUS, "bitrate", (10_000, 1_000_000), (9_999, 1_000_001)),
        (Bus, BUS, "data_bitrate", (10_000, 8_000_000), (9_999, 8_000_001)),
        (Cia402Joint, JOINT, "node", (1, 127), (0, 128)),
        (Cia402Joint, JOINT, "counts_per_turn", (1e-9, 2.0**32), (0.0, 1.0001 * 2.0**32)),
        (Cia402Joint, JOINT, "gear", (1e-9, 1e5), (0.0, 1.0001e5)),
        (Cia402Joint, JOINT, "rated_torque", (1e-9, 1e5), (0.0, 1.0001e5)),
        (Cia402Joint, JOINT, "torque_ratio", (1e-9, 1e5), (0.0, 1.0001e5)),
        (Cia402Joint, JOINT, "offset", (-1e3, 1e3), (-1000.1, 1000.1)),
        (Cia402Joint, JOINT, "serial", (0, 2**32 - 1), (-1, 2**32)),
        (Cia402Joint, JOINT, "vendor", (0, 2**32 - 1), (-1, 2**32)),
        (Cia402Joint, JOINT, "direction", (-1, 1), (0, 2)),
        (DamiaoJoint, MOTOR, "node", (1, 127), (0, 128)),
        (DamiaoJoint, MOTOR, "reply", (0, 0x7FE), (-1, 0x7FF)),
        (DamiaoJoint, MOTOR, "offset", (-1e3, 1e3), (-1000.1, 1000.1)),
        (DamiaoJoint, MOTOR, "stiffness", (0.0, 500.0), (-1e-9, 500.1)),
        (DamiaoJoint, MOTOR, "damping", (0.0, 5.0), (-1e-9, 5.01)),
        (Temperature, {}, "object", (0x2000, 0x9FFF), (0x1FFF, 0xA000)),
        (Temperature, {"object": 0x2000}, "subindex", (0, 254), (-1, 255)),
        (Temperature, {"object": 0x2000}, "step", (1e-9, 100.0), (0.0, 100.1)),
    ],
)
def test_entries_of_an_arm_have_bounds(kind, given, name, fine, refused):
    for value in fine:
        assert getattr(kind(**given | {name: value}), name) == value
    for value in refused:
        with pytest.raises(ConfigError, match=f"{name} is "):
            kind(**given | {name: value})


@pytest.mark.parametrize(
    ("name", "fine", "refused"),
    [
        ("rate", (2.0, 4000.0), (0.99, 4000.1)), ("master", (1, 127), (0, 128)),
        ("watchdog", (0.02, 5.0), (0.0019, 0.0199, 5.1)), ("hold_after", (1, 1000), (0, 1001)),
        ("status_every", (1, 240), (0, 241)), ("answer_timeout", (0.01, 60.0), (0.009, 60.1)),
    ],
)  # fmt: skip
def test_entries_of_its_cycles_have_bounds(name, fine, refused):
    """At a rate of 100 Hz, the watchdog waits for two cycles at least."""
    for value in fine:
        arm_config(**{name: value})
    for value in refused:
        with pytest.raises(ConfigError, match=name):
            arm_config(**{name: value})
