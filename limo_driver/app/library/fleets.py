"""Fleets: recordings by pattern or URL, diagnosed one by one."""

from __future__ import annotations

import os
from contextlib import contextmanager
from dataclasses import dataclass, replace
from errno import EINVAL
from glob import escape, glob
from pathlib import Path
from stat import S_ISREG
from tempfile import TemporaryDirectory
from time import perf_counter
from typing import TYPE_CHECKING, Any, Final, Literal

from limo_driver.app.library.executors import attempted
from limo_driver.app.library.inputs import simulation_of
from limo_driver.errors import ConfigError, LimoError
from limo_driver.logs.readers.formats.reading import is_log

if TYPE_CHECKING:
    from collections.abc import Callable, Generator, Iterable, Iterator, Sequence

    from estimators.studies.fleet import FleetDiagnosis, FleetStore
    from estimators.studies.fleet_row import FleetOutcome, FleetRow
    from limo_driver.logs.readers.mapping import LogMapping
    from limo_driver.physics import Simulation
    from limo_driver.recordings.recording import Recording

# As `benchmarks/fleet/cost.py` finds them, of seven joints and Parquet.
_BASE: Final = 0.45e9  # [bytes] of a process that diagnoses
_BY_SIZE: Final = 110.0  # [bytes] more for each of a recording's file
_LARGEST: Final = 5e9  # [bytes] more, whatever the length: longer ones are thinned out
_READ: Final = 6.0  # [bytes] more for each, while it is read in full
_ANY_DEPTH: Final = "**"


def diagnose_fleet(
    recordings: Path | str | Iterable[Path | str],
    simulation: Simulation | Path | str,
    out: Path | str,
    *,
    mapping: LogMapping | Path | str | None = None,
    bandwidth: float | None = None,
    workers: int | None = None,
    on: Literal["processes", "ray"] = "processes",
    progress: Callable[[FleetRow | None, int, int], None] | None = None,
) -> FleetDiagnosis:
    """Diagnose many recordings of one kind of arm side by side, and compare the arms.

    What is finished is kept in `out` at once: after any interruption, the same call goes on where
    it was. A recording is diagnosed anew where its bytes, the simulation, the mapping, the
    bandwidth or the version of limo are others. Every worker is a process of its own, and in a
    program that is a file, the call has to stand behind `if __name__ == "__main__":`.

    Args:
        recordings: Files, or patterns such as `recordings/**/*.parquet`; URLs of objects, or
            patterns of them, such as `s3://bucket/**/*.parquet`, for each store that `fsspec` has.
            The folder of a file is the arm it is of; a date in its path is the date.
        simulation: What is believed of such arms, or its file.
        out: Folder for results.parquet, fleet.html and the diagnosis of each recording.
        mapping: Which columns of all these logs are what, or the file that says so; logs in any
            format that leave nothing to be decided need none.
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
    from estimators.studies.fleet import FleetDiagnosis, FleetStore, digest_of
    from estimators.studies.fleet_page import save_fleet
    from limo_driver.app.library.executors import check_place
    from limo_driver.app.library.reading import mapping_of
    from limo_driver.runtime.outputs import only_writer, require_folder

    known, folder, used = simulation_of(simulation), Path(out), mapping_of(mapping)
    check_place(workers, on)
    found = matched(recordings)
    require_folder(folder, "the fleet", inputs=[item for item in found if isinstance(item, Path)])
    store = FleetStore(folder)
    with only_writer(folder):
        use = (bandwidth,) if used is None else (bandwidth, used.as_file)
        rows = rows_of(found, digest_of(known, *use))
        ended = {
            row.recording: done
            for row in rows
            if (done := row if row.error else store.finished(row)) is not None
        }
        left = [row for row in rows if row.recording not in ended]
        if progress is not None:
            progress(None, len(ended), len(rows))
        for row, outcome in _outcomes(FleetJob(known, bandwidth, used), left, workers, on):
            done = _kept(store, row, outcome)
            ended[row.recording] = done
            if progress is not None:
                progress(done, len(ended), len(rows))
        others = store.of_other_versions({row.key for row in rows})
        all_rows = tuple(ended[row.recording] for row in rows)
        fleet = FleetDiagnosis(known.model.name, all_rows, others, known.model.joint_names)
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
    from limo_driver.app.library.executors import executor_of, run_all

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


@dataclass(frozen=True)
class FleetJob:
    """What all diagnoses of a fleet share."""

    simulation: Simulation
    bandwidth: float | None  # [Hz]; what suits a recording, if none
    mapping: LogMapping | None = None  # of all recordings, where they are logs of another format

    def do(self, row: FleetRow) -> FleetOutcome | str:
        """Diagnose one recording on one thread.

        Args:
            row: Whose recording is read.

        Returns:
            How it ended; or, if it was the machine or limo itself that failed, why.
        """
        from estimators.studies.fleet_row import FleetOutcome, outcome_of
        from limo_driver.app.library.diagnosing import diagnose

        start = perf_counter()

        def diagnosed() -> FleetOutcome:
            found = diagnose(self.simulation, self._read(row), bandwidth=self.bandwidth)
            return outcome_of(found, perf_counter() - start)

        return attempted(diagnosed, lambda line: FleetOutcome(perf_counter() - start, line))

    def memory_of(self, row: FleetRow) -> float:
        """Return how much memory a diagnosis takes at most [bytes], by its recording's size."""
        return _BASE + min(_BY_SIZE * row.bytes, _LARGEST) + _READ * row.bytes

    def refused(self, row: FleetRow) -> FleetOutcome | None:
        """Return how a recording ended that cannot be read as one of this arm; None, if it can."""
        from estimators.studies.fleet_row import FleetOutcome

        start = perf_counter()
        found = attempted(
            lambda: self._read(row), lambda line: FleetOutcome(perf_counter() - start, line)
        )
        return found if isinstance(found, FleetOutcome) else None

    def _read(self, row: FleetRow) -> Recording:
        from limo_driver.app.library.reading import read

        with at_hand(row.recording) as path:
            try:
                recording = read(path, self.simulation.model, self.mapping)
            except LimoError as error:  # the row names the recording, and not where its copy lay
                raise LimoError(str(error).removeprefix(f"{path}: ")) from error
            return replace(recording, source=str(row.recording))


def matched(
    given: Path | str | Iterable[Path | str], wanted: str = "recordings"
) -> tuple[Path | str, ...]:
    """Return the files and URLs that names and patterns stand for, each once, in order.

    Args:
        given: Names and patterns.
        wanted: What they should stand for.

    Raises:
        ConfigError: A pattern matches nothing, or its store cannot be listed.
    """
    found: dict[Path | str, None] = {}
    for item in [given] if isinstance(given, (Path, str)) else given:
        is_url = isinstance(item, str) and "://" in item and not Path(item).exists()
        places = _objects(str(item)) if is_url else _files(item)
        if not places:
            raise ConfigError(f"{item}: matches no file, expected {wanted}")
        found |= dict.fromkeys(places)
    if not found:
        raise ConfigError(f"no {wanted} given, expected files or patterns")
    return tuple(found)


def rows_of(recordings: Iterable[Path | str], simulation: str) -> list[FleetRow]:
    """Return a row for each recording; one that cannot be read or is there twice has an error.

    Args:
        recordings: Files and URLs.
        simulation: Digest of the simulation and how it is used.
    """
    from estimators.studies.fleet_row import FleetRow, arm_of, date_of

    rows: list[FleetRow] = []
    first: dict[str, Path | str] = {}
    for place in recordings:
        key, size, error = "", 0, ""
        try:
            key, size = key_and_size(place, simulation)
        except OSError as failure:
            error = f"cannot be read: {failure.strerror or failure}"
        else:
            if first.setdefault(key, place) != place:
                error = f"the same recording as {first[key]}, and counted once"
        arm, date = arm_of(place), date_of(place)
        rows.append(FleetRow(place, key, arm, date, bytes=size, error=error))
    return rows


def key_and_size(place: Path | str, shared: str) -> tuple[str, int]:
    """Return the key of a file or object, which changes with it, and how large it is [bytes].

    Args:
        place: File or URL.
        shared: Digest of all else that its result depends on.

    Raises:
        OSError: It cannot be read.
    """
    from estimators.studies.fleet import key_of, key_of_object

    if isinstance(place, Path):
        files = sorted(place.rglob("*")) if place.is_dir() else [place]
        files = [file for file in files if not file.is_dir()]
        sizes = [file.stat() for file in files]
        if not all(S_ISREG(about.st_mode) for about in sizes):  # a pipe waits for who writes to it
            raise OSError(EINVAL, "it is a pipe or a device, expected a file")
        return key_of(files, shared), sum(about.st_size for about in sizes)
    store, path = _store_of(place)
    return key_of_object(store.ukey(path), shared), store.size(path) or 0


@contextmanager
def at_hand(place: Path | str) -> Generator[Path]:
    """Give what lies at a place as a file on this machine; that of an object goes in the end."""
    if isinstance(place, Path):
        yield place
        return
    store, path = _store_of(place)
    with TemporaryDirectory() as folder:
        copy = Path(folder) / Path(path).name
        store.get_file(path, str(copy))
        yield copy


def _files(item: Path | str) -> list[Path]:
    if Path(item).is_file() or (Path(item).is_dir() and is_log(Path(item))):  # also with brackets
        return [Path(item)]
    return files_of(str(item))


def _objects(pattern: str) -> list[str]:
    """Return the URLs that match; `zip://**/*.csv::s3://...` are files of an archive in a store."""
    outer = pattern.split("::")[1:]
    try:
        store, path = _store_of(pattern)
        about = store.glob(path, detail=True)
        found = sorted(name for name in about if about[name]["type"] != "directory")
        return ["::".join([store.unstrip_protocol(name), *outer]) for name in found]
    except Exception as error:  # each kind of store has errors of its own
        line = " ".join(str(error).split())
        raise ConfigError(f"{pattern}: cannot be listed: {line}") from error


def _store_of(url: str) -> tuple[Any, str]:
    """Return the file system of a URL, as `fsspec` knows it, and the path there."""
    from fsspec.core import url_to_fs

    return url_to_fs(url)


def files_of(pattern: str) -> list[Path]:
    """Return the files that match, each once, in order; a link to nothing is among them.

    A folder that is a log counts as a file, and what lies in it does not.

    `**` stands for any number of folders, linked ones included. `glob` of Python would follow a
    link to a folder above it round and round.

    Args:
        pattern: As a shell has it.
    """
    found = dict.fromkeys(sorted(_matching(pattern)))
    places = [place for place in map(Path, found) if os.path.lexists(place)]
    logs = {place for place in places if place.is_dir() and is_log(place)}
    within = (place for place in places if logs.isdisjoint(place.parents))
    return [place for place in within if place in logs or not place.is_dir()]


def _matching(pattern: str) -> Iterator[str]:
    parts = Path(pattern).parts
    if _ANY_DEPTH not in parts:
        yield from glob(pattern)
        return
    at = parts.index(_ANY_DEPTH)
    rest = Path(*(parts[at + 1 :] or ("*",)))
    for top in sorted(glob(str(Path(*parts[:at])))) if at else ["."]:
        for folder in _folders(Path(top)):
            yield from _matching(str(Path(escape(str(folder))) / rest))


def _folders(top: Path) -> Iterator[Path]:
    """Yield a folder and all below it but hidden ones, each once: by its own name before a link."""
    seen: set[str] = set()
    waiting = [top]
    while waiting:
        links: list[Path] = []
        for start in waiting:
            for name, folders, _ in os.walk(start):
                folder = Path(name)
                if (real := os.path.realpath(folder)) in seen:
                    folders.clear()
                    continue
                seen.add(real)
                yield folder
                below = [folder / each for each in sorted(folders) if not each.startswith(".")]
                links += [each for each in below if each.is_symlink()]
                folders[:] = [each.name for each in below if not each.is_symlink()]
        waiting = links
