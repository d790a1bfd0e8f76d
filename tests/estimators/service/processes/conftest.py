"""A store with two equal versions of the model of a small arm."""

from __future__ import annotations

from shutil import copytree
from typing import TYPE_CHECKING

import numpy as np
import pytest
from wandering import wander

from estimators.joint_physics import JointPhysics
from estimators.service.store.store import ModelStore
from limo_driver.physics import CoulombFriction, Simulation, ViscousFriction
from limo_driver.recordings.recording import Recording

if TYPE_CHECKING:
    from pathlib import Path

    from processes import Network


@pytest.fixture(scope="session")
def stored(two_links_urdf: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The store, not to be changed; `store` is a copy."""
    folder = tmp_path_factory.mktemp("service")
    t = np.arange(4000) / 100.0
    motion = wander(t, np.array([0.4, -0.8]), 1, (0.1, 0.6), (0.01, 0.05))
    true_arm = Simulation(
        str(two_links_urdf), tuple(ViscousFriction(joint=j, f_v=3.0) for j in (1, 2))
    )
    torque = true_arm.predict(motion)
    torque += 0.02 * np.random.default_rng(1).standard_normal(torque.shape)
    recording = Recording.from_arrays(t, motion.position, torque)
    known = tuple(CoulombFriction(joint=j, tau_c=0.1) for j in (1, 2))
    JointPhysics(Simulation(str(two_links_urdf), known)).fit([recording]).save(folder / "model")
    store = ModelStore(folder / "models")
    for _ in range(2):
        store.add(folder / "model", golden=recording)
    store.promote(1, "the first")
    return folder / "models"


@pytest.fixture
def store(stored: Path, tmp_path: Path) -> ModelStore:
    """Versions 1, the champion, and 2, equal to it."""
    return ModelStore(copytree(stored, tmp_path / "models"))


@pytest.fixture
def network(tmp_path: Path) -> Network:
    """Where the session of the tests listens, and other processes connect."""
    from processes import Network

    return Network(tmp_path)
