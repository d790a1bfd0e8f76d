"""An arm behind FRI that moves or pushes, and who judges what it receives by the limits alone."""

import time
from types import SimpleNamespace

import numpy as np
from fri_messages import POSE
from robot_commands import position

from backends.fri import replies
from backends.fri import robot as fri_robot
from backends.fri.codec.messages import SessionState
from limo_driver.types import TorqueCommand

ACTIVE = SessionState.COMMANDING_ACTIVE
ROUNDING = 1e-5  # relative
GOAL = np.array(POSE) + 0.6


class Judged:
    """What an arm received since it was asked last."""

    def __init__(self, robot):
        self.robot, self.limits, self.period = robot, robot.spec.limits, robot.spec.period
        self.heard = []

    def commands(self):
        self.robot.arm.listen()
        answers, self.robot.arm.answers[:] = list(self.robot.arm.answers), []
        self.heard += answers
        return self.heard

    def positions(self):
        return np.array([answer.data.joint_position for answer in self.commands()])

    def torques(self):
        return np.array([answer.data.joint_torque for answer in self.commands()])

    def check(self, most=1):
        """Check steps and changes of velocity; `most` cycles may lie between two commands."""
        path = self.positions()
        step, change = np.abs(np.diff(path, axis=0)), np.abs(np.diff(path, n=2, axis=0))
        assert (step <= most * self.limits.velocity * self.period * (1 + ROUNDING)).all()
        if most == 1:
            allowed = self.limits.acceleration * self.period**2 * (1 + 1e-4) + 1e-12
            assert (change <= allowed).all(), (change / allowed).max()
        return path


def moving(robot, cycles=150):
    """Move towards a goal that is far away; return who judges what the arm hears from now on."""
    judged = Judged(robot)
    robot.receive()
    robot.send(position(POSE))
    for _ in range(cycles):
        robot.receive()
        robot.send(position(GOAL))
    judged.check()
    return judged


def pushing(robot, cycles=30):
    judged = Judged(robot)
    robot.receive()
    for _ in range(cycles):
        robot.send(TorqueCommand(torque=np.full(7, 0.5)))
        robot.receive()
    return judged


def reason(robot):
    return robot._contract.save().reason


def stand_still(monkeypatch):
    """Stop the driver's clock: a busy machine may pause for longer than what a test is about."""
    now = time.monotonic()
    for module in (fri_robot, replies):
        monkeypatch.setattr(module, "time", SimpleNamespace(monotonic=lambda: now))
