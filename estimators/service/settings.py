"""What a user may choose of the service."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import TYPE_CHECKING, Final

import numpy as np

from limo_driver.errors import ConfigError

if TYPE_CHECKING:
    from limo_driver.types import FloatArray, JointLimits

_PART_OF_LIMIT: Final = 0.1  # of the torque limit, that a learned part may add by default


@dataclass(frozen=True)
class ServiceSettings:
    """How estimates are made and judged; a torque is for all joints, or a part of their limits.

    What a contact is may also be said joint by joint.

    Raises:
        ConfigError: A value is not above 0.
    """

    rate: float | None = None  # [Hz] of the states; measured if not given
    delay: float = 0.1  # [s] by which estimates are late
    history: float = 120.0  # [s] of states from which a new model's memory is made
    bound: float | None = None  # [N m] that the learned part may add; a tenth of the limit if None
    contact_torque: float | tuple[float, ...] = 4.0  # [N m] of external torque
    contact_duration: float | tuple[float, ...] = 0.15  # [s] for which it has to last

    def __post_init__(self) -> None:
        _check(self)

    def bounds(self, limits: JointLimits) -> FloatArray:
        """Return the largest torque that a learned part may add, (n,) [N m]."""
        if self.bound is None:
            return _PART_OF_LIMIT * limits.torque
        return np.full(limits.torque.shape, self.bound)

    def contact(self, n: int) -> tuple[FloatArray, FloatArray]:
        """Return the torque [N m] and the duration [s] that are a contact, (n,) each.

        Raises:
            ConfigError: One is given for another number of joints.
        """
        return (
            _per_joint("contact_torque", self.contact_torque, n),
            _per_joint("contact_duration", self.contact_duration, n),
        )


def _per_joint(name: str, value: float | tuple[float, ...], n: int) -> FloatArray:
    values = np.atleast_1d(value).astype(float)
    if values.size not in {1, n}:
        raise ConfigError(f"{name} has {values.size} values, expected one, or one for each of {n}")
    return np.broadcast_to(values, n).copy()


@dataclass(frozen=True)
class RetrainingSettings:
    """When a challenger is trained, and how it is judged; seconds are of joint states that came.

    Raises:
        ConfigError: A value is not above 0.
    """

    seconds: float = 300.0  # of the newest motion that a challenger learns from
    every: float | None = None  # seconds after which one is trained without drift
    pause: float = 600.0  # seconds at least between trainings
    training_limit: float = 1800.0  # [s] of this machine's time, after which training is ended
    shadow: float = 60.0  # seconds of motion before the first verdict
    shadow_limit: float = 1800.0  # seconds after which a challenger that is not better is dropped
    probation: float = 300.0  # seconds of motion in which a new champion may be sent back
    kind: str = "same"  # of the challenger, as the champion; see `learning`

    def __post_init__(self) -> None:
        _check(self)


def _check(settings: ServiceSettings | RetrainingSettings) -> None:
    for field in fields(settings):
        given = getattr(settings, field.name)
        for value in given if isinstance(given, tuple) else (given,):
            if isinstance(value, int | float) and not 0 < value < float("inf"):
                raise ConfigError(f"{field.name} = {value:g} has to be above 0 and finite")
