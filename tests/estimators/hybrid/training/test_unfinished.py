"""A training ends where nothing gets better, and goes on after a kill as if there had been none."""

from __future__ import annotations

import multiprocessing
import os
import signal
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
import pytest

from estimators.hybrid.model import train
from estimators.hybrid.training.passes import Passes, SequencePasses
from estimators.hybrid.training.settings import TrainingSettings
from limo_driver.errors import ConfigError

if TYPE_CHECKING:
    from pathlib import Path

    from estimators.hybrid.training.fit import Epoch
    from limo_driver.physics import Simulation
    from limo_driver.recordings.recording import Recording

SHORT = TrainingSettings(
    features="own-joint", epochs=4, hidden=4, rate=50.0, sequence_length=20, batch=2, folds=2
)
KINDS = ("mlp7", "gru", "lru", "transformer")
KILLED_AT = (1, 3)  # fold and epoch


def die(rigid: Simulation, recording: Recording, settings: TrainingSettings, folder: Path) -> None:
    """Train, and be killed in the middle."""

    def on_epoch(epoch: Epoch) -> None:
        if (epoch.fold, epoch.number) == KILLED_AT:
            os.kill(os.getpid(), signal.SIGKILL)

    train(rigid, [recording], settings, on_epoch, folder)


def killed(
    rigid: Simulation, recording: Recording, settings: TrainingSettings, folder: Path
) -> None:
    """Have a training killed in a process of its own."""
    arguments = (rigid, recording, settings, folder)
    process = multiprocessing.get_context("spawn").Process(target=die, args=arguments)
    process.start()
    process.join()
    assert process.exitcode == -signal.SIGKILL


@pytest.mark.parametrize("kind", KINDS)
def test_a_killed_training_goes_on_and_gives_the_same(
    kind: str,
    rigid: Simulation,
    training_recording: Recording,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    settings = replace(SHORT, model=kind)
    killed(rigid, training_recording, settings, tmp_path)
    made: list[Passes] = []
    of = type(passes_of(rigid, training_recording, settings, monkeypatch))
    epoch = of.epoch

    def counted(self: Passes, *given: object) -> tuple[float, float]:
        made.append(self)
        return epoch(self, *given)

    monkeypatch.setattr(of, "epoch", counted)
    seen: list[tuple[int, int]] = []
    again = train(
        rigid,
        [training_recording],
        settings,
        lambda epoch: seen.append((epoch.fold, epoch.number)),
        tmp_path,
    )
    assert len(made) == 1 + settings.epochs  # the last of the first fold, all of the second
    assert seen == [(fold, number) for fold in range(3) for number in range(1, 5)]
    whole = train(rigid, [training_recording], settings)
    for name, weight in whole.network.weights.items():
        np.testing.assert_array_equal(again.network.weights[name], weight)
    np.testing.assert_array_equal(again.gain, whole.gain)
    assert again.record == whole.record


def passes_of(
    rigid: Simulation,
    recording: Recording,
    settings: TrainingSettings,
    monkeypatch: pytest.MonkeyPatch,
) -> Passes:
    """Return what goes over the motion in such a training."""
    from estimators.hybrid.training import fit

    found: list[Passes] = []
    of = fit._passes

    def kept(*given: object) -> Passes:
        found.append(of(*given))
        return found[-1]

    with monkeypatch.context() as patched:
        patched.setattr(fit, "_passes", kept)
        train(rigid, [recording], replace(settings, epochs=1, folds=1))
    return found[0]


def test_what_another_training_left_is_not_gone_on_from(
    rigid: Simulation, training_recording: Recording, tmp_path: Path
) -> None:
    settings = replace(SHORT, epochs=2, folds=1)
    train(rigid, [training_recording], settings, unfinished=tmp_path)
    other = replace(settings, seed=1)
    again = train(rigid, [training_recording], other, unfinished=tmp_path)
    assert again.record == train(rigid, [training_recording], other).record


def test_a_damaged_file_is_refused_by_name(
    rigid: Simulation, training_recording: Recording, tmp_path: Path
) -> None:
    (tmp_path / "fold0.pt").write_bytes(b"PK\x03\x04 half of it")
    with pytest.raises(ConfigError, match=r"fold0\.pt: cannot be read as an unfinished training"):
        train(rigid, [training_recording], SHORT, unfinished=tmp_path)


@pytest.mark.parametrize(("patience", "epochs"), [(3, 5), (0, 9)])
def test_training_ends_where_patience_does(
    patience: int,
    epochs: int,
    rigid: Simulation,
    training_recording: Recording,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Held-out losses fall for two epochs, and never again."""
    losses = iter([2.0, 1.0, *[1.5] * 20])
    real = SequencePasses.epoch

    def epoch(self: SequencePasses, *given: object) -> tuple[float, float]:
        return real(self, *given)[0], next(losses)

    monkeypatch.setattr(SequencePasses, "epoch", epoch)
    settings = replace(SHORT, model="gru", epochs=9, folds=1, patience=patience)
    fitted = train(rigid, [training_recording], settings)
    assert len(fitted.record["epochs"]) == epochs
    monkeypatch.setattr(SequencePasses, "epoch", real)
    best = train(rigid, [training_recording], replace(settings, epochs=2, schedule="plateau"))
    assert len(best.record["epochs"]) == 2
