"""What a simulation leaves of each joint's torque, as waves over its own position."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from estimators.base import Estimate
from estimators.model_folder import ModelFolder, provenance, write_folder
from estimators.residual_model import ResidualModel
from limo_driver.errors import RecordingError

ORDERS = (1, 2, 3)  # waves in a turn
CREEP = 0.01  # [rad/s], width of the sign of the motion
RIDGE = 1e-6  # of the mean square of a column
TRAINED = 0.8  # of a recording, on which errors are not judged


@dataclass(frozen=True)
class Waves:
    """Weights of p columns for n joints."""

    weights: np.ndarray  # (n, p) [N m]
    std: np.ndarray  # (n,) [N m], of what they leave on motion held out
    record: dict[str, Any]


class JointWaves(ResidualModel[Waves]):
    """Predict tau_j = tau_S,j + w_j · (1, sin k q_j, cos k q_j, tanh(dq_j / 0.01 rad/s))."""

    name = "joint-waves"
    held_out_is = "on the last fifth of each recording"

    def __init__(self, simulation, bandwidth=10.0):
        super().__init__(simulation)
        self._bandwidth = bandwidth

    @property
    def bandwidth(self):
        return self._bandwidth

    def fit(self, recordings):
        if not recordings:
            raise RecordingError("there is none to fit to")
        rows = [self._rows(recording) for recording in recordings]
        everything = [np.concatenate(parts) for parts in zip(*rows, strict=True)]
        X, y, late = everything  # (T, n, p), (T, n), (T,)
        judged = y[late] - self._sum(X[late], self._weights(X[~late], y[~late]))
        std = np.sqrt(np.mean(judged**2, axis=0))
        record = {
            "recordings": [provenance(recording) for recording in recordings],
            "rmse": {
                "simulation": np.sqrt(np.mean(y[late] ** 2, axis=0)).tolist(),
                "held_out": std.tolist(),
            },
        }
        self.fitted_ = Waves(self._weights(X, y), std, record)
        return self

    def _rows(self, recording):
        recording.check_robot(self.simulation.model)
        motion = recording.motion(self.bandwidth)
        known = [self.simulation.predict(motion[rows]) for rows in recording.segments]
        left = recording.filtered(recording.torque - np.concatenate(known), self.bandwidth)
        used = ~recording.edges(self.bandwidth)
        late = np.arange(len(recording)) > TRAINED * len(recording)
        return self._columns(motion)[used], left[used], late[used]

    def _columns(self, motion):
        q = motion.position
        waves = [wave(order * q) for order in ORDERS for wave in (np.sin, np.cos)]
        return np.stack([np.ones_like(q), *waves, np.tanh(motion.velocity / CREEP)], axis=2)

    def _weights(self, X, y):
        gram = np.einsum("tjp,tjq->jpq", X, X)
        ridge = RIDGE * np.trace(gram, axis1=1, axis2=2)[:, None, None] * np.eye(X.shape[2])
        return np.linalg.solve(gram + ridge, np.einsum("tjp,tj->jp", X, y)[..., None])[..., 0]

    def _sum(self, X, weights):
        return np.einsum("tjp,jp->tj", X, weights)

    def init(self, rate=None):  # noqa: ARG002  # any will do
        _ = self.fitted
        return self.simulation.init()

    def _advance(self, state, motion):
        torque, after = self.simulation.advance(state, motion)
        learned = self._sum(self._columns(motion), self.fitted.weights)
        std = np.broadcast_to(self.fitted.std, torque.shape)
        return Estimate(torque, learned, std, np.zeros(torque.shape, dtype=bool)), after

    def save(self, folder):
        entries = {"estimator": self.name, "bandwidth": self.bandwidth}
        entries["training"] = self.fitted.record
        tensors = {"weights": self.fitted.weights, "std": self.fitted.std}
        write_folder(folder, entries, tensors, self.simulation, ("limo", "limo-cable"))

    @classmethod
    def load(cls, folder):
        opened = ModelFolder.open(folder, cls.name)
        model = cls(opened.simulation, opened.bandwidth)
        tensors = opened.tensors()
        model.fitted_ = Waves(tensors["weights"], tensors["std"], opened.record("held_out"))
        return model
