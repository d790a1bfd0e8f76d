"""What is learned of a change: short motion around few poses, on top of what was known before."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
import pytest

from estimators.joint_physics import JointPhysics
from limo_driver.physics import Payload, ViscousFriction
from limo_driver.recordings.recording import Recording

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

    from limo_driver.physics import Simulation

BANDWIDTH = 10.0
LOAD = Payload(mass=1.5, com=(0.05, 0.0, 0.1))


@pytest.fixture(scope="module")
def known(rigid: Simulation, true_arm: Simulation) -> JointPhysics:
    """Learn at many poses."""
    poses = np.random.default_rng(0).uniform(-1.2, 1.2, (12, 2))
    return JointPhysics(rigid).fit(
        [moved(true_arm, 20 + k, 15.0, pose) for k, pose in enumerate(poses)]
    )


def moved(arm: Simulation, seed: int, duration: float, around: ArrayLike) -> Recording:
    """Move both joints a little around a pose, and measure with noise."""
    random = np.random.default_rng(seed)
    t = np.arange(round(100.0 * duration)) / 100.0
    waves = random.uniform(0.1, 0.6, (2, 3)), random.uniform(0.0, 2 * np.pi, (2, 3))
    turns = np.sin(2 * np.pi * waves[0] * t[:, None, None] + waves[1]).sum(axis=2)
    position = np.array(around) + 0.05 * turns
    still = Recording.from_arrays(t, position, np.zeros_like(position))
    torque = arm.predict(still.motion(BANDWIDTH)) + 0.02 * random.standard_normal(position.shape)
    return Recording.from_arrays(t, position, torque, source=f"seed {seed}")


def errors(model: JointPhysics, recording: Recording) -> tuple[np.ndarray, np.ndarray]:
    """Return how far an estimate is off, and in how much of the time its interval holds that."""
    inside = ~recording.edges(BANDWIDTH)
    estimate = model.estimate(recording)
    off = (estimate.torque - recording.filtered_torque(BANDWIDTH))[inside]
    within = np.abs(off) <= 1.96 * estimate.std[inside]
    return np.sqrt(np.mean(off**2, axis=0)), within.mean(axis=0)


def with_effect(arm: Simulation, effect: Payload | ViscousFriction) -> Simulation:
    return replace(arm, effects=(*arm.effects, effect))


@pytest.mark.parametrize(
    ("effect", "better"),
    [(LOAD, 0.2), (ViscousFriction(joint=1, f_v=2.0), 1.0)],
    ids=["load", "friction"],
)
def test_what_short_motion_shows_of_a_change_holds_at_other_poses(
    known, rigid, true_arm, effect, better
) -> None:
    changed = with_effect(true_arm, effect)
    near = [moved(changed, 1, 40.0, (0.4, -0.8))]
    far = moved(changed, 2, 30.0, (-0.6, 0.9))
    (anew, _), (going_on, within) = (
        errors(model.fit(near), far)
        for model in (JointPhysics(rigid), JointPhysics(rigid).going_on_from(known))
    )
    stale, _ = errors(known, far)
    assert going_on.max() <= better * anew.max()
    assert going_on.max() < 0.2 * stale.max()
    assert (within > 0.9).all()


def test_without_a_change_it_stays_as_good_as_it_was(known, rigid, true_arm) -> None:
    near, far = (
        moved(true_arm, k, 40.0, pose) for k, pose in enumerate([(0.4, -0.8), (-0.6, 0.9)])
    )
    before, _ = errors(known, far)
    after, within = errors(JointPhysics(rigid).going_on_from(known).fit([near]), far)
    assert (after <= 1.5 * before).all()
    assert (within > 0.9).all()


def test_of_another_simulation_nothing_is_taken_over(known, true_arm, record) -> None:
    recording = record(1, 60.0)
    anew = JointPhysics(true_arm).fit([recording])
    going_on = JointPhysics(true_arm).going_on_from(known).fit([recording])
    np.testing.assert_array_equal(anew.fitted.weights, going_on.fitted.weights)
