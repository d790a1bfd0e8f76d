"""Report section on pushes: the residual of all joints around each, and its fitted wrench."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from estimators.diagnosis.report import figures
from estimators.diagnosis.verdict import CONTACT
from estimators.diagnosis.wording import names_of
from limo_driver.pages.markup import grid, number, section, table
from limo_driver.quoting import in_html as escape

if TYPE_CHECKING:
    from estimators.diagnosis.result import DiagnosisResult
    from estimators.diagnosis.verdict import Finding
    from limo_driver.pages.markup import Charts

_AXES = ("Fx [N]", "Fy [N]", "Fz [N]", "Mx [N m]", "My [N m]", "Mz [N m]")
_OPEN = 4  # pushes that are drawn; the table has all


def pushed(diagnosis: DiagnosisResult, charts: Charts) -> str:
    """Return the pushes, each with what all joints felt."""
    found = next((f for f in diagnosis.verdict.findings if f.effect == CONTACT), None)
    if found is None:
        return ""
    names = names_of(diagnosis.recordings)
    of = [names[k - 1] for k in found.where.recording]
    drawn = [
        charts.place(
            figures.push(diagnosis.traces, recording - 1, window),
            f"Push {k}",
            f"{window[0]:.1f} to {window[1]:.1f} s of {name}",
        )
        for k, (window, recording, name) in enumerate(
            zip(found.where.time[:_OPEN], found.where.recording, of, strict=False), start=1
        )
    ]
    lead = (
        "Recorded torque less that of the improved simulation, which leaves pushes out; shaded: "
        "the push. No row of it is fitted or scored. Force and moment on the flange, in axes of "
        "the base, where it is strongest."
    )
    return section("What pushed", grid(drawn) + _wrenches(found, of), "pushes", lead)


def _wrenches(found: Finding, of: list[str]) -> str:
    """Return a table of wrenches with the half width of their intervals."""
    known = found.parameters.get("wrench")
    if known is None or known.ci95 is None:
        return ""
    values, limits = np.array(known.value, dtype=float), np.array(known.ci95, dtype=float)
    half = (limits[..., 1] - limits[..., 0]) / 2
    rows = [
        [f"{a:.2f} to {b:.2f} s", escape(name),
         *(f"{number(v)} ± {number(h, 2)}" for v, h in zip(*pair, strict=True))]
        for (a, b), name, *pair in zip(found.where.time, of, values, half, strict=True)
    ]  # fmt: skip
    return table(("window", "recording", *_AXES), rows, numeric=2)
