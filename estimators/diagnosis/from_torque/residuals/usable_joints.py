"""Usable joints: which of them move, and which have a torque and an encoder that tell of them."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from estimators.diagnosis.from_torque.residuals.mistakes import constant_joints, dry_and_viscous
from estimators.diagnosis.from_torque.residuals.noise import roughness
from estimators.diagnosis.settings.residuals import MISTAKES, PLAUSIBILITY, ROWS
from estimators.recordings import WEIGHTLESS

if TYPE_CHECKING:
    from estimators.diagnosis.from_torque.residuals.observations import Observations
    from limo_driver.types import FloatArray


def still(observed: Observations) -> tuple[int, ...]:
    """Return the joints (0-based) that move too little for their friction to show."""
    return tuple(np.flatnonzero(observed.moving.sum(axis=0) < MISTAKES.least_moving).tolist())


def holds_still(observed: Observations) -> bool:
    """Say whether the arm stays where it is in all recordings, while its encoders tell of it."""
    farthest = max(float(np.ptp(item.position, axis=0).max()) for item in observed.recordings)
    alive = len(constant_joints(observed)) < observed.n
    return alive and farthest < PLAUSIBILITY.holding and len(still(observed)) == observed.n


def doubtful_encoders(observed: Observations) -> tuple[int, ...]:
    """Return joints (0-based) that may move although their encoder gives one value.

    Nothing that the arm does moves the torque of a locked joint as far as this, and the mistake is
    not one that the torques of the others would show: they hardly depend on its position.
    """
    left = observed.measured - observed.filter(observed.load)
    left -= np.median(left, axis=0)
    torque = observed.measured - np.median(observed.measured, axis=0)
    rough = roughness(left, np.ones_like(observed.moving), observed.least_noise)
    strange = np.median(np.abs(left), axis=0)
    doubt = (strange > PLAUSIBILITY.alive * rough) & (
        strange > PLAUSIBILITY.own * np.median(np.abs(torque), axis=0)
    )
    return tuple(j for j in constant_joints(observed) if doubt[j])


def without_torque(observed: Observations) -> tuple[int, ...]:
    """Return the joints (0-based) whose torque is one value in all rows."""
    return tuple(np.flatnonzero(np.ptp(observed.measured, axis=0) < PLAUSIBILITY.constant).tolist())


def without_load(observed: Observations, least: float = WEIGHTLESS) -> tuple[int, ...]:
    """Return the joints (0-based) whose torque is next to nothing of what their load asks for.

    Where the load hardly changes, as that of a lift, no scale and no unit shows in its course.

    Args:
        observed: The recordings beside a simulation.
        least: Part of the load that a torque has to be.
    """
    load, torque = sizes(observed)
    light = np.flatnonzero(torque < least * load)
    silent = without_torque(observed)
    return tuple(j for j in light.tolist() if j not in silent)


def without_effort(observed: Observations) -> tuple[int, ...]:
    """Return the joints (0-based) whose small torque nothing of their motion explains.

    A drive without power, whose joint others or hands move, shows noise about an offset: neither
    the load nor what may balance it in part, and no friction, which a torque that is measured has.
    """
    load, torque = sizes(observed)
    # whether its torque counts by now or not: `observed.faster` is of those that do
    fast = np.abs(observed.slow.velocity) > ROWS.rest * observed.sign_width
    found = list[int]()
    for j in np.flatnonzero(torque < PLAUSIBILITY.light * load).tolist():
        use = np.flatnonzero(fast[:, j])
        if use.size < MISTAKES.least_moving:
            continue
        motion, own = observed.slow[use], observed.measured[use, j]
        friction = dry_and_viscous(motion.velocity[:, j])
        its_load = observed.load[observed.kept][use, j]
        columns = np.column_stack([np.ones(own.size), motion.position[:, j], its_load, friction])
        left = own - columns @ np.linalg.lstsq(columns, own, rcond=None)[0]
        unexplained = np.sum(left**2) / (own.size - columns.shape[1])
        if unexplained > PLAUSIBILITY.idle**2 * np.var(own):
            found.append(j)
    return tuple(found)


def left_out(observed: Observations) -> tuple[int, ...]:
    """Return the joints (0-based) whose torque is measured, and tells nothing of them."""
    return tuple(sorted({*without_load(observed), *without_effort(observed)}))


def sizes(observed: Observations) -> tuple[FloatArray, FloatArray]:
    """Return the root mean squares of load and torque of each joint, rest included, (n,) each."""
    load, torque = observed.load[observed.kept], observed.measured
    return np.sqrt(np.mean(load**2, axis=0)), np.sqrt(np.mean(torque**2, axis=0))
