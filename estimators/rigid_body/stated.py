"""What is known beside bodies and friction: armature, springs, cogging, play, and the mounting."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from estimators.rigid_body.dynamics.regressor import PER_LINK
from limo_driver.physics import Armature, GravityDirection, Simulation
from limo_driver.physics.described import described_effects

if TYPE_CHECKING:
    from collections.abc import Sequence

    from estimators.rigid_body.terms import JointTerms
    from limo_driver.model import RobotModel
    from limo_driver.physics import Effect
    from limo_driver.recordings.recording import Recording
    from limo_driver.types import FloatArray


def stated_armatures(model: RobotModel, terms: JointTerms) -> FloatArray:
    """Return parameters (p,) that are zero but for the armatures that the description states."""
    phi = np.zeros(PER_LINK * model.linkage.links + model.n * len(terms.all()))
    for effect in described_effects(model) if terms.armature else ():
        if isinstance(effect, Armature):
            phi[effect.joint - 1 - model.n] = effect.inertia
    return phi


def stated_beside(model: RobotModel, terms: JointTerms) -> tuple[Effect, ...]:
    """Return the effects of a description that are no friction, and none of the terms."""
    modelled = {term.effect for term in terms.all()}
    return tuple(
        effect
        for effect in described_effects(model)
        if not effect.rubs and effect.name not in modelled
    )


def mounting_of(model: RobotModel) -> tuple[GravityDirection, ...]:
    """Return the gravity of a robot, where its description states another; else nothing."""
    stated = Simulation(model.name, inertials=model.inertials).model.gravity
    x, y, z = model.gravity
    return () if stated == model.gravity else (GravityDirection(gravity=(x, y, z)),)


def bare(model: RobotModel) -> Simulation:
    """Return a simulation of the bodies of a robot alone, as it hangs."""
    return Simulation(model.name, mounting_of(model), model.inertials)


def without_stated(
    model: RobotModel,
    recordings: Sequence[Recording],
    effects: tuple[Effect, ...],
    bandwidth: float,
) -> Sequence[Recording]:
    """Return recordings whose torque lacks that of some effects.

    Args:
        model: The robot.
        recordings: Measured motions and torques.
        effects: Whose torque is taken away.
        bandwidth: Of the filter on the motion that the effects are evaluated on [Hz].
    """
    if not effects:
        return recordings
    with_them, bare = Simulation(model.name, effects), Simulation(model.name)
    found: list[Recording] = []
    for recording in recordings:
        motion = recording.motion(bandwidth)
        added = [
            simulation.predict_stretches(motion, recording.segments, bandwidth)
            for simulation in (with_them, bare)
        ]
        found.append(replace(recording, torque=recording.torque - (added[0] - added[1])))
    return found
