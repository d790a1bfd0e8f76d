"""What the tests of the safety contract share: an arm, commands, and contracts under way."""

from __future__ import annotations

import numpy as np
import pytest

from limo_driver.errors import HoldingError
from limo_driver.robot.safety import SafetyContract
from limo_driver.types import (
    ImpedanceCommand,
    JointLimits,
    JointState,
    PositionCommand,
    RobotSpec,
    TorqueCommand,
    WrenchCommand,
    WrenchLimits,
)

PERIOD = 0.0078125  # [s], 2^-7: sums of it have no rounding
LIMITS = JointLimits(
    position_min=np.array([-2.0, -1.0, 0.5]),
    position_max=np.array([2.0, 1.5, 3.0]),
    velocity=np.array([1.0, 2.0, 0.5]),
    acceleration=np.array([10.0, 8.0, 4.0]),
    jerk=np.full(3, 1e3),
    torque=np.array([100.0, 50.0, 10.0]),
    torque_rate=np.array([1000.0, 600.0, 200.0]),
)
WRENCH = WrenchLimits(wrench=np.full(6, 50.0), rate=np.full(6, 640.0))
SPEC = RobotSpec("arm", ("a", "b", "c"), LIMITS, PERIOD, WRENCH)
POSE = np.array([0.0, 0.25, 1.5])
ZERO = np.zeros(3)
JUST = 0.01  # relative: a factor of 1.05 on a limit is noticed
LONG = 1.0  # [s], the longest that a command may be valid


def only(j, value, others=ZERO):
    """Return `others` with one joint changed."""
    values = np.array(others, dtype=float)
    values[j] = value
    return values


def state(cycle=0, position=POSE, velocity=ZERO, *, time=None, stale=False):
    when = cycle * PERIOD if time is None else time
    return JointState(when, position, velocity, ZERO, cycle, stale=stale)


def moved(values=POSE, **options):
    return PositionCommand(position=np.array(values, dtype=float), **options)


def pushed(values=ZERO, **options):
    return TorqueCommand(torque=np.array(values, dtype=float), **options)


def sprung(values=POSE, **options):
    given = {"stiffness": ZERO, "damping": ZERO, "torque": ZERO} | options
    return ImpedanceCommand(position=np.array(values, dtype=float), **given)


def wrenched(values=(0.0,) * 6, **options):
    return WrenchCommand(wrench=np.array(values, dtype=float), **options)


COMMANDS = {"position": moved, "torque": pushed, "impedance": sprung, "wrench": wrenched}


def opened(*, spec=SPEC, **options):
    """Return a contract that has seen the arm at rest."""
    contract = SafetyContract(spec, **options)
    contract.observe(state())
    return contract


def started(command, *, spec=SPEC, **options):
    """Return a contract under way, in its first cycle."""
    contract = opened(spec=spec, **options)
    contract.admit(command)
    return contract


def reason(contract):
    """Return why an arm holds; empty if it does not."""
    if not contract.holding:
        return ""
    with pytest.raises(HoldingError) as refused:
        contract.admit(pushed())
    return str(refused.value)


def assert_kept(path):
    velocity = np.diff(path, axis=0) / PERIOD
    acceleration = np.diff(velocity, axis=0) / PERIOD
    assert (path >= LIMITS.position_min).all()
    assert (path <= LIMITS.position_max).all()
    assert (np.abs(velocity) <= LIMITS.velocity * (1 + 2e-6)).all()
    assert (np.abs(acceleration) <= LIMITS.acceleration * (1 + 2e-6)).all()
