"""How much two series are alike."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from limo_driver.types import FloatArray


def correlation(x: FloatArray, y: FloatArray) -> float:
    """Return the correlation of two series, (T,) each; 0 where one does not change."""
    x, y = x - x.mean(), y - y.mean()
    power = float(np.sqrt((x @ x) * (y @ y)))
    return float(x @ y) / power if power > 0 else 0.0
