"""Which motion is trained on, in which pieces, and what is held out."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
import pytest

from estimators.hybrid.features import feature_set
from estimators.hybrid.model import train
from estimators.hybrid.training.data import HELD_OUT, LEFT_OUT, TRAINING, prepare
from estimators.hybrid.training.passes import BlockPasses, SequencePasses
from estimators.hybrid.training.settings import TrainingSettings, paper_settings
from estimators.neural.modules import LstmFclModule, Memory, TransformerModule
from limo_driver.errors import RecordingError
from limo_driver.recordings.recording import Recording

if TYPE_CHECKING:
    from limo_driver.physics import Simulation

QUICK = TrainingSettings(features="own-joint", epochs=2, rate=100.0, hidden=8)


def test_a_fifth_is_held_out_in_blocks(rigid: Simulation, training_recording: Recording) -> None:
    data = prepare(
        rigid,
        [training_recording],
        QUICK,
        np.random.default_rng(0),
    )
    assert np.mean(data.use == HELD_OUT) == pytest.approx(0.2, abs=0.02)
    starts = np.flatnonzero(np.diff((data.use == HELD_OUT).astype(int)) == 1)
    assert len(starts) <= 4  # of 20 blocks
    assert data.use[0] == data.use[-1] == LEFT_OUT
    normalised = data.inputs[data.use == TRAINING]
    np.testing.assert_allclose(normalised.mean(axis=0), 0.0, atol=1e-4)
    np.testing.assert_allclose(normalised.std(axis=0), 1.0, atol=1e-3)


def test_a_gap_parts_the_training_motion(rigid: Simulation, training_recording: Recording) -> None:
    whole = training_recording
    later = np.where(np.arange(len(whole)) < 3000, 0.0, 5.0)
    parted = Recording.from_arrays(whole.time + later, whole.position, whole.torque)
    data = prepare(
        rigid,
        [parted],
        QUICK,
        np.random.default_rng(0),
    )
    assert data.stretches == (slice(0, 3000), slice(3000, 6000))


def test_the_paper_draws_neighbouring_sequences(
    rigid: Simulation, training_recording: Recording
) -> None:
    """6000 rows at 100 Hz, of which the filter leaves a few at both ends out."""
    settings = replace(paper_settings("lstm-fcl", 50), bandwidth=5.0)
    data = prepare(rigid, [training_recording], settings, np.random.default_rng(0))
    assert (data.stride, data.rate) == (1, pytest.approx(100.0))
    sure = np.flatnonzero(data.use != LEFT_OUT)
    pieces = data.use[sure[0] : sure[-1] + 1].reshape(-1, 50)
    assert (pieces == pieces[:, :1]).all()
    assert np.mean(pieces == HELD_OUT) == pytest.approx(0.2, abs=0.01)


def test_a_fixed_division_trains_on_what_is_not_held_out(
    rigid: Simulation, training_recording: Recording
) -> None:
    import torch

    settings = paper_settings("lstm-fcl", 50)
    data = prepare(rigid, [training_recording], settings, np.random.default_rng(0))
    passes = SequencePasses(data, 7, np.random.default_rng(1), torch.device("cpu"), 50, 1)
    seen: list[torch.Tensor] = []

    class Spy(LstmFclModule):
        def forward(self, x: torch.Tensor, memory: Memory = None) -> tuple[torch.Tensor, Memory]:
            if torch.is_grad_enabled():
                seen.append(x)
                assert memory is None
            return super().forward(x, memory)

    module = Spy(feature_set("all-joints", 2).columns[:1], 4, 2)
    passes.epoch(module, torch.optim.AdamW(module.parameters()))
    trained = torch.cat(seen).reshape(-1, 10).numpy()
    expected = data.inputs[data.use == TRAINING]
    np.testing.assert_array_equal(np.sort(trained, axis=0), np.sort(expected, axis=0))


def test_a_transformer_is_shown_what_it_gave_before(
    rigid: Simulation, training_recording: Recording
) -> None:
    import torch

    settings = replace(paper_settings("transformer", 50), hidden=8)
    data = prepare(rigid, [training_recording], settings, np.random.default_rng(0))
    passes = BlockPasses(data, 7, np.random.default_rng(1), torch.device("cpu"), 50, 1)
    shown: list[tuple[torch.Tensor, torch.Tensor]] = []

    class Spy(TransformerModule):
        def forward(self, x: torch.Tensor, before: torch.Tensor) -> torch.Tensor:
            y = super().forward(x, before)
            shown.append((before, y.detach()))
            return y

    module = Spy(feature_set("all-joints", 2).columns[:1], 2, 50, 8, 1, 2)
    optimizer = torch.optim.AdamW(module.parameters())
    passes.epoch(module, optimizer)
    assert not any(before.any() for before, _ in shown)
    gave = torch.cat([y for _, y in shown])
    shown.clear()
    passes.epoch(module, optimizer)
    before = torch.cat([before for before, _ in shown])
    assert not before[:, 0].any()
    np.testing.assert_array_equal(  # in another order
        np.sort(before[:, 1:].reshape(-1)), np.sort(gave[:, :-1].reshape(-1))
    )


def test_whole_recordings_are_held_out(rigid: Simulation, training_recording: Recording) -> None:
    parts = [training_recording[i * 1000 : (i + 1) * 1000] for i in range(6)]
    settings = replace(QUICK, split="recordings")
    data = prepare(rigid, parts, settings, np.random.default_rng(0))
    held_out = [set(data.use[rows]) - {LEFT_OUT} == {HELD_OUT} for rows in data.recordings]
    assert sum(held_out) == 1
    with pytest.raises(RecordingError, match="the only recording"):
        train(rigid, parts[:1], settings)
