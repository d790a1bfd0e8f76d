"""Telemetry, below the verdict: what the recordings are worth."""

from __future__ import annotations

from html import escape
from typing import TYPE_CHECKING

from estimators.diagnosis.report.markup import section
from estimators.telemetry import channels_of, sampling_of, side_in

if TYPE_CHECKING:
    from estimators.diagnosis.result import Diagnosis


def telemetry(diagnosis: Diagnosis) -> str:
    """Return what to know of each recording before its findings are believed."""
    lines: list[str] = []
    for number, recording in enumerate(diagnosis.recordings, start=1):
        side = side_in(diagnosis.after, recording, diagnosis.bandwidth)
        said = "; ".join((*sampling_of(recording), *channels_of(recording), side))
        lines.append(f"{recording.source or f'recording {number}'}: {said}.")
    items = "".join(f"<li>{escape(line)}</li>" for line in lines)
    return section("Telemetry", f"<ul>{items}</ul>", "telemetry")
