"""Recordings that say nothing are refused alike by everything that is fitted to them."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
import pytest

from estimators.hybrid import HybridModel
from estimators.hybrid.training.settings import TrainingSettings
from estimators.joint_physics import JointPhysics
from estimators.rigid_body import identify
from limo_driver.errors import RecordingError

if TYPE_CHECKING:
    from collections.abc import Sequence

    from limo_driver.physics import Simulation
    from limo_driver.recordings.recording import Recording

FIT = {
    "network": lambda simulation, runs: HybridModel(simulation).fit(runs),
    "joint-physics": lambda simulation, runs: JointPhysics(simulation).fit(runs),
    "rigid body": lambda simulation, runs: identify(simulation.model, runs),
}


def constant(recording: Recording, name: str, value: float) -> Recording:
    return replace(recording, **{name: np.full(recording.position.shape, value)})


@pytest.mark.parametrize("name", FIT)
@pytest.mark.parametrize(
    ("runs", "message"),
    [
        (lambda _: [], "no recording to fit to"),
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


@pytest.mark.parametrize(("held_out", "purpose"), [(0.01, "hold out"), (0.99, "train on")])
def test_a_part_that_leaves_nothing_is_said(
    rigid: Simulation, training_recording: Recording, held_out: float, purpose: str
) -> None:
    model = HybridModel(rigid, TrainingSettings(held_out=held_out))
    message = f"nothing is left to {purpose}: {held_out:g} of 60 s are to be held out"
    with pytest.raises(RecordingError, match=message):
        model.fit([training_recording])
