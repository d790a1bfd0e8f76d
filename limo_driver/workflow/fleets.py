"""Diagnose the recordings of a fleet of arms, one by one, and say what they tell together."""

from __future__ import annotations

import os
from dataclasses import replace
from glob import glob
from pathlib import Path
from typing import TYPE_CHECKING

from limo_driver.errors import ConfigError
from limo_driver.workflow.inputs import simulation_of

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable

    from estimators.fleet.result import FleetDiagnosis
    from estimators.fleet.row import FleetRow
    from limo_driver.physics import Simulation


def diagnose_fleet(
    recordings: Path | str | Iterable[Path | str],
    simulation: Simulation | Path | str,
    out: Path | str,
    *,
    bandwidth: float | None = None,
    workers: int | None = None,
    progress: Callable[[FleetRow | None, int, int], None] | None = None,
) -> FleetDiagnosis:
    """Diagnose many recordings of one kind of arm side by side, and compare the arms.

    What is finished is kept in `out` at once: after any interruption, the same call goes on where
    it was. A recording is diagnosed anew where its bytes, the simulation, the bandwidth or the
    version of limo are others. Every worker is a process of its own, and in a program that is a
    file, the call has to stand behind `if __name__ == "__main__":`.

    Args:
        recordings: Files, or patterns such as `recordings/**/*.parquet`. The folder of a file is
            the arm it is of; a date in its path is the date.
        simulation: What is believed of such arms, or its file.
        out: Folder for results.parquet, fleet.html and the diagnosis of each recording.
        bandwidth: Of the zero-phase filter on motion and torque [Hz]; if not given, 10, or what a
            recording can bear.
        workers: How many run at a time; one for each core if not given.
        progress: Told each row as it is finished, how many are, and of how many; first of all
            without a row, how many were finished before.

    Returns:
        A row for each recording, also where it could not be used, and what they say together.

    Raises:
        ConfigError: A pattern matches no file, the folder cannot be written to, or the simulation
            fits no recording.

    Example:
        >>> fleet = limo.diagnose_fleet("recordings/**/*.parquet", "sim.yaml", "fleet/")
        >>> print(fleet)
    """
    from estimators.fleet.result import FleetDiagnosis
    from estimators.fleet.saving import save_fleet
    from estimators.fleet.store import FleetStore, digest_of
    from limo_driver.outputs import only_writer, require_folder
    from limo_driver.workflow.fleet_workers import FleetJob, run_fleet

    known, folder = simulation_of(simulation), Path(out)
    wanted = workers if workers is not None else len(os.sched_getaffinity(0))
    if wanted < 1:
        raise ConfigError(f"workers is {wanted}, expected at least 1")
    files = matched(recordings)
    require_folder(folder, "the fleet", inputs=files)
    store = FleetStore(folder)
    with only_writer(folder):
        rows = _rows(files, digest_of(known, bandwidth))
        ended = {
            row.recording: done
            for row in rows
            if (done := row if row.error else store.finished(row)) is not None
        }
        left = [row for row in rows if row.recording not in ended]
        if progress is not None:
            progress(None, len(ended), len(rows))
        for row, died in run_fleet(FleetJob(known, store, bandwidth), left, wanted):
            done = replace(row, error=died) if died else store.finished(row)
            if done is None:
                raise ConfigError("was written and cannot be read", path=store.place(row.key))
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


def matched(recordings: Path | str | Iterable[Path | str]) -> tuple[Path, ...]:
    """Return the files that names and patterns stand for, each once, in order.

    Raises:
        ConfigError: A pattern matches no file.
    """
    given = [recordings] if isinstance(recordings, (Path, str)) else list(recordings)
    files: dict[Path, None] = {}
    for item in given:
        if Path(item).is_file():  # also a name with brackets in it
            found = [Path(item)]
        else:
            places = map(Path, sorted(glob(str(item), recursive=True)))
            # `glob` gives the folder of `none/**` also where there is none
            found = [path for path in places if path.exists() and not path.is_dir()]
        if not found:
            raise ConfigError(f"{item}: matches no file, expected recordings")
        files |= dict.fromkeys(found)
    if not files:
        raise ConfigError("no recordings given, expected files or patterns")
    return tuple(files)


def _rows(files: Iterable[Path], simulation: str) -> list[FleetRow]:
    """Return a row for each file; those that cannot be read or are there twice have an error."""
    from estimators.fleet.row import FleetRow, arm_of, date_of
    from estimators.fleet.store import key_of

    rows: list[FleetRow] = []
    first: dict[str, Path] = {}
    for path in files:
        try:
            key, error = key_of(path, simulation), ""
        except OSError as failure:
            key, error = "", f"cannot be read: {failure.strerror}"
        else:
            if first.setdefault(key, path) != path:
                error = f"the same recording as {first[key]}, and counted once"
        rows.append(FleetRow(path, key, arm_of(path), date_of(path), error=error))
    return rows
