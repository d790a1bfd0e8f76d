"""Jackknife: how far fits that each leave a part of the data out disagree.

    V = (F - 1)/F Σ_f (phi_f - mean)(phi_f - mean)ᵀ,

a covariance that asks no model of the errors: what a wrong model pulls the parameters to changes
with the motion, and so shows.

Source: Shao and Tu, "The Jackknife and Bootstrap", 1995, sec. 2.3; Wu, "Jackknife, bootstrap and
other resampling methods in regression analysis", Annals of Statistics 1986.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Sequence

    from limo_driver.types import FloatArray


def jackknife(fits: Sequence[FloatArray]) -> FloatArray:
    """Return D (F, p), with Dᵀ D the covariance of parameters (p,) fitted without each of F parts.

    The norms of its columns are the parameters' standard deviations.
    """
    off = np.asarray(fits, dtype=np.float64) - fits[0]  # exactly zero where all agree
    return np.sqrt((len(off) - 1) / len(off)) * (off - off.mean(axis=0))
