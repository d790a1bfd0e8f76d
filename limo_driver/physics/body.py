"""Body: what changes the rigid body itself, and so every joint at once."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

from limo_driver.errors import ConfigError
from limo_driver.model import Inertial
from limo_driver.parameters import parameter
from limo_driver.physics.effect import BodyEffect

if TYPE_CHECKING:
    from limo_driver.model import RobotModel


@dataclass(frozen=True, kw_only=True)
class Payload(BodyEffect):
    """A body fixed to the last link.

    Its effect on the torque is linear in mass, mass times com and inertia at the link's frame: the
    last ten columns of the regressor.

    Raises:
        ConfigError: No rigid body has this mass and inertia.

    Source: Khalil, Gautier and Lemoine, "Identification of the payload inertial parameters of
    industrial manipulators", ICRA 2007.
    """

    name: ClassVar[str] = "payload"
    mass: float = parameter("kg", "mass", lower=0.0, upper=1e3)
    com: tuple[float, float, float] = parameter(
        "m", "centre of mass in the frame of the last link", lower=-10.0, upper=10.0, length=3
    )
    inertia: tuple[float, float, float, float, float, float] = parameter(
        "kg m^2",
        "at the centre of mass: xx xy xz yy yz zz",
        lower=-1e3,
        upper=1e3,
        length=6,
        default=(0.0,) * 6,
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

    def body(self, model: RobotModel) -> RobotModel:
        """Return the arm that carries the payload."""
        last = model.link_names[-1]
        return model.with_inertials({last: model.inertials[last].joined(self.load)})


@dataclass(frozen=True, kw_only=True)
class GravityDirection(BodyEffect):
    """An arm that is mounted otherwise than its model says, or stands on a tilted floor.

    Source: Atkeson, An and Hollerbach, "Estimation of inertial parameters of manipulator loads and
    links", Int. J. Robotics Research 5(3), 1986.
    """

    name: ClassVar[str] = "gravity_direction"
    gravity: tuple[float, float, float] = parameter(
        "m/s^2", "true gravity in the frame of the base", lower=-30.0, upper=30.0, length=3
    )

    def body(self, model: RobotModel) -> RobotModel:
        """Return the arm under the true gravity."""
        return model.with_gravity(self.gravity)
