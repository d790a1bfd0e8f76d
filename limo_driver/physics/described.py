"""What a description states of its joints, as effects: where a nominal simulation starts."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from limo_driver.physics.environment import SpringLoad
from limo_driver.physics.friction import CoulombFriction, QuadraticDrag, ViscousFriction
from limo_driver.physics.transmission import Armature

if TYPE_CHECKING:
    from limo_driver.model import RobotModel
    from limo_driver.physics.effect import Effect

# A description means a sign; smoothed over as little as recordings of slow arms resolve.
SIGN_WIDTH: Final = 0.005  # [rad/s]


def described_effects(model: RobotModel) -> tuple[Effect, ...]:
    """Return friction, damping, armature and springs that the robot's description states.

    Args:
        model: The robot.
    """
    found: list[Effect] = []
    for joint, name in enumerate(model.joint_names, start=1):
        stated = model.description.dynamics.get(name)
        if stated is None:
            continue
        if stated.friction:
            found.append(CoulombFriction(joint=joint, tau_c=stated.friction, v_eps=SIGN_WIDTH))
        if stated.damping:
            found.append(ViscousFriction(joint=joint, f_v=stated.damping))
        if stated.armature:
            found.append(Armature(joint=joint, inertia=stated.armature))
        if stated.drag > 0:
            found.append(QuadraticDrag(joint=joint, coefficient=stated.drag))
        if stated.stiffness or stated.cubic:
            found.append(
                SpringLoad(
                    joint=joint, stiffness=stated.stiffness, rest=stated.rest, cubic=stated.cubic
                )
            )
    return tuple(found)
