"""Stated zeros of encoders: taken off recordings, so that gravity is that of where links are.

Everything else then counts as the robot's description does, and what is found of zeros adds to
what is stated.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from estimators.diagnosis.from_motion.simulation.free_run import commands_of
from limo_driver.physics import EncoderOffset
from limo_driver.physics.effects.sensing import FARTHEST_ZERO
from limo_driver.recordings.channels import POSITION, led_by

if TYPE_CHECKING:
    from estimators.diagnosis.from_motion.simulation.loads import ArmChange
    from limo_driver.physics import Simulation
    from limo_driver.recordings.recording import Recording
    from limo_driver.types import FloatArray


def zeros_of(simulation: Simulation) -> FloatArray:
    """Return what the encoders of a simulation read where links are at zero, (n,) [rad]."""
    zero = np.zeros(simulation.model.n)
    for effect in simulation.effects:
        if isinstance(effect, EncoderOffset):
            zero[effect.joint - 1] += effect.offset
    return zero


def without_zeros(simulation: Simulation) -> Simulation:
    """Return the same with encoders that read where the links are."""
    kept = tuple(one for one in simulation.effects if not isinstance(one, EncoderOffset))
    return replace(simulation, effects=kept)


def with_zeros(simulation: Simulation, zero: FloatArray) -> Simulation:
    """Return the same with zeros (n,) [rad] added to those of its encoders."""
    total = (zeros_of(simulation) + zero).clip(-FARTHEST_ZERO, FARTHEST_ZERO)
    own = [EncoderOffset(joint=j, offset=x) for j, x in enumerate(total.tolist(), start=1) if x]
    bare = without_zeros(simulation)
    return replace(bare, effects=(*bare.effects, *own))


def from_zeros(recording: Recording, zero: FloatArray) -> Recording:
    """Return a recording whose positions, and set-points of these, count from the links' zeros.

    Args:
        recording: With commands.
        zero: Of its encoders, (n,) [rad].
    """
    if not zero.any():
        return recording
    command = commands_of(recording)
    told = np.where(led_by(POSITION, recording.channels), command - zero, command)
    return replace(recording, position=recording.position - zero, command=told, extras={})


def as_counted(zero: FloatArray, change: ArmChange) -> FloatArray:
    """Return the zeros (n,) [rad] of encoders whose recordings `as_described` has changed.

    Args:
        zero: As they were recorded, (n,) [rad].
        change: How the arm that was recorded differs.
    """
    return zero[list(change.order or range(zero.size))] * np.array(change.sign)
