"""Joint physics from motion to estimate in one compiled call.

A control loop asks for one sample at a time. Then each call of compiled code costs more than most
of what it computes, and after a wait, when the caches are another program's, several times as much.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from estimators.joint_physics.calibration import judge
from estimators.joint_physics.column_scan import scan
from estimators.joint_physics.memory import fill_variance
from estimators.joint_physics.prediction import predict
from limo_driver.runtime.compiled import compiled

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from estimators.joint_physics.column_scan import Arm
    from limo_driver.types import FloatArray


@compiled(
    reads=(
        "position", "velocity", "acceleration", "torque", "base", "kept", "less", "sizes",
        "weights", "roots", "root_sizes", "heights", "moments", "calibration",
    ),
    nogil=True,
)  # fmt: skip
def estimate(
    memory: FloatArray,
    position: FloatArray,
    velocity: FloatArray,
    acceleration: FloatArray,
    torque: FloatArray,
    arm: Arm,
    base: NDArray[np.int64],
    step_time: float,
    count: int,
    settled: float,
    kept: NDArray[np.int64],
    less: NDArray[np.int64],
    sizes: NDArray[np.int64],
    weights: FloatArray,
    roots: NDArray[np.float32],
    root_sizes: NDArray[np.int64],
    heights: FloatArray,
    moments: FloatArray,
    place: int,
    calibration: FloatArray,
    learned: FloatArray,
    std: FloatArray,
    outside: NDArray[np.bool_],
) -> None:
    """Advance `memory` in place over T samples and write the estimate, (T, n) each.

    Arguments up to `step_time` are those of `scan`; then come the number of columns, how far a
    joint has to have turned [rad], the fields of a `Prediction`, those of an `UnknownMemory`, and
    the `rows` of a `Calibration`.
    """
    T, n = position.shape
    columns, about = np.empty((n, T, count)), np.empty((2, T, n))
    leverage = np.empty((T, n))
    scan(memory, position, velocity, acceleration, torque, arm, base, step_time, 1, columns, about)
    predict(columns, kept, less, sizes, weights, roots, root_sizes, learned, leverage)
    fill_variance(columns, about, heights, moments, place, std)
    judge(calibration, leverage, about[0], settled, learned, std, outside)
