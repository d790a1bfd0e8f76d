"""Datagrams of every kind at the driver's socket, and what it may answer to them.

The judge keeps a record of its own: it knows the limits of the arm and the datagrams, and shares no
code with the driver but the codec.
"""

import random
from dataclasses import dataclass, field

import numpy as np
from fri_messages import monitoring
from stepped_arm import SteppedArm, wake

from backends.fri.codec import messages as m
from backends.fri.codec.codec import encode_command, encode_monitoring
from backends.fri.codec.messages import Generation
from limo_driver.errors import LimoError
from limo_driver.types import PositionCommand, TorqueCommand

ACTIVE = m.SessionState.COMMANDING_ACTIVE
WILD = (0.0, -0.0, 1e-300, 1.0, -3.0, 9.0, 1e300, float("inf"), float("nan"))


@dataclass
class Judge:
    """Says whether the answers keep the limits, whatever was sent.

    `stint` counts the uninterrupted times of COMMANDING_ACTIVE, whatever packets are counted from:
    a new one starts from where the robot's application has the arm, without torque; or, after a
    packet or two that were wrong, where the one before was.
    """

    robot: object
    stint: int = 0
    answered: int = 0
    commands: int = 0
    seen: dict = field(default_factory=dict)  # by sequence: message and stint
    position: np.ndarray | None = None
    torque: np.ndarray = field(default_factory=lambda: np.zeros(7))
    within: int = -1  # stint of the last command

    def see(self, message):
        """Note what the driver received last."""
        if self.seen.get(message.header.sequence, (None,))[0] is message:
            return
        if message.connection.session_state is not ACTIVE:
            self.stint += 1
        if len(self.seen) > 16:
            self.seen.pop(next(iter(self.seen)))
        self.seen[message.header.sequence] = message, self.stint

    def hear(self, command):
        self.answered += 1
        message, stint = self.seen[command.header.reflected]
        state = message.connection.session_state
        assert state is not m.SessionState.IDLE, "an idle robot was answered"
        if state in {m.SessionState.MONITORING_WAIT, m.SessionState.MONITORING_READY}:
            return
        self.commands += 1
        data, limits, period = command.data, self.robot.spec.limits, self.robot.spec.period
        position = np.array(data.joint_position)
        assert np.isfinite(position).all()
        assert (position >= limits.position_min - 0.011).all()
        assert (position <= limits.position_max + 0.011).all()
        torque = np.zeros(7) if data.joint_torque is None else np.array(data.joint_torque)
        assert (np.abs(torque) <= limits.torque).all()
        same = stint == self.within
        steps = [np.abs(torque - self.torque)] + [np.abs(torque)] * (not same)
        most = limits.torque_rate * period * (1 + 1e-6)
        assert any((step <= most).all() for step in steps), steps
        if state is not ACTIVE:
            assert not torque.any()
            assert data.joint_position == message.ipo.joint_position
        elif same and self.position is not None:
            step = np.abs(position - self.position)
            assert (step <= limits.velocity * period * (1 + 1e-5)).all(), step
        self.position, self.torque, self.within = position, torque, stint


class Fuzzer:
    """Makes datagrams: valid ones, of all states, wild values, mutations, and plain noise."""

    def __init__(self, arm, seed):
        self.arm, self.random = arm, random.Random(seed)  # noqa: S311

    def throw(self):
        arm, rng = self.arm, self.random
        kind = rng.random()
        arm.sequence = (arm.sequence + rng.choice((1, 1, 1, 1, 1, 2, 5))) % 2**32
        arm.ns += 1_000_000 * rng.choice((1, 1, 1, 0, 2, 50))
        if rng.random() < 0.03:
            arm.state = rng.choice(list(m.SessionState))
        elif rng.random() < 0.1:
            arm.state = ACTIVE
        if rng.random() < 0.01:
            arm.sequence, arm.ns = rng.randrange(2**32), rng.randrange(4 * 10**18)
        if rng.random() < 0.02:
            arm.ipo = arm.ipo + rng.uniform(-0.3, 0.3)
        arm.quality = rng.choice(list(m.Quality))
        message = arm.message()
        if kind < 0.1:
            message = self.wild(message)
        data = encode_monitoring(message, arm.generation)
        if kind > 0.75:
            data = self.spoiled(data)
        arm.throw(data)

    def wild(self, message):
        rng = self.random
        joints = tuple(rng.choice(WILD) for _ in range(7))
        name = rng.choice(["measured_position", "measured_torque", "ipo", "all", "counts"])
        if name == "ipo":
            return message._replace(ipo=message.ipo._replace(joint_position=joints))
        if name == "counts":
            return message._replace(header=m.Header(rng.randrange(2**32), rng.randrange(2**32)))
        if name == "all":
            bare = rng.choice(["data", "ipo", "connection", "robot"])
            return message._replace(**{bare: None})
        return message._replace(data=message.data._replace(**{name: joints}))

    def spoiled(self, data):
        rng = self.random
        kind = rng.randrange(5)
        if kind == 0:
            return rng.randbytes(rng.randrange(1501))
        if kind == 1:
            return data[: rng.randrange(len(data))]
        if kind == 2:
            return encode_command(m.Command(m.Header(1, 1)), self.arm.generation)
        if kind == 3:
            other = rng.choice([g for g in Generation if g is not self.arm.generation])
            return encode_monitoring(monitoring(other), other)
        spoiled = bytearray(data)
        for _ in range(rng.randrange(1, 4)):
            # Not in the first bytes: a header or a state that differs is another valid message,
            # of which the judge would not know what may be answered.
            spoiled[rng.randrange(len(spoiled))] = rng.randrange(256)
        return bytes(spoiled)


def fuzz(count, seed=0, mode=m.CommandMode.POSITION, generation=Generation.TWO_SEVEN):
    """Throw `count` datagrams at a driver that is commanded all the time; return what happened.

    The framed generation is used: its checksum tells the judge which spoiled messages are none.
    """
    arm = SteppedArm(mode=mode, generation=generation)
    rng = random.Random(seed + 1)  # noqa: S311
    errors = {}
    with wake(arm) as robot:
        fuzzer, judge = Fuzzer(arm, seed), Judge(robot)
        for _ in range(count):
            fuzzer.throw()
            try:
                state = robot.receive(timeout=0.0)
                judge.see(robot.monitoring)
                if state.holding and rng.random() < 0.2:
                    robot.resume()
                wanted = state.position + rng.uniform(-0.05, 0.05)
                if mode is m.CommandMode.TORQUE:
                    robot.send(TorqueCommand(torque=np.full(7, rng.uniform(-500, 500))))
                else:
                    robot.send(PositionCommand(position=wanted))
            except LimoError as error:
                name = type(error).__name__
                errors[name] = errors.get(name, 0) + 1
            for command in arm.listen():
                judge.hear(command)
            arm.answers.clear()
        figures = robot.figures.as_json()
    arm.close()
    return {
        "answered": judge.answered,
        "commands": judge.commands,
        "errors": errors,
        "link": figures,
    }
