"""A recording as columns, and as a file that a test may spoil."""

from __future__ import annotations

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

RATE = 100.0  # [Hz]


def make_columns(T=400, n=3):
    t = np.arange(T) / RATE
    angle = 2 * np.pi * 0.7 * t[:, None] + np.arange(n)
    columns = {"time": t}
    for j in range(n):
        columns[f"position_{j + 1}"] = np.sin(angle[:, j])
        columns[f"torque_{j + 1}"] = 5 * np.cos(angle[:, j]) + j
    return columns


def write(columns, path):
    pq.write_table(pa.table(columns), path)
    return path
