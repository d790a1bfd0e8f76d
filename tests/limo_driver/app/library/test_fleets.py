"""A fleet's table survives kills, full disks and bad files, and says each by name.

Patterns find each file once, and come to an end where links lead round and round.
"""

import errno
import os
import re
import signal
import subprocess
import sys
import zipfile
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest
from fleet_recordings import record_swing

import limo_driver as limo
from estimators.diagnosis.verdict import Fit, RowCount, StatedValue, Unexplained, Verdict
from estimators.studies.fleet import FleetDiagnosis, FleetStore, digest_of, key_of
from estimators.studies.fleet_page import write_table
from estimators.studies.fleet_row import FleetOutcome, FleetRow
from limo_driver.app.library.executors import run_all
from limo_driver.app.library.fleets import FleetJob, files_of, matched, rows_of
from limo_driver.errors import ConfigError, RecordingError
from limo_driver.logs.readers.mapping import Channels, LogMapping, TimeColumns

pytestmark = pytest.mark.waits

DRIVER = """
import os, signal, sys
import limo_driver as limo

def tell(row, done, total):
    if row is not None:
        print(row.recording, row.folder, flush=True)
        os.kill(os.getpid(), signal.SIGKILL)

if __name__ == "__main__":
    limo.diagnose_fleet(sys.argv[1], sys.argv[2], sys.argv[3], workers=1, progress=tell)
"""


@pytest.fixture(scope="module")
def fleet(tmp_path_factory, two_links_urdf):
    """Three short recordings of two arms beside one that is none, and their simulation."""
    folder = tmp_path_factory.mktemp("fleet")
    simulation = limo.Simulation(str(two_links_urdf))
    simulation.save(folder / "sim.yaml")
    for k, name in enumerate(("a/2026-03-01", "a/2026-03-02", "b/2026-03-01")):
        record_swing(simulation, k, folder / f"{name}.parquet")
    (folder / "b" / "2026-03-02.parquet").write_text("none")
    return folder


def row_of(fleet: Path, name: str) -> tuple[FleetJob, FleetRow]:
    simulation = limo.Simulation.load(fleet / "sim.yaml")
    (row,) = rows_of([fleet / name], digest_of(simulation, 10.0))
    return FleetJob(simulation, 10.0), row


@pytest.mark.slow("starts processes that import and compile: half a minute")
def test_a_kill_of_driver_or_worker_loses_no_finished_row(fleet, tmp_path):
    pattern, out = f"{fleet}/*/*.parquet", tmp_path / "out"
    program = tmp_path / "driver.py"
    program.write_text(DRIVER)
    given = [sys.executable, program, pattern, fleet / "sim.yaml", out]
    killed = subprocess.run(given, capture_output=True, text=True, check=False)
    assert killed.returncode == -signal.SIGKILL, killed.stderr
    before = {path: path.stat().st_mtime_ns for path in out.glob("diagnoses/*/row.json")}
    assert before

    told: list[FleetRow] = []
    struck: list[int] = []

    def strike(row, done, total):
        if row is not None:
            told.append(row)
        if not struck and row is not None and done < total:
            (worker,) = children()
            struck.append(worker)
            os.kill(worker, signal.SIGKILL)

    found = limo.diagnose_fleet(pattern, fleet / "sim.yaml", out, workers=1, progress=strike)
    assert struck
    assert len(told) == 4 - len(before)
    assert all(path.stat().st_mtime_ns == then for path, then in before.items())
    assert [row.diagnosed for row in found.rows] == [True, True, True, False]
    table = pq.read_table(out / "results.parquet").to_pylist()
    assert [line["arm"] for line in table] == ["a", "a", "b", "b"]
    assert "Parquet" in table[3]["error"]
    assert (out / "fleet.html").read_text().count("/report.html") == 3


def children() -> list[int]:
    """Return the worker processes of this one."""
    import multiprocessing

    return [child.pid for child in multiprocessing.active_children() if child.pid]


def test_a_full_disk_leaves_no_row_and_is_said(fleet, tmp_path, monkeypatch):
    store = FleetStore(tmp_path)
    job, row = row_of(fleet, "b/2026-03-02.parquet")

    def full(self, *_, **__):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), str(self))

    outcome = job.do(row)
    with monkeypatch.context() as patch:
        patch.setattr(Path, "write_text", full)
        with pytest.raises(ConfigError, match="No space left"):
            store.keep(row.key, outcome)
    assert store.finished(row) is None
    store.keep(row.key, outcome)
    done = store.finished(row)
    assert done is not None
    assert "Parquet" in done.error


@pytest.mark.slow("diagnoses a recording")
def test_a_full_disk_where_it_runs_is_no_finished_row(fleet, monkeypatch):
    def full(*_):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    job, row = row_of(fleet, "a/2026-03-01.parquet")
    monkeypatch.setattr("limo_driver.runtime.outputs.sync", full)
    assert re.search("cannot be written: .*No space left", job.do(row))


@pytest.mark.parametrize(
    "failure",
    [OSError(errno.EIO, os.strerror(errno.EIO)), MemoryError()],
    ids=["disk", "memory"],
)
def test_what_the_machine_failed_is_no_finished_row(fleet, monkeypatch, failure):
    job, row = row_of(fleet, "b/2026-03-02.parquet")

    def read(path, *_):
        try:
            raise failure
        except OSError as error:  # as the readers of recordings do
            raise RecordingError(f"cannot be read: {error.strerror}", path=path) from None

    with monkeypatch.context() as patch:
        patch.setattr("limo_driver.app.library.reading.read", read)
        assert re.search("Input/output error|too little memory", job.do(row))
    assert "Parquet" in job.do(row).error  # the file itself is at fault now


def test_rows_of_other_versions_are_set_aside_and_told(tmp_path, monkeypatch):
    store = FleetStore(tmp_path)
    monkeypatch.setattr("estimators.studies.fleet.version", lambda _: "0.0.9")
    store.keep("of-before", FleetOutcome(1.0))
    monkeypatch.undo()
    store.keep("of-now", FleetOutcome(1.0))
    store.keep("counted", FleetOutcome(1.0))
    (tmp_path / "diagnoses" / "cut-off").mkdir()
    (tmp_path / "diagnoses" / "cut-off" / "row.json").write_text("{")
    aside = store.of_other_versions({"counted"})
    assert aside == {"0.0.9": 1}
    said = str(FleetDiagnosis("two_links", (), aside))
    assert "set aside: 1 diagnoses by limo 0.0.9" in said


def test_stated_values_and_those_that_fit_are_in_the_table(tmp_path):
    store, row = FleetStore(tmp_path), FleetRow(Path("a.parquet"), "key", "arm", None)
    own = ("f_v", "viscous_friction", (1,), ("a",), "N m s/rad", 2.0, 2.6, (2.5, 2.7), 0.3)
    values = (StatedValue(*own, assumed=True, beyond=False, reported=False, share=0.0),)
    fit, count = Fit((), (), (), 0.0, (0.0, 0.0)), RowCount(1, {})
    verdict = Verdict("consistent", (), Unexplained(), (), None, fit, count, values=values)
    verdict.save(tmp_path / "verdict.json")
    files = {"verdict.json": (tmp_path / "verdict.json").read_bytes()}
    store.keep("key", FleetOutcome(1.0, files=files))
    done = store.finished(row)
    assert done is not None
    write_table([done], tmp_path / "results.parquet")
    (value,) = pq.read_table(tmp_path / "results.parquet").to_pylist()[0]["values"]
    assert (value["kind"], value["parameter"], value["stated"]) == ("stated", "f_v", 2.0)
    assert (value["value"], value["ci95"]) == ("2.6", "[2.5, 2.7]")


def test_the_key_changes_with_bytes_simulation_and_bandwidth(fleet):
    simulation = limo.Simulation.load(fleet / "sim.yaml")
    other = limo.Simulation.load(fleet / "sim.yaml").model.urdf
    friction = limo.Simulation(str(other), tolerances=simulation.tolerances)
    assert digest_of(simulation, 10.0) == digest_of(friction, 10.0)
    assert digest_of(simulation, 10.0) != digest_of(simulation, 9.0)
    assert digest_of(simulation, 10.0) != digest_of(limo.Simulation("iiwa14"), 10.0)
    one, two = (key_of([fleet / f"a/2026-03-0{k}.parquet"], "x") for k in (1, 2))
    assert one != two


def test_logs_of_another_format_are_read_as_one_mapping_says(fleet, tmp_path):
    measured = limo.Recording.load(fleet / "a/2026-03-01.parquet")
    columns = (measured.time, *np.rad2deg(measured.position).T, *measured.torque.T)
    path = tmp_path / "arm" / "log.csv"
    path.parent.mkdir()
    names = "t,one,two,m_one,m_two"
    np.savetxt(path, np.stack(columns, axis=1), delimiter=",", header=names, comments="")
    simulation = limo.Simulation.load(fleet / "sim.yaml")
    mapping = LogMapping(
        joints=simulation.model.joint_names,
        time=TimeColumns(columns=("t",)),
        position=Channels(columns=("one", "two"), unit=("deg",)),
        torque=Channels(columns=("m_one", "m_two"), unit=("Nm",)),
    )
    (row,) = rows_of([path], digest_of(simulation, 10.0, mapping.as_file))
    assert FleetJob(simulation, 10.0, mapping).refused(row) is None
    refused = FleetJob(simulation, 10.0).refused(row)
    assert "no name says what they are: is it position: one, two" in refused.error
    assert digest_of(simulation, 10.0) != digest_of(simulation, 10.0, mapping.as_file)


class Machine:
    """Room for one row at a time; it fails each as often as is said, and says what was done."""

    def __init__(self, failures: dict[str, int]) -> None:
        self.failures, self.rows, self.closed = dict(failures), [], False

    def has_room(self, _row):
        return not self.rows

    def submit(self, row):
        self.rows.append(row)

    def ended(self):
        row = self.rows.pop()
        self.failures[row.key] -= 1
        return [(row, "died" if self.failures[row.key] >= 0 else FleetOutcome(1.0))]

    def close(self):
        self.closed = True


def test_what_a_machine_fails_is_tried_twice_after_the_others():
    machine = Machine({"a": 0, "b": 1, "c": 2})
    rows = [FleetRow(Path(key), key, "arm", None) for key in "cba"]
    ended = [(row.key, outcome) for row, outcome in run_all(machine, rows)]
    assert ended == [("a", FleetOutcome(1.0)), ("c", "died"), ("b", FleetOutcome(1.0))]
    assert machine.closed


def test_a_pool_runs_no_more_than_memory_bears(fleet, monkeypatch):
    from limo_driver.app.library import executors

    class Worker:
        def __init__(self, *_):
            self.connection = object()

        def start(self, row):
            self.task = row

    job, row = row_of(fleet, "a/2026-03-01.parquet")
    monkeypatch.setattr(executors, "WorkerProcess", Worker)
    monkeypatch.setattr(executors, "_available", lambda: 2.5 * job.memory_of(row))
    pool = executors.ProcessPool(job, 8)
    for _ in range(2):
        assert pool.has_room(row)
        pool.submit(row)
    assert not pool.has_room(row)


@pytest.mark.slow("diagnoses a recording twice")
def test_objects_of_a_store_are_recordings_too(fleet, tmp_path):
    archive = tmp_path / "recordings.zip"
    with zipfile.ZipFile(archive, "w") as file:
        for path in (fleet / "a").iterdir():
            file.write(path, f"a/{path.name}")
    simulation = limo.Simulation.load(fleet / "sim.yaml")
    found = matched(f"zip://**/*.parquet::{archive}")
    assert found == tuple(f"zip://a/2026-03-0{day}.parquet::{archive}" for day in (1, 2))
    rows = rows_of(found, "x")
    assert [(row.arm, row.date.day, row.bytes > 0) for row in rows] == [
        ("a", 1, True),
        ("a", 2, True),
    ]
    assert len({row.key for row in rows} | {row.key for row in rows_of(found, "y")}) == 4
    (_, own) = row_of(fleet, "a/2026-03-01.parquet")
    from_file, from_store = (FleetJob(simulation, 10.0).do(row) for row in (own, rows[0]))
    assert from_store.files["verdict.json"] == from_file.files["verdict.json"]
    assert from_store.files["report.html"].count(b"zip://a/2026-03-01.parquet") == 1
    with pytest.raises(ConfigError, match=r"zip://\*.csv::.*: matches no file"):
        matched(f"zip://*.csv::{archive}")
    with pytest.raises(ConfigError, match="nowhere://x: cannot be listed: Protocol not known"):
        matched("nowhere://x")


def test_patterns_that_match_nothing_are_said(fleet, tmp_path):
    with pytest.raises(ConfigError, match="none/\\*\\*: matches no file"):
        matched("none/**")
    assert len(matched(f"{fleet}/**/*.parquet")) == 4
    with pytest.raises(ConfigError, match="workers is 0"):
        limo.diagnose_fleet("none/**", fleet / "sim.yaml", tmp_path, workers=0)


def test_a_link_to_nothing_is_a_row_that_says_so(tmp_path):
    (tmp_path / "gone.parquet").symlink_to(tmp_path / "nowhere")
    (row,) = rows_of(matched(f"{tmp_path}/*.parquet"), "")
    assert row.error == "cannot be read: No such file or directory"


def test_a_pipe_is_a_row_that_says_so_and_nobody_waits_for_it(tmp_path):
    os.mkfifo(tmp_path / "pipe.parquet")
    (row,) = rows_of(matched(f"{tmp_path}/*"), "")
    assert row.error == "cannot be read: it is a pipe or a device, expected a file"


def test_a_simulation_that_fits_no_recording_is_named_before_any_worker(
    fleet, tmp_path, monkeypatch
):
    def start(*_):
        raise AssertionError

    monkeypatch.setattr("limo_driver.app.library.executors.executor_of", start)
    limo.Simulation("iiwa14").save(tmp_path / "iiwa.yaml")
    with pytest.raises(ConfigError, match=r"iiwa.yaml: fits none of 2 recordings; .*has 2 joints"):
        limo.diagnose_fleet(f"{fleet}/a/*", tmp_path / "iiwa.yaml", tmp_path / "out", workers=1)


@pytest.fixture
def tree(tmp_path, monkeypatch):
    """Two arms, a folder elsewhere that is linked, and links that lead back."""
    for name in ("arms/a/1.csv", "arms/a/old/2.csv", "arms/b/3.csv", "arms/.hidden/4.csv"):
        place = tmp_path / name
        place.parent.mkdir(parents=True, exist_ok=True)
        place.touch()
    (tmp_path / "store").mkdir()
    (tmp_path / "store" / "5.csv").touch()
    (tmp_path / "arms" / "again").symlink_to(tmp_path / "arms")
    (tmp_path / "arms" / "a" / "up").symlink_to(tmp_path)
    (tmp_path / "arms" / "0_same").symlink_to("b")
    (tmp_path / "arms" / "b" / "lost.csv").symlink_to("nowhere")
    monkeypatch.chdir(tmp_path)
    return tmp_path


def names(pattern):
    return [str(path) for path in files_of(pattern)]


def test_any_depth_ends_where_links_lead_back(tree):
    assert names("arms/**/*.csv") == [
        "arms/a/1.csv",
        "arms/a/old/2.csv",
        "arms/a/up/store/5.csv",
        "arms/b/3.csv",
        "arms/b/lost.csv",
    ]
    assert names(f"{tree}/arms/**/old/*.csv") == [f"{tree}/arms/a/old/2.csv"]
    assert names("**/old/**/2.csv") == ["arms/a/old/2.csv"]
    assert names("**/3.csv") == ["arms/b/3.csv"]


def test_a_link_that_is_given_is_followed(tree):
    assert names("arms/0_same/*.csv") == ["arms/0_same/3.csv", "arms/0_same/lost.csv"]
    (tree / "arms" / "c").symlink_to(tree / "store")
    (tree / "arms" / "a" / "up").unlink()
    assert names("arms/**/5.csv") == ["arms/c/5.csv"]


def test_a_folder_that_is_a_log_is_one_recording(tree):
    inside = tree / "arms" / "a" / "2026-01-05"
    (inside / "meta").mkdir(parents=True)
    (inside / "meta" / "info.json").write_text("{}")
    (inside / "data.csv").touch()
    assert names("arms/a/2026*") == ["arms/a/2026-01-05"]
    assert "arms/a/2026-01-05" in names("arms/a/**")
    assert not [name for name in names("arms/a/**") if name.startswith("arms/a/2026-01-05/")]
    (row,) = rows_of(matched("arms/a/2026*"), "")
    assert (row.arm, row.bytes, row.error) == ("a", 2, "")
    (inside / "data.csv").write_text("1")
    (other,) = rows_of(matched("arms/a/2026-01-05"), "")
    assert other.key != row.key


@pytest.mark.usefixtures("tree")
def test_folders_and_nothing_are_no_files():
    assert names("none/**") == []
    assert names("arms/*") == []
    assert "arms/b/3.csv" in names("arms/**")
