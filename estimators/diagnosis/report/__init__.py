"""The report of a diagnosis: one HTML file that needs no network."""

from estimators.diagnosis.report.binning import Stretch, worst_stretch
from estimators.diagnosis.report.page import write_report

__all__ = ["Stretch", "worst_stretch", "write_report"]
