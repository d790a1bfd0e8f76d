"""Trials of the paper's table on a cluster of Ray; this machine keeps what they give."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

from limo_driver.app.library.executors.job import attempted

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from estimators.reproduction.data import TableData
    from estimators.reproduction.trial import Trial, TrialResult
    from estimators.reproduction.trial_runner import TrialRunner
    from estimators.reproduction.workers import Failed, Finished, TrialPlace

_BASE: Final = 0.7e9  # [bytes] of a process that trains
_BY_SAMPLE: Final = 20e3  # [bytes] more for each sample that is trained on


@dataclass(frozen=True)
class TrialJob:
    """What all trials share, data included: nodes need no folder of this machine."""

    runner: TrialRunner

    def do(self, trial: Trial) -> TrialResult | Failed | str:
        """Train and score one trial.

        Args:
            trial: The row, the split and the run.
        """
        from estimators.reproduction.workers import Failed

        return attempted(lambda: self.runner.run(trial), lambda line: Failed(trial, line))

    def memory_of(self, trial: Trial) -> float:  # noqa: ARG002  # the same data for all
        """Return how much memory a trial takes at most [bytes]."""
        return _BASE + _BY_SAMPLE * len(self.runner.data.limo)


def run_trials_on_ray(
    place: TrialPlace, data: TableData, trials: Sequence[Trial], workers: int | None
) -> Iterator[Finished | Failed]:
    """Run trials on a cluster, each on one core, and keep what they give.

    Args:
        place: Where the identified rigid body is, and where trials are kept.
        data: The recordings, which are sent to the nodes.
        trials: In this order.
        workers: How many run side by side at most; as many as there are cores, if none.

    Returns:
        Each trial as it ends; a node that is lost costs its present trials one more try.

    Raises:
        ConfigError: The cluster cannot be used.
    """
    from estimators.reproduction.trial_runner import TrialRunner
    from estimators.reproduction.workers import Failed, Finished
    from limo_driver.app.library.executors.running import executor_of, run_all
    from limo_driver.physics import Simulation

    store = place.store()
    runner = TrialRunner(data, Simulation.load(place.simulation), place.device)
    for trial, outcome in run_all(executor_of(TrialJob(runner), workers, "ray"), trials):
        if isinstance(outcome, str):
            yield Failed(trial, f"{outcome}, twice")
        elif isinstance(outcome, Failed):
            yield outcome
        else:
            store.save(outcome)
            yield Finished(trial, outcome.seconds)
