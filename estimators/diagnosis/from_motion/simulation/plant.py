"""What of a simulation moves an arm: its rigid body, and a row of constants for each joint."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from estimators.rigid_body.regressor import RegressorChain, link_parameters
from limo_driver.errors import ConfigError
from limo_driver.physics import (
    Armature,
    AsymmetricFriction,
    BodyEffect,
    CoulombFriction,
    DcMotor,
    EncoderOffset,
    LoadDependentFriction,
    QuadraticDrag,
    SensorEffect,
    SpringLoad,
    StribeckFriction,
    TorqueDrift,
    TorqueOffset,
    ViscousFriction,
)
from limo_driver.physics.drives import DRIVES

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from limo_driver.model import RobotModel
    from limo_driver.physics import Effect, JointDrive, Simulation
    from limo_driver.types import FloatArray

_Values = dict[str, float]  # by column
_LED: Final = tuple(name for name, kind in DRIVES.items() if kind.channel is not None)
DRIFTS: Final = 1.0  # [s] of a run, after which what is told no positions is put back where it was
# Load-dependent friction that can be run forward: its factors as the load resists and as it drives.
PRESSED: Final = {"absolute": (1.0, 1.0), "positive": (1.0, 0.0), "negative": (0.0, 1.0)}
NAMES: Final = (
    "kp",  # [N m/rad]
    "kd",  # [N m s/rad]
    "ki",  # [N m/(rad s)]
    "integral_limit",  # [N m]
    "dead_band",  # [rad]
    "punch",  # [N m]
    "speed",  # [rad/s]
    "acceleration",  # [rad/s²]
    "torque_limit",  # [N m]
    "delay",  # [s]
    "resolution",  # [rad]
    "stall",  # [N m], of the motor
    "free_speed",  # [rad/s], at which the motor without load stops gaining speed
    "inertia",  # [kg m²], of the drive
    "plus",  # [N m], dry friction moving positive
    "minus",  # [N m], and negative
    "viscous_plus",  # [N m s/rad]
    "viscous_minus",  # [N m s/rad]
    "drag",  # [N m s²/rad²]
    "stribeck",  # [N m], break-away beyond dry friction
    "v_s",  # [rad/s], at which that fades
    "delta",  # exponent of the fading
    "by_load",  # dry friction by N m of load
    "resisted",  # factor of that while the load resists the motion
    "assisted",  # and while it drives it
    "offset",  # [N m], which the joint needs beside the rigid body
    "spring",  # [N m/rad]
    "rest",  # [rad]
    "cubic",  # [N m/rad³]
    "zero",  # [rad], encoder minus link
    "play",  # [rad], between the servo's encoder and the joint
    "gear",  # ratio of the gear over the stated one, between motor and encoder
    "sag",  # resistance of the supply over that of a motor's winding
    "derating",  # resistance that a stalled motor's winding gains in the end, over its own
    "heating",  # [s], in which it does
    "inside",  # share of the damping that the servo makes, within its torque limit
    "kv",  # [N m s/rad], of a servo of velocity, which has no kp
    "restart",  # [s], after which errors begin anew where the joint was
    "straight",  # whether a command that is sent again is followed at once, without the profile
    "gain",  # of a drive that is told torques, and has no other: torque over the one commanded
)
(
    KP,
    KD,
    KI,
    INTEGRAL_LIMIT,
    DEAD_BAND,
    PUNCH,
    SPEED,
    ACCELERATION,
    TORQUE_LIMIT,
    DELAY,
    RESOLUTION,
    STALL,
    FREE_SPEED,
    INERTIA,
    PLUS,
    MINUS,
    VISCOUS_PLUS,
    VISCOUS_MINUS,
    DRAG,
    STRIBECK,
    V_S,
    DELTA,
    BY_LOAD,
    RESISTED,
    ASSISTED,
    OFFSET,
    SPRING,
    REST,
    CUBIC,
    ZERO,
    PLAY,
    GEAR,
    SAG,
    DERATING,
    HEATING,
    INSIDE,
    KV,
    RESTART,
    STRAIGHT,
    GAIN,
) = range(len(NAMES))
UNLIMITED: Final = (
    "integral_limit",
    "speed",
    "acceleration",
    "torque_limit",
    "stall",
    "free_speed",
    "restart",
)
_GEARED: Final = {  # powers of the gear's ratio in what is seen at the joint
    1: (KP, KV, GAIN, KI, INTEGRAL_LIMIT, PUNCH, TORQUE_LIMIT, STALL, PLUS, MINUS, STRIBECK),
    2: (KD, INERTIA, VISCOUS_PLUS, VISCOUS_MINUS),
    -1: (FREE_SPEED,),
}


@dataclass(frozen=True)
class ServoArm:
    """An arm of n joints, each behind a drive, as compiled code takes it."""

    chain: RegressorChain
    links: FloatArray  # (n, 10), inertial parameters
    rows: FloatArray  # (n, columns)

    @classmethod
    def of(cls, simulation: Simulation) -> ServoArm:
        """Take a simulation apart.

        Raises:
            ConfigError: A joint has no servo, or an effect cannot be run forward.
        """
        return cls.with_rows(simulation.body, rows_of(simulation))

    def without_restarts(self) -> ServoArm:
        """Return the same arm, which is never put back where it was."""
        rows = self.rows.copy()
        rows[:, RESTART] = np.inf
        return replace(self, rows=rows)

    @classmethod
    def with_rows(cls, body: RobotModel, rows: FloatArray) -> ServoArm:
        """Return an arm of known constants."""
        return cls(RegressorChain.of(body), link_parameters(body), rows)


def rows_of(simulation: Simulation) -> FloatArray:
    """Return the constants of each joint, (n, columns).

    Raises:
        ConfigError: A joint has no servo, or an effect cannot be run forward.
    """
    n = simulation.model.n
    missing = [j for j, own in enumerate(simulation.channels, start=1) if own is None]
    if missing:
        raise ConfigError(
            f"`drives:` has no {', '.join(_LED[:-1])} or {_LED[-1]} for "
            f"joint{'s' * (len(missing) > 1)} {', '.join(map(str, missing))} of "
            f"{simulation.model.name}; without one, nothing says what a command does there"
        )
    rows = np.zeros((n, len(NAMES)))
    for name, value in {
        **dict.fromkeys(UNLIMITED, np.inf),
        "v_s": 1.0,
        "delta": 1.0,
        "gear": 1.0,
        "resisted": 1.0,
        "assisted": 1.0,
        "heating": 1.0,
    }.items():
        rows[:, NAMES.index(name)] = value
    for drive in simulation.drives:
        _enter(rows[drive.joint - 1], _of_drive(drive))
        if drive.channel is not None and drive.channel.drifts:
            rows[drive.joint - 1, RESTART] = DRIFTS
    for effect in simulation.effects:
        if isinstance(effect, (BodyEffect, SensorEffect, TorqueDrift)):
            continue  # in the rigid body already, or nothing that moves an arm
        _add(rows, effect)
    return rows


def tolerances_of(simulation: Simulation) -> FloatArray:
    """Return how well each constant is known, (n, columns), deviations of its logarithm.

    That of damping is of servo and joint together.

    Raises:
        ConfigError: A joint has no servo, or an effect cannot be run forward.
    """
    usual, rows = simulation.tolerances.drive, rows_of(simulation)
    found = np.full(rows.shape, usual)
    for drive in simulation.drives:
        own = drive.tolerances
        if isinstance(drive, DcMotor):
            own = drive.tolerances_of_limits(usual)
        _enter(found[drive.joint - 1], own)
    for column in (VISCOUS_PLUS, VISCOUS_MINUS):
        whole = rows[:, KD] + rows[:, column]
        share = np.divide(rows[:, KD], whole, out=np.zeros_like(whole), where=whole > 0.0)
        found[:, column] = share * found[:, KD] + (1.0 - share) * usual
    return found


def most_torque(rows: FloatArray) -> FloatArray:
    """Return the most torque of each drive, (n,) [N m]."""
    return np.minimum(rows[:, TORQUE_LIMIT], rows[:, STALL])


def _enter(row: FloatArray, values: Mapping[str, float]) -> None:
    for name, value in values.items():
        row[NAMES.index(name)] = value


def _of_drive(drive: JointDrive) -> _Values:
    if isinstance(drive, DcMotor):
        return {"stall": drive.stall, "free_speed": drive.free_speed}
    given = {name: getattr(drive, name, None) for name in NAMES}
    return {name: value for name, value in given.items() if value is not None}


def _add(rows: FloatArray, effect: Effect) -> None:
    """Add an effect to the constants of its joint."""
    values = _FORWARD.get(type(effect))
    varies = isinstance(effect, LoadDependentFriction) and effect.variant not in PRESSED
    if values is None or varies:
        law = f" of variant {effect.variant}" if isinstance(effect, LoadDependentFriction) else ""
        raise ConfigError(
            f"{effect.place}: {effect.name}{law} cannot be run forward from commands; what can be: "
            + ", ".join(sorted(kind.name for kind in _FORWARD))
        )
    row = rows[effect.joints[0] - 1]
    if isinstance(effect, LoadDependentFriction):
        _press(row, effect)
        return
    shapes = {"v_s", "delta", "rest"}
    for name, value in values(effect).items():
        at = NAMES.index(name)
        row[at] = value if name in shapes else row[at] + value


def _press(row: FloatArray, effect: LoadDependentFriction) -> None:
    """Add friction by load: as the load resists the motion, and as it drives it."""
    known = row[BY_LOAD] * row[[RESISTED, ASSISTED]]
    both = known + effect.coefficient * np.array(PRESSED[effect.variant])
    if both.any():
        row[BY_LOAD] = both.max()
        row[[RESISTED, ASSISTED]] = both / both.max()


_FORWARD: Final[dict[type[Effect], Callable[[Any], _Values]]] = {
    CoulombFriction: lambda x: {"plus": x.tau_c, "minus": x.tau_c},
    AsymmetricFriction: lambda x: {"plus": x.tau_plus, "minus": x.tau_minus},
    ViscousFriction: lambda x: dict(
        zip(("viscous_plus", "viscous_minus"), x.coefficients, strict=True)
    ),
    QuadraticDrag: lambda x: {"drag": x.coefficient},
    StribeckFriction: lambda x: {"stribeck": x.tau_s, "v_s": x.v_s, "delta": x.delta},
    LoadDependentFriction: lambda x: {"by_load": x.coefficient},
    Armature: lambda x: {"inertia": x.inertia},
    TorqueOffset: lambda x: {"offset": x.offset},
    SpringLoad: lambda x: {"spring": x.stiffness, "rest": x.rest, "cubic": x.cubic},
    EncoderOffset: lambda x: {"zero": x.offset},
}


def geared(row: FloatArray) -> FloatArray:
    """Return constants as seen at the joint, of a motor behind another gear than the stated one.

    The servo's encoder is on the joint: its gains are torque of the motor by angle of the joint.
    """
    ratio = row[GEAR]
    if ratio == 1.0:
        return row
    new = row.copy()
    for power, columns in _GEARED.items():
        new[list(columns)] *= ratio**power
    new[GEAR] = 1.0
    return new
