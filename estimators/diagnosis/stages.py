"""Stages of a diagnosis: how far it is, which failed, and which there was no time for."""

from __future__ import annotations

import time
from collections.abc import Callable
from contextvars import ContextVar
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
        if stage == "done" and whole < 1.0:
            return  # a part of the work, and not all of it
        reached = max(reached, whole * done)
        progress(stage, reached)

    return tell


@dataclass(frozen=True)
class Failure:
    """A stage that failed beside others that did not."""

    stage: str  # what it computes, e.g. "intervals of the parameters"
    error: Exception

    def __str__(self) -> str:
        text = " ".join(str(self.error).split())
        return f"{self.stage} ({type(self.error).__name__}{': ' * bool(text)}{text})"

    def note(self) -> str:
        """Say what is missing for it, in one sentence."""
        return f"A stage failed, and what it would have said is missing: {self}."


class OutOfTimeError(Exception):
    """The time of a diagnosis is over; `Budget.within` takes it."""


@dataclass
class Attempts:
    """Stages without which a verdict is still worth having, and those of them that failed."""

    failures: list[Failure] = field(default_factory=list[Failure])

    def at(self, stage: str, work: Callable[[], _Result], otherwise: _Result) -> _Result:
        """Return what a stage computes; where it fails, keep the error and return `otherwise`."""
        try:
            return work()
        except OutOfTimeError:
            raise
        except Exception as error:  # noqa: BLE001  # whatever it is, the verdict so far is known
            if all(known.stage != stage for known in self.failures):  # gone through twice
                self.failures.append(Failure(stage, error))
            return otherwise


@dataclass
class Budget:
    """Time for a diagnosis, counted from now.

    What a verdict cannot do without takes as long as it takes. Each stage that makes it better is
    begun while there is time, and broken off where its loops next ask for the time.
    """

    seconds: float = float("inf")
    skipped: list[str] = field(default_factory=list[str])  # stages without a result
    _began: float = field(default_factory=time.monotonic)

    @property
    def over(self) -> bool:
        """Whether the time is over."""
        return time.monotonic() - self._began > self.seconds

    def watched(self, progress: Progress) -> Progress:
        """Return what tells progress, and breaks off a stage that can be done without."""

        def tell(stage: str, done: float) -> None:
            progress(stage, done)
            end_if_late()

        return tell

    def within(self, stage: str, work: Callable[[], _Result], otherwise: _Result) -> _Result:
        """Return what a stage computes, or `otherwise` where the time is over."""
        if not self.over:
            inside = _INSIDE.set(self)
            try:
                return work()
            except OutOfTimeError:
                pass
            finally:
                _INSIDE.reset(inside)
        if stage not in self.skipped:
            self.skipped.append(stage)
        return otherwise

    def note(self) -> str:
        """Say what there was no time for, in one sentence; empty if nothing."""
        if not self.skipped:
            return ""
        return (
            f"The budget of {self.seconds:g} s ended the search early, and what is said is what was"
            f" proven until then. Not tried, or not to the end: {'; '.join(self.skipped)}."
        )


_INSIDE: ContextVar[Budget | None] = ContextVar("of what can be done without", default=None)


def end_if_late() -> None:
    """Break off a stage that a verdict can do without, where its time is over.

    For loops that take long; elsewhere it does nothing.

    Raises:
        OutOfTimeError: The time is over.
    """
    budget = _INSIDE.get()
    if budget is not None and budget.over:
        raise OutOfTimeError
