"""The report of a diagnosis: one HTML file that needs no network."""

from estimators.diagnosis.report.page import write_report
from estimators.diagnosis.report.stretch import Stretch, worst_stretch

__all__ = ["Stretch", "worst_stretch", "write_report"]
