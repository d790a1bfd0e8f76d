"""Motion and torque of an iiwa 14 as somebody else's logger would have it."""

from __future__ import annotations

from functools import cache

import numpy as np

from limo_driver.model import RobotModel

PERIOD = 0.004  # [s]


@cache
def arm():
    return RobotModel.load("iiwa14")


@cache
def measured(duration=12.0, seed=0):
    """Time [s], position [rad], velocity [rad/s] and torque [N m] of a slow motion."""
    time = np.arange(0, duration, PERIOD)
    rate = 2 * np.pi * (0.1 + 0.04 * np.arange(7))
    phase = np.outer(time, rate) + np.arange(7)
    q, v, a = 0.7 * np.sin(phase), 0.7 * rate * np.cos(phase), -0.7 * rate**2 * np.sin(phase)
    torque = arm().inverse_dynamics(q, v, a) + 1.5 * np.tanh(v / 0.02) + 0.8 * v
    torque += np.random.default_rng(seed).normal(0, 0.05, q.shape)
    return time, q, v, torque


def written(columns, path, separator=",", comment=""):
    """Write columns as delimited text."""
    table = np.column_stack(list(columns.values()))
    header = separator.join(columns)
    with path.open("w", encoding="utf-8") as file:
        file.write(comment)
        np.savetxt(file, table, fmt="%.9g", delimiter=separator, header=header, comments="")
    return path


def numbered(name, values, first=0):
    """Columns of one quantity, numbered by joint."""
    return {name.format(j + first): values[:, j] for j in range(values.shape[1])}
