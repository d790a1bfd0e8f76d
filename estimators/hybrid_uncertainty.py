"""How sure a hybrid is: by its errors on motion held out, and by how far it is from all motion.

    variance of the error = e² + (d s)²

e is the root mean square error on held-out motion, s the standard deviation of what the network had
to learn, and d how far the farthest input that it sees lies beyond the range of training, in
standard deviations of that input: at d = 1 the network's part is as good as unknown.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np

from estimators.base import Estimate

if TYPE_CHECKING:
    from estimators.hybrid import FittedNetwork, HybridModel
    from limo_driver.recording import Recording
    from limo_driver.types import FloatArray, Motion

_OUTSIDE: Final = 0.1  # standard deviations of an input beyond its range; nearer, noise may be
_ROWS: Final = 10_000  # whose inputs are held at a time


def estimate(model: HybridModel, recording: Recording) -> Estimate:
    """Predict the torque of a recorded motion, its standard deviation, and where it is unsure.

    The standard deviation is NaN if no motion was held out from training.

    Raises:
        NotFittedError: Nothing was trained or loaded.
        ModelStoreError: The recording has another sampling rate than the model can take.
    """
    fitted, torque = model.fitted, model.predict(recording)
    motion, beyond = recording.motion(fitted.bandwidth), np.empty(torque.shape)
    for rows in recording.segments:
        beyond[rows] = _beyond(model, motion[rows])
    std = np.sqrt(_held_out_error(fitted) ** 2 + (beyond * fitted.outputs.std) ** 2)
    return Estimate(torque, std, beyond > _OUTSIDE)


def _held_out_error(fitted: FittedNetwork) -> FloatArray:
    """Return the root mean square error of each joint on motion held out, (n,) [N m]."""
    known = fitted.record.get("rmse", {}).get("held_out", {}).get("hybrid")
    return np.full(fitted.features.n, np.nan) if known is None else np.array(known)


def _beyond(model: HybridModel, motion: Motion) -> FloatArray:
    """Return how far one contiguous motion is beyond the range of training, (T, n)."""
    fitted = model.fitted
    bodies, memory = model.simulation.init(), fitted.features.init()
    beyond = np.empty(motion.position.shape)
    for start in range(0, len(motion), _ROWS):
        piece = motion[start : start + _ROWS]
        torque = np.zeros(piece.position.shape)
        if not fitted.standalone:
            torque, bodies = model.simulation.advance(bodies, piece)
        x, memory = fitted.features.advance(memory, piece, torque, model.simulation.body)
        excess = np.maximum(fitted.inputs.lowest - x, x - fitted.inputs.highest)
        excess = np.maximum(excess, 0.0) / fitted.inputs.std
        for j, columns in enumerate(fitted.features.columns):
            beyond[start : start + _ROWS, j] = excess[:, columns].max(axis=1)
    return beyond
