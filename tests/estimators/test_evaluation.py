from __future__ import annotations

import json
from dataclasses import replace
from functools import partial
from io import StringIO
from typing import TYPE_CHECKING

import numpy as np
import pytest
from one_file import arm_of, check_page, drawn, title_of
from wandering import wander

from estimators.evaluation import Evaluation, evaluate, noise_floor
from estimators.evaluation_page import evaluation_page, loop_figure, png, torque_figure
from estimators.hybrid import HybridModel
from estimators.hybrid.training.settings import TrainingSettings
from estimators.joint_physics import JointPhysics
from limo_driver.errors import RecordingError
from limo_driver.recordings.recording import Recording

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path
    from subprocess import CompletedProcess

    from limo_driver.physics import Simulation

    Limo = Callable[..., CompletedProcess[str]]


@pytest.fixture(scope="module")
def model(rigid: Simulation, training_recording: Recording) -> HybridModel:
    settings = TrainingSettings(features="drive", epochs=5, rate=50.0, learning_rate=3e-3)
    return HybridModel(rigid, settings).fit([training_recording])


@pytest.fixture(scope="module")
def evaluation(model: HybridModel, test_recording: Recording) -> Evaluation:
    return evaluate(model, test_recording)


def test_errors_are_against_the_filtered_torque(
    evaluation: Evaluation, model: HybridModel, test_recording: Recording
) -> None:
    inside = ~test_recording.edges(10.0)
    residual = test_recording.torque - model.predict(test_recording)
    residual = test_recording.filtered(residual, 10.0)
    np.testing.assert_allclose(evaluation.hybrid.mse, np.mean(residual[inside] ** 2, axis=0))
    assert evaluation.mean_mse_ratio == pytest.approx(
        evaluation.rigid_body.mse.mean() / evaluation.hybrid.mse.mean()
    )


@pytest.mark.slow("evaluates a minute")
def test_a_simulation_that_is_the_arm_leaves_nothing_but_noise(rigid: Simulation) -> None:
    motion = wander(
        np.arange(4000) / 100.0,
        np.array([0.4, -0.8]),
        np.random.default_rng(0),
        (0.1, 0.6),
        (0.05, 0.15),
    )
    noise = 0.02 * np.random.default_rng(1).standard_normal(motion.position.shape)
    recording = Recording.from_arrays(motion.time, motion.position, rigid.predict(motion) + noise)
    own = Recording.from_arrays(motion.time, motion.position, noise).filtered_torque(10.0)
    model = JointPhysics(rigid).fit([recording])
    found = evaluate(model, recording)
    np.testing.assert_allclose(found.rigid_body.rmse, np.std(own[found.scored], axis=0), rtol=0.25)
    np.testing.assert_allclose(
        model.fitted.record["rmse"]["simulation"], found.rigid_body.rmse, rtol=1e-9
    )
    np.testing.assert_allclose(found.noise_floor, np.std(own, axis=0), rtol=0.2)


@pytest.mark.slow("filters a minute at 1 kHz, twice")
def test_noise_floor_is_the_noise_that_the_filter_leaves() -> None:
    random = np.random.default_rng(0)
    t = np.arange(60_000) / 1000.0
    noise = 0.05 * random.standard_normal((t.size, 2))
    motion = np.sin(2 * np.pi * 0.5 * t)[:, None] * [0.3, 0.5]
    recording = Recording.from_arrays(t, motion, 8 * motion + noise)
    left = Recording.from_arrays(t, motion, noise).filtered_torque(20.0).std(axis=0)
    np.testing.assert_allclose(noise_floor(recording, 20.0), left, rtol=0.1)


def test_noise_floor_is_unknown_where_the_filter_reaches_that_far(
    test_recording: Recording,
) -> None:
    assert np.isnan(noise_floor(test_recording, 35.0)).all()


def test_noise_floor_is_unknown_where_noise_was_filtered_before_recording() -> None:
    random = np.random.default_rng(0)
    t = np.arange(20_000) / 1000.0
    noise = 0.05 * random.standard_normal((t.size, 2))
    motion = np.sin(2 * np.pi * 0.5 * t)[:, None] * [0.3, 0.5]
    raw = Recording.from_arrays(t, motion, 8 * motion + noise)
    smooth = Recording.from_arrays(t, motion, raw.filtered_torque(150.0))
    assert np.isnan(noise_floor(smooth, 20.0)).all()


def test_the_table_fits_a_narrow_terminal(evaluation: Evaluation) -> None:
    from rich.console import Console

    from limo_driver.app.cli.evaluate import table

    console = Console(width=80, file=StringIO())
    names = ("a_rather_long_name_of_a_joint", "another")
    console.print(table(replace(evaluation, joint_names=names)))
    shown = console.file.getvalue()
    assert "of MSE" in shown
    assert "…" not in shown


def test_a_joint_without_torque_has_no_errors(
    evaluation: Evaluation, model: HybridModel, test_recording: Recording
) -> None:
    torque = test_recording.torque.copy()
    torque[:, 1] = 0.0
    found = evaluate(model, replace(test_recording, torque=torque))
    for own, whole in (
        (found.hybrid.rmse, evaluation.hybrid.rmse),
        (found.rigid_body.rmse, evaluation.rigid_body.rmse),
        (found.coverage, evaluation.coverage),
    ):
        assert own[0] == pytest.approx(whole[0])
        assert np.isnan(own[1])
    assert found.mean_mse_ratio == pytest.approx(evaluation.mse_ratio[0])
    values = found.as_values()
    assert values["rmse_hybrid"][1] is None
    assert values["mean_mse_hybrid"] == values["mse_hybrid"][0]
    assert str(found).splitlines()[-1].split()[-1] == "-"
    text = evaluation_page(found).html()
    check_page(text)
    assert f"No torque was measured at {found.joint_names[1]}." in text
    assert "multiples of its noise floor" in text
    score = model.simulation.score(found.recording)
    assert np.isnan(score.rmse[1])
    assert score.joint_names[0] in score.headline()


def test_torques_that_are_all_zero_are_no_measurement(
    model: HybridModel, test_recording: Recording
) -> None:
    silent = replace(test_recording, torque=np.zeros_like(test_recording.torque))
    for judged in (partial(evaluate, model), model.simulation.score):
        with pytest.raises(RecordingError, match="every torque is 0 N m; was it measured"):
            judged(silent)


def test_too_short_to_score(model: HybridModel, test_recording: Recording) -> None:
    with pytest.raises(RecordingError, match="too short"):
        evaluate(model, test_recording[:8])


def test_the_page_shows_each_joint_and_the_errors_at_the_slider(
    evaluation: Evaluation, model: HybridModel
) -> None:
    text = evaluation_page(evaluation).html()
    check_page(text)
    charts = drawn(text)
    assert len(charts) == 1 + 2 * 2  # errors; over time and over position of both joints
    marks = {curve["name"]: curve["x"] for curve in charts[0]["data"]}
    assert marks[model.name] == pytest.approx(evaluation.hybrid.rmse, rel=1e-3)
    assert f"{np.sqrt(evaluation.hybrid.mse.mean()):.3g}" in title_of(text)
    ghosts = arm_of(text)["motion"]["ghosts"]
    assert [ghost["name"] for ghost in ghosts] == ["rigid body", model.name]


def test_without_a_noise_floor_errors_are_compared_with_the_largest(
    evaluation: Evaluation,
) -> None:
    unknown = replace(evaluation, noise_floor=np.full(2, np.nan), trained_on=True)
    text = evaluation_page(unknown).html()
    check_page(text)
    worst = max(evaluation.hybrid.rmse.max(), evaluation.rigid_body.rmse.max())
    assert arm_of(text)["floor"] == pytest.approx([worst / 100] * 2, abs=1e-6)
    assert "of the largest error" in text
    assert "multiples of its noise floor" not in text
    assert "trained on" in title_of(text)


@pytest.mark.slow("draws every picture")
def test_pictures_have_a_panel_for_each_joint(evaluation: Evaluation) -> None:
    for figure in (torque_figure(evaluation), loop_figure(evaluation)):
        shown = [axes for axes in figure.axes if axes.get_visible()]
        assert len(shown) == 2
        assert all("N m" in axes.get_ylabel() for axes in shown)
        assert len(shown[0].get_lines()) == 3
        assert png(figure).startswith(b"\x89PNG")


@pytest.fixture(scope="module")
def files(
    tmp_path_factory: pytest.TempPathFactory,
    rigid: Simulation,
    training_recording: Recording,
    test_recording: Recording,
) -> Path:
    folder = tmp_path_factory.mktemp("files")
    rigid.save(folder / "sim.yaml")
    training_recording.save(folder / "train.parquet")
    test_recording.save(folder / "test.parquet")
    return folder


def test_from_recordings_to_pictures(files: Path, limo: Limo) -> None:
    trained = limo(
        *("train", files / "train.parquet", "--sim", files / "sim.yaml", "--out", files / "model"),
        *("--features", "drive", "--epochs", "2", "--json"),
    )
    assert trained.returncode == 0, trained.stderr
    assert set(json.loads(trained.stdout)["rmse"]) == {"training", "held_out", "left_out"}
    evaluated = limo(
        *("evaluate", files / "test.parquet", "--model", files / "model"),
        *("--sim", files / "sim.yaml", "--out", files / "out"),
    )
    assert evaluated.returncode == 0, evaluated.stderr
    assert "shoulder" in evaluated.stdout
    figures = json.loads((files / "out" / "evaluation.json").read_text())
    assert len(figures["rmse_hybrid"]) == 2
    check_page((files / "out" / "report.html").read_text())
    assert (files / "out" / "torque.png").stat().st_size > 10_000
    assert (files / "out" / "loops.png").stat().st_size > 10_000


@pytest.mark.slow("trains a model")
def test_it_is_said_that_a_model_was_trained_on_the_recording(
    rigid: Simulation, files: Path, limo: Limo
) -> None:
    seen, unseen = (Recording.load(files / name) for name in ("train.parquet", "test.parquet"))
    settings = TrainingSettings(features="drive", epochs=1, rate=50.0, folds=1)
    model = HybridModel(rigid, settings).fit([seen])
    assert evaluate(model, seen).as_values()["trained_on"] is True
    assert evaluate(model, unseen).as_values()["trained_on"] is False
    model.save(files / "seen")
    told = limo("evaluate", files / "train.parquet", "--model", files / "seen")
    assert "train.parquet: the model was trained on it" in told.stderr


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("train", "nothing.parquet", "--sim", "sim.yaml", "--out", "m"), "nothing.parquet"),
        (("train", "train.parquet", "--sim", "no.yaml", "--out", "m"), "no.yaml"),
        (
            ("train", "train.parquet", "--sim", "sim.yaml", "--out", "m", "--model", "x"),
            "joint-physics, mlp7",
        ),
        (("evaluate", "test.parquet", "--model", "nowhere", "--out", "sim.yaml"), "is a file"),
        (("evaluate", "test.parquet", "--model", "nowhere"), "no such model folder"),
    ],
)
def test_bad_input_is_one_line(
    files: Path, limo: Limo, arguments: tuple[str, ...], message: str
) -> None:
    done = limo(*(files / a if "." in a or a in {"m", "nowhere"} else a for a in arguments))
    assert done.returncode == 2
    assert message in done.stderr
    assert done.stderr.count("\n") == 1
