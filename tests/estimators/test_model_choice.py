"""Which model suits recordings, by motion held out."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest

import limo_driver as limo_library
from estimators.model_folder import load_model
from estimators.studies import model_choice
from estimators.studies.model_choice import (
    CONFIRMED,
    NETWORK,
    SIMULATION,
    ModelChoice,
    Tried,
    choose_model,
    fit_chosen,
)
from limo_driver.errors import ConfigError, RecordingError
from limo_driver.physics import Simulation, ViscousFriction

BANDWIDTH, OTHER = 10.0, "another"


@pytest.fixture(scope="module")
def recordings(record):
    return [record(seed, 15.0) for seed in range(11, 17)]


@pytest.fixture
def physics_alone(monkeypatch):
    """Compare no network, which takes seconds."""
    every = model_choice.candidates
    monkeypatch.setattr(
        model_choice,
        "candidates",
        lambda *given: {name: make for name, make in every(*given).items() if name != NETWORK},
    )


def of(name, *left):
    shares = np.array([1.0 if one < 1.0 else 0.0 for one in left])
    return Tried(name, np.array(left), shares, np.full(2, 0.95))


@pytest.mark.usefixtures("physics_alone")
def test_chooses_and_fits_what_explains_other_motion(rigid, recordings, test_recording):
    stages = []
    choice = choose_model(
        rigid, recordings, BANDWIDTH, lambda what, part: stages.append((what, part))
    )
    assert choice.chosen.name == CONFIRMED
    assert choice.chosen.mean < 0.3
    assert [part for _, part in stages] == sorted(part for _, part in stages)
    assert stages[0][0] == f"trying {CONFIRMED}"
    assert stages[-1] == ("done", 1.0)
    model = fit_chosen(choice, rigid, recordings, BANDWIDTH)
    found = model.estimate(test_recording)
    errors = [
        np.sqrt(np.mean((test_recording.filtered_torque(BANDWIDTH) - torque) ** 2))
        for torque in (found.simulation, found.torque)
    ]
    assert errors[1] < 0.3 * errors[0]
    assert model.fitted.record["choice"] == choice.as_values()


@pytest.mark.usefixtures("physics_alone")
def test_one_recording_is_cut_into_stretches_that_are_held_out(rigid, record):
    choice = choose_model(rigid, [record(3, 60.0)], BANDWIDTH)
    assert choice.chosen.name == CONFIRMED
    assert (choice.chosen.left < 0.6).all()


@pytest.mark.usefixtures("physics_alone")
def test_a_simulation_that_is_right_stays_as_it_is(arm, recordings):
    smooth = Simulation(str(arm), tuple(ViscousFriction(joint=j, f_v=0.5) for j in (1, 2)))
    random = np.random.default_rng(3)
    exact = [
        replace(
            one, torque=smooth.predict(one, BANDWIDTH) + random.normal(0, 0.05, one.torque.shape)
        )
        for one in recordings[:3]
    ]
    choice = choose_model(smooth, exact, BANDWIDTH)
    assert choice.chosen.name == SIMULATION
    assert "nothing that was learned is confirmed" in choice.headline()
    model = fit_chosen(choice, smooth, exact, BANDWIDTH)
    assert (model.estimate(exact[0]).learned == 0.0).all()


def test_another_takes_the_place_of_the_first_where_it_errs_a_quarter_less():
    first, close, better = of(CONFIRMED, 0.5, 0.5), of(OTHER, 0.42, 0.42), of(NETWORK, 0.3, 0.3)
    assert model_choice._best([first, close]) is first
    assert model_choice._best([first, close, better]) is better
    assert model_choice._best([of(OTHER, 1.0, 1.0)]) is None
    refused = Tried(CONFIRMED, *np.full((3, 2), np.nan), "is too short")
    assert model_choice._best([refused, close]) is close


def test_what_could_not_be_compared_stands_in_headline_and_manifest():
    refused = Tried(CONFIRMED, *np.full((3, 2), np.nan), "is too short")
    network = of(NETWORK, 0.5, 1.0)
    choice = ModelChoice((refused, network), network, np.array([0.1, 0.2]))
    assert f"{CONFIRMED} not compared" in choice.headline()
    assert choice.as_values()["tried"][0] == {"name": CONFIRMED, "refused": "is too short"}
    json.dumps(choice.as_values())
    assert CONFIRMED not in choice.figures()
    assert choice.figures()[NETWORK] == ["0.50", "1.00"]


@pytest.mark.slow("trains four networks")
def test_a_network_that_was_chosen_leaves_unconfirmed_joints_alone(rigid, recordings, tmp_path):
    network = of(NETWORK, 0.5, 1.0)
    choice = ModelChoice((network,), network, np.array([0.1, 0.2]))
    model = fit_chosen(choice, rigid, recordings[:2], BANDWIDTH)
    model.save(tmp_path / "model")
    loaded = load_model(tmp_path / "model")
    assert loaded.fitted.gain[1] == 0.0
    assert loaded.fitted.error[1] == pytest.approx(0.2)
    assert (loaded.estimate(recordings[0]).learned[:, 1] == 0.0).all()


@pytest.mark.usefixtures("physics_alone")
def test_too_little_motion_is_refused_by_name(rigid, record):
    with pytest.raises(RecordingError, match=r"say too little of joint|too short"):
        choose_model(rigid, [record(1, 2.0)], BANDWIDTH)


def test_settings_are_of_networks(rigid, recordings):
    settings = limo_library.TrainingSettings(epochs=3)
    with pytest.raises(ConfigError, match="settings are of networks; auto has no such choice"):
        limo_library.train(rigid, recordings, "auto", settings=settings)


@pytest.mark.slow("compares two models, one of them a network")
def test_the_command_shows_what_was_tried(limo, rigid, record, tmp_path):
    rigid.save(tmp_path / "sim.yaml")
    record(3, 60.0).save(tmp_path / "run.parquet")
    given = (tmp_path / "run.parquet", "--sim", tmp_path / "sim.yaml", "--out", tmp_path / "model")
    done = limo("train", *given)
    assert done.returncode == 0, done.stderr
    for name in (CONFIRMED, NETWORK):
        assert name in done.stdout
    manifest = json.loads((tmp_path / "model" / "manifest.json").read_text())
    assert manifest["training"]["choice"]["chosen"] == CONFIRMED
    told = json.loads(limo("train", *given, "--json").stdout)
    assert told["choice"] == manifest["training"]["choice"]


def test_the_command_refuses_options_of_networks_for_auto(limo):
    done = limo(
        "train", "run.parquet", "--sim", "s.yaml", "--out", "m", "--model", "auto", "--epochs", "3"
    )
    assert done.returncode == 2
    assert "--epochs is of networks; auto has no such choice" in done.stderr
