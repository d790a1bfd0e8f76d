"""Effect: one piece of joint physics, with one set of named parameters.

A subclass writes only the mathematics. Every effect is used in three ways with the same
equation: over a recording (`predict`), sample by sample (`step`), and inside the simulated robot.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import MISSING, dataclass, field, fields
from typing import TYPE_CHECKING, Any, ClassVar, TypeAlias

import numpy as np

from limo_driver.errors import ConfigError

if TYPE_CHECKING:
    from limo_driver.types import FloatArray

State: TypeAlias = "FloatArray"
STATELESS: FloatArray = np.zeros(0)
STATELESS.flags.writeable = False


@dataclass(frozen=True)
class Parameter:
    """What is known of a parameter before any data."""

    name: str
    unit: str
    lower: float
    upper: float
    description: str
    is_list: bool = False
    optional: bool = False


def parameter(  # noqa: ANN201  # a dataclass field, whose type is the annotation's
    unit: str,
    description: str,
    *,
    lower: float = -np.inf,
    upper: float = np.inf,
    default: Any = MISSING,  # noqa: ANN401  # of the field's own type
):
    """Declare a parameter of an effect as a dataclass field."""
    return field(
        default=default,
        metadata={"unit": unit, "lower": lower, "upper": upper, "description": description},
    )


@dataclass(frozen=True)
class JointMotion:
    """Motion and load of one joint over T samples; each array has shape (T,)."""

    position: FloatArray  # [rad]
    velocity: FloatArray  # [rad/s]
    acceleration: FloatArray  # [rad/s²]
    load: FloatArray  # nominal rigid-body torque [N m]


@dataclass(frozen=True, kw_only=True)
class Effect(ABC):
    """One piece of physics of one joint."""

    name: ClassVar[str]  # the identifier in sim.yaml and in a diagnosis
    joint: int  # 1-based

    @classmethod
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
            )
            for item in fields(cls)
            if "unit" in item.metadata
        )

    def __post_init__(self) -> None:
        for known in self.parameters():
            self._check(known)

    def _check(self, known: Parameter) -> None:
        given = getattr(self, known.name)
        if known.unit == "text":
            return
        values = np.atleast_1d(np.asarray(given, dtype=float))
        if known.is_list:
            object.__setattr__(self, known.name, tuple(values.tolist()))
        bad = ~((values >= known.lower) & (values <= known.upper))
        if bad.any():
            raise ConfigError(
                f"{self.name}, joint {self.joint}: {known.name} = {values[bad][0]:g} {known.unit} "
                f"is outside [{known.lower:g}, {known.upper:g}]"
            )

    def initial_state(self) -> State:
        """Return the memory before the first sample; empty for effects without memory."""
        return STATELESS

    @abstractmethod
    def advance(self, state: State, motion: JointMotion) -> tuple[FloatArray, State]:
        """Evaluate the effect over T samples that follow `state`.

        Args:
            state: Memory after the sample before the first one.
            motion: T samples of this joint.

        Returns:
            Values of shape (T,), [N m] for a torque effect and [rad] for a motion effect, and
            the memory after the last sample.
        """


class TorqueEffect(Effect):
    """An effect that adds torque: what the joint needs beyond the rigid body."""


class MotionEffect(Effect):
    """An effect that displaces the link from where the encoder says it is.

    `advance` returns the displacement encoder minus link [rad]. It is quasi-static: the link's
    velocity and acceleration are taken as the encoder's.
    """
