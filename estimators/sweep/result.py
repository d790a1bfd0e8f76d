"""The result of a sweep: its trials, ranked, and the best of them."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np

from limo_driver.errors import ConfigError
from limo_driver.runtime.display import Displayed

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from estimators.hybrid.training.settings import TrainingSettings
    from estimators.sweep.trial import SweepTrial

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
        said = ", ".join(f"{name} {text_of(best.settings, name)}" for name in self.varied)
        test = "" if np.isnan(best.test) else f", {best.test:.1%} in the test recordings"
        return (
            f"{done} of {len(self.trials)} trials trained. Best: {said or best.settings.model}, "
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
