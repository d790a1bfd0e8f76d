"""`limo predict` on recordings with and without rows that cannot be used."""

from __future__ import annotations

import json
import sys
from dataclasses import replace

import numpy as np
import pyarrow.parquet as pq
import pytest

from estimators.hybrid import HybridModel
from estimators.hybrid.training.settings import TrainingSettings
from estimators.stream import Stream
from limo_driver.app.cli import main
from limo_driver.app.library.simulating import predict_forward
from limo_driver.physics import CoulombFriction, PositionServo, PreslidingHysteresis, Simulation
from limo_driver.recordings.channels import Columns
from limo_driver.recordings.files.recording_file import write_columns
from limo_driver.recordings.recording import Recording

RATE = 100.0
SIMULATION = Simulation(
    "iiwa14",
    (
        CoulombFriction(joint=2, tau_c=1.5, v_eps=0.01),
        PreslidingHysteresis(joint=4, stiffness=(50.0, 20.0), width=(0.01, 0.05)),
    ),
)


def motion_of(t):
    angle = 2 * np.pi * np.linspace(0.2, 0.5, 7) * t[:, None]
    return 0.6 * np.sin(angle)


@pytest.fixture
def predict(tmp_path, monkeypatch, capsys):
    """Run `limo predict` in this process; returns exit status, stdout and stderr."""
    SIMULATION.save(tmp_path / "sim.yaml")

    def run(path, *more, by=("--sim", tmp_path / "sim.yaml")):
        files = (*by, "--out", tmp_path / "torque.parquet")
        monkeypatch.setattr(sys, "argv", ["limo", "predict", *map(str, (path, *files, *more))])
        with pytest.raises(SystemExit) as ended:
            main()
        return (ended.value.code or 0, *capsys.readouterr())

    return run


@pytest.fixture
def recording(tmp_path):
    t = np.arange(400) / RATE
    position = motion_of(t)
    torque = np.zeros_like(position)
    torque[40, 2] = np.nan
    path = tmp_path / "run.parquet"
    write_columns(Columns(t, position, torque), path)  # as it was logged, hole and all
    return path


def test_one_row_for_each_row_and_nan_where_left_out(tmp_path, recording, predict):
    status, _, notes = predict(recording)
    assert status == 0, notes
    assert "1 row left out: a value is missing or not finite (row 40)" in notes
    out = tmp_path / "torque.parquet"
    table = pq.read_table(out)
    assert table.column_names == ["time", *(f"torque_{j}" for j in range(1, 8))]
    torque = np.stack([table[f"torque_{j}"].to_numpy() for j in range(1, 8)], 1)
    assert torque.shape == (400, 7)
    assert np.flatnonzero(np.isnan(torque).any(axis=1)).tolist() == [40]
    measured = Recording.load(recording)
    sharp = measured.calm_motion(10.0)  # the friction has a sharp sign
    np.testing.assert_allclose(torque[measured.rows], SIMULATION.predict(sharp), atol=1e-9)


def test_json_names_the_rows(recording, predict):
    _, printed, _ = predict(recording, "--json")
    assert json.loads(printed)["rows"] == {
        "used": 399,
        "left_out": {"a value is missing or not finite": [40]},
    }


def test_a_recording_of_another_robot_is_refused(recording, predict):
    replace(Recording.load(recording), robot="ur5.urdf").save(recording)
    status, _, notes = predict(recording)
    assert status == 2
    assert "is of robot ur5.urdf, expected iiwa14" in notes
    replace(Recording.load(recording), robot="elsewhere/iiwa14.urdf").save(recording)
    assert predict(recording)[0] == 0


def test_a_bandwidth_too_low_for_the_recording_is_refused(recording, predict):
    status, _, notes = predict(recording, "--bandwidth", "1e-4")
    assert status == 2
    assert "too low for a recording of 3.99 s; give at least 0.125 Hz" in notes


@pytest.fixture(scope="module")
def model(tmp_path_factory):
    """A model folder, trained in a moment on what the simulation does not know."""
    t = np.arange(3000) / RATE
    position = 0.3 * np.sin(2 * np.pi * np.linspace(0.2, 0.5, 7) * t[:, None])
    recording = Recording.from_arrays(
        t,
        position,
        SIMULATION.predict(Recording.from_arrays(t, position, np.ones_like(position))),
    )
    folder = tmp_path_factory.mktemp("model")
    settings = TrainingSettings(epochs=1, folds=1, hidden=4)
    HybridModel(SIMULATION.without_effects(), settings).fit([recording]).save(folder)
    return folder


def column(path, name):
    table = pq.read_table(path)
    return np.stack([table[f"{name}_{j}"].to_numpy() for j in range(1, 8)], 1)


def test_a_model_says_how_sure_it_is(tmp_path, recording, predict, model):
    status, _, notes = predict(recording, by=("--model", model))
    assert status == 0, notes
    out, measured = tmp_path / "torque.parquet", Recording.load(recording)
    expected = HybridModel.load(model).estimate(measured)
    for name in ("torque", "std"):
        written = column(out, name)
        np.testing.assert_array_equal(written[measured.rows], getattr(expected, name))
        assert np.isnan(written[40]).all()
    outside = pq.read_table(out)["outside_1"]
    assert outside.null_count == 1
    assert outside.take(measured.rows).to_pylist() == expected.outside[:, 0].tolist()


def test_with_a_delay_it_is_what_a_stream_says(tmp_path, recording, predict, model):
    measured = Recording.load(recording)
    for by, estimator in (
        (("--sim", tmp_path / "sim.yaml"), SIMULATION),
        (("--model", model), HybridModel.load(model)),
    ):
        status, _, notes = predict(recording, "--delay", "0.1", by=by)
        assert status == 0, notes
        table = pq.read_table(tmp_path / "torque.parquet")
        time = table["time"].to_numpy()[measured.rows]
        np.testing.assert_allclose(time, measured.time - 0.1, atol=1e-12)
        written = column(tmp_path / "torque.parquet", "torque")[measured.rows]
        stream = Stream(estimator, measured.rate, 0.1)
        np.testing.assert_array_equal(written, stream.predict(measured))
        assert ("std_1" in table.column_names) == (by[0] == "--model")


def test_it_is_said_what_predicts(tmp_path, recording, predict, model):
    sim = tmp_path / "sim.yaml"
    for by, message in (
        ((), "neither of --sim and --model given"),
        (("--sim", sim, "--model", model), "both of --sim and --model given"),
        (("--model", model, "--bandwidth", "5"), "--bandwidth is of --sim"),
        (("--sim", sim, "--delay", "9"), "a delay of 9 s is too long"),
    ):
        status, _, notes = predict(recording, by=by)
        assert (status, notes.count("\n")) == (2, 1)
        assert message in notes


def test_at_reversals_it_is_nearer_to_the_arm_than_a_velocity_within_the_bandwidth():
    # A triangle of position: its velocity jumps between two samples, as at a sharp reversal.
    speed = 0.1
    t = (np.arange(4000) + 0.5) / 500.0
    position = np.zeros((t.size, 7))
    position[:, 1] = speed * np.abs((t % 2) - 1)
    recording = Recording.from_arrays(t, position, np.zeros_like(position))
    friction = 1.5 * np.tanh(np.where(t % 2 < 1, -speed, speed) / 0.01)
    rigid = SIMULATION.without_effects()

    def error(torque, rigid_torque):
        return np.sqrt(np.mean(((torque - rigid_torque)[:, 1] - friction) ** 2))

    smooth = recording.motion(10.0)
    sharp = error(SIMULATION.predict(recording), rigid.predict(recording))
    assert sharp < 0.6 * error(SIMULATION.predict(smooth), rigid.predict(smooth))


def test_memory_starts_anew_after_a_gap():
    t = np.r_[np.arange(0, 3, 0.01), np.arange(5, 8, 0.01)]
    position = motion_of(t)
    both = Recording.from_arrays(t, position, np.zeros_like(position))
    torque = SIMULATION.predict(both)
    np.testing.assert_allclose(torque[300:], SIMULATION.predict(both[300:]))


@pytest.mark.parametrize(
    ("columns", "message"), [(6, "has 6 joints, but iiwa14 has 7"), (0, "no such file")]
)
def test_bad_input_is_one_line_and_status_2(tmp_path, predict, columns, message):
    path = tmp_path / "bad.parquet"
    if columns:
        t = np.arange(400) / RATE
        Recording(t, motion_of(t)[:, :columns], np.ones((400, columns))).save(path)
    status, _, notes = predict(path)
    assert status == 2
    assert message in notes
    assert notes.count("\n") == 1
    assert not (tmp_path / "torque.parquet").exists()


def test_positions_are_simulated_forward_from_commands(tmp_path, predict):
    t = np.arange(100) / RATE
    command = motion_of(t)
    drives = tuple(PositionServo(joint=j, kp=800.0, kd=60.0) for j in range(1, 8))
    simulation = Simulation("iiwa14", (CoulombFriction(joint=2, tau_c=1.5),), drives=drives)
    simulation.save(tmp_path / "driven.yaml")
    recording = Recording.from_arrays(t, 0.9 * command, command=command)
    recording.save(tmp_path / "commands.parquet")
    by = ("--sim", tmp_path / "driven.yaml")

    status, said, _ = predict(tmp_path / "commands.parquet", "--free-running", by=by)

    assert status == 0
    assert "position_1 … position_7 [rad]" in said
    table = pq.read_table(tmp_path / "torque.parquet")
    assert table.column_names == ["time", *(f"position_{j}" for j in range(1, 8))]
    found = np.stack([table[f"position_{j}"].to_numpy() for j in range(1, 8)], axis=1)
    assert found == pytest.approx(predict_forward(simulation, recording))


def test_free_running_takes_no_bandwidth(predict, recording):
    status, _, said = predict(recording, "--free-running", "--bandwidth", "8")

    assert status == 2
    assert "--bandwidth given with --free-running" in said
