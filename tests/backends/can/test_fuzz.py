"""Random frames: nothing crashes, and nothing goes out that the contract forbids."""

import struct
from contextlib import suppress
from dataclasses import replace

import numpy as np
import pytest
from arms import NODES, START, arm_config, counts_at
from canopen_drives import CanopenArm
from lanes import sampled
from sync_bus import SyncBus

from backends.can import CanRobot
from limo_driver.errors import BackendError
from limo_driver.types import PositionCommand, TorqueCommand

CYCLES = 1500
TALK = [base + node for base in (0x80, 0x180, 0x280, 0x380, 0x580, 0x700) for node in NODES]
SENT = {0x000, 0x080, 0x77F} | {base + node for base in (0x200, 0x300, 0x600) for node in NODES}
WORDS = {0x00, 0x02, 0x06, 0x07, 0x0F, 0x80}


def random_frame(random, drives):
    """A frame that drives may send, or anything else; often one that looks good."""
    kind = random.integers(4)
    if kind == 0:
        return int(random.integers(0x800)), random.bytes(int(random.integers(9)))
    frame_id = int(random.choice(TALK))
    if kind == 1:
        return frame_id, random.bytes(int(random.choice([1, 2, 7, 8])))
    j = int(random.integers(len(drives)))
    status = int(random.choice([0x27, 0x27, 0x27, 0x08, 0x40, 0x07]))
    near = drives[j].count + int(random.normal(0, 2000))
    return 0x180 + NODES[j], struct.pack("<Hih", status, near, int(random.integers(-999, 999)))


@sampled("density", [0.2, 0.02, 5.0], "1500 cycles each")  # frames in each cycle
def test_running(density):
    random = np.random.default_rng(round(100 * density))
    bus, config = SyncBus(), arm_config(hold_after=2)
    holds = moved = fresh = 0
    with CanopenArm(bus, NODES, counts_at(config, START)) as arm:
        with CanRobot(config, bus=bus, clock=bus.now) as robot:
            state = robot.receive()
            base, since, before = state.position, 0, None
            for cycle in range(CYCLES):
                for _ in range(random.poisson(density) if cycle % 100 > 20 else 0):
                    bus.deliver(*random_frame(random, arm.drives))
                try:
                    robot.send(command_of(base, cycle - since))
                except BackendError:
                    holds += 1
                    if cycle % 100 == 0:  # told to go on, in a quiet moment
                        bus.queue.clear()
                        with suppress(BackendError):
                            robot.reset_faults()
                            robot.resume()
                            base, since = robot.receive().position, cycle + 1
                        fresh = 2  # set-points begin anew, at the measured pose
                bus.sent.clear()
                state = robot.receive()
                assert np.isfinite(state.position).all()
                targets = check_frames(bus.sent, arm)
                if any(frame_id - 0x300 in NODES for frame_id, _ in bus.sent):
                    fresh = 2  # positions are not followed, or are so again from where it stands
                if before is not None and not fresh:
                    moved += check_steps(config, before, targets)
                before, fresh = targets, max(fresh - 1, 0)
        assert {drive.state for drive in arm.drives} <= {0x40, 0x08}
    assert holds  # it was rough enough
    assert moved > 200  # and did move


def command_of(base, cycle):
    """A motion that starts at rest, with torques in the end."""
    if cycle > 80:
        return TorqueCommand(torque=np.zeros(7))
    return PositionCommand(position=base + 0.1 * (1 - np.cos(0.05 * cycle)))


def check_frames(sent, arm):
    """One set of set-points a cycle, of known kinds; returns target counts by node."""
    targets = {}
    for frame_id, data in sent:
        assert frame_id in SENT
        if frame_id - 0x200 in NODES:
            word, count, offset = struct.unpack("<Hih", data)
            assert word in WORDS
            assert offset == 0
            assert frame_id not in targets
            targets[frame_id] = (word, count)
    assert len(targets) == len(arm.drives)
    return targets


def check_steps(config, before, after):
    """No enabled joint is told to move faster than it may; returns how many are told to move."""
    limits = config.model.limits.velocity
    moved = 0
    for j, joint in enumerate(config.joints):
        (old_word, old), (word, count) = before[0x200 + joint.node], after[0x200 + joint.node]
        if old_word == word == 0x0F:
            most = limits[j] * abs(joint.counts_per_radian) / config.rate
            assert abs(count - old) <= most + 1
            moved += count != old
    return moved


@pytest.mark.parametrize("seed", range(12))
def test_opening(seed):
    random = np.random.default_rng(seed)
    bus, config = SyncBus(), arm_config(answer_timeout=0.05)

    with CanopenArm(bus, NODES, counts_at(config, START)) as arm:

        def noise():
            if random.random() < 0.2:
                bus.deliver(*random_frame(random, arm.drives))

        bus.noise = noise
        with (
            suppress(BackendError),  # it may well fail, but not crash
            CanRobot(replace(config, hold_after=2), bus=bus, clock=bus.now) as robot,
        ):
            robot.receive()
        assert {frame_id for frame_id, _ in bus.sent} <= SENT | set(range(0x601, 0x680))
