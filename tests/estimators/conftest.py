"""Synthetic LIMO motion of two joints with hysteresis, small enough to learn in a second."""

from __future__ import annotations

import shutil
from typing import TYPE_CHECKING

import numpy as np
import pytest
from wandering import wander

from estimators.joint_physics import JointPhysics
from estimators.service.store.store import ModelStore
from limo_driver.physics import CoulombFriction, PreslidingHysteresis, Simulation
from limo_driver.recordings.recording import Recording

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

ARM = """<?xml version="1.0"?>
<robot name="two_joints">
  <link name="base"/>
  <link name="upper"><inertial><mass value="2"/><origin xyz="0.1 0 0"/>
    <inertia ixx="0.01" iyy="0.02" izz="0.02" ixy="0" ixz="0" iyz="0"/></inertial></link>
  <link name="lower"><inertial><mass value="1"/><origin xyz="0.1 0 0"/>
    <inertia ixx="0.005" iyy="0.01" izz="0.01" ixy="0" ixz="0" iyz="0"/></inertial></link>
  <joint name="shoulder" type="revolute"><parent link="base"/><child link="upper"/>
    <axis xyz="0 1 0"/><limit lower="-3" upper="3" velocity="2" effort="100"/></joint>
  <joint name="elbow" type="revolute"><parent link="upper"/><child link="lower"/>
    <origin xyz="0.3 0 0"/><axis xyz="0 1 0"/>
    <limit lower="-3" upper="3" velocity="2" effort="100"/></joint>
</robot>
"""
RATE = 100.0
NOISE = 0.02  # [N m]


@pytest.fixture(scope="session")
def arm(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("robot") / "two_joints.urdf"
    path.write_text(ARM)
    return path


@pytest.fixture(scope="session")
def rigid(arm: Path) -> Simulation:
    """What is known of the arm: rigid body and dry friction."""
    return Simulation(str(arm), tuple(CoulombFriction(joint=j, tau_c=1.0) for j in (1, 2)))


@pytest.fixture(scope="session")
def true_arm(arm: Path) -> Simulation:
    """The arm: its friction builds up over 6 mrad."""
    slip = [PreslidingHysteresis(joint=j, stiffness=(200.0,), width=(0.006,)) for j in (1, 2)]
    return Simulation(str(arm), tuple(slip))


@pytest.fixture(scope="session")
def record(true_arm: Simulation) -> Callable[[int, float], Recording]:
    """Record motion of a seed and a duration [s]."""
    return lambda seed, duration: _record(true_arm, seed, duration)


def _record(true_arm: Simulation, seed: int, duration: float) -> Recording:
    """Move both joints by small random sinusoids and measure with noise."""
    random = np.random.default_rng(seed)
    t = np.arange(int(duration * RATE)) / RATE
    motion = wander(t, np.array([0.4, -0.8]), random, (0.1, 0.6), (0.01, 0.05))
    torque = true_arm.predict(motion)
    torque += NOISE * random.standard_normal(torque.shape)
    return Recording.from_arrays(t, motion.position, torque, source=f"seed {seed}")


@pytest.fixture(scope="session")
def training_recording(record: Callable[[int, float], Recording]) -> Recording:
    return record(1, 60.0)


@pytest.fixture(scope="session")
def test_recording(record: Callable[[int, float], Recording]) -> Recording:
    return record(2, 30.0)


@pytest.fixture(scope="session")
def worn_arm(arm: Path) -> Simulation:
    """The arm with twice the friction."""
    slip = [PreslidingHysteresis(joint=j, stiffness=(200.0,), width=(0.012,)) for j in (1, 2)]
    return Simulation(str(arm), tuple(slip))


@pytest.fixture(scope="session")
def versions(
    rigid: Simulation,
    worn_arm: Simulation,
    training_recording: Recording,
    tmp_path_factory: pytest.TempPathFactory,
) -> Path:
    """A store: version 1 knows the arm, version 2 the worn arm."""
    folder = tmp_path_factory.mktemp("versions")
    store = ModelStore(folder / "models")
    motion = training_recording.motion(10.0)
    worn = Recording.from_arrays(motion.time, motion.position, worn_arm.predict(motion))
    for name, recording in (("new", training_recording), ("worn", worn)):
        JointPhysics(rigid).fit([recording]).save(folder / name)
        store.add(folder / name, golden=recording)
    store.promote(1, "the first")
    return store.root


@pytest.fixture
def store(versions: Path, tmp_path: Path) -> ModelStore:
    shutil.copytree(versions, tmp_path / "models")
    return ModelStore(tmp_path / "models")


@pytest.fixture(scope="session")
def learned(rigid: Simulation, training_recording: Recording) -> JointPhysics:
    return JointPhysics(rigid).fit([training_recording])


@pytest.fixture
def motion(test_recording: Recording) -> Recording:
    return test_recording[slice(0, 600)]
