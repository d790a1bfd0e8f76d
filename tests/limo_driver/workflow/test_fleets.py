"""A fleet's table survives kills, full disks and bad files, and says each by name."""

import errno
import os
import re
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest

import limo_driver as limo
from estimators.fleet.result import FleetDiagnosis
from estimators.fleet.row import FleetRow
from estimators.fleet.store import FleetStore, digest_of, key_of
from limo_driver.errors import ConfigError, RecordingError
from limo_driver.workflow.fleet_workers import FleetJob, diagnose_row
from limo_driver.workflow.fleets import matched

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
    time = np.arange(0.0, 6.0, 0.01)
    for k, name in enumerate(("a/2026-03-01", "a/2026-03-02", "b/2026-03-01")):
        random = np.random.default_rng(k)
        position = np.stack([0.8 * np.sin((1 + 0.1 * k) * time), 0.7 * np.cos(1.3 * time)], axis=1)
        still = limo.Recording.from_arrays(time, position, np.zeros_like(position))
        torque = simulation.predict(still) + 0.02 * random.standard_normal(position.shape)
        (folder / name).parent.mkdir(exist_ok=True)
        limo.Recording.from_arrays(time, position, torque).save(folder / f"{name}.parquet")
    (folder / "b" / "2026-03-02.parquet").write_text("none")
    return folder


def row_of(store: FleetStore, fleet: Path, name: str) -> tuple[FleetJob, FleetRow]:
    simulation = limo.Simulation.load(fleet / "sim.yaml")
    key = key_of(fleet / name, digest_of(simulation, 10.0))
    return FleetJob(simulation, store, 10.0), FleetRow(fleet / name, key, "a", None)


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
    job, row = row_of(store, fleet, "b/2026-03-02.parquet")

    def full(self, *_, **__):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), str(self))

    with monkeypatch.context() as patch:
        patch.setattr(Path, "write_text", full)
        with pytest.raises(ConfigError, match="No space left"):
            diagnose_row(job, row)
    assert store.finished(row) is None
    diagnose_row(job, row)
    done = store.finished(row)
    assert done is not None
    assert "Parquet" in done.error


@pytest.mark.parametrize(
    "failure",
    [OSError(errno.EIO, os.strerror(errno.EIO)), MemoryError()],
    ids=["disk", "memory"],
)
def test_what_the_machine_failed_is_no_finished_row(fleet, tmp_path, monkeypatch, failure):
    store = FleetStore(tmp_path)
    job, row = row_of(store, fleet, "b/2026-03-02.parquet")

    def read(path, _model):
        try:
            raise failure
        except OSError as error:  # as the readers of recordings do
            raise RecordingError(f"cannot be read: {error.strerror}", path=path) from None

    with monkeypatch.context() as patch:
        patch.setattr("limo_driver.workflow.reading.read", read)
        assert re.search("Input/output error|too little memory", diagnose_row(job, row))
    assert store.finished(row) is None
    assert diagnose_row(job, row) == ""  # the file itself is at fault now
    assert store.finished(row) is not None


def test_rows_of_other_versions_are_set_aside_and_told(tmp_path, monkeypatch):
    store = FleetStore(tmp_path)
    monkeypatch.setattr("estimators.fleet.store.version", lambda _: "0.0.9")
    store.keep("of-before", 1.0)
    monkeypatch.undo()
    store.keep("of-now", 1.0)
    store.keep("counted", 1.0)
    (tmp_path / "diagnoses" / "cut-off").mkdir()
    (tmp_path / "diagnoses" / "cut-off" / "row.json").write_text("{")
    aside = store.of_other_versions({"counted"})
    assert aside == {"0.0.9": 1}
    said = str(FleetDiagnosis("two_links", (), aside))
    assert "set aside: 1 diagnoses by limo 0.0.9" in said


def test_the_key_changes_with_bytes_simulation_and_bandwidth(fleet):
    simulation = limo.Simulation.load(fleet / "sim.yaml")
    other = limo.Simulation.load(fleet / "sim.yaml").model.urdf
    friction = limo.Simulation(str(other), tolerances=simulation.tolerances)
    assert digest_of(simulation, 10.0) == digest_of(friction, 10.0)
    assert digest_of(simulation, 10.0) != digest_of(simulation, 9.0)
    assert digest_of(simulation, 10.0) != digest_of(limo.Simulation("iiwa14"), 10.0)
    one, two = (key_of(fleet / f"a/2026-03-0{k}.parquet", "x") for k in (1, 2))
    assert one != two


def test_patterns_that_match_nothing_are_said(fleet, tmp_path):
    with pytest.raises(ConfigError, match="none/\\*\\*: matches no file"):
        matched("none/**")
    assert len(matched(f"{fleet}/**/*.parquet")) == 4
    with pytest.raises(ConfigError, match="workers is 0"):
        limo.diagnose_fleet("none/**", fleet / "sim.yaml", tmp_path, workers=0)


@pytest.mark.slow("starts processes that import: ten seconds")
def test_a_simulation_that_fits_no_recording_is_named(fleet, tmp_path):
    limo.Simulation("iiwa14").save(tmp_path / "iiwa.yaml")
    with pytest.raises(ConfigError, match=r"iiwa.yaml: fits none of 2 recordings; .*has 2 joints"):
        limo.diagnose_fleet(f"{fleet}/a/*", tmp_path / "iiwa.yaml", tmp_path / "out", workers=1)
