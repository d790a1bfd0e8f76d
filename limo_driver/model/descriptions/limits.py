"""Limits of joints: what a description states, what it leaves out, and what stands for that."""

# pinocchio has no stubs and is found through an import hook.
# pyright: reportMissingImports=false, reportUnknownParameterType=false

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from limo_driver.errors import ConfigError
from limo_driver.runtime.display import shortened
from limo_driver.types import JointLimits

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    import pinocchio as pin

    from limo_driver.model.descriptions.chain import Chain
    from limo_driver.types import FloatArray

_ACCELERATION_PER_VELOCITY = 5.0  # [1/s], default where nothing is published
_SLOW, _SLOW_SLIDE = 1.0, 0.25  # [rad/s], [m/s], in formats that have no limits of velocity
_JERK_PER_VELOCITY = 50.0  # [1/s^2]
_TORQUE_RATE_PER_TORQUE = 10.0  # [1/s]


def unstated_limits(
    model: pin.Model, names: Sequence[str], sliding: Sequence[bool], *, assumed: bool
) -> tuple[str, ...]:
    """Say which limits the description leaves out, and what stands for them."""
    told: list[str] = []
    slow = f"{_SLOW:g} rad/s is taken" + (
        f", {_SLOW_SLIDE:g} m/s of slides" if any(sliding) else ""
    )
    for values, what, instead in (
        (model.upperVelocityLimit, "velocity", slow),
        (model.upperEffortLimit, "effort", "none is kept"),
    ):
        lacking = [name for name, value in zip(names, np.array(values), strict=True) if value <= 0]
        if lacking:
            stands = instead if assumed else "without one, the arm cannot be planned or run"
            who = f"joints {shortened(lacking)} state"
            if len(lacking) == 1:
                who = f"joint {lacking[0]} states"
            elif len(lacking) == len(names):
                who = f"all {len(names)} joints state"
            told.append(f"{who} no {what} limit; {stands}")
    return tuple(told)


def joint_limits(
    chain: Chain, jerk: FloatArray | None, path: Path, *, assumed: bool
) -> JointLimits:
    """Return the limits of the joints, within which those that follow them are in theirs.

    A 0 stays unless values are assumed for what is not stated. MJCF has no limits of velocity, so
    that nothing would move. A URDF that states a 0 leaves out what it should state: no speed of a
    real arm is made up for it.

    Raises:
        ConfigError: A joint cannot move without one that follows it leaving its range.
    """
    own = chain.linkage.own
    velocity = np.array(chain.tree.upperVelocityLimit)[own]
    torque = np.array(chain.tree.upperEffortLimit)[own]
    lower = np.array(chain.tree.lowerPositionLimit)[own]
    upper = np.array(chain.tree.upperPositionLimit)[own]
    if assumed:
        velocity = np.where(velocity > 0, velocity, np.where(chain.sliding, _SLOW_SLIDE, _SLOW))
        torque = np.where(torque > 0, torque, np.inf)
    _narrow(chain, lower, upper, velocity, path)
    planned = _JERK_PER_VELOCITY * velocity
    if jerk is not None:
        planned = np.where(np.isfinite(jerk), jerk, planned)
    return JointLimits(
        position_min=lower,
        position_max=upper,
        velocity=velocity,
        acceleration=_ACCELERATION_PER_VELOCITY * velocity,
        jerk=planned,
        torque=torque,
        torque_rate=_TORQUE_RATE_PER_TORQUE * torque,
    )


def _narrow(
    chain: Chain, lower: FloatArray, upper: FloatArray, velocity: FloatArray, path: Path
) -> None:
    """Narrow limits (n,) to those at which followers reach theirs."""
    tree, linkage = chain.tree, chain.linkage
    for link in np.flatnonzero(linkage.own[linkage.driver] != np.arange(linkage.links)).tolist():
        joint, ratio = int(linkage.driver[link]), float(linkage.ratio[link])
        if chain.link_joints[link] not in chain.turning:
            ends = np.array([tree.lowerPositionLimit[link], tree.upperPositionLimit[link]])
            low, high = sorted(((ends - linkage.offset[link]) / ratio).tolist())
            lower[joint], upper[joint] = max(lower[joint], low), min(upper[joint], high)
        if (fastest := float(tree.upperVelocityLimit[link])) > 0:
            velocity[joint] = min(velocity[joint], fastest / abs(ratio))
        if lower[joint] > upper[joint]:
            raise ConfigError(
                f"joint {chain.link_joints[link]} follows {chain.names[joint]}, and there is no "
                "position of that at which both are within their limits",
                path=path,
            )
