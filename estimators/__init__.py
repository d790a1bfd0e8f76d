"""Estimators: from joint motion to joint torque.

`rigid_body` identifies an arm, `hybrid` adds a network to a simulation, `evaluation` judges both on
motion they have not seen. Import from the modules: torch is loaded only where something is trained.
What functions of the library return can be had from here; it is imported when it is first used.
"""

from typing import TYPE_CHECKING

from limo_driver.runtime.plugins import lazily

if TYPE_CHECKING:
    from estimators.base import Estimate, InverseDynamics, LiveEstimator
    from estimators.embedded.export import CodeExport
    from estimators.evaluation import Evaluation
    from estimators.residual_model import ResidualModel
    from estimators.stream import LiveEstimate, Stream

__all__ = [
    "CodeExport",
    "Estimate",
    "Evaluation",
    "InverseDynamics",
    "LiveEstimate",
    "LiveEstimator",
    "ResidualModel",
    "Stream",
]
__getattr__ = lazily(
    __name__,
    {
        "CodeExport": "estimators.embedded.export",
        "Estimate": "estimators.base",
        "Evaluation": "estimators.evaluation",
        "InverseDynamics": "estimators.base",
        "LiveEstimate": "estimators.stream",
        "LiveEstimator": "estimators.base",
        "ResidualModel": "estimators.residual_model",
        "Stream": "estimators.stream",
    },
)
