from __future__ import annotations

import json
import os
import subprocess
import sys
from dataclasses import replace
from io import StringIO
from typing import TYPE_CHECKING

import numpy as np
import pytest

from estimators.evaluation import Evaluation, evaluate, noise_floor
from estimators.hybrid import HybridModel
from estimators.pictures import loop_figure, png, torque_figure
from estimators.training import TrainingSettings
from limo_driver.errors import RecordingError
from limo_driver.recording import Recording

if TYPE_CHECKING:
    from pathlib import Path

    from limo_driver.physics import Simulation


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
    residual = test_recording.filtered_torque(10.0) - model.predict(test_recording)
    np.testing.assert_allclose(evaluation.hybrid.mse, np.mean(residual[inside] ** 2, axis=0))
    assert evaluation.mean_mse_ratio == pytest.approx(
        evaluation.rigid_body.mse.mean() / evaluation.hybrid.mse.mean()
    )


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

    from limo_driver.cli.evaluate import table

    console = Console(width=80, file=StringIO())
    names = ("a_rather_long_name_of_a_joint", "another")
    console.print(table(replace(evaluation, joint_names=names)))
    shown = console.file.getvalue()
    assert "of MSE" in shown
    assert "…" not in shown


def test_too_short_to_score(model: HybridModel, test_recording: Recording) -> None:
    with pytest.raises(RecordingError, match="too short"):
        evaluate(model, test_recording[:8])


def test_pictures_have_a_panel_for_each_joint(evaluation: Evaluation) -> None:
    for figure in (torque_figure(evaluation), loop_figure(evaluation)):
        shown = [axes for axes in figure.axes if axes.get_visible()]
        assert len(shown) == 2
        assert all("N m" in axes.get_ylabel() for axes in shown)
        assert len(shown[0].get_lines()) == 3
        assert png(figure).startswith(b"\x89PNG")


def limo(*arguments: str | Path) -> subprocess.CompletedProcess[str]:
    code = "from limo_driver.cli import main; main()"
    return subprocess.run(
        [sys.executable, "-c", code, *map(str, arguments)],
        capture_output=True,
        text=True,
        check=False,
        env=os.environ | {"COLUMNS": "120"},
    )


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


def test_from_recordings_to_pictures(files: Path) -> None:
    trained = limo(
        *("train", files / "train.parquet", "--sim", files / "sim.yaml", "--out", files / "model"),
        *("--features", "drive", "--epochs", "2", "--json"),
    )
    assert trained.returncode == 0, trained.stderr
    assert set(json.loads(trained.stdout)["rmse"]) == {"training", "held_out"}
    evaluated = limo(
        *("evaluate", files / "test.parquet", "--model", files / "model"),
        *("--sim", files / "sim.yaml", "--out", files / "out"),
    )
    assert evaluated.returncode == 0, evaluated.stderr
    assert "shoulder" in evaluated.stdout
    figures = json.loads((files / "out" / "evaluation.json").read_text())
    assert len(figures["rmse_hybrid"]) == 2
    assert (files / "out" / "torque.png").stat().st_size > 10_000
    assert (files / "out" / "loops.png").stat().st_size > 10_000


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("train", "nothing.parquet", "--sim", "sim.yaml", "--out", "m"), "nothing.parquet"),
        (("train", "train.parquet", "--sim", "no.yaml", "--out", "m"), "no.yaml"),
        (("train", "train.parquet", "--sim", "sim.yaml", "--out", "m", "--model", "x"), "mlp7"),
        (("evaluate", "test.parquet", "--model", "nowhere"), "no such model folder"),
    ],
)
def test_bad_input_is_one_line(files: Path, arguments: tuple[str, ...], message: str) -> None:
    done = limo(*(files / a if "." in a or a in {"m", "nowhere"} else a for a in arguments))
    assert done.returncode == 2
    assert message in done.stderr
    assert done.stderr.count("\n") == 1
