"""Studies: many recordings, settings or networks at once, kept one by one, and shown together.

Fleets of arms, sweeps of settings, and Table I of Çallar and Böttger 2022.
"""

from typing import TYPE_CHECKING

from limo_driver.runtime.plugins import lazily

if TYPE_CHECKING:
    from estimators.studies.fleet import FleetDiagnosis
    from estimators.studies.fleet_row import FleetRow
    from estimators.studies.sweep import Sweep
    from estimators.studies.sweep_trial import SweepSpace, SweepTrial

__all__ = ["FleetDiagnosis", "FleetRow", "Sweep", "SweepSpace", "SweepTrial"]
__getattr__ = lazily(
    __name__,
    {
        "FleetDiagnosis": "estimators.studies.fleet",
        "FleetRow": "estimators.studies.fleet_row",
        "Sweep": "estimators.studies.sweep",
        "SweepSpace": "estimators.studies.sweep_trial",
        "SweepTrial": "estimators.studies.sweep_trial",
    },
)
