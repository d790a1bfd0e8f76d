"""Show the progress of `limo reproduce` while its trials run."""

from __future__ import annotations

from collections import defaultdict
from typing import TYPE_CHECKING, Self

from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn

from estimators.reproduction.rows import RBD

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from rich.console import Console
    from rich.progress import TaskID

    from estimators.reproduction.trial import Trial, TrialResult

_HOUR, _MINUTE = 3600, 60  # [s]


class TrialProgress:
    """Progress bars on a terminal, else one line for each trial.

    Args:
        console: Where to.
        trials: All of them.
        before: Those that were finished before.
        processes: How many run side by side.
    """

    def __init__(
        self,
        console: Console,
        trials: Sequence[Trial],
        before: Iterable[TrialResult],
        processes: int | None,
    ) -> None:
        self.console, self.processes = console, processes
        self.seconds: dict[str, list[float]] = defaultdict(list)  # of finished trials, by row
        self.rest = {trial.file_name: trial for trial in trials}
        self.total = len(trials)
        for result in before:
            self._done(result.trial, result.seconds)
        columns = (
            TextColumn("{task.description}", markup=False),
            BarColumn(),
            MofNCompleteColumn(),
            TextColumn("{task.fields[note]}", markup=False),
        )
        disable = not console.is_terminal
        self.progress = Progress(*columns, console=console, transient=True, disable=disable)
        self.bars: dict[str, TaskID] = {}
        self.all = self.progress.add_task("trials", total=self.total, note="")

    def __enter__(self) -> Self:
        self._count()
        self.progress.start()
        return self

    def __exit__(self, *_: object) -> None:
        self.progress.stop()

    def advanced(self, trial: Trial, epoch: int) -> None:
        """Show that a trial has gone through an epoch."""
        name = trial.file_name
        if name not in self.bars:
            self.bars[name] = self.progress.add_task(
                _title(trial), total=trial.settings.epochs, note="epochs"
            )
        self.progress.update(self.bars[name], completed=epoch)

    def finished(self, trial: Trial, seconds: float) -> None:
        """Show that a trial is done."""
        self._done(trial, seconds)
        self._close(trial, f"{_clock(seconds)}")

    def failed(self, trial: Trial, reason: str) -> None:
        """Show that a trial came to no end."""
        self.rest.pop(trial.file_name)
        self._close(trial, f"failed: {reason}")

    def _done(self, trial: Trial, seconds: float) -> None:
        del self.rest[trial.file_name]
        self.seconds[trial.row.name].append(seconds)

    def _close(self, trial: Trial, how: str) -> None:
        bar = self.bars.pop(trial.file_name, None)
        if bar is not None:
            self.progress.remove_task(bar)
        count = self.total - len(self.rest)
        self.console.print(f"{count}/{self.total}  {_title(trial)}: {how}{self._left()}")
        self._count()

    def _count(self) -> None:
        self.progress.update(
            self.all, completed=self.total - len(self.rest), note=self._left().lstrip("; ")
        )

    def _left(self) -> str:
        """Say how long the rest will take, if each row takes as long as it took before.

        Rows without any finished trial are taken to be like the others that are trained.
        """
        every = [s for name, own in self.seconds.items() if name != RBD.name for s in own]
        if not every or not self.rest or self.processes is None:
            return ""
        seconds = sum(
            _mean(self.seconds.get(trial.row.name) or every) for trial in self.rest.values()
        )
        return f"; about {_clock(seconds / self.processes)} left"


def _title(trial: Trial) -> str:
    return f"{trial.row.name}, {trial.split}, run {trial.run}"


def _mean(values: Sequence[float]) -> float:
    return sum(values) / len(values)


def _clock(seconds: float) -> str:
    if seconds < _MINUTE:
        return f"{seconds:.1f} s"
    if seconds < _HOUR:
        return f"{seconds / _MINUTE:.1f} min"
    return f"{seconds / _HOUR:.1f} h"
