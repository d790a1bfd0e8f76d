"""The same commands on recordings of real arms, where those are at hand."""

from __future__ import annotations

import os
from dataclasses import replace
from pathlib import Path

import numpy as np
import pinocchio
import pyarrow.parquet as pq
import pytest

from estimators.rigid_body import RigidBodyModel, Rows, identify
from estimators.rigid_body.terms import JointTerms
from limo_driver.app.cli import main
from limo_driver.model import RobotModel
from limo_driver.physics import Simulation
from limo_driver.recordings.filters.differentiation import smooth
from limo_driver.recordings.recording import Recording

DATA = Path(os.environ.get("LIMO_DATA", Path(__file__).parents[2] / ".." / "shared" / "data"))
BANDWIDTH = 8.0  # [Hz], of the published baselines
REGRESSION = 1.05  # of the errors once reached; not a claim to be as good as a baseline
EXAMPLE_ROBOTS = Path(pinocchio.__file__).parents[4] / "share/example-robot-data/robots"

pytestmark = [
    pytest.mark.slow("real recordings, minutes long, which few have"),
    pytest.mark.skipif(
        not DATA.is_dir(),
        reason=f"no real recordings in {DATA}; name their folder in LIMO_DATA",
    ),
]


def load(name):
    return Recording.load(DATA / name)


def heldout_rmse(model, recording):
    return rmse_of(model.predict(recording), recording)


def rmse_of(torque, recording):
    predicted = smooth(recording.time, torque, BANDWIDTH, recording.segments)
    error = recording.filtered_torque(BANDWIDTH) - predicted
    return np.sqrt(np.mean(error**2, axis=0))


def test_corrupt_rows_of_the_ur10e_are_named_and_left_out():
    path = DATA / "ur10e" / "loaded_15harm_corrupt_rows.parquet"
    table = pq.read_table(path)
    values = np.stack([table[name].to_numpy() for name in table.column_names], 1)
    wild = np.flatnonzero((np.abs(values) > 1e3).any(axis=1)).tolist()
    recording = Recording.load(path)
    reasons = {item.reason: item.rows for item in recording.left_out}
    beyond = (
        "a value is impossible",
        "a value is missing or not finite",
    )  # above 1e100: as if none
    assert sorted(row for reason in beyond for row in reasons.pop(reason)) == wild
    assert wild == list(range(1, 10))
    assert reasons == {"fewer than 10 rows between gaps": (0,)}  # alone, once those are out
    assert len(recording) == table.num_rows - 10
    assert np.abs(recording.position).max() < 4


@pytest.mark.parametrize(
    ("name", "rate", "joints"),
    [
        ("kuka_lwr4/measurements_1.parquet", 200, 7),
        ("panda/exciting_trajectory.parquet", 1000, 7),
        ("ur10e/unloaded_point_to_point.parquet", 100, 6),
    ],
)
def test_clean_recordings_are_read_whole(name, rate, joints):
    recording = load(name)
    assert (recording.n, recording.left_out) == (joints, ())
    assert recording.rate == pytest.approx(rate, rel=0.01)
    assert len(recording.segments) == 1


def test_still_joints_of_the_ur10e_are_told():
    warnings = load("ur10e/unloaded_joint_1_alone.parquet").warnings
    assert [text.split(" (")[0] for text in warnings] == [
        f"joint {j} never moves" for j in (2, 3, 4, 5, 6)
    ]


def test_derivatives_agree_with_what_the_arm_reports():
    recording = load("ur10e/unloaded_14harm.parquet")
    velocity = recording.motion(BANDWIDTH).velocity
    error = np.sqrt(np.mean((velocity - recording.velocity)[100:-100] ** 2, axis=0))
    assert (error / recording.velocity.std(axis=0)).max() < 0.02


def test_ur10e_reaches_the_published_baseline():
    model = RigidBodyModel(DATA / "ur10e/ur10e.urdf", JointTerms((0.01,)), Rows(BANDWIDTH))
    model.fit([load("ur10e/unloaded_14harm.parquet")])
    baseline = np.array([2.9, 4.2, 1.4, 0.49, 0.80, 0.62])  # [N m]
    rmse = heldout_rmse(model, load("ur10e/unloaded_15harm.parquet"))
    assert (rmse / baseline).max() < 1.05


def test_ur10e_becomes_a_simulation_of_bodies_that_exist():
    model = RobotModel.load(DATA / "ur10e/ur10e.urdf")
    train, test = load("ur10e/unloaded_14harm.parquet"), load("ur10e/unloaded_15harm.parquet")
    found = identify(model, [train], rows=Rows(BANDWIDTH))
    assert all(body.is_consistent() for body in found.simulation.inertials.values())
    torque = found.simulation.predict(test.motion(BANDWIDTH))
    error = test.filtered_torque(BANDWIDTH) - torque
    baseline = np.array([2.9, 4.2, 1.4, 0.49, 0.80, 0.62])  # [N m]
    assert (np.sqrt(np.mean(error**2, axis=0)) / baseline).max() < 1.1


@pytest.mark.parametrize(
    ("run", "other"),
    [("loaded_14harm", "loaded_20_01_31"), ("loaded_20_01_31", "loaded_14harm")],
)
def test_a_loaded_ur10e_is_identified_from_a_description_without_the_load(run, other):
    urdf, rows = DATA / "ur10e/ur10e.urdf", Rows(BANDWIDTH, moving_only=True)
    train, test = load(f"ur10e/{run}.parquet"), load(f"ur10e/{other}.parquet")
    simulation = identify(RobotModel.load(urdf), [train], rows=rows).simulation
    free = RigidBodyModel(urdf, JointTerms(), rows).fit([train])  # no body has to exist
    rmse = rmse_of(simulation.predict(test, BANDWIDTH), test)
    assert (rmse / heldout_rmse(free, test)).max() < 1.1


def test_lwr4_with_the_weights_of_the_baseline_reaches_it():
    model = RigidBodyModel(
        DATA / "kuka_lwr4/kuka_lwr4.urdf", JointTerms(), Rows(BANDWIDTH, weighting="torque")
    )
    model.fit([load(f"kuka_lwr4/measurements_{run}.parquet") for run in (2, 3)])
    baseline = np.array([0.34, 0.62, 0.29, 0.48, 0.23, 0.18, 0.19])  # [N m]
    rmse = heldout_rmse(model, load("kuka_lwr4/measurements_1.parquet"))
    assert (rmse / baseline).max() < 1.05


@pytest.fixture
def identified(tmp_path, monkeypatch):
    """Run `limo identify` as a user does, and read what it wrote."""

    def run(recordings, urdf):
        out = tmp_path / "sim.yaml"
        options = ("--robot", urdf, "--bandwidth", BANDWIDTH, "--out", out)
        monkeypatch.setattr("sys.argv", ["limo", "identify", *map(str, (*recordings, *options))])
        with pytest.raises(SystemExit) as ended:
            main()
        assert not ended.value.code
        return Simulation.load(out)

    return run


def test_lwr4_sim_yaml_holds_what_it_reached(identified):
    """Hold the figures reached, which miss the baseline by up to 24 % (joint 7).

    Joints 2 and 4 are 40 % better than the baseline, the others worse. Joints count by the inverse
    variance of their error, and bodies have to exist; the baseline does neither.
    """
    folder = DATA / "kuka_lwr4"
    runs = [folder / f"measurements_{run}.parquet" for run in (2, 3)]
    simulation = identified(runs, folder / "kuka_lwr4.urdf")
    reached = np.array([0.381, 0.375, 0.298, 0.279, 0.257, 0.193, 0.235])  # [N m]
    test = load("kuka_lwr4/measurements_1.parquet")
    rmse = rmse_of(simulation.predict(test.motion(BANDWIDTH)), test)
    assert (rmse / reached).max() < REGRESSION
    assert all(body.is_consistent() for body in simulation.inertials.values())
    assert simulation.tolerances.inertia < 0.05  # of what the torque of such motion depends on


@pytest.fixture
def panda():
    urdf = EXAMPLE_ROBOTS / "panda_description/urdf/panda.urdf"
    if not urdf.is_file():
        pytest.skip(f"no {urdf}; the package example-robot-data has it")
    return urdf


def thirds(recording):
    """Fit on the first two thirds, test on the last."""
    split = 2 * len(recording) // 3
    return recording[:split], recording[split:]


def test_panda_base_parameters_hold_what_they_reached(panda):
    """Hold the figures reached at 1 kHz; the baseline was fitted at 500 Hz."""
    train, test = thirds(load("panda/exciting_trajectory.parquet"))
    model = RigidBodyModel(panda, JointTerms(), Rows(BANDWIDTH)).fit([train])
    reached = np.array([0.180, 0.224, 0.173, 0.171, 0.0695, 0.0301, 0.0435])  # [N m]
    assert (heldout_rmse(model, test) / reached).max() < REGRESSION


def test_panda_sim_yaml_holds_what_it_reached(panda, identified, tmp_path):
    """Hold the figures reached, which miss the baseline by up to 14 % (joint 1).

    The baseline was fitted at 500 Hz, and its bodies need not exist.
    """
    train, test = thirds(load("panda/exciting_trajectory.parquet"))
    train.save(tmp_path / "train.parquet")
    simulation = identified([tmp_path / "train.parquet"], panda)
    reached = np.array([0.183, 0.232, 0.167, 0.212, 0.0747, 0.0383, 0.0464])  # [N m]
    motion = test.motion(BANDWIDTH)
    rmse = rmse_of(simulation.predict(motion), test)
    assert (rmse / reached).max() < REGRESSION
    nominal = rmse_of(Simulation(str(panda)).predict(motion), test)
    assert (rmse / nominal).max() < 0.3
    assert all(body.is_consistent() for body in simulation.inertials.values())


def test_a_recording_that_names_another_robot_is_refused(tmp_path, monkeypatch, capsys):
    path = tmp_path / "named.parquet"
    named = replace(load("kuka_lwr4/measurements_1.parquet"), robot="kuka_lwr4.urdf")
    named.save(path)
    options = ("--robot", "iiwa14", "--out", str(tmp_path / "sim.yaml"))
    monkeypatch.setattr("sys.argv", ["limo", "identify", str(path), *options])
    with pytest.raises(SystemExit) as ended:
        main()
    assert ended.value.code == 2
    told = f"limo: {path}: is of robot kuka_lwr4.urdf, expected iiwa14\n"
    assert capsys.readouterr().err == told
