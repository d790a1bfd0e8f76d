"""What a simulated arm really applied in each cycle, beside what it measured.

It is read where the simulation reads it, behind everything that limits commands.
"""

import numpy as np
from wire_rules import IMPEDANCE, POSITION, TORQUE, Applied

from backends.mujoco_sim import MujocoRobot, layout
from limo_driver.types import ImpedanceCommand, PositionCommand, TorqueCommand

_KINDS = {PositionCommand: POSITION, ImpedanceCommand: IMPEDANCE, TorqueCommand: TORQUE}
_MODES = {layout.POSITION: POSITION, layout.IMPEDANCE: IMPEDANCE, layout.TORQUE: TORQUE}


def tapped(robot):
    """Return a list that grows by what is applied in each cycle of a simulated robot."""
    applied, cycle = [], robot._cycle_once

    def noted():
        state = cycle()
        applied.append(_applied(robot))
        return state

    robot._cycle_once = noted
    return applied


def _applied(robot):
    zero = np.zeros(robot.spec.n)
    if isinstance(robot, MujocoRobot):
        rows, mode = robot._command, _MODES[robot._mode]
        values = {
            "position": rows[layout.TARGET].copy(),
            "torque": rows[layout.FEED_FORWARD].copy(),
            "stiffness": rows[layout.STIFFNESS].copy(),
            "damping": rows[layout.DAMPING].copy(),
        }
    else:
        command = robot._command
        mode = _KINDS[type(command)]
        values = {
            name: getattr(command, name, zero)
            for name in ("position", "torque", "stiffness", "damping")
        }
    used = {POSITION: {"position"}, TORQUE: {"torque"}}.get(mode, set(values))
    return Applied(mode, **{name: v if name in used else zero for name, v in values.items()})
