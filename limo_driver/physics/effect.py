"""Effect: one piece of physics, with one set of named parameters.

A subclass writes only the mathematics: `advance(state, ...)` evaluates it over the T samples that
follow `state`, the memory after the sample before them, and returns its values and the memory after
the last sample. Every effect is so used in three ways with the same equation: over a recording
(`predict`), sample by sample (`step`), and inside the simulated robot.

Effect
├── BodyEffect          what it makes of the rigid body
├── ArmEffect           torque that needs the motion of more than one joint
└── JointEffect         of one joint
    ├── TorqueEffect    torque that the joint needs beyond the rigid body
    │   └── Friction    torque against the motion, without memory
    ├── MotionEffect    displacement of the link from where the encoder says it is
    └── SensorEffect    what the torque sensor makes of the torque
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import MISSING, dataclass, field, fields
from functools import cache
from itertools import pairwise
from typing import TYPE_CHECKING, Any, ClassVar, TypeAlias

import numpy as np

from limo_driver.errors import ConfigError

if TYPE_CHECKING:
    from limo_driver.model import RobotModel
    from limo_driver.types import FloatArray, Motion

State: TypeAlias = "FloatArray"
STATELESS: FloatArray = np.zeros(0)
STATELESS.flags.writeable = False
TEXT, JOINT = "text", "joint"  # units of parameters that are no physical quantity


@dataclass(frozen=True)
class Parameter:
    """What is known of a parameter before any data."""

    name: str
    unit: str  # or "text", or "joint" for the 1-based number of another joint
    lower: float
    upper: float
    description: str
    is_list: bool = False
    optional: bool = False
    length: int | None = None  # of a list, where it is fixed
    columns: int | None = None  # of each row, for a list of rows

    @property
    def is_number(self) -> bool:
        """Whether the parameter is one real number, which can be fitted."""
        return not self.is_list and self.unit not in {TEXT, JOINT}


def parameter(  # noqa: ANN201  # a dataclass field, whose type is the annotation's
    unit: str,
    description: str,
    *,
    lower: float = -np.inf,
    upper: float = np.inf,
    default: Any = MISSING,  # noqa: ANN401  # of the field's own type
    length: int | None = None,
    columns: int | None = None,
):
    """Declare a parameter of an effect as a dataclass field."""
    known = {"unit": unit, "lower": lower, "upper": upper, "description": description}
    return field(default=default, metadata={**known, "length": length, "columns": columns})


@dataclass(frozen=True)
class JointMotion:
    """Motion and load of one joint over T samples; each array has shape (T,)."""

    time: FloatArray  # [s]
    position: FloatArray  # [rad]
    velocity: FloatArray  # [rad/s]
    acceleration: FloatArray  # [rad/s²]
    load: FloatArray  # nominal rigid-body torque [N m]
    temperature: FloatArray | None = None  # [°C]
    inertia: FloatArray | None = None  # [kg m²], for effects that ask for it


@dataclass(frozen=True)
class ArmMotion:
    """Motion and load of all n joints over T samples."""

    motion: Motion
    load: FloatArray  # (T, n), nominal rigid-body torque [N m]
    model: RobotModel

    def of_joint(self, j: int, *, inertia: bool = False) -> JointMotion:
        """Return the motion and load of one joint (0-based), its inertia only if asked for."""
        motion = self.motion
        return JointMotion(
            motion.time,
            motion.position[:, j],
            motion.velocity[:, j],
            motion.acceleration[:, j],
            self.load[:, j],
            None if motion.temperature is None else motion.temperature[:, j],
            self.model.inertia_of(motion.position, j)[:, j] if inertia else None,
        )


@dataclass(frozen=True)
class SensedTorque:
    """Torque of all n joints as it reaches a sensor effect, after the sensor effects before it."""

    time: FloatArray  # (T,) [s]
    torque: FloatArray  # (T, n) [N m]


@dataclass(frozen=True, kw_only=True)
class Effect(ABC):
    """One piece of physics."""

    name: ClassVar[str]  # the identifier in sim.yaml and in a diagnosis

    @classmethod
    @cache  # effects are made by the thousand while they are fitted
    def parameters(cls) -> tuple[Parameter, ...]:
        """Return the named parameters with unit and bounds."""
        return tuple(
            Parameter(
                item.name,
                item.metadata["unit"],
                item.metadata["lower"],
                item.metadata["upper"],
                item.metadata["description"],
                is_list="tuple" in str(item.type),
                optional=item.default is not MISSING,
                length=item.metadata["length"],
                columns=item.metadata["columns"],
            )
            for item in fields(cls)
            if "unit" in item.metadata
        )

    @property
    def joints(self) -> tuple[int, ...]:
        """The 1-based joints that the effect belongs to; empty if it is of the whole arm."""
        return ()

    @property
    def place(self) -> str:
        """Name and joints, as they stand in messages."""
        if not self.joints:
            return self.name
        numbers = ", ".join(map(str, self.joints))
        return f"{self.name}, joint{'s' if len(self.joints) > 1 else ''} {numbers}"

    def __post_init__(self) -> None:
        for known in self.parameters():
            if known.unit != TEXT and getattr(self, known.name) is not None:
                self._check(known)

    def _check(self, known: Parameter) -> None:
        given = getattr(self, known.name)
        values = self._rows(known) if known.columns else np.atleast_1d(np.asarray(given, float))
        if known.length is not None and values.shape != (known.length,):
            raise ConfigError(
                f"{self.place}: {known.name} has {values.size} numbers, expected {known.length}"
            )
        if known.columns:
            rows = tuple(tuple(row) for row in values.tolist())
            object.__setattr__(self, known.name, rows)
        elif known.is_list:
            object.__setattr__(self, known.name, tuple(values.ravel().tolist()))
        bad = ~((values >= known.lower) & (values <= known.upper))
        if bad.any():
            raise ConfigError(
                f"{self.place}: {known.name} = {values[bad][0]:g} {known.unit} "
                f"is outside [{known.lower:g}, {known.upper:g}]"
            )

    def _rows(self, known: Parameter) -> FloatArray:
        """Return a list of rows as an array, (k, columns)."""
        rows = [np.asarray(row, dtype=float) for row in getattr(self, known.name)]
        for number, row in enumerate(rows, start=1):
            if row.shape != (known.columns,):
                raise ConfigError(
                    f"{self.place}: {known.name}, row {number} has {row.size} numbers, "
                    f"expected {known.columns}"
                )
        return np.array(rows).reshape(-1, known.columns or 0)

    def _same_length(self, *names: str) -> None:
        """Refuse lists that do not belong together entry by entry, and empty ones."""
        lengths = {name: len(getattr(self, name)) for name in names}
        if len(set(lengths.values())) > 1 or 0 in lengths.values():
            listed = ", ".join(f"{size} {name}" for name, size in lengths.items())
            raise ConfigError(f"{self.place}: has {listed}; each entry needs all of them")

    def _increasing(self, name: str) -> None:
        """Refuse a list that does not increase strictly."""
        values = getattr(self, name)
        for before, after in pairwise(values):
            if not before < after:
                raise ConfigError(
                    f"{self.place}: {name} has {after:g} after {before:g}; it has to increase"
                )

    def initial_state(self) -> State:
        """Return the memory before the first sample; empty for effects without memory."""
        return STATELESS


class BodyEffect(Effect):
    """An effect on the rigid body itself."""

    @abstractmethod
    def body(self, model: RobotModel) -> RobotModel:
        """Return what the effect makes of a rigid body."""


class ArmEffect(Effect):
    """An effect that adds torque and needs the motion of more than one joint."""

    @abstractmethod
    def advance(self, state: State, motion: ArmMotion) -> tuple[FloatArray, State]:
        """Return the torques of T samples, (T, n) [N m], and the memory after them."""


@dataclass(frozen=True, kw_only=True)
class JointEffect(Effect):
    """One piece of physics of one joint."""

    joint: int  # 1-based

    @property
    def joints(self) -> tuple[int, ...]:
        """The joint."""
        return (self.joint,)


class TorqueEffect(JointEffect):
    """An effect that adds torque: what the joint needs beyond the rigid body."""

    @abstractmethod
    def advance(self, state: State, motion: JointMotion) -> tuple[FloatArray, State]:
        """Return the torque of T samples, (T,) [N m], and the memory after them."""


class Friction(TorqueEffect):
    """Torque without memory that vanishes with the velocity and has its sign.

    The simulated robot takes it as a damping, so that it dissipates at any step size.
    """


class MotionEffect(JointEffect):
    """An effect that displaces the link from where the encoder says it is.

    Sample by sample it is quasi-static: the link's velocity and acceleration are the encoder's.
    Where past and future are known, the displacement has its own, within `agility` times the
    bandwidth.
    """

    agility: ClassVar[float] = 0.0
    needs_inertia: ClassVar[bool] = False

    @abstractmethod
    def advance(self, state: State, motion: JointMotion) -> tuple[FloatArray, State]:
        """Return encoder minus link of T samples, (T,) [rad], and the memory after them."""


class SensorEffect(JointEffect):
    """An effect of the torque sensor, after all that is torque."""

    @abstractmethod
    def advance(self, state: State, sensed: SensedTorque) -> tuple[FloatArray, State]:
        """Return what this joint's sensor adds, (T,) [N m], and the memory after it."""
