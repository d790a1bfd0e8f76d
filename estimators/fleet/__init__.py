"""Fleets: many recordings diagnosed one by one, and what they say of arms and dates together."""

from estimators.fleet.result import FleetDiagnosis
from estimators.fleet.row import FleetRow

__all__ = ["FleetDiagnosis", "FleetRow"]
