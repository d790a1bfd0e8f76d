"""The page of a report: its sections in the order in which they are read."""

from __future__ import annotations

from typing import TYPE_CHECKING

from estimators.diagnosis.headline import headline
from estimators.diagnosis.report import doubts, sections
from estimators.diagnosis.report.arm import arm
from estimators.diagnosis.report.contact import pushed
from estimators.diagnosis.report.findings import overview
from estimators.diagnosis.report.telemetry import telemetry
from estimators.diagnosis.report.truth import beside_the_truth
from limo_driver.pages import Charts, Page
from limo_driver.pages.page import FOOTER

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from estimators.diagnosis.result import DiagnosisResult
    from limo_driver.physics import Effect

_FOOTER = (
    f"{FOOTER} Positive torque acts along the joint axis. The same content for programs: "
    "<code>verdict.json</code>; the improved simulation: <code>sim.yaml</code>."
)


def write_report(
    diagnosis: DiagnosisResult, path: Path, concealed: Sequence[Effect] | None = None
) -> None:
    """Write a diagnosis as one HTML file that needs no network.

    Args:
        diagnosis: What was found.
        path: File to write.
        concealed: What is known to be in the arm, where that was made up.

    Raises:
        ConfigError: The file cannot be written.
    """
    report(diagnosis, concealed).save(path)


def render(diagnosis: DiagnosisResult) -> str:
    """Return the page as HTML."""
    return report(diagnosis).html()


def report(diagnosis: DiagnosisResult, concealed: Sequence[Effect] | None = None) -> Page:
    """Return the page of a diagnosis, as `write_report` writes it."""
    charts, n = Charts(), diagnosis.before.model.n
    known = beside_the_truth(concealed, diagnosis.verdict.findings, n) if concealed else ""
    view, on_the_arm = arm(diagnosis, charts)
    worth, worth_in_full = telemetry(diagnosis)
    body = (
        overview(diagnosis, charts, known + worth + on_the_arm)
        + sections.identified(diagnosis.verdict)
        + worth_in_full
        + pushed(diagnosis, charts)
        + sections.where(diagnosis, charts)
        + sections.competing(diagnosis, charts)
        + sections.tests(diagnosis)
        + sections.replay(diagnosis, charts)
        + doubts.next_motion(diagnosis, charts)
        + doubts.doubts(diagnosis, charts)
        + doubts.data(diagnosis)
    )
    return Page(headline(diagnosis.verdict), body, charts, view, _FOOTER)
