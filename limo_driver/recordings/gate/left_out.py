"""Rows of a recording: those that can be used, and those that are left out."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

_LISTED = 12  # stretches of rows that a message names


@dataclass(frozen=True)
class LeftOut:
    """Rows of a file that cannot be used."""

    reason: str
    rows: tuple[int, ...]  # 0-based rows of the file

    def __str__(self) -> str:
        """Name the rows, as `3 rows left out: a value is impossible (rows 1-2, 7)`."""
        rows = np.array(self.rows)
        runs = np.split(rows, np.flatnonzero(np.diff(rows) > 1) + 1)
        listed = [f"{run[0]}" if run.size == 1 else f"{run[0]}-{run[-1]}" for run in runs]
        more = f" and {len(listed) - _LISTED} more stretches" if len(listed) > _LISTED else ""
        many = "s" * (rows.size > 1)
        return (
            f"{rows.size} row{many} left out: {self.reason} "
            f"(row{many} {', '.join(listed[:_LISTED])}{more})"
        )


@dataclass(frozen=True)
class UsableRows:
    """Usable rows, the rows left out by reason, and warnings about the others."""

    rows: NDArray[np.int64]  # (T,)
    left_out: tuple[LeftOut, ...]
    warnings: tuple[str, ...]
