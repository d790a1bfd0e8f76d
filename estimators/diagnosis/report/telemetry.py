"""Telemetry: what the recordings are worth, in a line near the head and in full below."""

from __future__ import annotations

from typing import TYPE_CHECKING

from estimators.telemetry import telemetry_in
from limo_driver.pages.markup import prose, section

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from estimators.diagnosis.result import DiagnosisResult

_ANCHOR = "telemetry"
_SHOWN = 2  # recordings in the line near the head


def telemetry(diagnosis: DiagnosisResult) -> tuple[str, str]:
    """Return what to know of the recordings before any finding is believed.

    Args:
        diagnosis: What was found.

    Returns:
        A line that leads to the details, and the section that holds them.
    """
    said = {
        recording.source or f"recording {number}": telemetry_in(diagnosis.after, recording)
        for number, recording in enumerate(diagnosis.recordings, start=1)
    }
    items = "".join(
        f"<li>{prose(f'{name}: ' + '; '.join(lines))}.</li>" for name, lines in said.items()
    )
    return _line(said), section("What the recordings are worth", f"<ul>{items}</ul>", _ANCHOR)


def _line(said: Mapping[str, Sequence[str]]) -> str:
    """Return the first sentence of the first recordings, and the way to the others."""
    first = "; ".join(dict.fromkeys(lines[0] for lines in list(said.values())[:_SHOWN]))
    many = "Recordings" if len(said) > 1 else "Recording"
    return (
        f'<p class="lead">{many}: {prose(first)}. '
        f'<a href="#{_ANCHOR}">What the data are worth</a></p>'
    )
