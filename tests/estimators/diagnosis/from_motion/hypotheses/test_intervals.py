"""How sure values are beside stated drives, and what parts of the motion prove."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from servo_arms import commands, recorded, write_arm

from estimators.diagnosis.from_motion import free_run
from estimators.diagnosis.from_motion.fitting.arm import ArmProblem, Weights, fit_arm
from estimators.diagnosis.from_motion.search import (
    Searched,
    beliefs,
    search,
    stated_guess,
)
from estimators.diagnosis.from_motion.simulation.constants import DAMPING, inner, value_in
from estimators.diagnosis.from_motion.simulation.loads import ArmLoads
from estimators.diagnosis.from_motion.simulation.plant import rows_of
from estimators.diagnosis.from_motion.stated import (
    prove_on_part,
    stated_arm,
    with_intervals,
)
from estimators.diagnosis.from_motion.suspects import Suspect
from estimators.diagnosis.settings import Z95
from limo_driver.physics import GravityDirection, Simulation, StribeckFriction

NO_STEP = np.zeros(2)  # of encoders that are as fine as numbers


@pytest.fixture(scope="module")
def stated(tmp_path_factory):
    return Simulation.load(write_arm(tmp_path_factory.mktemp("arm") / "arm.xml", friction=0.3))


def found_in(simulation, recordings, steps):
    """Return the stated constants, fitted, with nothing looked for beyond them."""
    rows = rows_of(simulation)
    loads = ArmLoads(simulation.body, recordings, rows)
    guess = stated_guess(rows)
    problem = ArmProblem(loads, Weights(np.full(2, 1e-4), np.full(2, 0.1)), beliefs(rows, 0.1))
    return Searched(fit_arm(problem, guess, steps, deviations=True), ())


def test_intervals_hold_what_fits_to_filtered_motion_are_off_by(stated):
    """Without noise no two parts of the motion disagree, and every fit is off alike."""
    time, command = commands(20.0, 50.0, 1.5)
    recording = recorded(time, command, free_run(stated, recorded(time, command, command)))
    found = found_in(stated, [recording], 20)

    arm = with_intervals(stated, found, NO_STEP)

    true = stated_guess(rows_of(stated)).rows
    away, curved = list[float](), list[float]()
    for j, fit in enumerate(arm.identified.fits):
        for name in fit.names:
            off = abs(inner(name, fit.value(name)) - inner(name, value_in(true[j], name)))
            away.append(off / fit.deviation[name])
            curved.append(off / found.fit.own[j][name])
    assert max(curved) > 2.0 * Z95
    assert np.mean(np.array(away) < Z95) > 0.9


def test_a_joint_that_gravity_does_not_load_has_no_gain_beside_one_that_it_does(
    stated, monkeypatch
):
    time, command = commands(4.0, 50.0)
    found = found_in(stated, [recorded(time, command, command)], 0)
    monkeypatch.setattr(
        "estimators.diagnosis.from_motion.stated.gives_scale",
        lambda _load: np.array([True, False]),
    )

    loaded, light = stated_arm(stated, found, found.fit).identified.fits

    assert "kp" in loaded.names
    assert "kp" not in light.deviation
    assert "damping" in light.names


def test_where_gravity_loads_no_joint_gains_are_in_the_scale_of_what_is_stated(stated):
    weightless = replace(stated, effects=(GravityDirection(gravity=(0.0, 0.0, 0.0)),))
    time, command = commands(4.0, 50.0)
    found = found_in(stated, [recorded(time, command, command)], 0)

    loaded, light = (stated_arm(own, found, found.fit).identified for own in (stated, weightless))

    assert (loaded.scaled, light.scaled) == ((True, True), (False, False))
    assert all("kp" in fit.names for fit in (*loaded.fits, *light.fits))


def test_of_a_joint_that_no_command_moves_the_stated_values_are_kept(stated):
    time, command = commands(6.0, 50.0)
    command[:, 1] = 0.3
    recording = recorded(time, command, free_run(stated, recorded(time, command, command)))
    rows = rows_of(stated)
    searched = search(ArmLoads(stated.body, [recording], rows), rows, 0.1, 1e-4)

    arm = with_intervals(stated, searched, NO_STEP)

    assert arm.identified.moved == (True, False)
    assert arm.identified.fits[1].names == ()
    assert arm.identified.fits[1].row == pytest.approx(rows[1])
    assert not any(one.joint == 1 and not one.shared for one in arm.suspects)


def test_a_gain_that_the_motion_leaves_undecided_is_said_to_be(stated):
    time, command = commands(4.0, 50.0)
    recording = recorded(time, command, command)
    found = found_in(stated, [recording], 0)
    blind = replace(found.fit.problem, weights=Weights(np.full(2, 1e3), np.full(2, 0.1)))

    fit = fit_arm(blind, found.fit.guess, 0, deviations=True)
    arm = with_intervals(stated, replace(found, fit=fit), NO_STEP)

    assert {(1, "kp"), (2, "kp")} <= set(arm.identified.undecided)


TICK = 1e-4  # [rad]


@pytest.fixture(scope="module")
def sticky_recording(stated):
    sticky = replace(
        stated, effects=(*stated.effects, StribeckFriction(joint=2, tau_s=0.4, v_s=0.03))
    )
    time, command = commands(20.0, 100.0, 0.5)
    return recorded(time, command, free_run(sticky, recorded(time, command, command)))


@pytest.mark.parametrize("held", [True, False])
def test_values_of_what_was_found_are_held_and_all_else_is_fitted(stated, sticky_recording, held):
    rows = rows_of(stated)
    loads = ArmLoads(stated.body, [sticky_recording], rows)
    suspects = (
        Suspect("stribeck_friction", 1, (("stribeck", 0.5), ("v_s", 0.05))),
        Suspect("payload", None, (("mass", 0.01), ("com_x", 0.1)), shared=True),
        Suspect("position_servo", 0, (), freed="kp"),
    )
    guess = stated_guess(rows)
    for one in suspects:
        guess = one.added(guess)
    weights = Weights(np.full(2, 1e-3), np.full(2, 0.1))
    problem = ArmProblem(loads, weights, beliefs(rows, 0.1), tick=TICK)
    found = Searched(fit_arm(problem, guess, 0, deviations=True), suspects)

    arm = prove_on_part(stated, [sticky_recording[:1000]], found, held=held)

    shoulder, elbow = (fit.row for fit in arm.identified.fits)
    kept = (
        value_in(elbow, "stribeck") == 0.5,
        value_in(elbow, "v_s") == 0.05,
        arm.change.mass == 0.01,
        value_in(shoulder, "kp") == value_in(rows[0], "kp"),
    )
    assert kept == (held,) * 4
    assert value_in(elbow, DAMPING) != value_in(guess.rows[1], DAMPING)
