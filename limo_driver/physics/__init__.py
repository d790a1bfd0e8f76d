"""The catalogue of joint physics, and simulations made of it."""

from limo_driver.physics.catalogue import CATALOGUE, display_name
from limo_driver.physics.description import Confusion, Description
from limo_driver.physics.drives import (
    DcMotor,
    JointDrive,
    PositionServo,
    TorqueDrive,
    VelocityServo,
)
from limo_driver.physics.effect import (
    ArmEffect,
    BodyEffect,
    DiagnosisContext,
    Effect,
    Friction,
    Hypothesis,
    JointEffect,
    MotionEffect,
    SensorEffect,
    State,
    TorqueEffect,
)
from limo_driver.physics.effects.arm import ExternalContact, JointCoupling, SpringLoad
from limo_driver.physics.effects.body import GravityDirection, Payload, PickedUpLoad
from limo_driver.physics.effects.changing_friction import (
    LoadDependentFriction,
    PositionDependentFriction,
    TemperatureDependentFriction,
)
from limo_driver.physics.effects.delay import TimeDelay
from limo_driver.physics.effects.friction import (
    AsymmetricFriction,
    CoulombFriction,
    QuadraticDrag,
    StribeckFriction,
    ViscousFriction,
)
from limo_driver.physics.effects.hysteresis import PreslidingHysteresis
from limo_driver.physics.effects.play import Backlash
from limo_driver.physics.effects.sensing import (
    EncoderOffset,
    Sensors,
    TorqueCrosstalk,
    TorqueDrift,
    TorqueGain,
    TorqueOffset,
)
from limo_driver.physics.effects.transmission import (
    Armature,
    JointElasticity,
    TorqueRipple,
)
from limo_driver.physics.score import Score
from limo_driver.physics.simulation import Simulation
from limo_driver.physics.simulation_file import Tolerances
from limo_driver.runtime.parameters import Parameter, parameter

__all__ = [
    "CATALOGUE",
    "ArmEffect",
    "Armature",
    "AsymmetricFriction",
    "Backlash",
    "BodyEffect",
    "Confusion",
    "CoulombFriction",
    "DcMotor",
    "Description",
    "DiagnosisContext",
    "Effect",
    "EncoderOffset",
    "ExternalContact",
    "Friction",
    "GravityDirection",
    "Hypothesis",
    "JointCoupling",
    "JointDrive",
    "JointEffect",
    "JointElasticity",
    "LoadDependentFriction",
    "MotionEffect",
    "Parameter",
    "Payload",
    "PickedUpLoad",
    "PositionDependentFriction",
    "PositionServo",
    "PreslidingHysteresis",
    "QuadraticDrag",
    "Score",
    "SensorEffect",
    "Sensors",
    "Simulation",
    "SpringLoad",
    "State",
    "StribeckFriction",
    "TemperatureDependentFriction",
    "TimeDelay",
    "Tolerances",
    "TorqueCrosstalk",
    "TorqueDrift",
    "TorqueDrive",
    "TorqueEffect",
    "TorqueGain",
    "TorqueOffset",
    "TorqueRipple",
    "VelocityServo",
    "ViscousFriction",
    "display_name",
    "parameter",
]
