"""Diagnosis: where a simulation and recordings differ, and what physics was left out."""

from estimators.diagnosis.from_torque.diagnosis import Diagnosis
from estimators.diagnosis.from_torque.pipeline import diagnose
from estimators.diagnosis.verdict import Finding, Verdict

__all__ = ["Diagnosis", "Finding", "Verdict", "diagnose"]
