"""Text without a line of names: what columns may be by their number, and by what runs evenly."""

from __future__ import annotations

import re
from dataclasses import replace
from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np

from limo_driver.logs.readers.columns.families import ColumnFamily
from limo_driver.logs.readers.columns.names import PLAIN, POSITION, TORQUE, VELOCITY, Name
from limo_driver.logs.readers.proposals.times import TimeFound, time_in

if TYPE_CHECKING:
    from limo_driver.logs.readers.table import LogTable

_COUNTED: Final = re.compile(r"column_\d+")
_EVEN: Final = 0.5  # of the usual step, within which nearly all steps of a time are
_NEARLY_ALL: Final = 0.9
_LAYOUTS: Final = ((POSITION, TORQUE), (POSITION, VELOCITY, TORQUE))


class UnnamedColumns(NamedTuple):
    """What the columns of a log may be of which nothing says so."""

    time: TimeFound
    families: list[ColumnFamily]
    question: str


def unnamed_columns(table: LogTable, joints: int) -> UnnamedColumns | None:
    """Return what columns without names may be.

    Args:
        table: What the log holds.
        joints: Of the robot.

    Returns:
        A time, then positions and torques of all joints, with velocities between them where there
        are as many columns; None where the columns have names, or are of another number.
    """
    names = list(table.columns)
    if not names or not all(_COUNTED.fullmatch(name) for name in names):
        return None
    running = next((name for name in names[:1] if _runs_evenly(table, name)), None)
    if running is None:
        return None
    others = [name for name in names if name != running]
    layout = next((x for x in _LAYOUTS if len(x) * joints == len(others)), None)
    if layout is None:
        return None
    families = [
        ColumnFamily(
            quantity,
            PLAIN,
            tuple(
                Name(name, quantity, PLAIN, number + 1, "", ())
                for number, name in enumerate(others[k * joints : (k + 1) * joints])
            ),
        )
        for k, quantity in enumerate(layout)
    ]
    told = "; ".join(f"{family.quantity}: {family}" for family in families)
    question = (
        f"columns: no line of names says what they are: is it time: {running}; {told}, in the "
        "order of the joints?"
    )
    found = time_in(table, running)
    return UnnamedColumns(replace(found, why=f"it runs evenly; {found.why}"), families, question)


def _runs_evenly(table: LogTable, name: str) -> bool:
    values = table.columns[name]
    if values.dtype.kind not in "fiu":
        return False
    steps = np.diff(values.astype(np.float64))
    usual = float(np.median(steps)) if steps.size else 0.0
    even = np.abs(steps - usual) < _EVEN * usual
    return usual > 0 and bool(even.mean() > _NEARLY_ALL)
