"""Recordings that say nothing are refused alike by everything that is fitted to them."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
import pytest

from estimators.base import check_different
from estimators.hybrid import HybridModel
from estimators.hybrid.training.settings import TrainingSettings
from estimators.joint_physics import JointPhysics
from estimators.rigid_body import identify
from limo_driver.errors import RecordingError
from limo_driver.model import RobotModel
from limo_driver.recordings.recording import Recording

if TYPE_CHECKING:
    from collections.abc import Sequence

    from limo_driver.physics import Simulation

FIT = {
    "network": lambda simulation, runs: HybridModel(simulation).fit(runs),
    "joint-physics": lambda simulation, runs: JointPhysics(simulation).fit(runs),
    "rigid body": lambda simulation, runs: identify(simulation.model, runs),
}


def constant(recording: Recording, name: str, value: float) -> Recording:
    return replace(recording, **{name: np.full(recording.position.shape, value)})


def told(recording: Recording) -> Recording:
    """Return what a drive that tells no torque would have recorded."""
    command = recording.position + 0.01
    return Recording.from_arrays(
        recording.time, recording.position, command=command, source=recording.source
    )


@pytest.mark.parametrize("name", FIT)
@pytest.mark.parametrize(
    ("runs", "message"),
    [
        (lambda _: [], "no recording to fit to"),
        (lambda r: [told(r)], "seed 1: lacks torque_1: it holds commands and positions alone"),
        (lambda r: [constant(r, "torque", 0.0)], "seed 1: every torque is 0 N m"),
        (lambda r: [constant(r, "torque", 1.0)], "seed 1: no torque ever changes"),
        (lambda r: [constant(r, "position", 0.3)], "seed 1: no joint moves"),
        (lambda r: [r, replace(r, source="b")], "b: holds the same samples as seed 1"),
    ],
)
def test_recordings_that_say_nothing_are_refused(
    rigid: Simulation, training_recording: Recording, name: str, runs, message: str
) -> None:
    given: Sequence[Recording] = runs(training_recording)
    with pytest.raises(RecordingError, match=message):
        FIT[name](rigid, given)


@pytest.mark.parametrize("name", ["network", "joint-physics"])
def test_of_a_joint_without_torque_nothing_is_learned(
    rigid: Simulation, training_recording: Recording, name: str
) -> None:
    torque = training_recording.torque.copy()
    torque[:, 1] = 0.0
    with pytest.raises(RecordingError, match="seed 1: has no torque that changes at joint 2, of"):
        FIT[name](rigid, [replace(training_recording, torque=torque)])


def test_bodies_are_found_for_torques_that_no_bodies_have() -> None:
    time = np.arange(0.0, 40.0, 0.01)
    pace = np.array([0.31, 0.23, 0.41, 0.29, 0.37, 0.43, 0.47])
    rest = np.deg2rad([10, 40, -20, -70, 30, 50, -40])
    position = rest + 0.3 * np.sin(2 * np.pi * time[:, None] * pace)
    robot = RobotModel.load("iiwa14")
    is_friction = 2.0 * np.sign(np.gradient(position, axis=0))
    noise = np.random.default_rng(0).normal(0.0, 0.02, position.shape)
    weightless = (
        robot.gravity_torque(position) + is_friction + noise
    )  # nothing resists acceleration
    found = identify(robot, [Recording.from_arrays(time, position, weightless)])
    left = found.simulation.score(Recording.from_arrays(time, position, weightless)).rmse
    assert (left < np.sqrt(np.mean(weightless**2, axis=0))).all()


def later(recording: Recording) -> Recording:
    return replace(recording, time=recording.time + 3600.0)


def single(recording: Recording) -> Recording:
    """Return a copy that was kept in single precision."""
    arrays = (getattr(recording, name) for name in ("time", "position", "torque"))
    return Recording(*(values.astype(np.float32).astype(float) for values in arrays))


@pytest.mark.parametrize(
    ("first", "second", "message"),
    [
        (lambda r: r, later, "holds the same samples as"),
        (lambda r: r, lambda r: later(r)[2000:], "shares 100% of its rows with"),
        (lambda r: r[:3500], lambda r: r[3000:], "shares 17% of its rows with"),
        (lambda r: r, single, "shares 100% of its rows with"),
    ],
    ids=["later", "a cut of it, later", "cuts that overlap", "in single precision"],
)
def test_a_copy_is_no_second_recording(training_recording: Recording, first, second, message):
    given = [first(training_recording), replace(second(training_recording), source="b")]
    with pytest.raises(RecordingError, match=f"^b: {message} seed 1, and would"):
        check_different(given)


@pytest.mark.parametrize("step", [None, 0.01], ids=["fine", "coarse"])
def test_motion_made_again_and_cuts_that_follow_are_other_recordings(
    true_arm: Simulation, training_recording: Recording, step: float | None
) -> None:
    """Coarse sensors give the same sample now and then, and often where the arm rests."""
    r = training_recording
    rest = np.minimum(np.arange(len(r)), len(r) // 2)
    clean = true_arm.predict(r)[rest]
    runs = []
    for seed in range(2):
        torque = clean + 0.02 * np.random.default_rng(seed).standard_normal(clean.shape)
        arrays = (r.position[rest], torque)
        runs.append(
            Recording(r.time, *(x if step is None else step * np.round(x / step) for x in arrays))
        )
    check_different(runs)
    check_different([r[:3000], r[3000:]])


@pytest.mark.parametrize(("held_out", "purpose"), [(0.01, "hold out"), (0.99, "train on")])
def test_a_part_that_leaves_nothing_is_said(
    rigid: Simulation, training_recording: Recording, held_out: float, purpose: str
) -> None:
    model = HybridModel(rigid, TrainingSettings(held_out=held_out))
    message = f"nothing is left to {purpose}: {held_out:g} of 60 s are to be held out"
    with pytest.raises(RecordingError, match=message):
        model.fit([training_recording])
