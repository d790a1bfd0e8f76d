"""The space of a sweep: which settings of training are tried.

```yaml
model: [mlp7, lstm-fcl]     # every combination of what is listed
features: drive             # one value: the same for all
hidden: [8, 16]
seed: [0, 1, 2]             # the spread over these is shown beside each setting
learning_rate: {from: 3e-4, to: 1e-2, scale: log}
draws: 4                    # numbers from each range, the same for each combination
```
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import product
from math import exp, log, prod
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from estimators.hybrid.training.settings import TrainingSettings, usual_settings
from limo_driver.errors import ConfigError
from limo_driver.runtime.declarations import read_yaml
from limo_driver.runtime.parameters import (
    REAL,
    TEXT,
    WHOLE,
    Declared,
    Parameter,
    parameter,
    parameters_of,
)

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path

    from limo_driver.runtime.declarations import Given

_MOST: Final = 10_000  # trials
_OWN: Final = ("device",)  # where it is trained, and not what
_SWEPT: Final = {
    item.name: item for item in parameters_of(TrainingSettings) if item.name not in _OWN
} | {"features": Parameter("features", kind=TEXT)}


@dataclass(frozen=True)
class SweptRange(Declared):
    """Numbers that are drawn between two."""

    low: float = parameter("", key="from")
    high: float = parameter("", key="to")
    scale: str = parameter("", of=("linear", "log"), default="linear")

    def __post_init__(self) -> None:
        super().__post_init__()
        if not self.low < self.high:
            raise ConfigError(f"from {self.low:g} to {self.high:g}, expected a larger number last")
        if self.scale == "log" and self.low <= 0:
            raise ConfigError(f"from {self.low:g}, expected a number above 0 on a log scale")

    def at(self, part: float) -> float:
        """Return the number at a part of the way, from 0 to 1."""
        if self.scale == "log":
            return exp(log(self.low) + part * log(self.high / self.low))
        return self.low + part * (self.high - self.low)


@dataclass(frozen=True)
class SweepSpace:
    """Settings that are tried: every combination of values, with every draw from the ranges.

    Args:
        values: Of settings of training, by name; those not named are the usual ones.
        ranges: From which numbers are drawn, by name.
        draws: From each range.
        draw_seed: Of the draws; the same gives the same, whatever else is in the space.

    Raises:
        ConfigError: There is no such setting, or a combination cannot be trained.
    """

    values: Mapping[str, tuple[Any, ...]]
    ranges: Mapping[str, SweptRange]
    draws: int = 1
    draw_seed: int = 0

    @classmethod
    def load(cls, path: Path) -> SweepSpace:
        """Read a space.yaml.

        Raises:
            ConfigError: Names what cannot be used, and its line.
        """
        said = read_yaml(path, "settings of training, such as `hidden: [8, 16]`")
        said.only(*_SWEPT, "draws", "draw_seed")
        values: dict[str, tuple[Any, ...]] = {}
        ranges: dict[str, SweptRange] = {}
        for name, known in _SWEPT.items():
            if name not in said:
                continue
            if known.kind in {REAL, WHOLE} and said[name].items is None:
                ranges[name] = said[name].make(SweptRange)
            else:
                values[name] = _values(said[name], known)
        draws, seed = (
            said.take(Parameter(name, kind=WHOLE, lower=lower)) if name in said else default
            for name, lower, default in (("draws", 1, 1), ("draw_seed", 0, 0))
        )
        if draws > 1 and not ranges:
            said["draws"].refuse("1 where there is no range `{from: ..., to: ...}` to draw from")
        return cls(values, ranges, draws, seed)

    @property
    def varied(self) -> tuple[str, ...]:
        """What differs from trial to trial, but for seeds."""
        listed = [name for name, values in self.values.items() if len(values) > 1]
        return tuple(name for name in (*listed, *self.ranges) if name != "seed")

    def settings(self, bandwidth: float) -> tuple[TrainingSettings, ...]:
        """Return the settings of every trial, in order; every one is checked.

        Args:
            bandwidth: Where the space has none [Hz].

        Raises:
            ConfigError: Names a combination that cannot be trained.
        """
        count = prod(map(len, self.values.values())) * (self.draws if self.ranges else 1)
        if count > _MOST:
            raise ConfigError(f"the space has {count} trials, expected {_MOST} at most")
        return tuple(
            self._made({"bandwidth": bandwidth, **dict(zip(self.values, chosen, strict=True)), **d})
            for chosen in product(*self.values.values())
            for d in self._drawn()
        )

    def _drawn(self) -> list[dict[str, Any]]:
        if not self.ranges:
            return [{}]
        parts = np.random.default_rng(self.draw_seed).random((self.draws, len(self.ranges)))
        return [
            {
                name: round(own.at(part)) if _SWEPT[name].kind == WHOLE else own.at(part)
                for (name, own), part in zip(self.ranges.items(), row, strict=True)
            }
            for row in parts.tolist()
        ]

    def _made(self, chosen: Mapping[str, Any]) -> TrainingSettings:
        try:
            usual = usual_settings(chosen.get("features", TrainingSettings.features))
            return replace(usual, **chosen)
        except ConfigError as error:
            said = ", ".join(f"{name}: {value}" for name, value in chosen.items())
            raise ConfigError(
                f"the space has a combination that cannot be: {error} ({said})"
            ) from None


def _values(given: Given, known: Parameter) -> tuple[Any, ...]:
    found = dict.fromkeys(item.value(known) for item in given.items or ())
    if not found:
        given.refuse(f"{known.expected}, or a list of such")
    return tuple(found)
