"""The catalogue of joint physics, and simulations made of it."""

from limo_driver.physics.catalogue import CATALOGUE
from limo_driver.physics.effect import Effect, MotionEffect, Parameter, TorqueEffect
from limo_driver.physics.friction import CoulombFriction, StribeckFriction, ViscousFriction
from limo_driver.physics.hysteresis import PreslidingHysteresis
from limo_driver.physics.sensing import Sensors, TorqueOffset
from limo_driver.physics.simulation import Simulation, Tolerances
from limo_driver.physics.transmission import Armature, JointElasticity

__all__ = [
    "CATALOGUE",
    "Armature",
    "CoulombFriction",
    "Effect",
    "JointElasticity",
    "MotionEffect",
    "Parameter",
    "PreslidingHysteresis",
    "Sensors",
    "Simulation",
    "StribeckFriction",
    "Tolerances",
    "TorqueEffect",
    "TorqueOffset",
    "ViscousFriction",
]
