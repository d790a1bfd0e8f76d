"""The catalogue: every effect by its identifier."""

from __future__ import annotations

from typing import TYPE_CHECKING

from limo_driver.physics.body import GravityDirection, Payload
from limo_driver.physics.changing_friction import (
    LoadDependentFriction,
    PositionDependentFriction,
    TemperatureDependentFriction,
)
from limo_driver.physics.coupling import JointCoupling
from limo_driver.physics.delay import TimeDelay
from limo_driver.physics.environment import ExternalContact, SpringLoad
from limo_driver.physics.friction import (
    AsymmetricFriction,
    CoulombFriction,
    QuadraticDrag,
    StribeckFriction,
    ViscousFriction,
)
from limo_driver.physics.hysteresis import PreslidingHysteresis
from limo_driver.physics.sensing import (
    EncoderOffset,
    TorqueCrosstalk,
    TorqueDrift,
    TorqueGain,
    TorqueOffset,
)
from limo_driver.physics.transmission import Armature, Backlash, JointElasticity, TorqueRipple

if TYPE_CHECKING:
    from limo_driver.physics.effect import Effect

CATALOGUE: dict[str, type[Effect]] = {
    effect.name: effect
    for effect in (
        Armature,
        AsymmetricFriction,
        Backlash,
        CoulombFriction,
        EncoderOffset,
        ExternalContact,
        GravityDirection,
        JointCoupling,
        JointElasticity,
        LoadDependentFriction,
        Payload,
        PositionDependentFriction,
        PreslidingHysteresis,
        QuadraticDrag,
        SpringLoad,
        StribeckFriction,
        TemperatureDependentFriction,
        TimeDelay,
        TorqueCrosstalk,
        TorqueDrift,
        TorqueGain,
        TorqueOffset,
        TorqueRipple,
        ViscousFriction,
    )
}


def spoken(effect: str) -> str:
    """Return an effect's identifier in words."""
    return effect.replace("_", " ")
