"""The page and the card of a training say what was tried, on what, how good it is and where not."""

from __future__ import annotations

from dataclasses import replace

import pytest
from one_file import check_page, drawn, title_of

from estimators.hybrid import HybridModel
from estimators.hybrid.training.settings import TrainingSettings
from estimators.joint_physics import JointPhysics
from estimators.training_page import (
    held_out_errors,
    limits,
    model_card,
    save_training,
    training_page,
)


@pytest.fixture(scope="module")
def physics(rigid, training_recording):
    return JointPhysics(rigid).fit([training_recording])


def test_the_page_has_errors_data_and_limits(physics, training_recording):
    page = training_page(physics, [training_recording]).html()
    check_page(page)
    errors = drawn(page)[0]["data"]
    assert [one["name"] for one in errors] == ["simulation", "model"]
    assert errors[1]["x"] == pytest.approx(physics.fitted.record["rmse"]["held_out"], rel=1e-3)
    assert "of the simulation's error is left" in title_of(page).replace("&#x27;", "'")
    for anchor in ("errors", "data", "range", "limits"):
        assert f'id="{anchor}"' in page
    assert 'id="tried"' not in page  # a model that was asked for by its name
    assert 'id="curves"' not in page  # fitted in closed form


def test_what_was_tried_and_why_not_stands_in_the_page(physics, training_recording):
    choice = {
        "chosen": "joint-physics",
        "simulation": [1.0, 2.0],
        "tried": [
            {"name": "joint-physics", "left": [0.5, 0.25], "coverage": [0.9, 0.97], "shares": []},
            {"name": "mlp7, drive features", "refused": "is too short"},
        ],
    }
    record = {**physics.fitted.record, "choice": choice}
    chosen = JointPhysics(physics.simulation)
    chosen.fitted_ = replace(physics.fitted, record=record)
    page = training_page(chosen, [training_recording]).html()
    check_page(page)
    assert "mlp7, drive features was not compared: is too short" in page
    assert "90%" in page or "90\N{NO-BREAK SPACE}%" in page
    simulation, model = held_out_errors(record)
    assert model.tolist() == [0.5, 0.5]
    assert simulation.tolist() == [1.0, 2.0]


def test_a_network_shows_its_losses(rigid, training_recording):
    settings = TrainingSettings(features="drive", epochs=2, rate=50.0, folds=1)
    model = HybridModel(rigid, settings).fit([training_recording])
    page = training_page(model, [training_recording]).html()
    check_page(page)
    losses = drawn(page)[-1]["data"]
    assert [one["name"] for one in losses] == ["trained on", "held out"]
    assert losses[0]["x"] == [1, 2]


def test_the_card_says_data_robot_bandwidth_limits_and_that_no_licence_is_stated(
    physics, training_recording, tmp_path
):
    physics.save(tmp_path)
    page, card = save_training(physics, [training_recording], tmp_path)
    text = card.read_text()
    assert page.read_text().startswith("<!")
    assert text == model_card(physics, [training_recording])
    head = text.split("---")[1]
    assert "licence: not stated" in head
    assert "bandwidth: 10 " in head
    assert f"| {len(training_recording)} |" in text
    assert JointPhysics.load(tmp_path).bandwidth == 10.0  # the folder is read as before


def test_limits_say_that_another_payload_is_unknown(physics):
    assert any("payload" in line and "Identify and train again" in line for line in limits(physics))
