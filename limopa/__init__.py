"""LIMOPA: plan locally isotropic motion, the motion in which joint hysteresis shows.

path → limits → time: a plan is a chain of straight reaching phases and sinusoidal exploring
phases in joint space, checked for feasibility and time-parameterised with limited jerk.
`excite` finds the motion that identifies the rigid body and simple friction; `excite_servos` plans
commands for arms behind position servos that tell no torque.
"""

from limopa.excitation.search import Excitation, ExcitationRequest, excite
from limopa.excitation.servo import ServoExcitation, ServoRequest, excite_servos
from limopa.feasibility import Feasibility
from limopa.picture import draw
from limopa.planner import Plan, Statistics, plan, summarise
from limopa.request import Exploring, PlanRequest, Reaching, Surroundings, Workspace

__all__ = [
    "Excitation",
    "ExcitationRequest",
    "Exploring",
    "Feasibility",
    "Plan",
    "PlanRequest",
    "Reaching",
    "ServoExcitation",
    "ServoRequest",
    "Statistics",
    "Surroundings",
    "Workspace",
    "draw",
    "excite",
    "excite_servos",
    "plan",
    "summarise",
]
