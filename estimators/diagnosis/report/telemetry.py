"""Telemetry, below the verdict: what the recordings are worth."""

from __future__ import annotations

from html import escape
from typing import TYPE_CHECKING

from estimators.telemetry import telemetry_in
from limo_driver.pages.markup import section

if TYPE_CHECKING:
    from estimators.diagnosis.result import Diagnosis


def telemetry(diagnosis: Diagnosis) -> str:
    """Return what to know of each recording before its findings are believed."""
    lines: list[str] = []
    for number, recording in enumerate(diagnosis.recordings, start=1):
        said = "; ".join(telemetry_in(diagnosis.after, recording))
        lines.append(f"{recording.source or f'recording {number}'}: {said}.")
    items = "".join(f"<li>{escape(line)}</li>" for line in lines)
    return section("Telemetry", f"<ul>{items}</ul>", "telemetry")
