"""The catalogue: every effect by its identifier."""

from __future__ import annotations

from typing import TYPE_CHECKING

from limo_driver.physics.friction import CoulombFriction, StribeckFriction, ViscousFriction
from limo_driver.physics.hysteresis import PreslidingHysteresis
from limo_driver.physics.sensing import TorqueOffset
from limo_driver.physics.transmission import Armature, JointElasticity

if TYPE_CHECKING:
    from limo_driver.physics.effect import Effect

CATALOGUE: dict[str, type[Effect]] = {
    effect.name: effect
    for effect in (
        Armature,
        CoulombFriction,
        JointElasticity,
        PreslidingHysteresis,
        StribeckFriction,
        TorqueOffset,
        ViscousFriction,
    )
}
