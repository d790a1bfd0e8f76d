"""Sweeps: networks trained with many settings, judged on motion that each did not see."""

from estimators.sweep.result import Sweep
from estimators.sweep.trial import SweepSpace, SweepTrial

__all__ = ["Sweep", "SweepSpace", "SweepTrial"]
