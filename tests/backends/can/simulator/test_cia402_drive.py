"""A simulated CiA 402 drive: its state machine, its watchdogs, its limits; time is the test's."""

import struct

import pytest
from bus_master import enable, words

from backends.can.simulator.drive import StatuswordState, commanded

NODE, OTHER = 11, 12
COUNTS = 65536 * 160 / 6.283185307179586  # per rad, of node 11


@pytest.mark.parametrize(
    ("state", "controlword", "expected"),
    [
        ("SWITCH_ON_DISABLED", 0x06, "READY"),
        ("SWITCH_ON_DISABLED", 0x07, "SWITCH_ON_DISABLED"),
        ("SWITCH_ON_DISABLED", 0x0F, "SWITCH_ON_DISABLED"),
        ("READY", 0x07, "SWITCHED_ON"),
        ("READY", 0x0F, "ENABLED"),
        ("READY", 0x00, "SWITCH_ON_DISABLED"),
        ("READY", 0x02, "SWITCH_ON_DISABLED"),
        ("SWITCHED_ON", 0x0F, "ENABLED"),
        ("SWITCHED_ON", 0x06, "READY"),
        ("ENABLED", 0x07, "SWITCHED_ON"),
        ("ENABLED", 0x06, "READY"),
        ("ENABLED", 0x02, "QUICK_STOP"),
        ("ENABLED", 0x00, "SWITCH_ON_DISABLED"),
        ("QUICK_STOP", 0x00, "SWITCH_ON_DISABLED"),
        ("FAULT", 0x0F, "FAULT"),
        ("FAULT", 0x80, "SWITCH_ON_DISABLED"),
        ("FAULT_REACTION", 0x80, "FAULT_REACTION"),
    ],
)
def test_a_controlword_does_what_the_standard_says(state, controlword, expected):
    assert commanded(StatuswordState[state], controlword, 0) is StatuswordState[expected]


def test_a_fault_is_reset_by_a_rising_bit_alone():
    assert commanded(StatuswordState.FAULT, 0x80, 0x80) is StatuswordState.FAULT


def test_booting_says_so_and_enables_nothing(master):
    drives = master()
    assert drives.heard == [(0x700 + NODE, b"\0"), (0x700 + OTHER, b"\0")]
    assert drives.read(NODE, 0x6041) & 0x6F == 0x40


def test_a_drive_takes_its_own_position_as_target_when_it_is_enabled(master):
    drives = master(position=[0.4, -0.3])
    drives.write(NODE, 0x607A, 0, struct.pack("<i", 12345))
    enable(drives, NODE)
    target = drives.read(NODE, 0x607A, signed=True)
    assert target == pytest.approx(0.4 * COUNTS, abs=COUNTS * 1e-3)


def test_signs_and_offsets_are_those_of_the_joint(master):
    drives = master(position=[0.4, -0.3])
    count = drives.read(OTHER, 0x6064, signed=True)
    assert count == pytest.approx(-(-0.3 - 0.1) * 65536 * 100 / 6.283185, rel=1e-4)


def test_set_points_count_at_sync_and_only_while_operational(master):
    drives = master()
    enable(drives, NODE)
    where = drives.read(NODE, 0x6064, signed=True)
    target = struct.pack("<Hih", 0x0F, where + 100, 0)
    drives.say(0x200 + NODE, target)
    assert drives.read(NODE, 0x607A, signed=True) != where + 100
    drives.cycle()
    assert drives.read(NODE, 0x607A, signed=True) == where + 100
    drives.say(0x000, bytes([0x80, NODE]))  # pre-operational: not a set-point any more
    drives.say(0x200 + NODE, struct.pack("<Hih", 0x0F, where + 200, 0))
    drives.cycle()
    assert drives.read(NODE, 0x607A, signed=True) == where + 100


def test_a_target_too_far_away_is_a_fault(master):
    drives = master()
    enable(drives, NODE)
    where = drives.read(NODE, 0x6064, signed=True)
    drives.say(0x200 + NODE, struct.pack("<Hih", 0x0F, where + int(0.5 * COUNTS), 0))
    said = [frame for _ in range(3) for frame in drives.cycle()]
    assert (0x080 + NODE, struct.pack("<HB5x", 0x8611, 1)) in said
    drives.wait(0.1)
    assert drives.read(NODE, 0x6041) & 0x4F == 0x08
    moved = drives.read(NODE, 0x6064, signed=True) - where
    assert abs(moved) < 1e-3 * COUNTS


def test_a_target_beyond_the_software_limits_is_cut_to_them(master):
    drives = master()
    where = drives.read(NODE, 0x6064, signed=True)
    drives.write(NODE, 0x607D, 1, struct.pack("<i", where - 1000))
    drives.write(NODE, 0x607D, 2, struct.pack("<i", where + 1000))
    enable(drives, NODE)
    for _ in range(100):
        drives.say(0x200 + NODE, struct.pack("<Hih", 0x0F, where + 5000, 0))
        drives.cycle()
    assert abs(drives.read(NODE, 0x6064, signed=True) - where) < 2000
    assert drives.read(NODE, 0x6041) & 1 << 11  # a limit is active


def test_a_short_pdo_is_an_emergency_and_no_set_point(master):
    drives = master()
    enable(drives, NODE)
    assert drives.say(0x200 + NODE, b"\x0f\0") == [
        (0x080 + NODE, struct.pack("<HB5x", 0x8210, 0x11))
    ]


@pytest.mark.parametrize(
    ("option", "mask", "state"),
    [
        (0, 0x6F, 0x27),  # nothing: goes on
        (1, 0x4F, 0x08),  # fault
        (2, 0x4F, 0x40),  # no voltage: the brake closes
        (3, 0x6F, 0x07),  # quick stop
    ],
)
def test_set_points_that_cease_lead_to_the_reaction_that_was_chosen(master, option, mask, state):
    drives = master()
    drives.write(NODE, 0x6007, 0, struct.pack("<h", option))
    drives.write(NODE, 0x605A, 0, struct.pack("<h", 6))  # stays in quick stop
    drives.write(NODE, 0x1400, 5, struct.pack("<H", 50))  # [ms]
    enable(drives, NODE)
    assert (0x080 + NODE, struct.pack("<HB5x", 0x8250, 0x11)) not in drives.wait(0.04)
    assert (0x080 + NODE, struct.pack("<HB5x", 0x8250, 0x11)) in drives.wait(0.2)
    assert drives.read(NODE, 0x6041) & mask == state


def test_a_synchronous_set_point_without_its_sync_keeps_no_deadline(master):
    drives = master()
    drives.write(NODE, 0x1400, 5, struct.pack("<H", 50))
    where = enable(drives, NODE)
    for _ in range(20):  # set-points come, SYNC does not
        drives.say(0x200 + NODE, struct.pack("<Hih", 0x0F, where, 0))
        drives.wait(0.01)
    assert drives.read(NODE, 0x603F) == 0x8250


def test_a_moving_joint_slows_down_when_its_master_is_gone(master):
    drives = master()
    drives.write(NODE, 0x6007, 0, struct.pack("<h", 1))
    drives.write(NODE, 0x1400, 5, struct.pack("<H", 20))
    where = enable(drives, NODE)
    velocity = 0.5  # [rad/s]
    for k in range(100):
        target = where + round(0.004 * k * velocity * COUNTS)
        drives.say(0x200 + NODE, struct.pack("<Hih", 0x0F, target, 0))
        drives.cycle()
    gone = drives.read(NODE, 0x6064, signed=True)
    drives.wait(1.0)
    rest = drives.read(NODE, 0x6064, signed=True)
    way = (rest - gone) / COUNTS
    assert 0.05 < way < 0.075  # the ramp of 2 rad/s² takes 0.0625 rad
    drives.wait(0.5)
    assert abs(drives.read(NODE, 0x6064, signed=True) - rest) < 1e-4 * COUNTS
    assert drives.read(NODE, 0x6041) & 0x4F == 0x08


def test_a_set_point_that_is_lost_is_bridged(master):
    drives = master()
    where = enable(drives, NODE)
    torques = []
    for lost in (None, 60):
        for k in range(100):
            target = where + round(0.004 * k * 0.1 * COUNTS)
            if k != lost:
                drives.say(0x200 + NODE, struct.pack("<Hih", 0x0F, target, 0))
            drives.cycle()
            if 50 < k < 80:
                torques.append(drives.station.arm.joints[0].measured_torque)
        for k in range(99, 0, -1):
            target = where + round(0.004 * k * 0.1 * COUNTS)
            drives.say(0x200 + NODE, struct.pack("<Hih", 0x0F, target, 0))
            drives.cycle()
    whole, bridged = torques[: len(torques) // 2], torques[len(torques) // 2 :]
    assert max(abs(a - b) for a, b in zip(whole, bridged, strict=True)) < 2.0  # [N m]


def test_stopping_a_node_is_no_error_but_stops_its_joint(master):
    drives = master()
    drives.write(NODE, 0x6007, 0, struct.pack("<h", 3))
    enable(drives, NODE)
    assert drives.say(0x000, bytes([0x80, NODE])) == []
    drives.wait(0.1)
    assert drives.read(NODE, 0x6041) & 0x6F != 0x27
    assert drives.read(NODE, 0x1001) == 0


def test_the_torque_comes_in_steps_of_a_thousandth_of_the_rating(master):
    drives = master(position=[0.4, -0.3])
    drives.wait(0.2)
    port = drives.station.arm.joints[0]
    assert drives.read(NODE, 0x6077, signed=True) == round(port.measured_torque / 0.05)


def test_errors_are_remembered_newest_first(master):
    drives = master()
    for code in (0x4310, 0x3210):
        drives.station.drives[0].fail(code)
        drives.write(NODE, 0x6040, 0, b"\x80\0")
        drives.write(NODE, 0x6040, 0, b"\0\0")
    assert words(drives, NODE, 0x1003, 3) == [2, 0x3210, 0x4310]
