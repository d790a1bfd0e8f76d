"""Save a fleet: the table of its rows, and its page."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from estimators.fleet.page import fleet_page
from estimators.fleet.table import write_table

if TYPE_CHECKING:
    from pathlib import Path

    from estimators.fleet.result import FleetDiagnosis

TABLE: Final = "results.parquet"
PAGE: Final = "fleet.html"


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
