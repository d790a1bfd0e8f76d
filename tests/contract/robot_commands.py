"""What the contract suites of the robot share: commands, and motion in answer to states."""

import numpy as np

from limo_driver.types import ImpedanceCommand, PositionCommand

START = (0.1, 0.5, -0.2, -1.0, 0.3, 0.8, 0.0)


def position(values, **options):
    return PositionCommand(position=np.asarray(values, dtype=float), **options)


def follow(robot, targets):
    """Send each target in answer to a state; return states and what was sent."""
    state = robot.receive()
    states, sent = [], []
    for target in targets:
        sent.append(robot.send(position(target)))
        state = robot.receive()
        states.append(state)
    return states, sent


def smooth_move(distance, cycles):
    s = np.linspace(0.0, 1.0, cycles)[:, None]
    return np.array(START) + distance * (10 * s**3 - 15 * s**4 + 6 * s**5)


def impedance(values, stiffness=300.0, damping=30.0, torque=None):
    zero = np.zeros(7)
    return ImpedanceCommand(
        position=np.asarray(values, dtype=float),
        stiffness=zero + stiffness,
        damping=zero + damping,
        torque=zero if torque is None else np.asarray(torque, dtype=float),
    )
