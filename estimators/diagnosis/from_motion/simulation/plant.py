"""What of a simulation moves an arm: its rigid body, and a row of constants for each joint."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from estimators.diagnosis.from_motion.simulation import constants as c
from estimators.diagnosis.quantities import of_joints
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
    from collections.abc import Callable, Sequence

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
        rows[:, c.RESTART] = np.inf
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
            f"{of_joints(missing)} of {simulation.model.name}; without one, nothing says what a "
            "command does there"
        )
    rows = np.tile(c.ABSENT, (n, 1))
    for drive in simulation.drives:
        j = drive.joint - 1
        rows[j] = c.with_values(rows[j], _of_drive(drive))
        if drive.channel is not None and drive.channel.drifts:
            rows[j, c.RESTART] = DRIFTS
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
        found[drive.joint - 1] = c.with_values(found[drive.joint - 1], own)
    for column in (c.VISCOUS_PLUS, c.VISCOUS_MINUS):
        whole = rows[:, c.KD] + rows[:, column]
        share = np.divide(rows[:, c.KD], whole, out=np.zeros_like(whole), where=whole > 0.0)
        found[:, column] = share * found[:, c.KD] + (1.0 - share) * usual
    return found


def most_torque(rows: FloatArray) -> FloatArray:
    """Return the most torque of each drive, (n,) [N m]."""
    return np.minimum(rows[:, c.TORQUE_LIMIT], rows[:, c.STALL])


def _of_drive(drive: JointDrive) -> _Values:
    if isinstance(drive, DcMotor):
        return {"stall": drive.stall, "free_speed": drive.free_speed}
    given = {one.name: getattr(drive, one.name, None) for one in c.CONSTANTS}
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
        known = row[c.BY_LOAD] * row[[c.RESISTED, c.ASSISTED]]
        both = known + effect.coefficient * np.array(PRESSED[effect.variant])
        if both.any():
            row[c.BY_LOAD] = both.max()
            row[[c.RESISTED, c.ASSISTED]] = both / both.max()
        return
    own = values(effect).items()
    row[:] = c.with_values(row, {k: x if k in _SHAPES else c.value_in(row, k) + x for k, x in own})


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


def with_rows(simulation: Simulation, rows: Sequence[FloatArray]) -> Simulation:
    """Return a simulation with the constants that were fitted, as seen at the joints.

    Damping of the servo and viscous friction of the joint act alike but at a torque limit: what
    fits do not place within that is viscous friction.
    """
    rows, given = [c.geared(row) for row in rows], rows
    fitted = tuple({*_FORWARD} - {QuadraticDrag, EncoderOffset})
    kept = tuple(effect for effect in simulation.effects if not isinstance(effect, fitted))
    effects = tuple(effect for j, row in enumerate(rows, start=1) for effect in _effects(j, row))
    drives = tuple(
        _driven(drive, rows[drive.joint - 1], c.value_in(given[drive.joint - 1], "gear"))
        for drive in simulation.drives
    )
    turned = {drive.joint for drive in drives if isinstance(drive, DcMotor)}
    motors = tuple(
        DcMotor.of_limits(j, c.value_in(row, "stall"), c.value_in(row, "free_speed"))
        for j, row in enumerate(rows, start=1)
        if j not in turned and np.isfinite(c.value_in(row, "stall"))
    )
    return replace(simulation, effects=(*effects, *kept), drives=(*drives, *motors))


def _driven(drive: JointDrive, row: FloatArray, ratio: float) -> JointDrive:
    if isinstance(drive, DcMotor):
        limits = c.value_in(row, "stall"), c.value_in(row, "free_speed")
        return replace(drive, gear=ratio * drive.gear).limited(*limits)
    values = {
        item.name: _finite(c.value_in(row, item.name))
        for item in fields(drive)
        if item.name in c.COLUMNS
    }
    if "kd" in values:
        values["kd"] = c.value_in(row, "kd") + c.value_in(row, "inside") * c.value_in(
            row, c.DAMPING
        )
    if not c.value_in(row, "derating"):
        values.pop("heating", None)
    known = {name: own for name, own in drive.tolerances.items() if values.get(name)}
    # values by name: numbers alone, of which a checker cannot tell that no one is `tolerances`
    return replace(drive, tolerances=known, **values)  # pyright: ignore[reportArgumentType]


def _finite(value: float) -> float | None:
    """Return a limit as it is declared."""
    return value if np.isfinite(value) else None


def _effects(joint: int, row: FloatArray) -> list[Effect]:
    def value(name: str) -> float:
        return c.value_in(row, name)

    plus, minus = value("plus"), value("minus")
    found: list[Effect] = [
        CoulombFriction(joint=joint, tau_c=plus)
        if plus == minus
        else AsymmetricFriction(joint=joint, tau_plus=plus, tau_minus=minus),
        ViscousFriction(joint=joint, f_v=(1.0 - value("inside")) * value(c.DAMPING)),
        Armature(joint=joint, inertia=value("inertia")),
        TorqueOffset(joint=joint, offset=value("offset")),
    ]
    if value("stribeck") > 0.0:
        tau_s, v_s, delta = value("stribeck"), value("v_s"), value("delta")
        found.append(StribeckFriction(joint=joint, tau_s=tau_s, v_s=v_s, delta=delta))
    if value("by_load") > 0.0:
        resisted, assisted = (value("by_load") * value(own) for own in ("resisted", "assisted"))
        parts = {
            "absolute": min(resisted, assisted),
            "positive": max(resisted - assisted, 0.0),
            "negative": max(assisted - resisted, 0.0),
        }
        found += [
            LoadDependentFriction(joint=joint, coefficient=size, variant=variant)
            for variant, size in parts.items()
            if size > 0.0
        ]
    if value("spring") != 0.0 or value("cubic") != 0.0:
        stiffness, rest, cubic = value("spring"), value("rest"), value("cubic")
        found.append(SpringLoad(joint=joint, stiffness=stiffness, rest=rest, cubic=cubic))
    return found
