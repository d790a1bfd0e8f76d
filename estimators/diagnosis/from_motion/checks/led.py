"""A joint that moves away from all that it was told: by hand, or by its weight without torque."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np
from scipy.ndimage import maximum_filter1d, minimum_filter1d

if TYPE_CHECKING:
    from limo_driver.types import FloatArray

_PAST: Final = 2.0  # [s], in which a servo in order has come to where it was told
_NEAR, _AWAY = 0.1, 0.3  # [rad] beyond the commands of that time: where it begins, and is sure
_MOVED: Final = 0.15  # [rad], by which the joint itself has moved meanwhile


def led_away(time: FloatArray, command: FloatArray, position: FloatArray) -> tuple[float, float]:
    """Return since when a joint is led away from its commands [s], and how far [rad].

    A servo lags, sags and swings; what it never does is leave the range of all that it was told in
    the last seconds by a lot, from near it, by moving itself.

    Args:
        time: (T,) [s].
        command: (T,) [rad].
        position: (T,) [rad].

    Returns:
        Time and distance; a distance of 0 if it is not.
    """
    rows = max(1, round(_PAST / float(np.median(np.diff(time)))))
    low, high = (
        of(command, rows + 1, origin=rows // 2, mode="nearest")
        for of in (minimum_filter1d, maximum_filter1d)
    )
    beyond = np.where(position > high, position - high, np.minimum(position - low, 0.0))
    near = -1
    for i, far in enumerate(beyond.tolist()):
        if abs(far) < _NEAR:
            near = i
        elif abs(far) > _AWAY and near >= 0:
            if np.sign(far) * (position[i] - position[near]) > _MOVED:
                return float(time[near]), float(np.abs(beyond[near : i + rows]).max())
            near = -1  # its command went away from it
    return 0.0, 0.0
