"""On a cluster of Ray, a fleet's rows are those of the pool, whichever node or driver is killed."""

import os
import signal
import subprocess
import sys
from contextlib import contextmanager
from importlib.util import find_spec
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import pyarrow.parquet as pq
import pytest
from fleet_recordings import record_swing
from ports import free_port
from table_data import write_data

import limo_driver as limo

pytestmark = [
    pytest.mark.waits,
    pytest.mark.slow("starts nodes of a cluster: a minute"),
    pytest.mark.skipif(find_spec("ray") is None, reason="needs Ray: pip install limo[fleet]"),
]

DRIVER = """
import os, signal, sys, time
import limo_driver as limo
import ray

told = []

def tell(row, done, total):
    if row is not None:
        told.append(row)
    if row is not None and sys.argv[4] == "itself":
        os.kill(os.getpid(), signal.SIGKILL)
    elif len(told) == 2 and sys.argv[4] != "nobody":
        os.killpg(int(sys.argv[4]), signal.SIGKILL)
        while sum(node["Alive"] for node in ray.nodes()) > 1:  # else all may be done before
            time.sleep(0.1)

if __name__ == "__main__":
    found = limo.diagnose_fleet(*sys.argv[1:4], on="ray", progress=tell)
    print(*(f"{row.arm} {row.diagnosed}" for row in found.rows), sep=", ")
"""

READY = """
import sys, time
import ray

ray.init(log_to_driver=False)  # waits for the first
while sum(node["Alive"] for node in ray.nodes()) < int(sys.argv[1]):
    time.sleep(0.1)
"""


@pytest.fixture(scope="module")
def fleet(tmp_path_factory, two_links_urdf):
    """Eight short recordings of two arms and their simulation."""
    folder = tmp_path_factory.mktemp("fleet")
    simulation = limo.Simulation(str(two_links_urdf))
    simulation.save(folder / "sim.yaml")
    for k in range(8):
        place = folder / "recordings" / "ab"[k % 2]
        record_swing(simulation, k, place / f"2026-03-0{k + 1}.parquet")
    return folder


SIZE = ("--object-store-memory=100000000", "--memory=4000000000")  # [bytes]


@contextmanager
def node(environment, count, *given):
    """Start a node with one core, the first or a further one; give its group of processes."""
    command = [sys.executable, "-m", "ray.scripts.scripts", "start", "--block", "--num-cpus=1"]
    ports = ("--min-worker-port=0", "--max-worker-port=0", "--dashboard-agent-listen-port=0")
    process = subprocess.Popen(
        [*command, *ports, *SIZE, *given],
        env=environment,
        start_new_session=True,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )
    try:
        subprocess.run(
            [sys.executable, "-c", READY, str(count)], env=environment, check=True, timeout=60
        )
        yield process.pid
    finally:
        os.killpg(process.pid, signal.SIGKILL)  # whatever it has started, workers included
        process.wait()


@pytest.fixture
def head():
    """A cluster of one node; gives what a driver or another node needs to find it."""
    port = free_port()
    # a short path, because sockets lie in it; and a name that no other cluster has
    with TemporaryDirectory(prefix="ray", dir="/tmp") as folder:
        open_to_all = {"RAY_AUTH_MODE": "disabled", "RAY_USAGE_STATS_ENABLED": "0"}
        environment = os.environ | open_to_all | {"RAY_ADDRESS": f"127.0.0.1:{port}"}
        given = (
            "--head",
            f"--port={port}",
            "--include-dashboard=false",
            f"--ray-client-server-port={free_port()}",
            f"--temp-dir={folder}",
        )
        with node(environment, 1, *given):
            yield environment


def drive(fleet, out, environment, kill="nobody"):
    """Diagnose the fleet on the cluster; kill nobody, the driver, or a group of processes."""
    program = out.parent / "driver.py"
    program.write_text(DRIVER)
    given = [sys.executable, program, f"{fleet}/recordings/**/*.parquet", fleet / "sim.yaml", out]
    return subprocess.run(
        [*given, str(kill)],
        env=environment,
        capture_output=True,
        text=True,
        check=False,
        timeout=120,
    )


def rows_in(out: Path) -> dict[Path, int]:
    return {path: path.stat().st_mtime_ns for path in out.glob("diagnoses/*/row.json")}


def test_kills_of_driver_and_node_lose_no_row_and_results_are_the_pool_s(fleet, head, tmp_path):
    out = tmp_path / "ray"
    killed = drive(fleet, out, head, "itself")
    assert killed.returncode == -signal.SIGKILL, killed.stderr
    before = rows_in(out)
    assert before
    with node(head, 2, f"--address={head['RAY_ADDRESS']}") as second:
        done = drive(fleet, out, head, second)
    assert done.stdout, done.stderr
    *told, rows = done.stdout.splitlines()
    assert rows == ", ".join(["a True"] * 4 + ["b True"] * 4)
    assert "has been marked dead" in "".join(told)  # which Ray says
    after = rows_in(out)
    assert len(after) == 8
    assert before.items() <= after.items()

    limo.diagnose_fleet(f"{fleet}/recordings/**/*.parquet", fleet / "sim.yaml", tmp_path / "pool")
    kept = [p for p in (tmp_path / "pool" / "diagnoses").rglob("*.*") if p.name != "row.json"]
    assert len(kept) >= 24
    for path in kept:
        assert path.read_bytes() == (out / path.relative_to(tmp_path / "pool")).read_bytes()
    pool, ray = (pq.read_table(tmp_path / name / "results.parquet") for name in ("pool", "ray"))
    assert pool.drop(["seconds"]).equals(ray.drop(["seconds"]))


EVERYTHING = """
import sys
from pathlib import Path
import limo_driver as limo
from estimators.studies.table1_data import TableData
from estimators.studies.table1_data import rigid_body
from estimators.studies.table1_results import Protocol, TrialStore
from estimators.studies.table1_trials import TrialRunner
from limo_driver.app.library.demonstrating import run_trials

if __name__ == "__main__":
    fleet, table, out = map(Path, sys.argv[1:4])
    on = sys.argv[4]
    limo.simulate_dataset(fleet / "sim.yaml", fleet / "plan.parquet", out / "set", [1, 2], on=on)
    run = next((fleet / "recordings" / "a").glob("*.parquet"))
    limo.sweep(fleet / "sim.yaml", run, fleet / "space.yaml", out / "sweep", on=on)
    if on == "ray":
        data = TableData.load(table)
        (out / "prepared").mkdir()
        (out / "trials").mkdir()
        simulation = limo.Simulation.load(rigid_body(data, out / "prepared"))
        runner, store = TrialRunner(data, simulation, "cpu"), TrialStore(out / "trials", "one")
        trials = Protocol(runs=1, epochs=1, batch=5).trials(data.digests)[:2]
        for ended in run_trials(runner, store, trials, (1, on), lambda *_: None):
            print(type(ended).__name__, store.load(ended.trial).seconds > 0)
"""
SPACE = "model: mlp7\nfeatures: own-joint\nepochs: 1\nfolds: 1\nhidden: [2, 3]\n"


def test_data_sets_sweeps_and_trials_are_those_of_the_pool(fleet, head, tmp_path):
    t = np.arange(0.0, 0.6, 0.001)
    position = 0.02 * (1.0 - np.cos(np.pi * t))[:, None] * np.ones(2)
    rest = np.zeros_like(position)
    robot = limo.Simulation.load(fleet / "sim.yaml").robot
    limo.Trajectory(t, position, rest, rest, robot=robot).save(fleet / "plan.parquet")
    (fleet / "space.yaml").write_text(SPACE)
    table = write_data(tmp_path / "table")
    program = tmp_path / "everything.py"
    program.write_text(EVERYTHING)
    for on in ("ray", "processes"):
        done = subprocess.run(
            [sys.executable, program, fleet, table, tmp_path / on, on],
            env=head | {"PYTHONPATH": os.pathsep.join(sys.path)},
            capture_output=True,
            text=True,
            check=False,
            timeout=300,
        )
        assert not done.returncode, done.stderr
        if on == "ray":
            assert done.stdout.splitlines() == ["TrialResult True"] * 2
    kept = [p for p in (tmp_path / "ray").rglob("*") if p.suffix in {".parquet", ".safetensors"}]
    assert len(kept) == 2 + 3 + 1  # recordings, models with the best, a table
    for path in kept:
        if path.name != "results.parquet":  # which says how long each took
            same = tmp_path / "processes" / path.relative_to(tmp_path / "ray")
            assert path.read_bytes() == same.read_bytes()


def test_a_node_with_another_limo_is_named(fleet, head, tmp_path):
    about = tmp_path / "other" / "limo-0.0.9.dist-info" / "METADATA"
    about.parent.mkdir(parents=True)
    about.write_text("Metadata-Version: 2.1\nName: limo\nVersion: 0.0.9\n")
    path = os.pathsep.join([str(tmp_path / "other"), os.environ.get("PYTHONPATH", "")])
    with node(head | {"PYTHONPATH": path}, 2, f"--address={head['RAY_ADDRESS']}"):
        done = drive(fleet, tmp_path / "out", head)
    assert done.returncode
    assert "have other versions of limo than" in done.stderr
    assert done.stderr.count("has 0.0.9") == 1
    assert not rows_in(tmp_path / "out")


def test_a_cluster_that_does_not_answer_is_named(fleet, tmp_path):
    port = free_port()
    done = drive(fleet, tmp_path / "out", os.environ | {"RAY_ADDRESS": f"127.0.0.1:{port}"})
    assert (
        f"RAY_ADDRESS=127.0.0.1:{port}: no cluster answers there: Connection refused" in done.stderr
    )
