"""Motion that the backends' tests share: a small LIMOPA-like exploration around one pose."""

import numpy as np
import pytest

START = np.array([0.1, 0.5, -0.2, -1.0, 0.3, 0.8, 0.0])


@pytest.fixture(scope="session")
def exploration():
    """Six seconds of sinusoids of 2 degrees that start and end at rest, (T, 7) [rad]."""
    time = np.arange(6000) * 1e-3
    frequency = np.array([0.45, 0.5, 0.6, 0.44, 0.7, 0.8, 0.9])
    s = time / time[-1]
    envelope = 64 * (s * (1 - s)) ** 3
    return START + np.deg2rad(2.0) * envelope[:, None] * np.sin(
        2 * np.pi * frequency * time[:, None]
    )
