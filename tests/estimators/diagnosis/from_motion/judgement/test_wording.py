"""What was found of drives is said in the words of those who use them."""

from __future__ import annotations

import re
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from estimators.diagnosis.from_motion.findings import as_stated
from estimators.diagnosis.from_motion.fitting.identification import DriveIdentification
from estimators.diagnosis.from_motion.fitting.joint import JointFit
from estimators.diagnosis.from_motion.simulation.constants import KINDS, with_values
from estimators.diagnosis.from_motion.simulation.plant import rows_of
from estimators.diagnosis.from_motion.verdict import (
    about_scale,
    full_load,
    plays,
    sags,
    undecided,
)
from limo_driver.physics import Simulation, ViscousFriction
from limo_driver.physics.drives import PositionServo


def test_play_is_told_in_degrees_where_there_is_some(arm):
    servos = tuple(PositionServo(joint=j, kp=20.0, kd=0.5) for j in (1, 2))
    rigid, loose = rows_of(Simulation(str(arm), drives=servos))
    loose = with_values(np.array(loose), {"play": 0.0157})
    fits = [SimpleNamespace(row=np.array(rigid)), SimpleNamespace(row=loose)]
    assert plays(fits) == ("Joint 2 has 0.0157 rad of play between motor and joint.",)


def test_what_is_stated_is_told_in_words_and_by_its_parts(arm):
    servo = PositionServo(joint=1, kp=20.0, kd=0.5)
    friction = ViscousFriction(joint=1, f_v=0.2)
    row = rows_of(Simulation(str(arm), (friction,), drives=(servo, replace(servo, joint=2))))[0]

    def said(effect, row=row, extra=False):
        return as_stated(effect, np.array(row), KINDS[effect], extra=extra)

    assert said("position_servo") == "with a P gain of 20 N m/rad, as stated"
    both = "with damping of 0.7 N m s/rad (0.5 of the servo, 0.2 of the joint), as stated"
    assert said("viscous_friction") == both
    alone = with_values(np.array(row), {"kd": 0.0})
    assert said("viscous_friction", alone) == "with damping of 0.2 N m s/rad, as stated"
    assert said("drive_delay") == "without it"  # none is stated
    assert said("stribeck_friction", extra=True) == "without it"
    stated = with_values(np.array(row), {next(iter(units)): 0.3 for units in KINDS.values()})
    for effect in KINDS:
        assert said(effect, stated).startswith("with ")


@pytest.mark.parametrize("deviation", [0.1, 1e-3])
def test_a_sag_is_told_with_its_interval(arm, deviation):
    servos = tuple(PositionServo(joint=j, kp=20.0, kd=0.5) for j in (1, 2))
    simulation = Simulation(str(arm), drives=servos)
    fits = tuple(
        JointFit(row, ("kp",), {"kp": deviation}, np.zeros(1)) for row in rows_of(simulation)
    )
    shown = DriveIdentification(simulation, fits, ((), ()), (True, True), (True, False))

    (said,) = sags(shown)

    sag, factor = full_load(simulation.body)[0] / 20.0, np.exp(1.96 * deviation)
    found = re.search(r"sags (\S+) rad \(95 % interval (\S+) to (\S+) rad\)", said)
    value, low, high = map(float, found.groups())
    assert low < value < high
    assert (value, low, high) == pytest.approx((sag, sag / factor, sag * factor), rel=5e-3)


def test_joints_without_scale_or_motion_are_told(arm):
    servos = tuple(PositionServo(joint=j, kp=20.0, kd=0.5) for j in (1, 2))
    simulation = Simulation(str(arm), drives=servos)
    fits = tuple(JointFit(row, (), {}, np.zeros(1)) for row in rows_of(simulation))
    found = DriveIdentification(simulation, fits, ((), ()), (False, True), (True, False))

    light, still = about_scale(found, stated=True)

    assert "only the ratios are known there; their scale is that of all that is stated" in light
    assert still.endswith("and the stated values are kept.")
    assert [reason for effect, reason in undecided(found, 50.0) if effect == "position_servo"] == [
        "gravity never loads joint 1: kp is known there in ratio to friction, damping and inertia "
        "alone",
        "no command moves joint 2: its drive does not show",
    ]
