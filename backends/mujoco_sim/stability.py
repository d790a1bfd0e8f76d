"""Stability limits of the integration step: name and refuse springs too stiff for it."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from backends.simulated import check_gains
from limo_driver.errors import ConfigError

if TYPE_CHECKING:
    from backends.mujoco_sim.realisation import Draft, Plant
    from limo_driver.model import RobotModel
    from limo_driver.types import FloatArray, ImpedanceCommand

# A spring on an inertia is stable while h sqrt(k / M) < 2; at half of that it is still followed.
LARGEST_STEP_RATIO = 1.0
LARGEST_DAMPING_RATIO = 100.0  # h d / M; implicit, so stable, but no drive damps faster
LARGEST_COUPLING_RATIO = 0.5  # inertia that acts one cycle late over inertia; diverges at 1
LARGEST_WIND_UP_RATIO = 0.5  # presliding stiffness over joint stiffness
_POSES = 50


def effective_inertia(model: RobotModel, armature: FloatArray) -> FloatArray:
    """Return the least inertia that a torque on one joint alone moves, over poses, (n,) [kg m²]."""
    return np.min(
        [
            1.0 / np.diag(np.linalg.inv(model.mass_matrix(q) + np.diag(armature)))
            for q in _poses(model)
        ],
        axis=0,
    )


def usual_load(model: RobotModel) -> FloatArray:
    """Return the most torque that each joint holds and accelerates, over poses, (n,) [N m]."""
    poses = _poses(model)
    inertia = np.array([np.diag(model.mass_matrix(q)) for q in poses])
    held = np.abs(model.gravity_torque(poses))
    return np.max(held + inertia * model.limits.acceleration, axis=0)


def _poses(model: RobotModel) -> FloatArray:
    """Return the same poses each time, anywhere within the limits, (_POSES, n) [rad]."""
    random = np.random.default_rng(0)
    limits = model.limits
    return random.uniform(limits.position_min, limits.position_max, (_POSES, model.n))


def check_elements(plant: Plant, inertia: FloatArray, period: float) -> None:
    """Refuse presliding springs that are too stiff for the step or for the gear they act on.

    Raises:
        ConfigError: Names the joint, its stiffness and what the step allows.
    """
    stiffness = np.bincount(
        plant.element_joint, weights=plant.element_stiffness, minlength=inertia.size
    )
    most = largest_stiffness(inertia, period)
    for j in np.flatnonzero(stiffness > most):
        raise ConfigError(
            f"presliding_hysteresis, joint {j + 1}: a stiffness of {stiffness[j]:.4g} N m/rad on "
            f"{inertia[j]:.3g} kg m² needs a shorter period than {period:g} s; at that period at "
            f"most {most[j]:.4g} N m/rad, or a larger motor_inertia"
        )
    for j in np.flatnonzero(stiffness * plant.compliance > LARGEST_WIND_UP_RATIO):
        raise ConfigError(
            f"presliding_hysteresis, joint {j + 1}: its stiffness of {stiffness[j]:.4g} N m/rad "
            f"has to be below half the joint_elasticity of {1 / plant.compliance[j]:.4g} N m/rad"
        )


def check_late(draft: Draft, inertia: FloatArray, period: float) -> None:
    """Refuse sampled effects that are too stiff or too heavy for acting one cycle late.

    Raises:
        ConfigError: Names the effect, the joint and what the step allows.
    """
    stiffness = draft.late_stiffness + draft.late_damping / period
    most = largest_stiffness(inertia, period)
    for j in np.flatnonzero(stiffness > most):
        raise ConfigError(
            f"presliding_hysteresis, joint {j + 1}: sigma_0 + sigma_1 / {period:g} s is "
            f"{stiffness[j]:.4g} N m/rad; on {inertia[j]:.3g} kg m² the step of {period:g} s "
            f"carries at most {most[j]:.4g} N m/rad"
        )
    for j in np.flatnonzero(draft.late_inertia > LARGEST_COUPLING_RATIO * inertia):
        raise ConfigError(
            f"joint_coupling, joint {j + 1}: inertia = {draft.late_inertia[j]:.4g} kg m² has to be "
            f"below half of the {inertia[j]:.3g} kg m² that the joint moves"
        )


def check_impedance(command: ImpedanceCommand, inertia: FloatArray, period: float) -> None:
    """Refuse a stiffness that the step cannot follow, and a damping that no drive has.

    Raises:
        JointLimitError: Names the joint and what is allowed.
    """
    most_damping = inertia * LARGEST_DAMPING_RATIO / period
    check_gains(command, largest_stiffness(inertia, period), most_damping)


def largest_stiffness(inertia: FloatArray, period: float) -> FloatArray:
    """Return the stiffest spring that the step follows on each joint, (n,) [N m/rad]."""
    return inertia * (LARGEST_STEP_RATIO / period) ** 2
