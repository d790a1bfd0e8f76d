"""Stages of a diagnosis: how far it is, and which of the later ones failed."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import TypeAlias, TypeVar

Progress: TypeAlias = Callable[[str, float], None]
"""Told the stage and the part of the work that is done, 0 to 1."""

_Result = TypeVar("_Result")


def quiet(_stage: str, _done: float) -> None:
    """Report no progress."""


def forward(progress: Progress, whole: float = 1.0) -> Progress:
    """Return what tells progress that never goes back, although stages are gone through again.

    Args:
        progress: Who is told.
        whole: Part of the work that 1 stands for.
    """
    reached = 0.0

    def tell(stage: str, done: float) -> None:
        nonlocal reached
        reached = max(reached, whole * done)
        progress(stage, reached)

    return tell


@dataclass(frozen=True)
class Failure:
    """A stage that failed beside others that did not."""

    stage: str  # what it computes, e.g. "intervals of the parameters"
    error: Exception

    def __str__(self) -> str:
        said = " ".join(str(self.error).split())
        return f"{self.stage} ({type(self.error).__name__}{': ' * bool(said)}{said})"

    def note(self) -> str:
        """Say what is missing for it, in one sentence."""
        return f"A stage failed, and what it would have said is missing: {self}."


@dataclass
class Attempts:
    """Stages without which a verdict is still worth having, and those of them that failed."""

    failures: list[Failure] = field(default_factory=list[Failure])

    def at(self, stage: str, work: Callable[[], _Result], otherwise: _Result) -> _Result:
        """Return what a stage computes; where it fails, keep the error and return `otherwise`."""
        try:
            return work()
        except Exception as error:  # noqa: BLE001  # whatever it is, the verdict so far is known
            self.failures.append(Failure(stage, error))
            return otherwise
