"""What of a simulation moves an arm: its rigid body, and a row of constants for each joint."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from estimators.diagnosis.from_motion.simulation.constants import (
    ABSENT,
    ASSISTED,
    BY_LOAD,
    CONSTANTS,
    KD,
    RESISTED,
    RESTART,
    STALL,
    TORQUE_LIMIT,
    VISCOUS_MINUS,
    VISCOUS_PLUS,
    value_in,
    with_values,
)
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
    from collections.abc import Callable

    from limo_driver.model import RobotModel
    from limo_driver.physics import Effect, JointDrive, Simulation
    from limo_driver.types import FloatArray

_Values = dict[str, float]  # by name
_SHAPES: Final = {"v_s", "delta", "rest"}  # of laws: of two effects, that of the last counts
_LED: Final = tuple(name for name, kind in DRIVES.items() if kind.channel is not None)
DRIFTS: Final = 1.0  # [s] of a run, after which what is told no positions is put back where it was
# Load-dependent friction that can be run forward: its factors as the load resists and as it drives.
PRESSED: Final = {"absolute": (1.0, 1.0), "positive": (1.0, 0.0), "negative": (0.0, 1.0)}


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
    rows = np.tile(ABSENT, (n, 1))
    for drive in simulation.drives:
        j = drive.joint - 1
        rows[j] = with_values(rows[j], _of_drive(drive))
        if drive.channel is not None and drive.channel.drifts:
            rows[j, RESTART] = DRIFTS
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
        found[drive.joint - 1] = with_values(found[drive.joint - 1], own)
    for column in (VISCOUS_PLUS, VISCOUS_MINUS):
        whole = rows[:, KD] + rows[:, column]
        share = np.divide(rows[:, KD], whole, out=np.zeros_like(whole), where=whole > 0.0)
        found[:, column] = share * found[:, KD] + (1.0 - share) * usual
    return found


def most_torque(rows: FloatArray) -> FloatArray:
    """Return the most torque of each drive, (n,) [N m]."""
    return np.minimum(rows[:, TORQUE_LIMIT], rows[:, STALL])


def _of_drive(drive: JointDrive) -> _Values:
    if isinstance(drive, DcMotor):
        return {"stall": drive.stall, "free_speed": drive.free_speed}
    given = {one.name: getattr(drive, one.name, None) for one in CONSTANTS}
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
    own = values(effect).items()
    row[:] = with_values(row, {k: x if k in _SHAPES else value_in(row, k) + x for k, x in own})


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
