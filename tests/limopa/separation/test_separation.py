"""The motion that is asked for lets two effects differ, measured on their own torques."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from lanes import sampled

from limo_driver.errors import InfeasiblePathError
from limo_driver.physics import (
    Backlash,
    CoulombFriction,
    EncoderOffset,
    JointCoupling,
    JointElasticity,
    LoadDependentFriction,
    PositionDependentFriction,
    PreslidingHysteresis,
    QuadraticDrag,
    Simulation,
    SpringLoad,
    StribeckFriction,
    TemperatureDependentFriction,
    TorqueCrosstalk,
    TorqueDrift,
    TorqueOffset,
    TorqueRipple,
    ViscousFriction,
)
from limopa.separation import motions as excitation
from limopa.separation.separation import motion_for, purpose_of, separation_of

START = np.array([0.1, 0.5, -0.2, -1.0, 0.3, 0.8, 0.0])
BASE = Simulation("iiwa14", tuple(CoulombFriction(joint=j, tau_c=1.0) for j in range(1, 8)))
PLACES, BUMPS = (-2.0, -1.2, -0.8, 0.0, 0.6, 1.0, 2.0), (0.0, 0.5, 0.0, 0.6, 0.0, 0.5, 0.0)
J = 6  # has a neighbour to couple with, and is loaded by gravity
BACKLASH = Backlash(joint=J, gap=1e-3)
SLIP = PreslidingHysteresis(joint=J, stiffness=(100.0, 30.0), width=(0.003, 0.012))
DRAGGED = Backlash(joint=J, gap=1e-3, drag=0.5)
BY_LOAD = LoadDependentFriction(joint=J, coefficient=0.03, variant="absolute")
BY_PLACE = PositionDependentFriction(joint=J, positions=PLACES, excess=BUMPS)
BY_WARMTH = TemperatureDependentFriction(joint=J, excess=1.0, time_constant=60.0)
OFFSET = TorqueOffset(joint=J, offset=1.0)
SPRING = SpringLoad(joint=J, stiffness=2.0, rest=0.0, cubic=0.0)
STRIBECK = StribeckFriction(joint=J, tau_s=0.5, v_s=0.03, delta=2.0)
VISCOUS = ViscousFriction(joint=J, f_v=3.0)
APART = [
    (BACKLASH, EncoderOffset(joint=J, offset=1e-3)),
    (DRAGGED, SLIP),  # play that a link falls across does not show in it
    (BY_LOAD, BY_PLACE),
    (BY_LOAD, BY_WARMTH),
    (BY_PLACE, BY_WARMTH),
    (BY_PLACE, TorqueRipple(joint=J, cycles_per_rev=(100.0,), amplitude=(0.3,), phase=(0.0,))),
    (BY_WARMTH, TorqueDrift(joint=J, times=(0.0, 60.0, 120.0), offset=(0.0, 0.7, 1.0))),
    (JointCoupling(joint=J, other=7, f_v=1.0), TorqueCrosstalk(joint=J, source=7, gain=0.05)),
    (JointElasticity(joint=J, stiffness=8000.0), SPRING),
    (QuadraticDrag(joint=J, coefficient=2.0), VISCOUS),
    (SLIP, STRIBECK),
    (SPRING, OFFSET),
    (STRIBECK, VISCOUS),
]


@sampled(("first", "second"), APART, "plans a motion each", first=3, ids=lambda effect: effect.name)
def test_in_its_motion_neither_effect_passes_for_the_other(iiwa, first, second):
    trajectory = motion_for(iiwa, [J], (first.name, second.name), START)
    motion = trajectory[np.arange(0, len(trajectory), 4)]
    one, other = (_torque(effect, motion) for effect in (first, second))
    friction = np.tanh(motion.velocity[:, J - 1] / 0.002)  # known within tolerances only
    beyond_friction, beyond_both = _left(one, friction), _left(one, friction, other)
    assert beyond_both > 0.25 * beyond_friction
    assert beyond_friction > 0.2 * np.sqrt(np.mean(one**2))


def _left(torque, *columns):
    """Return the RMS of what multiples of the columns leave of a torque [N m]."""
    given = np.stack(columns, axis=1)
    return np.std(torque - given @ np.linalg.lstsq(given, torque, rcond=None)[0])


def _torque(effect, motion):
    added = replace(BASE, effects=(*BASE.effects, effect))
    return (added.predict(motion) - BASE.predict(motion))[:, J - 1]


def test_a_pair_names_its_motion_in_either_order(iiwa):
    pair = ("stribeck_friction", "presliding_hysteresis")
    assert separation_of(pair) == separation_of(pair[::-1])
    assert separation_of(pair).motion is excitation.creep
    assert purpose_of(pair, [2, 3]).startswith("Creep at five speeds, both ways; decides between ")
    assert "joints 2, 3" in purpose_of(pair, [2, 3])
    motion = motion_for(iiwa, [2], pair, np.stack([iiwa.limits.position_max, START]))
    assert np.allclose(motion.position[0], START)  # the first pose allows no motion


def test_what_no_motion_tells_apart_is_said():
    with pytest.raises(InfeasiblePathError, match="once with and once without it"):
        separation_of(("payload", "link_inertia"))


def test_laws_of_one_effect_are_split_by_what_shows_it():
    pair = ("presliding_hysteresis", "presliding_hysteresis")
    assert separation_of(pair).motion is excitation.nested_reversals
