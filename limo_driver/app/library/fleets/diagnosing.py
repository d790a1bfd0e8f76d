"""Diagnose the recordings of a fleet of arms, one by one, and say what they tell together."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from limo_driver.app.library.fleets.sources import matched, rows_of
from limo_driver.app.library.inputs import simulation_of
from limo_driver.errors import ConfigError

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator, Sequence

    from estimators.fleet.outcome import FleetOutcome
    from estimators.fleet.result import FleetDiagnosis
    from estimators.fleet.row import FleetRow
    from estimators.fleet.store import FleetStore
    from limo_driver.app.library.fleets.job import FleetJob
    from limo_driver.physics import Simulation


def diagnose_fleet(
    recordings: Path | str | Iterable[Path | str],
    simulation: Simulation | Path | str,
    out: Path | str,
    *,
    bandwidth: float | None = None,
    workers: int | None = None,
    on: Literal["processes", "ray"] = "processes",
    progress: Callable[[FleetRow | None, int, int], None] | None = None,
) -> FleetDiagnosis:
    """Diagnose many recordings of one kind of arm side by side, and compare the arms.

    What is finished is kept in `out` at once: after any interruption, the same call goes on where
    it was. A recording is diagnosed anew where its bytes, the simulation, the bandwidth or the
    version of limo are others. Every worker is a process of its own, and in a program that is a
    file, the call has to stand behind `if __name__ == "__main__":`.

    Args:
        recordings: Files, or patterns such as `recordings/**/*.parquet`; URLs of objects, or
            patterns of them, such as `s3://bucket/**/*.parquet`, for each store that `fsspec` has.
            The folder of a file is the arm it is of; a date in its path is the date.
        simulation: What is believed of such arms, or its file.
        out: Folder for results.parquet, fleet.html and the diagnosis of each recording.
        bandwidth: Of the zero-phase filter on motion and torque [Hz]; if not given, 10, or what a
            recording can bear.
        workers: How many run at a time at most; one for each core if not given.
        on: "processes" of this machine, or a cluster of "ray": that of `RAY_ADDRESS`, else one
            that was started on this machine. Both give the same results.
        progress: Told each row as it is finished, how many are, and of how many; first of all
            without a row, how many were finished before.

    Returns:
        A row for each recording, also where it could not be used, and what they say together.

    Raises:
        ConfigError: A pattern matches no file, the folder cannot be written to, the simulation
            fits no recording, or nodes of the cluster have other versions of limo.

    Example:
        >>> fleet = limo.diagnose_fleet("recordings/**/*.parquet", "sim.yaml", "fleet/")
        >>> print(fleet)
    """
    from estimators.fleet.result import FleetDiagnosis
    from estimators.fleet.saving import save_fleet
    from estimators.fleet.store import FleetStore, digest_of
    from limo_driver.app.library.executors.running import check_place
    from limo_driver.app.library.fleets.job import FleetJob
    from limo_driver.runtime.outputs import only_writer, require_folder

    known, folder = simulation_of(simulation), Path(out)
    check_place(workers, on)
    found = matched(recordings)
    require_folder(folder, "the fleet", inputs=[item for item in found if isinstance(item, Path)])
    store = FleetStore(folder)
    with only_writer(folder):
        rows = rows_of(found, digest_of(known, bandwidth))
        ended = {
            row.recording: done
            for row in rows
            if (done := row if row.error else store.finished(row)) is not None
        }
        left = [row for row in rows if row.recording not in ended]
        if progress is not None:
            progress(None, len(ended), len(rows))
        for row, outcome in _outcomes(FleetJob(known, bandwidth), left, workers, on):
            done = _kept(store, row, outcome)
            ended[row.recording] = done
            if progress is not None:
                progress(done, len(ended), len(rows))
        others = store.of_other_versions({row.key for row in rows})
        all_rows = tuple(ended[row.recording] for row in rows)
        fleet = FleetDiagnosis(known.model.name, all_rows, others)
        save_fleet(fleet, folder)
    if len(fleet.failed) == len(rows):
        place = str(simulation) if isinstance(simulation, (Path, str)) else "the simulation"
        first = fleet.failed[0]
        raise ConfigError(
            f"{place}: fits none of {len(rows)} recordings; {first.recording}: {first.error}"
        )
    return fleet


def _outcomes(
    job: FleetJob, rows: Sequence[FleetRow], workers: int | None, on: str
) -> Iterator[tuple[FleetRow, FleetOutcome | str]]:
    """Diagnose rows, and give each as it ends.

    The first ones that cannot be read are told before any worker begins, which takes many seconds:
    a simulation that fits none of them needs no worker.
    """
    from limo_driver.app.library.executors.running import executor_of, run_all

    first = 0
    for row in rows:
        refused = job.refused(row)
        if refused is None:
            break
        first += 1
        yield row, refused
    if first < len(rows):
        yield from run_all(executor_of(job, workers, on), rows[first:])


def _kept(store: FleetStore, row: FleetRow, outcome: FleetOutcome | str) -> FleetRow:
    """Return a row with how it ended, which is on the disk by then, unless a machine failed it."""
    if isinstance(outcome, str):
        return replace(row, error=f"{outcome}, twice")
    store.keep(row.key, outcome)
    done = store.finished(row)
    if done is None:
        raise ConfigError("was written and cannot be read", path=store.place(row.key))
    return done
