"""What was found in all motion is proved on parts of it, its own values held."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from servo_arms import commands, recorded, write_arm

from estimators.diagnosis.from_motion import free_run
from estimators.diagnosis.from_motion.fitting.arm import ArmProblem, Weights, fit_arm
from estimators.diagnosis.from_motion.hypotheses.search import Searched, beliefs, stated_guess
from estimators.diagnosis.from_motion.hypotheses.stated import proven
from estimators.diagnosis.from_motion.hypotheses.suspects import Suspect
from estimators.diagnosis.from_motion.simulation.constants import DAMPING, value_in
from estimators.diagnosis.from_motion.simulation.loads import ArmLoads
from estimators.diagnosis.from_motion.simulation.plant import rows_of
from limo_driver.physics import Simulation, StribeckFriction

TICK = 1e-4  # [rad]


@pytest.fixture(scope="module")
def stated(tmp_path_factory):
    return Simulation.load(write_arm(tmp_path_factory.mktemp("arm") / "arm.xml", friction=0.3))


@pytest.fixture(scope="module")
def recording(stated):
    sticky = replace(
        stated, effects=(*stated.effects, StribeckFriction(joint=2, tau_s=0.4, v_s=0.03))
    )
    time, command = commands(20.0, 100.0, 0.5)
    return recorded(time, command, free_run(sticky, recorded(time, command, command)))


@pytest.mark.parametrize("held", [True, False])
def test_values_of_what_was_found_are_held_and_all_else_is_fitted(stated, recording, held):
    rows = rows_of(stated)
    loads = ArmLoads(stated.body, [recording], rows)
    suspects = (
        Suspect("stribeck_friction", 1, (("stribeck", 0.5), ("v_s", 0.05))),
        Suspect("payload", None, (("mass", 0.01), ("com_x", 0.1)), shared=True),
        Suspect("position_servo", 0, (), freed="kp"),
    )
    guess = stated_guess(rows)
    for one in suspects:
        guess = one.added(guess)
    problem = ArmProblem(loads, Weights(np.full(2, 1e-3), np.full(2, 0.1)), beliefs(rows, 0.1))
    found = Searched(problem, fit_arm(problem, guess, 0), suspects)

    arm = proven(stated, [recording[:1000]], found, TICK, held=held)

    shoulder, elbow = (fit.row for fit in arm.identified.fits)
    kept = (
        value_in(elbow, "stribeck") == 0.5,
        value_in(elbow, "v_s") == 0.05,
        arm.change.mass == 0.01,
        value_in(shoulder, "kp") == value_in(rows[0], "kp"),
    )
    assert kept == (held,) * 4
    assert value_in(elbow, DAMPING) != value_in(guess.rows[1], DAMPING)
