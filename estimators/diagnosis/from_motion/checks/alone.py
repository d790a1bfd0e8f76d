"""Commands beside which nothing was recorded but where the arm was at first."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np

from limo_driver.errors import RecordingError

if TYPE_CHECKING:
    from limo_driver.model import RobotModel
    from limo_driver.recordings.commanded import Commanded

_TURNS: Final = 3.0 * np.pi  # [rad] from where it begins, that no servo leads a joint without end
_BEYOND: Final = np.pi  # [rad] behind the end of a joint, where nobody leads it
_FAR: Final = 0.5  # [rad] from all commands of a joint, where few arms begin


def check_alone(model: RobotModel, told: Commanded) -> tuple[str, ...]:
    """Refuse commands that lead joints far beyond their ends; tell what else is odd.

    Args:
        model: The robot.
        told: Its commands.

    Returns:
        A sentence, if the arm begins where no command leads it.

    Raises:
        RecordingError: Commands are in another unit.
    """
    low, high = told.command.min(axis=0), told.command.max(axis=0)
    turning = np.array(model.turning)
    least = np.where(turning, told.start - _TURNS, model.limits.position_min)
    most = np.where(turning, told.start + _TURNS, model.limits.position_max)
    beyond = np.maximum(least - low, high - most)
    j = int(beyond.argmax())
    if beyond[j] > _BEYOND:
        raise RecordingError(
            f"command_{j + 1} spans {low[j]:.3g} to {high[j]:.3g}, where joint {j + 1} of "
            f"{model.name} begins at {told.start[j]:.3g} rad and is led from {least[j]:.3g} to "
            f"{most[j]:.3g} rad at most; expected set-points in rad; are the commands in degrees, "
            "or normalised, as -100 to 100?",
            path=told.source or None,
        )
    away = np.maximum(low - told.start, told.start - high)
    j = int(away.argmax())
    if away[j] <= _FAR:
        return ()
    return (
        f"joint {j + 1} begins {away[j]:.2f} rad away from all of its commands; are these deltas, "
        "or in another unit?",
    )
