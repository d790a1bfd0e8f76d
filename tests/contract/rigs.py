"""Every backend with an arm behind it, a tap at its wire, and ways to disturb what it measures.

Wires are read by code of their own: protobuf's generated code for FRI, `struct` for CAN.
"""

import math
import re
import struct
from collections.abc import Callable
from contextlib import AbstractContextManager, contextmanager
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from arms import NODES, arm_config
from bus_master import DrivesBus
from faults import LOST_STEPS, Cia402Faults, DamiaoFaults, FriFaults
from robot_commands import START
from stepped_arm import SteppedArm, SteppedRobot, wake
from wire_rules import IMPEDANCE, POSITION, TORQUE, Applied, Quanta
from wire_tap import tapped

from backends.can import CanRobot
from backends.can.config import DamiaoJoint
from backends.fri.codec.messages import CommandMode, SessionState
from limo_driver.robot.registry import open_robot

ZERO = np.zeros(7)


class Rig:
    """A robot, what it is told at the wire, and what disturbs it."""

    kinds = (POSITION, IMPEDANCE, TORQUE)
    faults = ()  # that can be begun at its wire
    delayed = False  # what is heard is not of this cycle
    quanta = Quanta()
    gains = None  # stiffness and damping by which positions are kept, if all is done by one law

    def __init__(self, robot):
        self.robot = robot

    def told(self):
        """Return what was applied since the last call; None where nobody was commanded."""
        raise NotImplementedError

    def truth(self, state):
        """Return a state that was measured now as it would be if no reply had been false."""
        return state

    def lose(self, cycles):
        """Lose measurements."""
        self.robot.lose_measurements(cycles)

    def spoil(self, cycles, **values):
        """Make measurements have other values for some cycles, where the wire can say them."""

    def turn_clock(self, seconds):
        """Let the robot's clock jump."""

    def interrupt(self):
        """Let the robot take back the command for a moment."""

    def settle(self):
        """Put an arm that has run away where it can be commanded, if there is a way."""


class SimulatedRig(Rig):
    def __init__(self, robot):
        super().__init__(robot)
        self.applied, self.false, self.ahead = tapped(robot), [], 0.0
        cycle = robot._cycle_once

        def disturbed():
            state = cycle()
            values = self.false.pop() if self.false else {}
            state = replace(state, time=state.time + self.ahead)
            if "position" in values:
                values = values | {"position": state.position + values["position"]}
            return replace(state, **values) if values else state

        robot._cycle_once = disturbed

    def told(self):
        told, self.applied[:] = list(self.applied), []
        return told

    def spoil(self, cycles, **values):
        self.false = [values] * cycles

    def turn_clock(self, seconds):
        self.ahead += seconds


@contextmanager
def virtual():
    with open_robot("virtual", robot="iiwa14", initial_position=START) as robot:
        yield SimulatedRig(robot)


@contextmanager
def jerk():
    """The virtual arm with a limit of jerk on each joint, from lenient to strict."""
    text = Path("limo_driver/assets/iiwa14.urdf").read_text()
    limits = iter(np.geomspace(4000.0, 40.0, 7))
    text = re.sub("<limit ", lambda _: f'<limit jerk="{next(limits):.4g}" ', text)
    with TemporaryDirectory() as folder:
        stated = Path(folder) / "iiwa14.urdf"
        stated.write_text(text)
        with open_robot("virtual", robot=str(stated), initial_position=START) as robot:
            yield SimulatedRig(robot)


@contextmanager
def mujoco():
    options = {"simulation": "examples/iiwa14_hysteretic.yaml", "initial_position": START}
    with open_robot("mujoco", **options) as robot:
        yield SimulatedRig(robot)


class FriRig(FriFaults, Rig):
    def __init__(self, robot, schema):
        super().__init__(robot)
        self.arm, self.schema = robot.arm, schema
        torque = self.arm.mode is CommandMode.TORQUE
        self.mode = TORQUE if torque else POSITION
        self.kinds = (self.mode,)
        self.states = {}

    def told(self):
        self.arm.listen()
        heard, self.arm.socket.heard = self.arm.socket.heard, []
        return [item for data, lost in heard for item in self.decoded(data, lost)]

    def decoded(self, data, lost):
        message = self.schema.Command.FromString(data)
        said, reflected = message.data, message.header.reflected_sequence_counter
        if self.states.get(reflected) is not SessionState.COMMANDING_ACTIVE:
            return [None]
        position = np.array(said.joint_position.value)
        torque = np.array(said.joint_torque.value) if said.HasField("joint_torque") else ZERO
        steps = 1 + lost if lost < LOST_STEPS else 1
        return [Applied(self.mode, position, torque, ZERO, ZERO, steps=steps)]

    def truth(self, state):
        return replace(state, position=self.arm.position.copy(), velocity=self.arm.velocity.copy())

    def lose(self, cycles):
        self.arm.losing = cycles

    def spoil(self, cycles, **values):
        arm, plain, left = self.arm, SteppedArm.message, [cycles]

        def message(**changes):
            made = plain(arm, **changes)
            if not left[0]:
                del arm.message
                return made
            left[0] -= 1
            data = made.data
            if "position" in values:
                there = np.array(data.measured_position) + values["position"]
                data = data._replace(measured_position=tuple(there.tolist()))
            if "torque" in values:
                data = data._replace(measured_torque=tuple(values["torque"].tolist()))
            return made._replace(data=data)

        arm.message = message

    def turn_clock(self, seconds):
        self.arm.ns = max(self.arm.ns + int(seconds * 1e9), 10**9)

    def interrupt(self):
        # No robot is back within three packets of MONITORING.
        for state in [SessionState.MONITORING_READY] * 4 + [SessionState.COMMANDING_WAIT]:
            self.arm.state = state
            self.robot.receive()
            self.arm.ipo, self.arm.velocity = self.arm.position.copy(), np.zeros(7)
        self.arm.state = SessionState.COMMANDING_ACTIVE

    def settle(self):
        self.arm.position = np.array(START)
        self.interrupt()


class TappedRobot(SteppedRobot):
    rig = None

    def _take(self, message, *rest):
        if self.rig is not None and message.connection is not None:
            self.rig.states[message.header.sequence] = self.rig.arm.state
        return super()._take(message, *rest)


@contextmanager
def fri(schema, mode=CommandMode.POSITION):
    arm = SteppedArm(position=START, mode=mode)
    try:
        robot = wake(arm, factory=TappedRobot)
    except BaseException:
        arm.close()
        raise
    robot.arm = arm
    arm.sequence, arm.ns = -1, arm.ns - 1_000_000
    rig = FriRig(robot, schema)
    undo = rig.equip()
    try:
        with robot:
            robot.rig = rig
            yield rig
    finally:
        undo()


class CanRig(Rig):
    """Drives with one MuJoCo arm behind them, on a bus that has a time of its own."""

    def __init__(self, robot, bus, config):
        super().__init__(robot)
        self.bus, self.config, self.model = bus, config, config.model
        self.sign = np.array([joint.direction for joint in config.joints])
        self.offset = np.array([joint.offset for joint in config.joints])
        self.row, self.unheard, self.delivered = {}, 0, bus.deliver
        self.places = np.array(robot._link._position())  # as heard, without what was false [rad]
        self.heard, self.true = set(), np.array([self.places, np.zeros(7)])  # as it really is
        self.carried = self.gravity()
        bus.deliver = bus.station._port.send = self.deliver
        self.equip()

    def told(self):
        """Return what was applied; gravity was added where the arm was before."""
        sent, self.bus.sent[:] = list(self.bus.sent), []
        told = self.decoded(sent)
        self.carried = self.gravity()
        return told

    def truth(self, state):
        (position, velocity), stale = self.true.copy(), len(self.heard) < len(NODES)
        self.heard.clear()
        return replace(state, position=position, velocity=velocity, stale=stale)

    def lose(self, cycles):
        """Drives that are not heard for some cycles."""
        self.unheard = len(NODES) * cycles

    def deliver(self, frame_id, data, **kind):
        """Pass on what drives say, unless it is to be lost."""
        if self.measures(frame_id):
            j = self.joint(frame_id)
            port = self.bus.station.arm.joints[j]
            self.true[:, j] = port.measured_position, port.measured_velocity
            if self.unheard:
                self.unheard -= 1
                return
        frames = [(frame_id, data)]
        for change in self.filters:
            frames = [item for frame in frames for item in change(*frame)]
        if frames and self.measures(frame_id):
            self.heard.add(self.joint(frame_id))
            self.places[self.joint(frame_id)] = self.measured(frame_id, data)
        for frame in frames:
            self.delivered(*frame, **kind)

    def gravity(self):
        """Return what carries the arm where it was heard to be, without what was false."""
        return self.model.gravity_torque(self.places)[0]


class Cia402Rig(Cia402Faults, CanRig):
    kinds = (POSITION, TORQUE)
    quanta = Quanta(position=math.tau / 524288, torque=0.2)

    def measures(self, frame_id):
        return 0x180 < frame_id <= 0x1FF

    def joint(self, frame_id):
        return NODES.index(frame_id - 0x180)

    def measured(self, frame_id, data):
        """Return where a joint is [rad]."""
        j, count = self.joint(frame_id), struct.unpack("<Hih", data)[1]
        return self.sign[j] * count * math.tau / 524288 + self.offset[j]

    def decoded(self, sent):
        told = []
        for frame_id, data in sent:
            kind, node = frame_id & 0x780, frame_id & 0x7F
            if kind == 0x200:
                self.row[node, "word"], self.row[node, "position"], _ = struct.unpack("<Hih", data)
            elif kind == 0x300:
                self.row[node, "torque"], self.row["mode"] = struct.unpack("<hb", data)
            elif frame_id == 0x080:
                told.append(self.applied())
        return told

    def applied(self):
        counts = np.array([self.row[node, "position"] for node in NODES])
        position = self.sign * counts * math.tau / 524288 + self.offset
        stopped = np.array([self.row[node, "word"] != 0x0F for node in NODES])
        if self.row.get("mode", 8) != 10:
            return Applied(POSITION, position, ZERO, ZERO, ZERO, stopped=stopped)
        per_mille = np.array([self.row[node, "torque"] for node in NODES])
        carried = self.carried
        torque = self.sign * per_mille * 0.1 - carried
        return Applied(TORQUE, position, torque, ZERO, ZERO, carried=carried, stopped=stopped)


class DamiaoRig(DamiaoFaults, CanRig):
    def __init__(self, robot, bus, config):
        super().__init__(robot, bus, config)
        self.gains = robot._link.gains
        ranges = [motor.ranges for motor in robot._link._motors]
        self.quanta = Quanta(
            position=2 * max(item.position for item in ranges) / 65535,
            torque=2 * max(item.torque for item in ranges) / 4095,
            stiffness=500 / 4095,
            damping=5 / 4095,
            velocity=2 * max(item.velocity for item in ranges) / 4095,
        )

    def measures(self, frame_id):
        return 0x11 <= frame_id <= 0x17

    def joint(self, frame_id):
        return frame_id - 0x11

    def measured(self, frame_id, data):
        """Return where a joint is [rad]."""
        j = self.joint(frame_id)
        most = self.robot._link._motors[j].ranges.position
        place = int.from_bytes(data[1:3], "big") / 65535 * 2 * most - most
        return self.sign[j] * (place - self.offset[j])

    def decoded(self, sent):
        told = []
        for frame_id, data in sent:
            if not 1 <= frame_id <= 7 or data[:7] == b"\xff" * 7:
                continue
            word = int.from_bytes(data, "big")
            codes = (word >> 48, *(word >> k & 0xFFF for k in (36, 24, 12, 0)))
            self.row[frame_id] = codes
            if frame_id == 7:
                told.append(self.applied())
        return told

    def applied(self):
        codes = np.array([self.row[node] for node in range(1, 8)], dtype=float).T
        most = [motor.ranges for motor in self.robot._link._motors]
        p, v, t = np.array([(each.position, each.velocity, each.torque) for each in most]).T
        position = self.sign * (codes[0] / 65535 * 2 * p - p - self.offset)
        velocity = self.sign * (codes[1] / 4095 * 2 * v - v)
        torque = self.sign * (codes[4] / 4095 * 2 * t - t) - self.carried
        stiffness, damping = codes[2] / 4095 * 500, codes[3] / 4095 * 5
        return Applied(IMPEDANCE, position, torque, stiffness, damping, velocity, self.carried)


@contextmanager
def cia402():
    config = arm_config(rate=250.0, watchdog=0.1, hold_after=50, temperature=None)
    bus = DrivesBus(config, START)
    with CanRobot(config, bus=bus, clock=bus.now) as robot:
        robot.receive()  # which enables the drives
        bus.sent.clear()
        yield Cia402Rig(robot, bus, config)


@contextmanager
def damiao():
    joints = tuple(
        DamiaoJoint(node=k, stiffness=200.0, damping=4.0, direction=-1 if k % 2 else 1)
        for k in range(1, 8)
    )
    config = arm_config(
        rate=400.0, watchdog=0.1, hold_after=50, temperature=None, joints=joints,
        convention="damiao",
    )  # fmt: skip
    bus = DrivesBus(config, START)
    with CanRobot(config, bus=bus, clock=bus.now) as robot:
        robot.receive()
        bus.sent.clear()
        yield DamiaoRig(robot, bus, config)


def every(schema: Any) -> dict[str, Callable[[], AbstractContextManager[Rig]]]:
    """Return what opens each backend, by its name.

    Args:
        schema: Of FRI messages, as `compile_schema` makes it.
    """
    return {
        "virtual": virtual,
        "jerk": jerk,
        "mujoco": mujoco,
        "fri": lambda: fri(schema),
        "fri-torque": lambda: fri(schema, CommandMode.TORQUE),
        "cia402": cia402,
        "damiao": damiao,
    }
