"""Prior standard deviations of those weights that are tolerances of a sensor, encoder or gear.

Evidence judges weights by what they do in the motion at hand. A column that hardly moved there, as
that of a deflection near one pose, could have any weight: one that says nothing where it was fitted
and N m elsewhere. But sensors, encoders and gears are off by about as much on any arm:

    gain         0.05 of the own torque, 0.01 of every other joint's
    placement    5 mrad
    elasticity   5 mrad of deflection under the load that there usually is
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np

if TYPE_CHECKING:
    from estimators.joint_physics.columns import JointColumns
    from limo_driver.types import FloatArray

_GAIN: Final = 0.05
_CROSSTALK: Final = 0.01
_ANGLE: Final = 0.005  # [rad]
_LEAST_TORQUE: Final = 1e-6  # [N m], so that a joint that bears none has finite deviations


def tolerances(columns: JointColumns, joint: int, rms: FloatArray) -> FloatArray:
    """Return the standard deviations of the weights of a joint before any data, (K,).

    Args:
        columns: The columns.
        joint: 0-based.
        rms: Root mean square of each column, (K,).

    Returns:
        Deviations of the weights, of columns as they come; NaN where the data have to decide.
    """
    found = np.full(columns.count, np.nan)
    gain = columns.of_family("gain")
    found[gain] = np.where(np.arange(columns.n) == joint, _GAIN, _CROSSTALK)
    found[columns.of_family("placement")] = _ANGLE
    torque = np.maximum(rms[gain], _LEAST_TORQUE)  # (n,) [N m], of every joint
    found[columns.of_family("elasticity")] = _ANGLE / torque  # [rad/(N m)]
    return found
