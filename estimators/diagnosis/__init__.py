"""Diagnosis: where a simulation and recordings differ, and what physics was left out."""

from estimators.diagnosis.comparison import SimulationComparison
from estimators.diagnosis.from_torque.pipeline import Diagnosis, diagnose
from estimators.diagnosis.verdict import Finding, Verdict

__all__ = ["Diagnosis", "Finding", "SimulationComparison", "Verdict", "diagnose"]
