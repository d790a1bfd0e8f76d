"""The estimator service: versions of models, and what has to hold before one may serve."""

from typing import TYPE_CHECKING

from estimators.service.settings import RetrainingSettings, ServiceSettings
from limo_driver.runtime.plugins import lazily

if TYPE_CHECKING:
    from estimators.service.server import Service

__all__ = ["RetrainingSettings", "Service", "ServiceSettings"]
__getattr__ = lazily(__name__, {"Service": "estimators.service.server"})
