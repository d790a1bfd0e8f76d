"""Table I: its rows, its data, how a trial is scored, kept and counted."""

from __future__ import annotations

import json
import multiprocessing
import os
import shutil
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
import pytest
from lanes import sampled
from table_data import RATE, robot, write_data

from estimators.studies import table1_data as r
from estimators.studies.table1_data import (
    ALL_ROWS,
    PARTS,
    RECORDINGS,
    ROWS,
    TOPOLOGIES,
    Row,
    TableData,
    paper_table,
    physics_digest,
    rigid_body,
)
from estimators.studies.table1_results import (
    SCAFFOLDS,
    SEQUENCES,
    Protocol,
    Trial,
    TrialResult,
    TrialStore,
)
from estimators.studies.table1_trials import (
    Failed,
    ScoringMotion,
    TrialRunner,
)
from limo_driver.app.library.demonstrating import run_trials
from limo_driver.errors import ConfigError, LimoError, RecordingError
from limo_driver.model import RobotModel
from limo_driver.physics import CoulombFriction, Simulation
from limo_driver.recordings.recording import Recording

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence
    from pathlib import Path

    from limo_driver.types import FloatArray

TINY = Protocol(runs=2, epochs=1, batch=10)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_data(tmp_path_factory.mktemp("table") / "data")


@pytest.fixture(scope="module")
def data(folder: Path) -> TableData:
    return TableData.load(folder)


@pytest.fixture(scope="module")
def runner(data: TableData) -> TrialRunner:
    return TrialRunner(data, robot(), "cpu")


def trial_of(data: TableData, row: Row, split: str = SEQUENCES, run: int = 0) -> Trial:
    (found,) = (
        trial
        for trial in TINY.trials(data.digests)
        if (trial.row, trial.split, trial.run) == (row, split, run)
    )
    return found


# The rows


def test_rows_are_those_of_the_paper() -> None:
    assert list(paper_table()) == [(part, row.name) for part in PARTS for row in ROWS]
    best = paper_table()["test", "LSTM-FCL 500 with tau_rbd,r"]
    assert best.tolist() == [0.0400, 0.0628, 0.0253, 0.0271, 0.0168, 0.0141, 0.0124, 0.0284]


def test_each_row_trains_what_its_name_says() -> None:
    for row in ALL_ROWS[1:]:
        settings, words = row.settings(), row.name.lower()
        assert settings.model == words.split(" with")[0].removesuffix(" 100").removesuffix(
            " 500"
        ).replace("mlp-7", "mlp7")
        assert settings.standalone != ("tau_rbd" in words)
        assert (settings.without == ()) == (words.endswith((",r", " r")))
        assert settings.sequence_length == (500 if " 500" in words else 100)
        assert (settings.epochs, settings.batch, settings.schedule) == (100, 50, "plateau")
        assert (settings.keep, settings.carried, settings.folds) == ("last", 1, 1)


def test_topologies_share_the_row_of_the_table() -> None:
    assert TOPOLOGIES[1, 35] is r.FCL500_FULL
    settings = TOPOLOGIES[2, 15].settings()
    assert (settings.layers, settings.hidden) == (2, 15)
    assert len({row.name for row in TOPOLOGIES.values()}) == 6


def test_the_first_run_of_all_rows_comes_before_the_second(data: TableData) -> None:
    trials = TINY.trials(data.digests)
    assert len(trials) == 2 * (2 * len(ALL_ROWS) + 5)
    assert [trial.run for trial in trials] == sorted(trial.run for trial in trials)
    assert len({trial.file_name for trial in trials}) == len(trials)
    assert {trial.settings.seed for trial in trials} == {0, 1}


@pytest.mark.parametrize("name", ["runs", "epochs", "batch"])
def test_a_protocol_of_nothing_is_refused(name: str) -> None:
    with pytest.raises(ConfigError, match=f"{name} is 0, expected a whole number of 1 or more"):
        Protocol(**{name: 0})


# The data


def test_scaffolds_cover_the_motion(data: TableData) -> None:
    pieces = data.scaffolds()
    assert len(pieces) == data.scaffold_starts.size
    np.testing.assert_array_equal(np.concatenate([p.time for p in pieces]), data.limo.time)
    for piece, start in zip(pieces[1:], data.scaffold_starts[1:], strict=True):
        assert piece.time[0] == pytest.approx(start, abs=1 / RATE)


def described(**changes: object) -> Callable[[Path], None]:
    def change(folder: Path) -> None:
        path = folder / "data.json"
        path.write_text(json.dumps(json.loads(path.read_text()) | changes))

    return change


def recorded(name: str, change: Callable[[Recording], Recording]) -> Callable[[Path], None]:
    return lambda folder: change(Recording.load(folder / name)).save(folder / name)


@pytest.mark.parametrize(
    ("damage", "message"),
    [
        (lambda folder: (folder / "data.json").unlink(), "data.json: cannot be read"),
        (lambda folder: (folder / "data.json").write_text("{"), "data.json: is no JSON"),
        (lambda folder: (folder / "limo.parquet").unlink(), "lacks limo.parquet"),
        (described(schema=2), "its schema is not 1"),
        (lambda folder: (folder / "data.json").write_text("[" * 100_000), "data.json: is no JSON"),
        (described(robot="panda9"), "panda9"),
        (described(robot=14), "data.json: robot is 14, expected a text"),
        (described(scaffold_starts=[0, 10**400]), "scaffold_starts: number 2 is 1000"),
        (recorded("limo.parquet", lambda it: replace(it, robot="panda")), "is of robot panda"),
        (recorded("validation.parquet", lambda it: it[::2]), "at 50 Hz, but .* at 100 Hz"),
        (described(scaffold_starts=[0.0, 20.0, 10.0]), "10 s follows 20 s; expected .* increase"),
        (described(scaffold_starts=[0.0, 20.0, 20.5]), "each by 1 s or more"),
        (described(scaffold_starts=[0.0, 900.0]), "span 0 to 900 s, but .*limo.parquet"),
        (described(scaffold_starts=[0.0]), "a list of 2 or more times"),
        (described(scaffold_starts="10"), "scaffold_starts is '10', expected a list of numbers"),
    ],
)  # fmt: skip
def test_data_that_do_not_fit_are_refused(
    folder: Path, tmp_path: Path, damage: Callable[[Path], object], message: str
) -> None:
    copy = tmp_path / "data"
    shutil.copytree(folder, copy)
    damage(copy)
    with pytest.raises(LimoError, match=message):
        TableData.load(copy)


def test_what_is_missing_of_the_description_is_named(folder: Path, tmp_path: Path) -> None:
    copy = tmp_path / "data"
    shutil.copytree(folder, copy)
    (copy / "data.json").write_text('{"schema": 1, "robot": "iiwa14"}')
    with pytest.raises(ConfigError, match="lacks made_by, scaffold_starts"):
        TableData.load(copy)


def test_recordings_of_other_joints_than_the_robots_are_refused(
    folder: Path, tmp_path: Path, arm: Path
) -> None:
    copy = tmp_path / "data"
    shutil.copytree(folder, copy)
    described(robot=str(arm))(copy)
    with pytest.raises(RecordingError, match=r"has 7 joints, but .*two_joints\.urdf has 2"):
        TableData.load(copy)


@sampled("row", [r.RBD, r.MLP_FULL, r.FCL100_FULL, r.TRANSFORMER], "trains a network each")
def test_an_arm_of_other_joints_than_the_papers_is_trained_and_scored(
    row: Row, tmp_path: Path, arm: Path
) -> None:
    data = TableData.load(write_data(tmp_path / "data", arm))
    assert data.robot == "arm"
    simulation = Simulation.load(rigid_body(data, tmp_path))
    result = TrialRunner(data, simulation, "cpu").run(trial_of(data, row, SCAFFOLDS))
    assert [len(result.mse[part]) for part in PARTS] == [2, 2, 2]
    assert np.isfinite(list(result.mse.values())).all()


@pytest.mark.slow("identifies an arm twice")
def test_a_urdf_lies_beside_the_data_and_another_one_is_other_data(
    folder: Path, data: TableData, tmp_path: Path
) -> None:
    copy = tmp_path / "data"
    shutil.copytree(folder, copy)
    described(robot="arm.urdf")(copy)
    urdf = RobotModel.load("iiwa14").urdf.read_text()
    (copy / "arm.urdf").write_text(urdf)
    one = TableData.load(copy)
    (copy / "arm.urdf").write_text(urdf + "<!-- measured anew -->")
    another = TableData.load(copy)
    assert trial_of(one, r.RBD).file_name != trial_of(another, r.RBD).file_name
    assert rigid_body(one, tmp_path) != rigid_body(another, tmp_path)
    assert set(data.digests) == {"data.json", *RECORDINGS}  # trials of built-in robots stay done


def test_the_rigid_body_is_identified_once(data: TableData, tmp_path: Path) -> None:
    path = rigid_body(data, tmp_path)
    found = Simulation.load(path)
    friction = {effect.name for effect in found.effects}
    assert {"coulomb_friction", "viscous_friction"} <= friction
    before = path.stat().st_mtime_ns
    assert rigid_body(data, tmp_path) == path
    assert path.stat().st_mtime_ns == before


# How a trial is scored


class Counting:
    """Predicts how many samples it has seen since its memory was empty."""

    def init(self, stride: int) -> FloatArray:
        return np.zeros(stride)

    def advance(self, memory: FloatArray, x: FloatArray) -> tuple[FloatArray, FloatArray]:
        seen = memory[0] + np.arange(1, len(x) + 1)
        return np.column_stack([seen, seen]), np.array([seen[-1]])


def test_every_subsequence_starts_from_zero_memory_and_all_samples_count() -> None:
    scored = np.ones(23, bool)
    scored[[0, 1, -1]] = False  # edges
    motion = ScoringMotion(
        np.zeros((23, 3)), np.zeros((23, 2)), scored, (slice(0, 12), slice(12, 23)), np.zeros(2)
    )
    errors = motion.squared_errors(Counting(), 4)  # type: ignore[arg-type]
    expected = [*(1, 4, 9, 16) * 2, 1, 4, *(1, 4, 9, 16) * 2, 1, 4]
    np.testing.assert_array_equal(errors[scored], np.column_stack([expected, expected]))
    assert np.isnan(errors[~scored]).all()


def test_the_rigid_body_is_scored_by_what_it_leaves(runner: TrialRunner, data: TableData) -> None:
    result = runner.run(trial_of(data, r.RBD))

    def squares(recording: Recording) -> FloatArray:
        left = recording.filtered_torque(10.0) - runner.simulation.predict(recording.motion(10.0))
        return left[~recording.edges(10.0)] ** 2

    np.testing.assert_allclose(
        result.mse["validation"], squares(data.validation).mean(axis=0), rtol=1e-5
    )
    both = 0.8 * np.array(result.mse["training"]) + 0.2 * np.array(result.mse["test"])
    np.testing.assert_allclose(both, squares(data.limo).mean(axis=0), rtol=0.15)
    assert result.epochs == 0


@pytest.mark.slow("trains networks")
def test_runs_differ_by_their_seed_alone(runner: TrialRunner, data: TableData) -> None:
    first, again = (runner.run(trial_of(data, r.FCL100_FULL)) for _ in range(2))
    assert first.mse == again.mse
    assert first.epochs == 1
    other = runner.run(trial_of(data, r.FCL100_FULL, run=1))
    assert other.mse["validation"] != first.mse["validation"]


def test_a_standalone_network_answers_for_the_whole_torque(
    runner: TrialRunner, data: TableData
) -> None:
    alone, hybrid = (runner.run(trial_of(data, row)) for row in (r.MLP, r.MLP_HYBRID))
    assert np.mean(alone.mse["validation"]) > 3 * np.mean(hybrid.mse["validation"])


def test_the_split_by_scaffold_tests_on_whole_scaffolds(
    runner: TrialRunner, data: TableData
) -> None:
    rigid = runner.run(trial_of(data, r.RBD, SCAFFOLDS))
    possible: list[FloatArray] = []
    for piece in data.scaffolds():
        left = piece.filtered_torque(10.0) - runner.simulation.predict(piece.motion(10.0))
        possible.append(np.mean(left[~piece.edges(10.0)] ** 2, axis=0))
    assert any(np.allclose(rigid.mse["test"], mse, rtol=1e-4) for mse in possible)


# Where finished trials are kept


def test_a_finished_trial_is_read_back(
    runner: TrialRunner, data: TableData, tmp_path: Path
) -> None:
    store, trial = TrialStore(tmp_path, "one"), trial_of(data, r.MLP_FULL)
    assert store.load(trial) is None
    result = runner.run(trial)
    store.save(result)
    assert store.load(trial) == result
    assert set(result.packages) >= {"limo", "numpy", "torch"}
    assert [path.name for path in tmp_path.iterdir()] == [trial.file_name]


def test_a_trial_on_another_rigid_body_is_not_finished(
    runner: TrialRunner, data: TableData, tmp_path: Path
) -> None:
    trial = trial_of(data, r.RBD)
    store, another = TrialStore(tmp_path, "one"), TrialStore(tmp_path, "another")
    result = runner.run(trial)
    store.save(result)
    assert another.load(trial) is None
    path = tmp_path / trial.file_name
    values = json.loads(path.read_text())
    del values["rigid_body"]  # as the first versions wrote it
    path.write_text(json.dumps(values))
    assert another.load(trial) == result


def test_a_rigid_body_is_told_by_its_physics_wherever_its_robot_lies(
    arm: Path, tmp_path: Path
) -> None:
    (tmp_path / "deeper").mkdir()
    one, moved = tmp_path / "sim.yaml", tmp_path / "deeper" / "sim.yaml"
    friction = CoulombFriction(joint=1, tau_c=1.0)
    for path in (one, moved):
        Simulation(str(arm), (friction,)).save(path)
    assert one.read_bytes() != moved.read_bytes()
    assert physics_digest(one) == physics_digest(moved)
    Simulation(str(arm), (replace(friction, tau_c=1.1),)).save(moved)
    assert physics_digest(one) != physics_digest(moved)


@pytest.mark.parametrize("text", ["", "robot: [", "effects: []"])
def test_a_damaged_rigid_body_is_refused_by_name(tmp_path: Path, text: str) -> None:
    (tmp_path / "sim.yaml").write_text(text)
    with pytest.raises(ConfigError, match=r"sim\.yaml"):
        physics_digest(tmp_path / "sim.yaml")


def test_other_data_or_settings_are_another_trial(data: TableData) -> None:
    trial = trial_of(data, r.MLP_FULL)
    others = [
        replace(trial, digests={**data.digests, "limo.parquet": "0"}),
        replace(trial, settings=replace(trial.settings, epochs=7)),
        replace(trial, run=5),
        replace(trial, split=SCAFFOLDS),
    ]
    assert len({item.file_name for item in (trial, *others)}) == 5
    elsewhere = replace(trial, settings=replace(trial.settings, device="cpu"))
    assert elsewhere.file_name == trial.file_name


@pytest.mark.parametrize("text", ["", "{}", '{"trial": {}, "mse": {}}', "[1"])
def test_a_damaged_trial_is_refused_by_name(data: TableData, tmp_path: Path, text: str) -> None:
    trial = trial_of(data, r.RBD)
    (tmp_path / trial.file_name).write_text(text)
    with pytest.raises(ConfigError, match=f"{trial.file_name}: cannot be read as a finished"):
        TrialStore(tmp_path, "one").load(trial)


# Processes


def run_two(
    runner: TrialRunner,
    store: TrialStore,
    trials: Sequence[Trial],
    advanced: Callable[[Trial, int], None],
) -> list[TrialResult | Failed]:
    try:
        return list(run_trials(runner, store, trials, (2, "processes"), advanced))
    finally:
        assert not multiprocessing.active_children()


@pytest.mark.slow("trains in processes of their own")
def test_worker_processes_finish_trials_and_say_why_one_cannot_be(
    runner: TrialRunner, data: TableData, tmp_path: Path
) -> None:
    store, epochs = TrialStore(tmp_path, "one"), dict[str, int]()
    trials = [trial_of(data, row) for row in (r.RBD, r.MLP_FULL, r.FCL100)]
    hopeless = trial_of(data, r.FCL500_FULL, SCAFFOLDS)
    hopeless = replace(hopeless, settings=replace(hopeless.settings, sequence_length=5000))
    ended = run_two(
        runner,
        store,
        [hopeless, *trials],
        lambda trial, epoch: epochs.update({trial.row.name: epoch}),
    )
    (failed,) = (item for item in ended if isinstance(item, Failed))
    assert failed.trial == hopeless
    assert "a sequence needs 5000" in failed.reason
    done = [item.trial.file_name for item in ended if isinstance(item, TrialResult)]
    assert sorted(done) == sorted(trial.file_name for trial in trials)
    assert epochs == {"MLP-7 with tau_rbd,r": 1, "LSTM-FCL 100": 1}
    for trial in trials:
        assert store.load(trial) is not None


@pytest.mark.slow("starts worker processes")
def test_a_worker_that_dies_fails_its_trial_only(
    runner: TrialRunner, data: TableData, tmp_path: Path
) -> None:
    trials = [trial_of(data, row) for row in (r.MLP_FULL, r.RBD)]
    trials[0] = replace(trials[0], settings=replace(trials[0].settings, epochs=10_000))

    def kill(_trial: Trial, epoch: int) -> None:
        if epoch == 1:
            for worker in multiprocessing.active_children():
                assert worker.pid is not None
                os.kill(worker.pid, 9)

    store = TrialStore(tmp_path, "one")
    ended = list(run_trials(runner, store, trials, (1, "processes"), kill))
    reasons = [item.reason for item in ended if isinstance(item, Failed)]
    assert reasons == ["its process ended with status -9, twice"]
    assert [item.trial.row.name for item in ended if isinstance(item, TrialResult)] == ["RBD"]


@pytest.mark.slow("starts worker processes")
def test_workers_are_stopped_when_nobody_listens(
    runner: TrialRunner, data: TableData, tmp_path: Path
) -> None:
    trial, store = trial_of(data, r.MLP_FULL), TrialStore(tmp_path, "one")
    endless = replace(trial, settings=replace(trial.settings, epochs=10_000))

    def interrupt(_trial: Trial, _epoch: int) -> None:
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        run_two(runner, store, [endless], interrupt)
    assert store.load(endless) is None


def test_sequences_longer_than_the_motion_are_refused(runner: TrialRunner, data: TableData) -> None:
    trial = trial_of(data, r.FCL500_FULL)
    long = replace(trial, settings=replace(trial.settings, sequence_length=5000))
    with pytest.raises(RecordingError, match="nothing is left to train on"):
        runner.run(long)
