"""Diagnosis: where a simulation and recordings differ, and what physics was left out."""

from estimators.diagnosis.pipeline import diagnose

__all__ = ["diagnose"]
