"""Save a sweep: the table of its trials, its page, and the best model."""

from __future__ import annotations

from dataclasses import asdict
from typing import TYPE_CHECKING, Any, Final

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from estimators.model_folder import load_model
from estimators.sweep.result import text_of
from limo_driver.pages import Charts, Page
from limo_driver.pages.figures import AFTER, layout
from limo_driver.pages.markup import grid, header, paragraph, section, table
from limo_driver.quoting import in_html as escape
from limo_driver.runtime.outputs import whole

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

    from estimators.sweep.result import Sweep


TABLE: Final = "results.parquet"
PAGE: Final = "sweep.html"
BEST: Final = "best"
_ABOUT: Final = (
    "Error left: RMSE of simulation and network over that of the simulation alone, root mean "
    "square over joints, on stretches predicted by networks that did not see them. It has chosen "
    "the best setting, which is therefore flattered; errors in test recordings have chosen nothing."
)


def save_sweep(sweep: Sweep, folder: Path) -> None:
    """Write results.parquet, sweep.html and best, the folder of the best model.

    Args:
        sweep: What to save.
        folder: Of the sweep.

    Raises:
        ConfigError, ModelStoreError: They cannot be written.
    """
    with whole(folder / TABLE) as draft:
        pq.write_table(pa.Table.from_pylist(list(_values(sweep))), draft)
    sweep_page(sweep).save(folder / PAGE)
    if sweep.ranked and sweep.best.folder is not None:
        load_model(sweep.best.folder).save(folder / BEST)


def sweep_page(sweep: Sweep) -> Page:
    """Return the page of a sweep."""
    charts = Charts()
    drawn = grid(charts.place(_against(sweep, name), name) for name in sweep.varied)
    rows = [[escape(str(cell)) for cell in row] for row in sweep.rows()]
    failed = [
        [escape(text_of(trial.settings, name)) for name in (*sweep.varied, "seed")]
        + [escape(trial.error)]
        for trial in sweep.failed
    ]
    body = (
        header("Sweep", sweep.headline())
        + section("What each setting leaves", drawn, "drawn", _ABOUT)
        + section("All settings", table(sweep.headings(), rows, len(sweep.varied)), "settings")
    )
    if failed:
        lost = table((*sweep.varied, "seed", "why"), failed)
        body += section("Trials without a network", lost, "failed")
    return Page("Sweep", body or paragraph("no trial"), charts)


def _against(sweep: Sweep, name: str) -> dict[str, Any]:
    """Draw what is left of the error against one setting."""
    trained = [trial for trial in sweep.trials if trial.trained]
    values = [getattr(trial.settings, name) for trial in trained]
    numeric = all(isinstance(value, (int, float)) for value in values)
    axes: dict[str, Any] = layout(name, "error left [%]")
    if numeric and values and min(values) > 0 and max(values) > 10 * min(values):
        axes["xaxis"] = axes["xaxis"] | {"type": "log"}
    dots = {
        "type": "scatter",
        "mode": "markers",
        "x": values if numeric else [str(value) for value in values],
        "y": [100 * trial.left for trial in trained],
        "marker": {"size": 8, "color": AFTER, "opacity": 0.7},
        "hovertemplate": "%{x}: %{y:.3g} %<extra></extra>",
    }
    return {"data": [dots], "layout": axes, "height": 260}


def _values(sweep: Sweep) -> Iterator[dict[str, Any]]:
    for trial in sweep.trials:
        settings = {
            name: list(value) if isinstance(value, tuple) else value
            for name, value in asdict(trial.settings).items()
        }
        yield {
            "key": trial.key,
            **settings,
            "left": trial.left,
            "test": None if np.isnan(trial.test) else trial.test,
            "rmse": list(trial.rmse),
            "seconds": trial.seconds,
            "error": trial.error or None,
        }
