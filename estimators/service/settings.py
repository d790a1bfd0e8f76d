"""Settings of the service that users choose: estimates, contacts and retraining."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from limo_driver.errors import ConfigError
from limo_driver.runtime.parameters import Declared, parameter
from limo_driver.types import FloatArray, JointLimits

_PART_OF_LIMIT: Final = 0.1  # of the torque limit, that a learned part may add by default


def _above_zero(unit: str, description: str, default: float | None):  # noqa: ANN202  # a field
    return parameter(unit, description, lower=0, above=True, default=default)


@dataclass(frozen=True)
class ServiceSettings(Declared):
    """Settings of estimates; a torque is for all joints, or a part of their limits.

    What a contact is may also be said joint by joint.

    Args:
        rate: Of the joint states [Hz]; measured if None.
        delay: By which estimates are late [s]; less hears more noise.
        history: Of states from which a new model's memory is made [s].
        bound: Most that the learned part may add [N m]; a tenth of the joint's limit if None,
            which an arm without torque limits cannot be served with.
        contact_torque: External torque that is a contact [N m]; one value, or one for each joint.
        contact_duration: For which it has to last [s]; likewise.

    Raises:
        ConfigError: A value is not above 0.

    Example:
        >>> settings = limo.ServiceSettings(delay=0.05, contact_torque=6.0)
        >>> with limo.serve("iiwa14", model="model/", settings=settings) as service:
        ...     service.wait(60.0)
    """

    rate: float | None = _above_zero("Hz", "of the states; measured if not given", None)
    delay: float = _above_zero("s", "by which estimates are late", 0.1)
    history: float = _above_zero("s", "of states from which a new model's memory is made", 120.0)
    bound: float | None = _above_zero(
        "N m", "that the learned part may add; a tenth of the limit if None", None
    )
    contact_torque: float | tuple[float, ...] = _above_zero("N m", "of external torque", 4.0)
    contact_duration: float | tuple[float, ...] = _above_zero("s", "for which it has to last", 0.15)

    def bounds(self, limits: JointLimits) -> FloatArray:
        """Return the largest torque that a learned part may add, (n,) [N m].

        Raises:
            ConfigError: It is a part of a limit that a joint does not have.
        """
        if self.bound is not None:
            return np.full(limits.torque.shape, self.bound)
        stated = np.isfinite(limits.torque) & (limits.torque > 0.0)
        if not stated.all():
            without = ", ".join(str(j + 1) for j in np.flatnonzero(~stated))
            raise ConfigError(
                f"no torque limit is stated of joint {without}, of which a tenth bounds what a "
                "model has learned; expected one in the robot's description, or `bound` [N m]"
            )
        return _PART_OF_LIMIT * limits.torque

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
class RetrainingSettings(Declared):
    """When a challenger is trained, and how it is judged; seconds are of joint states that came.

    Args:
        seconds: Of the newest motion that a challenger learns from [s].
        every: After which one is trained without drift [s]; never if None.
        pause: At least between trainings [s].
        training_limit: Of this machine's time, after which training is ended [s].
        shadow: Of motion before the first verdict [s].
        shadow_limit: After which a challenger that is not better is dropped [s].
        probation: Of motion in which a new champion may be sent back [s].
        reference: Of motion that show how large the residual usually is, before drift counts [s].
        kind: Of the challenger: same as the champion, joint-physics, or a network.

    Raises:
        ConfigError: A value is not above 0.

    Example:
        >>> daily = limo.RetrainingSettings(every=86400.0)
        >>> with limo.serve("iiwa14", store="models/", log="logs/", retraining=daily) as service:
        ...     service.wait()
    """

    seconds: float = _above_zero("", "of the newest motion that a challenger learns from", 300.0)
    every: float | None = _above_zero("", "seconds after which one is trained without drift", None)
    pause: float = _above_zero("", "seconds at least between trainings", 600.0)
    training_limit: float = _above_zero(
        "s", "of this machine's time, after which training is ended", 1800.0
    )
    shadow: float = _above_zero("", "seconds of motion before the first verdict", 60.0)
    shadow_limit: float = _above_zero(
        "", "seconds after which a challenger that is not better is dropped", 1800.0
    )
    probation: float = _above_zero(
        "", "seconds of motion in which a new champion may be sent back", 300.0
    )
    reference: float = _above_zero(
        "", "seconds of motion that show how large the residual is, before drift counts", 120.0
    )
    kind: str = "same"  # of the challenger, as the champion; see `learning`
