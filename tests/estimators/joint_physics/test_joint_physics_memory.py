"""How unsure an estimate is where memory began anew: as unsure as friction then is."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pytest
from safetensors.numpy import load_file, save_file

from estimators.joint_physics import JointPhysics
from estimators.joint_physics.prediction import (
    UnknownMemory,
    any_moments,
    fill_variance,
    remembered,
)
from estimators.model_folder import MANIFEST, as_manifest, read_manifest
from estimators.service.store.version import digest
from estimators.stream import Stream
from limo_driver.errors import ModelStoreError
from limo_driver.physics import PreslidingHysteresis, Simulation

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from limo_driver.recordings.recording import Recording

RATE = 100.0


def variance(unknown: UnknownMemory, columns: np.ndarray, about: np.ndarray) -> np.ndarray:
    found = np.empty(about.shape[1:])
    fill_variance(columns, about, unknown.heights, unknown.moments, unknown.place, found)
    return found


SECOND = slice(0, 100)


@pytest.fixture(scope="module")
def recording(record: Callable[[int, float], Recording]) -> Recording:
    return record(1, 60.0)


@pytest.fixture(scope="module")
def model(rigid: Simulation, recording: Recording) -> JointPhysics:
    return JointPhysics(rigid).fit([recording])


def restarted(model: JointPhysics, fresh: list[Recording]) -> tuple[np.ndarray, np.ndarray]:
    """Return errors and deviations (R, T, n) of streams that begin in the middle of motion."""
    stream, random, found = Stream(model, RATE), np.random.default_rng(5), []
    for recording in fresh:
        for first in random.integers(300, len(recording) - 300, 10):
            part = recording[int(first) : int(first) + 300]
            late, _ = stream.advance(stream.init(), part.time, part.position, part.torque)
            assert late.measured is not None
            found.append((late.measured - late.torque, late.std))
    errors, std = (np.array(values) for values in zip(*found, strict=True))
    return errors, std


@pytest.mark.slow("fits an arm each, and restarts in many places")
@pytest.mark.parametrize("knows", ["dry friction", "a hysteresis of another width"])
def test_after_a_restart_the_interval_holds_what_it_says(
    rigid: Simulation, recording: Recording, record: Callable[[int, float], Recording], knows: str
) -> None:
    known = rigid
    if knows != "dry friction":
        slips = [PreslidingHysteresis(joint=j, stiffness=(150.0,), width=(0.01,)) for j in (1, 2)]
        known = Simulation(rigid.robot, tuple(slips))
    model = JointPhysics(known).fit([recording])
    errors, std = restarted(model, [record(seed, 30.0) for seed in range(50, 60)])
    off = np.abs(errors) / std
    assert (off[:, SECOND] < 2).mean() > 0.95
    assert (off[:, 200:] < 2).mean() > 0.93
    # Not by saying less than is known: deviations are of the size of the errors, and shrink.
    for rows in (slice(0, 20), slice(20, 50), slice(50, 100)):
        size = np.sqrt(np.mean(errors[:, rows] ** 2) / np.mean(std[:, rows] ** 2))
        assert 0.6 < size < 1.1
    assert std[:, 250:].mean() < 0.25 * std[:, 0].mean()


def test_a_joint_that_rests_stays_unsure_and_one_that_turns_becomes_sure(
    model: JointPhysics, recording: Recording
) -> None:
    stream, time = Stream(model, RATE), np.arange(300) / RATE
    position = recording.position[:300].copy()
    position[:, 1] = position[0, 1]
    late, _ = stream.advance(stream.init(), time, position)
    assert late.std[250:, 0].max() < 0.3 * late.std[0, 0]
    assert late.std[250:, 1].min() > 0.9 * late.std[0, 1]


@pytest.mark.parametrize("r", [0.0, 0.3, 1.0, 1.4, 2.0])
def test_stops_come_together_as_the_formula_says(r: float) -> None:
    begun = np.random.default_rng(2).uniform(-1, 1, 200_000)
    distance = np.clip(begun + r, -1, 1) - np.clip(r, -1, 1)
    assert remembered(r) ** 2 == pytest.approx(3 * np.mean(distance**2), abs=0.01)


def test_memory_of_a_simulation_counts_by_what_it_carries(rigid: Simulation) -> None:
    columns = JointPhysics(rigid).columns
    weights = np.zeros((2, columns.count))
    effects = (
        PreslidingHysteresis(joint=1, stiffness=(100.0, 50.0), width=(0.003, 0.02)),
        PreslidingHysteresis(joint=2, law="lugre", sigma_0=500.0, tau_c=2.0),
        PreslidingHysteresis(joint=2, law="preisach", up=(0.1,), down=(0.09,), weight=(0.5,)),
    )
    known = Simulation(rigid.robot, effects)
    unknown = UnknownMemory.of(columns, weights, any_moments(2), known)
    x = np.zeros((2, 1, columns.count))
    still = variance(unknown, x, np.zeros((2, 1, 2)))
    np.testing.assert_allclose(np.sqrt(still), [[0.3 + 1.0, 2.5]])
    turned = variance(unknown, x, np.stack([np.full((1, 2), 0.1), np.zeros((1, 2))]))
    np.testing.assert_allclose(turned, 0.0, atol=1e-12)


class TestFolder:
    @pytest.fixture
    def folder(self, model: JointPhysics, tmp_path: Path) -> Path:
        model.save(tmp_path / "model")
        return tmp_path / "model"

    def rewrite(self, folder: Path, moments: np.ndarray | None) -> None:
        file = folder / "model.safetensors"
        tensors = load_file(file)
        del tensors["moments"]
        save_file(tensors if moments is None else {**tensors, "moments": moments}, file)
        values = read_manifest(folder).content
        values = {**values, "weights": {**values["weights"], "sha256": digest(file)}}
        (folder / MANIFEST).write_text(as_manifest(values))

    def test_keeps_it(self, model: JointPhysics, folder: Path, recording: Recording) -> None:
        loaded = JointPhysics.load(folder)
        part = recording[:200]
        np.testing.assert_array_equal(loaded.estimate(part).std, model.estimate(part).std)

    def test_from_before_it_was_kept_is_the_less_sure(
        self, model: JointPhysics, folder: Path, recording: Recording
    ) -> None:
        self.rewrite(folder, None)
        part = recording[:200]
        older, now = JointPhysics.load(folder).estimate(part), model.estimate(part)
        np.testing.assert_array_equal(older.torque, now.torque)
        assert older.std[0].min() > 0.9 * now.std[0].max()

    def test_with_moments_that_cannot_be_is_refused(self, folder: Path) -> None:
        self.rewrite(folder, -any_moments(2))
        with pytest.raises(ModelStoreError, match="moments"):
            JointPhysics.load(folder)
