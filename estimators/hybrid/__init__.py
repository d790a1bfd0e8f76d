"""Hybrid of a rigid-body simulation and a network that learns its residual."""

from typing import TYPE_CHECKING

from estimators.hybrid.features import Features
from estimators.hybrid.model import HybridModel
from limo_driver.runtime.plugins import lazily

if TYPE_CHECKING:
    from estimators.hybrid.training.fit import Epoch
    from estimators.hybrid.training.settings import TrainingSettings

__all__ = ["Epoch", "Features", "HybridModel", "TrainingSettings"]
__getattr__ = lazily(
    __name__,
    {
        "Epoch": "estimators.hybrid.training.fit",
        "TrainingSettings": "estimators.hybrid.training.settings",
    },
)
