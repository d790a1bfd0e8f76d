"""Body: what changes the rigid body itself, and so every joint at once."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, ClassVar

import numpy as np

from limo_driver.errors import ConfigError
from limo_driver.model.descriptions.geometry import Inertial
from limo_driver.physics.description import Confusion, Description
from limo_driver.physics.effect import MOST_INERTIA, ArmEffect, BodyEffect, Hypothesis, State
from limo_driver.runtime.parameters import parameter

if TYPE_CHECKING:
    from collections.abc import Iterator

    from limo_driver.model import RobotModel
    from limo_driver.physics.effect import ArmMotion, DiagnosisContext, Effect, SimulatedPlant
    from limo_driver.recordings.recording import Recording
    from limo_driver.types import FloatArray

_TILT = 0.1  # [m/s²]


@dataclass(frozen=True, kw_only=True)
class Payload(BodyEffect):
    """A body fixed to the last link.

    Its effect on the torque is linear in mass, mass times com and inertia at the link's frame: the
    last ten columns of the regressor.

    Args:
        mass: Mass.
        com: Centre of mass in the frame of the last link.
        inertia: At the centre of mass: xx xy xz yy yz zz.

    Raises:
        ConfigError: No rigid body has this mass and inertia.

    Source: Khalil, Gautier and Lemoine, "Identification of the payload inertial parameters of
    industrial manipulators", ICRA 2007.
    """

    name: ClassVar[str] = "payload"
    description: ClassVar[Description] = Description(
        signature="the residuals of the joints are those of one rigid body at the flange",
        confusions=(
            Confusion(
                "link_inertia",
                "a payload is part of the last link's inertia; record once with and once without "
                "it",
                identical=True,
            ),
        ),
        part_of="link_inertia",
    )
    mass: float = parameter("kg", lower=0.0, upper=1e5)
    com: tuple[float, float, float] = parameter(
        "m", lower=-10.0, upper=10.0, length=3, deviation=0.2
    )
    inertia: tuple[float, float, float, float, float, float] = parameter(
        "kg m^2",
        lower=-MOST_INERTIA,
        upper=MOST_INERTIA,
        length=6,
        default=(0.0,) * 6,
        deviation=0.02,
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        if not self.load.is_possible():
            raise ConfigError(
                f"{self.place}: no rigid body has the mass {self.mass:g} kg and that inertia"
            )

    @property
    def load(self) -> Inertial:
        """The body that is fixed to the link."""
        return Inertial(self.mass, self.com, self.inertia)

    def with_value(self, name: str, value: float) -> Effect:
        """Return it with another value; a heavier body of the same shape has more inertia."""
        if name != "mass" or not self.mass:
            return super().with_value(name, value)
        scaled = tuple(value / self.mass * item for item in self.inertia)
        return replace(self, mass=value, inertia=scaled)

    def body(self, model: RobotModel) -> RobotModel:
        """Return the arm that carries the payload."""
        last = model.link_names[-1]
        return model.with_inertials({last: model.inertials[last].joined(self.load)})


@dataclass(frozen=True, kw_only=True)
class GravityDirection(BodyEffect):
    """An arm that is mounted otherwise than its model says, or stands on a tilted floor.

    Args:
        gravity: True gravity in the frame of the base.

    Source: Atkeson, An and Hollerbach, "Estimation of inertial parameters of manipulator loads and
    links", Int. J. Robotics Research 5(3), 1986.
    """

    name: ClassVar[str] = "gravity_direction"
    description: ClassVar[Description] = Description(
        signature="the gravity torques err as if the base were tilted",
        shown_by="wide_sweep",
        confusions=(
            Confusion(
                "spring_load",
                "gravity changes with the whole pose, a spring with its own joint only",
                "wide_sweep",
            ),
            Confusion(
                "torque_offset", "gravity changes with the pose, an offset does not", "wide_sweep"
            ),
        ),
    )
    gravity: tuple[float, float, float] = parameter(
        "m/s^2", lower=-30.0, upper=30.0, length=3, deviation=1.0
    )

    def body(self, model: RobotModel) -> RobotModel:
        """Return the arm under the true gravity."""
        return model.with_gravity(self.gravity)

    def fitted_from(self, start: Effect) -> Effect:
        """Return it as strong as it was: the base can be turned, and masses err instead."""
        if not isinstance(start, GravityDirection):
            return self
        size, was = np.linalg.norm(self.gravity), np.linalg.norm(start.gravity)
        if not size:
            return start
        return GravityDirection(gravity=tuple((np.array(self.gravity) * was / size).tolist()))

    def with_more(self, more: Effect) -> Effect | None:
        """Return the newer one: there is but one gravity."""
        return more if isinstance(more, GravityDirection) else None

    @classmethod
    def on_arm(cls, recorded: DiagnosisContext) -> Iterator[Hypothesis]:
        """Yield a base that is not mounted as the simulation says."""
        nominal = np.array(recorded.gravity)
        across = [axis for axis in np.eye(3) if abs(axis @ nominal) < 1.0]
        terms = tuple(cls(gravity=tuple((nominal + _TILT * axis).tolist())) for axis in across)
        size = float(np.linalg.norm(nominal))

        def realise(c: FloatArray) -> tuple[Effect, ...]:
            tilted = nominal + _TILT * sum(x * axis for x, axis in zip(c, across, strict=True))
            return (cls(gravity=tuple((tilted * size / np.linalg.norm(tilted)).tolist())),)

        yield Hypothesis(cls.name, (), terms, realise)


@dataclass(frozen=True, kw_only=True)
class PickedUpLoad(ArmEffect):
    """A payload that the last link carries from a time on.

    Args:
        start: Time from which it is carried.
        mass: Mass.
        com: Centre of mass in the frame of the last link.
        inertia: At the centre of mass: xx xy xz yy yz zz.

    Raises:
        ConfigError: No rigid body has this mass and inertia.

    Source: Khalil, Gautier and Lemoine, "Identification of the payload inertial parameters of
    industrial manipulators", ICRA 2007.
    """

    name: ClassVar[str] = "picked_up_load"
    description: ClassVar[Description] = Description(
        signature="from a time on the residuals of the joints are those of one body at the flange"
    )
    start: float = parameter("s", lower=-1e12, upper=1e12, chosen=True)
    mass: float = parameter("kg", lower=0.0, upper=1e5)
    com: tuple[float, float, float] = parameter("m", lower=-10.0, upper=10.0, length=3)
    inertia: tuple[float, float, float, float, float, float] = parameter(
        "kg m^2", lower=-MOST_INERTIA, upper=MOST_INERTIA, length=6, default=(0.0,) * 6
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        _ = self.payload  # refuses an impossible body

    @property
    def payload(self) -> Payload:
        """The body, once it is carried."""
        return Payload(mass=self.mass, com=self.com, inertia=self.inertia)

    def advance(self, state: State, motion: ArmMotion) -> tuple[FloatArray, State]:
        """Return what the body adds from its start on [N m], (T, n)."""
        torque, given = np.zeros_like(motion.load), motion.motion
        if (carried := given.time >= self.start).any():
            q, v, a = given.position, given.velocity, given.acceleration
            rows = (q[carried], v[carried], a[carried])
            loaded = self.payload.body(motion.model).inverse_dynamics(*rows)
            torque[carried] = loaded - motion.model.inverse_dynamics(*rows)
        return torque, state

    def realise(self, robot: SimulatedPlant) -> None:
        """Ask for the body of the last link to change at the start."""
        robot.carry(self.start, self.payload)

    def from_time(self, start: float, recording: Recording) -> Effect:  # noqa: ARG002
        """Return it in a time that begins at `start` [s]."""
        return replace(self, start=self.start - start)
