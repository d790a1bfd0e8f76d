"""The result of a sweep: its trials, ranked, the best of them, and all of it saved."""

from __future__ import annotations

from dataclasses import asdict, dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any, Final

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from estimators.model_folder import load_model
from limo_driver.errors import ConfigError
from limo_driver.pages import Charts, Page
from limo_driver.pages.figures import AFTER, layout
from limo_driver.pages.markup import grid, header, paragraph, section, table
from limo_driver.quoting import in_html as escape
from limo_driver.runtime.display import Displayed
from limo_driver.runtime.outputs import whole

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence
    from pathlib import Path

    from estimators.hybrid.training.settings import TrainingSettings
    from estimators.studies.sweep_trial import SweepTrial

_SHOWN = 10  # settings that are printed


@dataclass(frozen=True)
class SweptSetting:
    """The trials of one setting, which differ by their seed alone; at least one was trained."""

    settings: TrainingSettings  # with the seed of its best trial
    trials: tuple[SweepTrial, ...]  # that were trained, best first

    @property
    def left(self) -> float:
        """Mean part of the simulation's error that is left."""
        return float(np.mean([trial.left for trial in self.trials]))

    @property
    def spread(self) -> float:
        """Standard deviation of that over seeds; NaN with one."""
        left = [trial.left for trial in self.trials]
        return float(np.std(left, ddof=1)) if len(left) > 1 else float("nan")

    @property
    def test(self) -> float:
        """Mean part that is left in the test recordings; NaN without any."""
        return float(np.mean([trial.test for trial in self.trials]))

    @property
    def seconds(self) -> float:
        """Mean time of a training [s]."""
        return float(np.mean([trial.seconds for trial in self.trials]))


@dataclass(frozen=True, repr=False)
class Sweep(Displayed):
    """The trials of a sweep, in their order, and what they say together."""

    trials: tuple[SweepTrial, ...]
    varied: tuple[str, ...]  # settings that differ from trial to trial, but for seeds

    @cached_property
    def ranked(self) -> tuple[SweptSetting, ...]:
        """Settings by how little of the simulation's error they leave on motion not seen."""
        groups: dict[TrainingSettings, list[SweepTrial]] = {}
        for trial in self.trials:
            if trial.trained:
                groups.setdefault(replace(trial.settings, seed=0), []).append(trial)
        ordered = [sorted(own, key=lambda trial: trial.left) for own in groups.values()]
        found = [SweptSetting(own[0].settings, tuple(own)) for own in ordered]
        return tuple(sorted(found, key=lambda setting: setting.left))

    @property
    def best(self) -> SweepTrial:
        """The best trial of the best setting.

        Raises:
            ConfigError: No trial was trained.
        """
        if not self.ranked:
            raise ConfigError(f"none of {len(self.trials)} trials was trained")
        return self.ranked[0].trials[0]

    @property
    def failed(self) -> tuple[SweepTrial, ...]:
        """Trials without a network."""
        return tuple(trial for trial in self.trials if not trial.trained)

    def headline(self) -> str:
        """Say what is best, and how much it leaves."""
        done = len(self.trials) - len(self.failed)
        if not done:
            return f"none of {len(self.trials)} trials was trained"
        best = self.ranked[0]
        chosen = ", ".join(f"{name} {text_of(best.settings, name)}" for name in self.varied)
        test = "" if np.isnan(best.test) else f", {best.test:.1%} in the test recordings"
        return (
            f"{done} of {len(self.trials)} trials trained. Best: {chosen or best.settings.model}, "
            f"which leaves {best.left:.1%} of the simulation's error on motion not seen{test}"
        )

    def figures(self) -> Mapping[str, Sequence[object]]:
        """Return the best settings beside what they leave."""
        return dict(zip(self.headings(), zip(*self.rows()[:_SHOWN], strict=True), strict=False))

    def headings(self) -> tuple[str, ...]:
        """Return what the columns of `rows` are."""
        tested = any(np.isfinite(setting.test) for setting in self.ranked)
        return (
            *self.varied,
            "seeds",
            "error left",
            "spread over seeds",
            *(("left in test recordings",) if tested else ()),
            "seconds",
        )

    def rows(self) -> list[list[object]]:
        """Return each setting as its cells, the best first."""
        tested = "left in test recordings" in self.headings()
        return [
            [
                *(text_of(setting.settings, name) for name in self.varied),
                len(setting.trials),
                f"{setting.left:.1%}",
                "" if np.isnan(setting.spread) else f"{setting.spread:.1%}",
                *((f"{setting.test:.1%}",) if tested else ()),
                f"{setting.seconds:.0f}",
            ]
            for setting in self.ranked
        ]


def text_of(settings: TrainingSettings, name: str) -> str:
    """Return a setting as text, numbers with three digits."""
    value: Any = getattr(settings, name)
    return f"{value:.3g}" if isinstance(value, float) else str(value)


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
    # One page of all trials
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
    Page("Sweep", body or paragraph("no trial"), charts).save(folder / PAGE)
    if sweep.ranked and sweep.best.folder is not None:
        load_model(sweep.best.folder).save(folder / BEST)


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
    return {"data": [dots], "layout": axes}


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
