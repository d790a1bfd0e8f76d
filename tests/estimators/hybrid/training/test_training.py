from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
import pytest
import torch
from lanes import sampled

from estimators.hybrid import HybridModel
from estimators.hybrid.features import feature_set
from estimators.hybrid.model import train
from estimators.hybrid.training.data import HELD_OUT, LEFT_OUT, TRAINING, TrainingData, prepare
from estimators.hybrid.training.fit import carry_over, device_for
from estimators.hybrid.training.settings import TrainingSettings, paper_settings, usual_settings
from estimators.neural import NETWORKS, Mlp, Network
from limo_driver.errors import ConfigError, DivergedError, RecordingError
from limo_driver.recordings.recording import Recording

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from estimators.hybrid.fitted_network import FittedNetwork
    from estimators.hybrid.training.fit import Epoch
    from limo_driver.physics import Simulation

QUICK = TrainingSettings(features="own-joint", epochs=2, rate=100.0, hidden=8)


def mse(model: HybridModel, recording: Recording) -> tuple[float, float]:
    """Return MSE of rigid body and hybrid [(N m)²]."""
    found, bandwidth = model.estimate(recording), model.fitted.bandwidth
    inside = ~recording.edges(bandwidth)
    measured = recording.filtered_torque(bandwidth)
    return tuple(
        float(np.mean((measured - p)[inside] ** 2)) for p in (found.simulation, found.torque)
    )


@sampled(
    ("settings", "factor"),
    [
        (TrainingSettings(features="drive", epochs=25, rate=50.0, learning_rate=3e-3), 30),
        (
            TrainingSettings(
                features="own-joint", epochs=25, rate=50.0, learning_rate=3e-3, folds=1
            ),
            4,
        ),
        (
            TrainingSettings(
                model="lstm-fcl",
                features="own-joint",
                epochs=30,
                rate=50.0,
                sequence_length=50,
                batch=4,
                hidden=8,
                learning_rate=1e-2,
                folds=1,
            ),
            4,
        ),
    ],
    "trains a network each",
    ids=["mlp7 drive", "mlp7", "lstm-fcl"],
)
def test_hybrid_beats_the_rigid_body_on_other_motion(
    rigid: Simulation,
    training_recording: Recording,
    test_recording: Recording,
    settings: TrainingSettings,
    factor: float,
) -> None:
    model = HybridModel(rigid, settings).fit([training_recording])
    rigid_body, hybrid = mse(model, test_recording)
    assert rigid_body / hybrid > factor


@pytest.mark.slow("trains a network")
def test_recurrent_memory_does_not_drift(
    rigid: Simulation, record: Callable[[int, float], Recording]
) -> None:
    """Sequences of training are 0.5 s; five minutes later the error is what it was."""
    settings = TrainingSettings(
        model="lstm-fcl",
        features="own-joint",
        epochs=10,
        sequence_length=50,
        batch=4,
        hidden=8,
        folds=1,
    )
    model = HybridModel(rigid, settings).fit([record(1, 40.0)])
    long = record(3, 300.0)
    error = long.filtered_torque(10.0) - model.predict(long)
    early, late = error[1000:6000], error[-5000:]
    assert np.sqrt(np.mean(late**2)) < 1.5 * np.sqrt(np.mean(early**2))


@sampled("model", NETWORKS, "trains each kind twice")
def test_same_seed_same_weights(
    rigid: Simulation, training_recording: Recording, model: str
) -> None:
    settings = TrainingSettings(
        model=model, features="own-joint", epochs=1, hidden=4, seed=3, folds=2, sequence_length=20
    )
    first, second = (train(rigid, [training_recording], settings).network for _ in range(2))
    for name, weight in first.weights.items():
        np.testing.assert_array_equal(weight, second.weights[name])


def test_another_seed_other_weights(rigid: Simulation, training_recording: Recording) -> None:
    networks = [
        train(rigid, [training_recording], replace(QUICK, seed=seed)).network for seed in (0, 1)
    ]
    assert not np.allclose(
        networks[0].weights["hidden_weight"], networks[1].weights["hidden_weight"]
    )


def test_training_leaves_the_random_state_and_threads_alone(
    rigid: Simulation, training_recording: Recording
) -> None:
    import torch

    before, threads = torch.random.get_rng_state(), torch.get_num_threads()
    train(rigid, [training_recording], QUICK)
    assert torch.equal(torch.random.get_rng_state(), before)
    assert torch.get_num_threads() == threads


def test_epochs_are_reported_and_recorded(rigid: Simulation, training_recording: Recording) -> None:
    seen: list[Epoch] = []
    fitted = train(rigid, [training_recording], QUICK, seen.append)
    assert [(epoch.fold, epoch.number) for epoch in seen] == [
        *((0, 1), (0, 2)),  # the network that is kept
        *((1, 1), (1, 2), (2, 1), (2, 2), (3, 1), (3, 2)),
    ]
    assert [item["held_out_loss"] for item in fitted.record["epochs"]] == [
        epoch.held_out_loss for epoch in seen[:2]
    ]
    assert set(fitted.record["rmse"]) == {"training", "held_out", "left_out"}


def test_a_network_that_carries_over_is_trusted(
    rigid: Simulation, training_recording: Recording
) -> None:
    settings = TrainingSettings(features="drive", epochs=15, rate=50.0, learning_rate=3e-3)
    assert (train(rigid, [training_recording], settings).gain > 0.95).all()


def test_a_network_that_learns_by_heart_is_switched_off(
    rigid: Simulation, training_recording: Recording
) -> None:
    """What the halves of the second joint leave unexplained contradicts each other."""
    early = (training_recording.time < training_recording.time[3000])[:, None]
    motion = training_recording.motion(10.0)
    unexplained = np.where(early, 1.0, -1.0) * np.sign(motion.velocity) * [0.0, 2.0]
    contradicting = Recording.from_arrays(
        training_recording.time,
        training_recording.position,
        rigid.predict(motion) + 0.3 * np.tanh(motion.velocity / 0.05) * [1.0, 0.0] + unexplained,
    )
    settings = TrainingSettings(features="drive", epochs=5, rate=50.0, learning_rate=3e-3, folds=2)
    found = train(rigid, [contradicting], settings)
    assert found.gain[0] > 0.9
    assert found.gain[1] == 0.0
    # switched off, it leaves all of what contradicts itself, however well blocks were learned
    np.testing.assert_array_equal(found.error, found.record["rmse"]["left_out"]["hybrid"])
    assert found.error[1] == pytest.approx(2.0, rel=0.15)
    trusting = train(rigid, [contradicting], replace(settings, epochs=1, folds=1))
    np.testing.assert_array_equal(trusting.gain, 1.0)
    np.testing.assert_array_equal(trusting.error, trusting.record["rmse"]["held_out"]["hybrid"])


def test_whole_recordings_judge_where_there_are_enough(
    rigid: Simulation, training_recording: Recording
) -> None:
    data = prepare(
        rigid,
        [training_recording[:2000], training_recording[2000:]],
        QUICK,
        np.random.default_rng(0),
    )
    seen: list[TrainingData] = []

    def fit(rest: TrainingData, fold: int) -> Network:
        seen.append(rest)
        assert fold == len(seen)
        zero = {"hidden_weight": (2, 5, 1), "hidden_bias": (2, 1)}
        zero |= {"output_weight": (2, 1, 1), "output_bias": (2, 1)}
        columns = feature_set("own-joint", 2).columns
        return Mlp(columns, {name: np.zeros(shape) for name, shape in zero.items()})

    found = carry_over(data, 2, fit)
    used = data.output_scaling.restore(data.targets[data.use != LEFT_OUT].astype(np.float64))
    left = np.std(used, axis=0)  # it gives the mean, and no more
    np.testing.assert_allclose(found.rmse, left, rtol=1e-3)
    for rest, out in zip(seen, (slice(0, 2000), slice(2000, 6000)), strict=True):
        kept = np.delete(np.arange(6000), out)
        assert (rest.use[out] == LEFT_OUT).all()
        np.testing.assert_array_equal(rest.use[kept], data.use[kept])
        training = rest.inputs[rest.use == TRAINING]
        assert (rest.inputs[out] <= training.max(axis=0)).all()


def test_a_network_that_stands_alone_gives_the_whole_torque(
    rigid: Simulation, training_recording: Recording, test_recording: Recording, tmp_path: Path
) -> None:
    settings = replace(
        QUICK, standalone=True, without=("rotation_since_reversal",), epochs=20, folds=1, hidden=30
    )
    model = HybridModel(rigid, settings).fit([training_recording])
    assert model.fitted.features.quantities == ("position", "velocity", "acceleration")
    found = model.estimate(test_recording)
    assert not found.simulation.any()
    nothing, network = mse(model, test_recording)
    assert nothing / network > 4
    model.save(tmp_path / "model")
    loaded = HybridModel.load(tmp_path / "model")
    np.testing.assert_array_equal(loaded.predict(test_recording), found.learned)
    state, motion = loaded.init(100.0), test_recording.motion(10.0)
    for t in range(50):
        torque, state = loaded.step(state, motion.sample(t))
        np.testing.assert_allclose(torque, found.learned[t], atol=1e-6)


def test_the_last_weights_are_kept_where_asked(
    rigid: Simulation, training_recording: Recording
) -> None:
    settings = replace(
        QUICK, keep="last", epochs=3, learning_rate=0.05, schedule="plateau", folds=1
    )
    first, second = (
        train(rigid, [training_recording], replace(settings, epochs=epochs)) for epochs in (3, 2)
    )
    last = [epoch["held_out_loss"] for epoch in first.record["epochs"]]
    assert last[:2] == [epoch["held_out_loss"] for epoch in second.record["epochs"]]
    found = mse_of_held_out(rigid, first, training_recording, settings)
    assert found == pytest.approx(last[-1], rel=1e-3)


def mse_of_held_out(
    rigid: Simulation, fitted: FittedNetwork, recording: Recording, settings: TrainingSettings
) -> float:
    """Return the normalised loss of a memoryless network."""
    data = prepare(rigid, [recording], settings, np.random.default_rng(settings.seed))
    y, _ = fitted.network.advance(fitted.network.init(1), data.inputs.astype(np.float64))
    return float(np.mean((y - data.targets)[data.use == HELD_OUT] ** 2))


def test_the_papers_protocol() -> None:
    settings = paper_settings("lstm-fcl", 500, without=("rotation_since_reversal",))
    assert (settings.batch, settings.epochs, settings.learning_rate) == (50, 100, 1e-3)
    assert (settings.split, settings.carried, settings.keep) == ("sequences", 1, "last")
    assert (settings.rate, settings.folds, settings.hidden) == (0.0, 1, 35)
    assert len(settings.features_for(7).inputs) == 28
    assert paper_settings("mlp7", 500).hidden == 100


def test_a_gpu_that_is_not_there_is_refused(
    rigid: Simulation, training_recording: Recording, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("torch.cuda.is_available", lambda: False)
    with pytest.raises(ConfigError, match="no CUDA device"):
        train(rigid, [training_recording], replace(QUICK, device="cuda"))


@pytest.mark.parametrize(
    ("model", "device", "type_"),
    [("mlp7", "auto", "cpu"), ("mlp7", "cuda", "cpu"), ("lstm-fcl", "auto", "cuda")],
)
def test_a_gpu_trains_what_it_trains_sooner_or_what_it_is_told_to(
    model: str, device: str, type_: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("torch.cuda.is_available", lambda: True)
    assert device_for(replace(QUICK, model=model, device=device)).type == type_


@pytest.mark.skipif(not torch.cuda.is_available(), reason="PyTorch sees no GPU")
@pytest.mark.parametrize("model", NETWORKS)
def test_a_gpu_trains_as_a_cpu_does(
    rigid: Simulation, training_recording: Recording, model: str
) -> None:
    losses: dict[str, list[float]] = {"cpu": [], "cuda": []}
    for device, found in losses.items():
        settings = replace(QUICK, model=model, device=device, sequence_length=20, folds=1)

        def on_epoch(epoch: Epoch, found: list[float] = found) -> None:
            found.append(epoch.training_loss)

        train(rigid, [training_recording], settings, on_epoch)
    assert losses["cuda"] == pytest.approx(losses["cpu"], rel=1e-2)


def test_a_recording_shorter_than_a_sequence_is_refused(
    rigid: Simulation, training_recording: Recording
) -> None:
    settings = TrainingSettings(model="lstm-fcl", sequence_length=500)
    with pytest.raises(RecordingError, match=r"300 samples at 100 Hz .* needs 500"):
        train(rigid, [training_recording[:300]], settings)


def test_recordings_of_different_rates_are_refused(
    rigid: Simulation, training_recording: Recording
) -> None:
    slower = training_recording[::2]
    with pytest.raises(RecordingError, match="50 Hz, but seed 1 at 100 Hz"):
        train(rigid, [training_recording, slower], QUICK)


def test_a_diverging_loss_is_an_error(rigid: Simulation, training_recording: Recording) -> None:
    settings = TrainingSettings(features="own-joint", epochs=3, learning_rate=1e30)
    with pytest.raises(DivergedError, match="no longer finite in epoch"):
        train(rigid, [training_recording], settings)


@pytest.mark.parametrize(
    ("setting", "message"),
    [
        ({"split": "rows"}, "split is 'rows', expected one of blocks, sequences, recordings"),
        ({"keep": "first"}, "'first', expected one of best, last"),
        ({"device": "tpu"}, "'tpu', expected one of auto, cpu, cuda"),
        ({"carried": 0}, "carried is 0, expected a whole number above 0"),
        ({"rate": -1.0}, "rate is -1 Hz, expected a number of 0 Hz or more"),
        ({"layers": 0}, "layers is 0"),
        ({"layers": 2}, "layers = 2, but mlp7 is built with at most 1"),
        ({"model": "lstm-fcl", "layers": 3}, "layers = 3, but lstm-fcl is built with at most 2"),
        ({"model": "transformer", "hidden": 33}, "hidden = 33 has to be a multiple of heads = 2"),
        ({"model": "transformer", "heads": 3}, "hidden = 32 has to be a multiple of heads = 3"),
        ({"features": "every"}, "no feature set is called 'every'"),
        ({"without": ("velocity", "temperature")}, "has no 'temperature'; known: acceleration, "),
        ({"model": "gpt"}, "'gpt', expected one of mlp7, lstm-2, lstm-fcl, gru, lru, transformer"),
        ({"schedule": "step"}, "'step', expected one of cosine, plateau"),
        ({"epochs": 0}, "epochs is 0"),
        ({"folds": 0}, "folds is 0"),
        ({"held_out": 1.0}, "held_out is 1, expected a number between 0 and 1"),
        ({"learning_rate": float("nan")}, "learning_rate is nan"),
        ({"weight_decay": float("inf")}, "weight_decay is inf, expected a number of 0 or more"),
        ({"rate": float("inf")}, "rate is inf Hz"),
        ({"rate": 0.001}, "rate = 0.001 Hz has to be 10 Hz, the bandwidth, or more"),
        ({"seed": 10**20}, "seed is 1.*, expected a whole number from 0 to 18446744073709551615"),
    ],
)
def test_settings_that_cannot_be_are_refused(setting: dict[str, object], message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        TrainingSettings(**setting)


def test_only_a_drive_departs_from_the_paper() -> None:
    assert usual_settings("all-joints") == TrainingSettings()
    assert usual_settings("drive") != TrainingSettings(features="drive")
