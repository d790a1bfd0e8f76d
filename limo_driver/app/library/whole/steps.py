"""Steps of the proof of the whole, how long they take, and what came of them."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from limo_driver.app.library.whole.processes import ProvenWire


@dataclass(frozen=True)
class Step:
    """What came of one step.

    Args:
        name: What was proven.
        figure: What was measured, with its unit.
        bar: What it is held to.
        held: Whether it is.
    """

    name: str
    figure: str
    bar: str
    held: bool


@dataclass
class Proof:
    """The steps, what a consumer felt, and how long all took."""

    wire: ProvenWire
    steps: list[Step] = field(default_factory=list)
    felt: list[tuple[Any, Any]] = field(default_factory=list)  # stamps [ns], external [N m]
    seconds: float = 0.0
    failure: str = ""  # why it ended early

    @property
    def held(self) -> bool:
        """Whether every step was reached and held to its bar."""
        return not self.failure and all(step.held for step in self.steps)
