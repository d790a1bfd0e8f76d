"""Torques of CiA 402 drives as they stand on the bus, decoded by hand."""

import struct
from dataclasses import replace

import numpy as np
import pytest
from arms import NODES, START, arm_config, counts_at
from canopen_drives import CanopenArm
from sync_bus import SyncBus

from backends.can import CanRobot
from limo_driver.types import PositionCommand, TorqueCommand

QUANTUM = 0.1  # [N m] of one per mille of these drives


@pytest.fixture
def config():
    return arm_config(rate=250.0, hold_after=1000, watchdog=0.1, temperature=None)


@pytest.fixture
def bus():
    return SyncBus()


@pytest.fixture
def robot(bus, config):
    with (
        CanopenArm(bus, NODES, counts_at(config, START)),
        CanRobot(config, bus=bus, clock=bus.now) as opened,
    ):
        yield opened


def torques(bus):
    """Return what each joint's drive was told in each cycle of torque mode, (T, 7) [N m]."""
    rows, row = [], {}
    for frame_id, data in bus.sent:
        if frame_id == 0x080:
            if len(row) == 7:
                rows.append([row[node] for node in NODES])
            row = {}
        elif 0x300 < frame_id <= 0x37F:
            per_mille, mode = struct.unpack("<hb", data)
            joint = NODES.index(frame_id - 0x300)
            if mode == 10:
                row[NODES[joint]] = per_mille * QUANTUM * (-1 if joint % 2 else 1)
    return np.array(rows)


def push(robot, wanted, cycles=40):
    state = robot.receive()
    for _ in range(cycles):
        sent = robot.send(TorqueCommand(torque=wanted))
        state = robot.receive()
    return state, sent


@pytest.mark.parametrize("how", ["position", "hold"])
def test_never_step_whatever_is_asked_for_in_between(bus, robot, how):
    state, _ = push(robot, np.array([192.0, 0, 0, 0, 0, 0, 0]))
    if how == "hold":
        robot.hold()
        robot.resume()
    else:
        robot.send(PositionCommand(position=state.position))
    robot.send(TorqueCommand(torque=np.zeros(7)))
    robot.receive()
    steps = np.abs(np.diff(torques(bus), axis=0))
    assert len(steps) == 40
    allowed = robot.spec.limits.torque_rate * robot.spec.period
    assert (steps <= allowed + QUANTUM).all()


@pytest.mark.parametrize("sign", [-1.0, 1.0])
def test_are_what_send_said_with_gravity_on_top(bus, robot, config, sign):
    """Also where both together are more than the drive can do: then less is sent, and said."""
    gravity = config.model.gravity_torque(START)[0]
    assert np.abs(gravity).max() > 20.0
    limits = robot.spec.limits
    for _ in range(60):
        _, sent = push(robot, sign * 2 * limits.torque, cycles=1)
        told = torques(bus)[-1]
        assert told == pytest.approx(sent.torque + gravity, abs=QUANTUM)
        assert (np.abs(told) <= limits.torque + QUANTUM).all()
    assert "torque" in sent.limited_by
    assert told == pytest.approx(sign * limits.torque, abs=QUANTUM)


def test_no_command_is_more_than_the_frames_can_say(bus):
    config = arm_config(rate=250.0, hold_after=1000, watchdog=0.1, temperature=None)
    joints = tuple(replace(joint, rated_torque=1.0) for joint in config.joints)
    config = replace(config, joints=joints)
    with CanopenArm(bus, NODES, counts_at(config, START)) as arm:
        for drive in arm.drives:
            drive.node.object_dictionary[0x6076].default = 1_000  # of 1 N m: 32.767 N m in a frame
        with CanRobot(config, bus=bus, clock=bus.now) as robot:
            assert robot.spec.limits.torque.max() == pytest.approx(32.767)
