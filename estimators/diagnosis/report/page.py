"""The page of a report: sections, style, charts and plotly in one file."""

from __future__ import annotations

from html import escape
from importlib.resources import files
from string import Template
from typing import TYPE_CHECKING

from estimators.diagnosis.report import sections
from estimators.diagnosis.report.contact import pushed
from estimators.diagnosis.report.findings import overview
from estimators.diagnosis.report.markup import Charts
from estimators.diagnosis.report.telemetry import telemetry
from limo_driver.outputs import whole

if TYPE_CHECKING:
    from pathlib import Path

    from estimators.diagnosis.result import Diagnosis


def write_report(diagnosis: Diagnosis, path: Path) -> None:
    """Write a diagnosis as one HTML file that needs no network.

    Args:
        diagnosis: What was found.
        path: File to write.

    Raises:
        ConfigError: The file cannot be written.
    """
    with whole(path) as draft:
        draft.write_text(render(diagnosis), encoding="utf-8")


def render(diagnosis: Diagnosis) -> str:
    """Return the page as HTML."""
    from plotly.offline import get_plotlyjs

    charts = Charts()
    body = (
        overview(diagnosis, charts)
        + telemetry(diagnosis)
        + pushed(diagnosis, charts)
        + sections.where(diagnosis, charts)
        + sections.competing(diagnosis, charts)
        + sections.tests(diagnosis)
        + sections.replay(diagnosis, charts)
        + sections.next_motion(diagnosis, charts)
        + sections.doubts(diagnosis, charts)
        + sections.data(diagnosis)
    )
    return Template(_asset("page.html")).substitute(
        title=escape(diagnosis.verdict.sentence()),
        style=_asset("style.css"),
        body=body,
        figures=charts.as_json(),
        plotly=get_plotlyjs(),
        script=_asset("charts.js"),
    )


def _asset(name: str) -> str:
    return (files("estimators.diagnosis.report") / name).read_text(encoding="utf-8")
