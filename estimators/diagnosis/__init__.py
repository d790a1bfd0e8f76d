"""Diagnosis: where a simulation and recordings differ, and what physics was left out."""

from estimators.diagnosis.pipeline import diagnose
from estimators.diagnosis.result import Diagnosis
from estimators.diagnosis.verdict import Finding, Verdict

__all__ = ["Diagnosis", "Finding", "Verdict", "diagnose"]
