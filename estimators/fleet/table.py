"""The table of a fleet as Parquet: one row a recording."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING, Any, Final

import pyarrow as pa
import pyarrow.parquet as pq

from limo_driver.runtime.outputs import whole

if TYPE_CHECKING:
    from collections.abc import Iterable
    from pathlib import Path

    from estimators.diagnosis.verdict import Finding, Identified
    from estimators.fleet.row import FleetRow
    from estimators.fleet.tolerated import ToleratedValue

_VALUE: Final = pa.struct(
    {
        "effect": pa.string(),
        "joints": pa.list_(pa.int64()),  # 1-based
        "kind": pa.string(),  # missing, wrong_parameter, identified, tolerated
        "confidence": pa.float64(),
        "parameter": pa.string(),
        "value": pa.string(),  # JSON: a number, a text, or lists of them
        "ci95": pa.string(),  # JSON
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
    found: dict[str, Any] = {
        "recording": str(row.recording),
        "key": row.key,
        "arm": row.arm,
        "date": row.date,
        "seconds": row.seconds,
        "error": row.error or None,
    }
    if (verdict := row.verdict) is None:
        return found
    return found | {
        "verdict": verdict.verdict,
        "findings": [place_in_short(item) for item in verdict.findings],
        "values": [
            *(v for f in verdict.findings for v in _parameters(f, f.kind, f.confidence)),
            *(v for item in verdict.identified for v in _parameters(item, "identified", None)),
            *map(_tolerated, row.tolerated),
        ],
        "heldout_rmse_before": verdict.fit.heldout_rmse_before,
        "heldout_rmse_after": verdict.fit.heldout_rmse_after,
        "noise_floor": verdict.fit.noise_floor,
        "unit": verdict.fit.unit,
    }


def _tolerated(item: ToleratedValue) -> dict[str, Any]:
    return {
        "kind": "tolerated",
        "parameter": item.name,
        "value": json.dumps(item.value),
        "unit": item.unit,
    }


def _parameters(
    item: Finding | Identified, kind: str, confidence: float | None
) -> list[dict[str, Any]]:
    return [
        {
            "effect": item.effect,
            "joints": item.joints,
            "kind": kind,
            "confidence": confidence,
            "parameter": name,
            "value": json.dumps(known.value),
            "ci95": json.dumps(known.ci95),
            "unit": known.unit,
        }
        for name, known in item.parameters.items()
    ]
