"""A fleet shown: its table, its page, and both saved."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Iterable, Sequence, Set
from pathlib import Path
from typing import Any, Final

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from estimators.diagnosis.headline import headline, place_of
from estimators.diagnosis.quantities import QUANTITIES, name_of_value, of_joints, placed
from estimators.diagnosis.verdict import REPORT, Finding, Identified, StatedValue, Verdict
from estimators.studies import fleet_standing as standing
from estimators.studies.fleet import FleetDiagnosis, changed
from estimators.studies.fleet_row import FLEET, FleetRow
from limo_driver.pages import Charts, Page
from limo_driver.pages.figures import AFTER, BEFORE, layout, numbers
from limo_driver.pages.markup import (
    UNSAID,
    Figure,
    folded,
    header,
    number,
    paragraph,
    section,
    table,
    typeset,
)
from limo_driver.physics import Payload
from limo_driver.quoting import in_html as escape
from limo_driver.runtime.display import naturally
from limo_driver.runtime.outputs import whole

_ODD, _ALIKE = BEFORE, AFTER
_DRAWN: Final = 6  # drifts that have a chart
_VALUE: Final = pa.struct(
    {
        "effect": pa.string(),
        "joints": pa.list_(pa.int64()),  # 1-based
        "kind": pa.string(),  # missing, wrong_parameter, identified, stated
        "confidence": pa.float64(),
        "parameter": pa.string(),
        "value": pa.string(),  # JSON: a number, a text, or lists of them
        "ci95": pa.string(),  # JSON
        "stated": pa.float64(),  # what the simulation has of it, where that differs
        "beyond": pa.bool_(),  # whether beyond its tolerance
        "unit": pa.string(),
    }
)
SCHEMA: Final = pa.schema(
    {
        "recording": pa.string(),
        "key": pa.string(),
        "arm": pa.string(),
        "date": pa.timestamp("s"),
        "verdict": pa.string(),  # null where there is none
        "states": pa.list_(pa.string()),  # agrees, or what does not
        "findings": pa.list_(pa.string()),  # e.g. payload@7
        "values": pa.list_(_VALUE),
        "heldout_rmse_before": pa.list_(pa.float64()),  # by joint [unit]
        "heldout_rmse_after": pa.list_(pa.float64()),
        "noise_floor": pa.list_(pa.float64()),
        "unit": pa.string(),
        "seconds": pa.float64(),  # that the diagnosis took
        "error": pa.string(),  # null where there is a verdict
    }
)
_OF_FIT: Final = ("heldout_rmse_before", "heldout_rmse_after", "noise_floor", "unit")
TABLE: Final = "results.parquet"
PAGE: Final = "fleet.html"


def fleet_page(fleet: FleetDiagnosis, folder: Path) -> Page:
    """Return the page of a fleet.

    Args:
        fleet: What was found.
        folder: The page will lie in; links to reports are relative to it.
    """
    charts = Charts()
    title = fleet.headline
    lead = (
        "An arm is odd where its median is more than "
        f"{FLEET.odd:g} robust standard deviations from that of the arms, and by more than "
        f"{FLEET.least:.0%}; z is how many deviations. "
        "Arms are the folders that recordings lie in."
    )
    body = (
        header(f"Fleet of {fleet.robot}", title)
        + "".join(map(paragraph, str(fleet).splitlines()))
        + section("Which arm is the odd one out", _odd(fleet.standings, charts), "odd", lead)
        + section("What drifts over dates", _drifts(fleet, charts), "drift")
        + section("Unit against unit", _spreads(fleet.spreads, charts), "spread")
        + section("What was found", _findings(fleet.rows), "found")
        + section("The worst recordings", _worst(fleet.rows, folder), "worst")
        + section("Recordings without a verdict", _failed(fleet.failed), "failed")
    )
    return Page(title, body, charts)


def _odd(standings: Sequence[standing.ArmStanding], charts: Charts) -> str:
    if not standings:
        return paragraph(f"Fewer than {FLEET.arms} arms: none can be told from the others.")
    sides = ((_ALIKE, "like the others", False), (_ODD, "odd", True))
    data = [
        _dots([i.z for i in own], [i.arm for i in own], [i.series.name for i in own], name, colour)
        for colour, name, odd in sides
        if (own := [item for item in standings if item.odd == odd])
    ]
    title = "robust standard deviations from the median arm"
    figure = _by_arm(data, title, {item.arm for item in standings})
    rows = [
        [*map(escape, (item.arm, item.series.name, item.series.unit)),
         number(item.median), number(item.fleet), f"{item.z:+.1f}"]
        for item in standings
        if item.odd
    ]  # fmt: skip
    heads = ("arm", "quantity", "unit", "median", "fleet", "z")
    listed = table(heads, rows, 3) if rows else paragraph("No arm is odd.")
    return charts.place(figure, "Each error and value of each arm, against all arms") + listed


def _drifts(fleet: FleetDiagnosis, charts: Charts) -> str:
    if not any(np.isfinite(item.days).any() for item in fleet.series):
        return paragraph("No recording has a date in its path, such as 2026-03-01.")
    if not fleet.drifts:
        few = standing.few_dates(fleet.series)
        why = paragraph(f"Nothing changes over dates beyond chance{few and '; '}{few}.")
        if (most := standing.most_moved(fleet.series)) is None:
            return why
        return why + charts.place(_over_days(most), f"Moved most: {most.name} of {most.arms[0]}")
    heads = ("arm", "quantity", "change over the dates (95 %)", "p")
    rows = [
        [escape(d.arm), escape(d.series.name), escape(changed(d)), number(d.p, 2)]
        for d in fleet.drifts
    ]
    meaning = paragraph(
        "p is the probability that chance alone makes as much of a trend. Over all quantities, "
        f"about one in {1 / FLEET.false_alarms:.0f} fleets without drift gets one named."
    )
    return (
        meaning
        + table(heads, rows, 3)
        + "".join(
            charts.place(_over_days(item.series), f"{item.arm}: {item.series.name}")
            for item in fleet.drifts[:_DRAWN]
        )
    )


def _over_days(series: standing.Series) -> Figure:
    dated = int(np.isfinite(series.days).sum())  # what has no date is last
    order = np.argsort(series.days, kind="stable")[:dated]
    dots = {
        "type": "scatter", "mode": "lines+markers", "x": series.days[order].tolist(),
        "y": series.values[order].tolist(), "line": {"color": "#c9ced4"},
        "marker": {"size": 8, "color": _ODD}, "showlegend": False,
    }  # fmt: skip
    unit = f" [{series.unit}]" if series.unit else ""
    axes = layout("days since the first recording of the fleet", f"{series.name}{unit}")
    return {"data": [dots], "layout": axes}


def _spreads(spreads: Sequence[standing.UnitSpread], charts: Charts) -> str:
    if not spreads:
        return ""
    widest = max((s for s in spreads if s.series.ratio), key=lambda s: s.deviation)
    low, high = np.array(widest.intervals).T
    means = np.array(widest.means)
    dots = _dots(widest.means, widest.arms, widest.arms, widest.series.name, _ALIKE)
    bars = {"array": numbers(high - means), "arrayminus": numbers(means - low)}
    dots["error_x"] = bars | {"type": "data", "symmetric": False, "color": _ALIKE}
    figure = _by_arm([dots], f"{widest.series.name} [{widest.series.unit}]", {*widest.arms})
    rows = [
        [escape(s.series.name), "factor, 1: alike" if s.series.ratio else escape(s.series.unit),
         str(len(s.arms)), number(s.deviation + s.series.ratio),
         " to ".join(number(end + s.series.ratio) for end in s.interval)]
        for s in spreads
    ]  # fmt: skip
    heads = ("quantity", "unit", "arms", "standard deviation between arms", "95 %")
    caption = "The error in which arms differ most: mean of each arm, with 95 % interval"
    return charts.place(figure, caption) + folded("All quantities", table(heads, rows, 2))


def _findings(rows: Sequence[FleetRow]) -> str:
    """Return what was found, at which arms, and in how many of their recordings."""
    recordings = Counter(row.arm for row in rows if row.diagnosed)
    found: dict[str, Counter[str]] = {}
    for row in rows:
        for name in _named(row.verdict) if row.verdict is not None else ():
            found.setdefault(name, Counter())[row.arm] += 1
    listed = [
        [escape(typeset(name)), escape(", ".join(f"{a} ({n} of {recordings[a]})" for a, n in arms))]
        for name, arms in ((n, c.most_common()) for n, c in sorted(found.items()))
    ]
    return table(("finding", "arms, and how many of their recordings"), listed) if listed else ""


def _named(verdict: Verdict) -> list[str]:
    """Return what a recording has: findings, and other quantities that are not as stated."""
    names, found = verdict.names, verdict.findings
    named = {(x.effect, x.joints) for x in found}
    values = [
        x
        for x in verdict.values
        if x.reported and (x.effect, x.name) in QUANTITIES and (x.effect, x.joints) not in named
    ]
    return [
        *(f"payload {place_of(x, names)}" for x in found if x.effect == Payload.name),
        *(placed(x.effect, x.joints, names) for x in found if x.effect != Payload.name),
        *(f"{name_of_value(x)} at {of_joints(x.joints, names)}: not as stated" for x in values),
    ]


def _worst(rows: Sequence[FleetRow], folder: Path) -> str:
    ranked = sorted((row for row in rows if row.diagnosed), key=lambda row: -_floors(row))
    lines = [
        [_linked(row, folder), escape(row.arm),
         f"{row.date:%Y-%m-%d}".replace("-", "\N{NON-BREAKING HYPHEN}") if row.date else UNSAID,
         escape(typeset(headline(row.verdict))), number(_floors(row))]
        for row in ranked[: FLEET.worst]
        if row.verdict is not None
    ]  # fmt: skip
    return table(("recording", "arm", "date", "verdict", "error in noise floors"), lines, 4)


def _floors(row: FleetRow) -> float:
    """Return the largest error of a joint, in its noise floors."""
    if row.verdict is None:
        return 0.0
    fit = row.verdict.fit
    pairs = zip(fit.heldout_rmse_before, fit.noise_floor, strict=True)
    return max((error / floor for error, floor in pairs if floor > 0), default=0.0)


def _linked(row: FleetRow, folder: Path) -> str:
    name = escape(Path(row.recording).name)
    if row.folder is None or not (row.folder / REPORT).exists():
        return name
    return f'<a href="{escape((row.folder / REPORT).relative_to(folder).as_posix())}">{name}</a>'


def _failed(rows: Sequence[FleetRow]) -> str:
    listed = [[escape(str(row.recording)), escape(row.error)] for row in rows]
    return table(("recording", "why"), listed) if listed else ""


def _dots(
    x: Sequence[float], y: Sequence[str], text: Sequence[str], name: str, colour: str
) -> Figure:
    return {
        "type": "scatter", "mode": "markers", "x": list(x), "y": list(y), "text": list(text),
        "name": name, "marker": {"size": 8, "color": colour, "opacity": 0.7},
        "hovertemplate": "%{y}, %{text}: %{x:.3g}<extra></extra>",
    }  # fmt: skip


def _by_arm(data: Sequence[Figure], title: str, arms: Set[str]) -> Figure:
    """Return a chart with a row for each arm, bay2 above bay10."""
    upwards = sorted(arms, key=naturally, reverse=True)
    axes = layout(title, "")
    axes["yaxis"] |= {"categoryorder": "array", "categoryarray": upwards}
    return {"data": list(data), "layout": axes, "rows": len(arms)}


def write_table(rows: Iterable[FleetRow], path: Path) -> None:
    """Write the table of a fleet.

    Raises:
        ConfigError: It cannot be written.
    """
    table = pa.Table.from_pylist([_values(row) for row in rows], SCHEMA)
    with whole(path) as draft:
        pq.write_table(table, draft)


def place_in_short(item: Finding | Identified) -> str:
    """Return an effect and its joints, e.g. `backlash@3`."""
    joints = ",".join(map(str, item.joints))
    return f"{item.effect}@{joints}" if joints else item.effect


def _values(row: FleetRow) -> dict[str, Any]:
    same = {name: getattr(row, name) for name in ("key", "arm", "date", "seconds")}
    found: dict[str, Any] = same | {"recording": str(row.recording), "error": row.error or None}
    if (verdict := row.verdict) is None:
        return found
    return found | {
        "verdict": verdict.verdict,
        "states": verdict.states,
        "findings": [place_in_short(item) for item in verdict.findings],
        "values": [
            *(v for f in verdict.findings for v in _parameters(f, f.kind, f.confidence)),
            *(v for item in verdict.identified for v in _parameters(item, "identified", None)),
            *map(_stated, verdict.values),
        ],
        **{name: getattr(verdict.fit, name) for name in _OF_FIT},
    }


def _stated(item: StatedValue) -> dict[str, Any]:
    same = {name: getattr(item, name) for name in ("effect", "joints", "unit", "stated", "beyond")}
    texts = {"value": json.dumps(item.fitted), "ci95": json.dumps(item.ci95)}
    return same | texts | {"kind": "stated", "parameter": item.name}


def _parameters(
    item: Finding | Identified, kind: str, confidence: float | None
) -> list[dict[str, Any]]:
    return [
        {"effect": item.effect, "joints": item.joints, "kind": kind, "confidence": confidence,
         "parameter": name, "value": json.dumps(known.value), "ci95": json.dumps(known.ci95),
         "unit": known.unit}
        for name, known in item.parameters.items()
    ]  # fmt: skip


def save_fleet(fleet: FleetDiagnosis, folder: Path) -> None:
    """Write results.parquet and fleet.html.

    Args:
        fleet: What to save.
        folder: That the diagnoses lie in, so that the page can link their reports.

    Raises:
        ConfigError: They cannot be written.
    """
    write_table(fleet.rows, folder / TABLE)
    fleet_page(fleet, folder).save(folder / PAGE)
