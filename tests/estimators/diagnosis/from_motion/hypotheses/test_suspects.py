"""What an arm has beyond what is stated, found from commands and positions."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from servo_arms import ARMATURE, DAMPING, KD, KP, commands, recorded, simulated, write_arm

from estimators.diagnosis.from_motion import diagnose_drives, free_run
from estimators.diagnosis.from_motion.fitting.arm import ArmProblem, Weights, fit_arm
from estimators.diagnosis.from_motion.fitting.identification import DriveIdentification
from estimators.diagnosis.from_motion.fitting.joint import JointFit
from estimators.diagnosis.from_motion.fitting.starts import mean_distance
from estimators.diagnosis.from_motion.search import beliefs, stated_guess
from estimators.diagnosis.from_motion.simulation.constants import COULOMB, value_in, with_values
from estimators.diagnosis.from_motion.simulation.loads import ArmChange, ArmLoads
from estimators.diagnosis.from_motion.simulation.plant import rows_of
from estimators.diagnosis.from_motion.stated import StatedArm
from estimators.diagnosis.from_motion.suspects import (
    SHAPES,
    Suspect,
    start_of_stiction,
    suspects_of,
)
from estimators.regression.evidence import REACH
from limo_driver.physics import (
    Armature,
    CoulombFriction,
    Payload,
    Simulation,
    StribeckFriction,
    ViscousFriction,
)
from limo_driver.physics.simulation_file import Tolerances

FRICTION = 0.25  # [N m]
STEP = 2 * np.pi / 4096  # [rad], of the encoder


@pytest.fixture(scope="module")
def stated(tmp_path_factory):
    """Return the arm as it is, with its drives."""
    path = write_arm(tmp_path_factory.mktemp("arm") / "arm.xml", friction=FRICTION)
    return replace(Simulation.load(path), tolerances=Tolerances(drive=0.1))


@pytest.fixture(scope="module")
def recordings(stated):
    found = []
    for pace in (1.0, 0.6):
        time, command = commands(16.0, 100.0, pace)
        position = STEP * np.round(simulated(stated.robot, time, command) / STEP)
        found.append(recorded(time, command, position))
    return found


def named(simulation, recordings):
    diagnosis = diagnose_drives(simulation, recordings)
    verdict = diagnosis.verdict
    assert diagnosis.headline()
    assert str(diagnosis)
    return [(item.effect, item.joints) for item in verdict.findings], verdict


@pytest.mark.slow("diagnoses an arm of servos")
def test_an_arm_as_stated_has_no_finding(stated, recordings):
    found, verdict = named(stated, recordings)

    assert found == []
    assert verdict.verdict == "consistent"
    assert "joint_sign" not in {item.effect for item in verdict.not_observable}


def moved(simulation, recordings):
    """Return what an encoder of 12 bit reads of an arm that follows the same commands."""
    return [
        recorded(r.time, r.command, STEP * np.round(free_run(simulation, r) / STEP))
        for r in recordings
    ]


@pytest.mark.slow("diagnoses an arm of servos")
def test_a_payload_has_its_first_moment(stated, recordings):
    """Of two joints whose gains have tolerances, mass alone is less sure than mass times arm."""
    heavy = moved(with_payload(stated, 0.15), recordings)

    found, verdict = named(stated, heavy)

    assert found == [("payload", ())]
    values = verdict.findings[0].parameters
    assert values["mass"].value * values["com"].value[0] == pytest.approx(0.15 * 0.2, rel=0.1)


@pytest.mark.slow("diagnoses an arm of servos")
def test_play_between_motor_and_joint_has_its_gap(stated, recordings):
    loose = replace(
        stated, drives=tuple(replace(d, play=0.03 if d.joint == 2 else 0.0) for d in stated.drives)
    )
    played = moved(loose, recordings)

    found, verdict = named(stated, played)

    assert found == [("backlash", (2,))]
    assert verdict.findings[0].parameters["gap"].value == pytest.approx(0.03, rel=0.2)


@pytest.mark.slow("diagnoses an arm of servos")
def test_a_joint_that_counts_the_other_way_is_a_finding(stated, recordings):
    turned = [recorded(r.time, r.command * [1, -1], r.position * [1, -1]) for r in recordings]

    found, verdict = named(stated, turned)

    assert found == [("joint_sign", (2,))]
    assert any("position_2 and command_2 count against" in note for note in verdict.notes)


def with_payload(simulation, mass):
    payload = Payload(mass=mass, com=(0.2, 0.0, 0.0))
    return replace(simulation, effects=(*simulation.effects, payload))


def test_the_stated_arm_is_what_was_simulated(stated):
    """The tests above mean nothing if the description does not state the whole arm."""
    assert [(d.kp, d.kd) for d in stated.drives] == list(zip(KP, KD, strict=True))
    kinds = {type(effect): effect for effect in stated.effects}
    assert kinds[CoulombFriction].tau_c == FRICTION
    assert kinds[ViscousFriction].f_v == DAMPING
    assert kinds[Armature].inertia == ARMATURE


def test_values_stay_within_their_tolerance_until_one_is_suspected(stated, recordings):
    wrong = [
        with_values(row, {"kp": 2.0 * kp}) for row, kp in zip(rows_of(stated), KP, strict=True)
    ]
    guess = stated_guess(np.array(wrong))
    problem = ArmProblem(
        ArmLoads(stated.body, recordings[:1]),
        Weights(np.full(2, STEP), np.full(2, 0.1)),
        beliefs(guess.rows, 0.1),
        within=REACH,
    )

    kept = fit_arm(problem, guess, 8, deviations=True).guess
    one = fit_arm(problem, Suspect("position_servo", 1, (), freed="kp").added(kept), 8).guess
    all_of = fit_arm(replace(problem, within=np.inf), kept, 8, deviations=True).guess

    least = 2.0 * np.array(KP) * np.exp(-0.1 * REACH)
    assert [value_in(row, "kp") for row in kept.rows] == pytest.approx(least)
    assert [value_in(row, "kp") for row in one.rows] == pytest.approx([least[0], KP[1]], rel=0.03)
    assert [value_in(row, "kp") for row in all_of.rows] == pytest.approx(KP, rel=0.03)


def test_a_glance_ends_where_a_fit_does_and_says_not_how_sure_it_is(stated, recordings):
    wrong = [
        with_values(row, {"kp": 1.2 * kp}) for row, kp in zip(rows_of(stated), KP, strict=True)
    ]
    guess = stated_guess(np.array(wrong))
    weights = Weights(np.full(2, STEP), np.full(2, 0.1))
    problem = ArmProblem(ArmLoads(stated.body, recordings[:1]), weights, beliefs(guess.rows, 0.1))

    for steps in (1, 8):
        fit, glance = (
            fit_arm(problem, guess, steps, deviations=True),
            fit_arm(problem, guess, steps),
        )

        np.testing.assert_array_equal(glance.guess.rows, fit.guess.rows)
        assert glance.cost == fit.cost
        assert all(own["kp"] > 0.0 for own in fit.own)
        assert glance.own == ()


def test_a_gear_that_may_be_the_stated_one_is_doubtful(stated):
    other = Suspect("gear_ratio", 1, (("gear", 1.0),))

    for ratio, deviation, doubtful in ((0.6, 0.02, False), (0.6, 0.2, True), (0.8, 0.02, True)):
        row = with_values(rows_of(stated)[1], {"gear": ratio})
        fit = JointFit(row, ("gear",), {"gear": deviation}, np.zeros(1))
        found = DriveIdentification(stated, (fit, fit), ((), ("gear_ratio",)), *[(True, True)] * 2)
        arm = StatedArm(found, ArmChange.none(2), {}, (other,))

        assert (arm.doubtful is other) == doubtful


@pytest.mark.parametrize(
    ("mass", "deviation", "doubtful"),
    [(0.05, 0.03, True), (0.07, 0.03, False), (0.02, 0.003, True)],
    ids=["its interval holds none", "neither", "within the tolerance of the masses"],
)
def test_a_body_is_doubtful(stated, mass, deviation, doubtful):
    payload = Suspect("payload", None, (("mass", 0.1),), shared=True)
    change = replace(ArmChange.none(2), mass=mass)
    none = DriveIdentification(stated, (), (), (), ())

    arm = StatedArm(none, change, {"mass": deviation}, (payload,))

    assert (arm.doubtful is payload) == doubtful


def test_a_shape_that_is_not_fitted_comes_and_goes_with_its_suspect(stated, recordings):
    guess = stated_guess(rows_of(stated))
    (bell,) = [
        one
        for one in suspects_of(ArmLoads(stated.body, recordings[:1]), guess, guess.rows)
        if one.effect == "stribeck_friction" and one.joint == 0 and dict(one.shape)["delta"] == 2.0
    ]

    added = bell.added(guess)

    assert value_in(added.rows[0], "delta") == 2.0
    assert added.names[0] == (*guess.names[0], "stribeck", "v_s")
    left = guess.rows.copy()
    left[0] = with_values(left[0], dict(bell.bent))  # which a fit without it bends back
    np.testing.assert_array_equal(bell.removed(added).rows, left)
    assert bell.excludes(replace(bell, shape=()))


def test_stiction_that_is_fitted_is_no_suspect_again(stated, recordings):
    loads, guess = ArmLoads(stated.body, recordings[:1]), stated_guess(rows_of(stated))
    first = next(x for x in suspects_of(loads, guess, guess.rows) if "stribeck" in x.names)

    again = list(suspects_of(loads, first.added(guess), guess.rows))

    assert [x.joint for x in again if "stribeck" in x.names] == [1, 1]


def test_stiction_that_is_stated_is_still_a_suspect(stated, recordings):
    """It may be another amount."""
    sticky = replace(
        stated,
        effects=(*stated.effects, StribeckFriction(joint=1, tau_s=0.1, v_s=0.03)),
    )
    loads, guess = ArmLoads(stated.body, recordings[:1]), stated_guess(rows_of(sticky))

    found = list(suspects_of(loads, guess, guess.rows))

    assert [x.joint for x in found if "stribeck" in x.names] == [0, 0, 1, 1]


DRY, STICTION, FADES = 0.4, 0.6, 0.03  # [N m], [N m], [rad/s]


@pytest.fixture(scope="module")
def rubbing(tmp_path_factory):
    path = write_arm(tmp_path_factory.mktemp("arm") / "arm.xml", friction=DRY)
    return Simulation.load(path)


def sticking(rubbing, shape):
    """Return a slow motion of an arm whose elbow has stiction of that shape."""
    sticky = StribeckFriction(joint=2, tau_s=STICTION, v_s=FADES, delta=shape)
    time, command = commands(30.0, 200.0, 0.3)
    start = recorded(time, command, command)
    moved = free_run(replace(rubbing, effects=(*rubbing.effects, sticky)), start)
    return recorded(time, command, moved)


@pytest.mark.parametrize("shape", SHAPES)
def test_the_nearest_of_the_grid_is_near_what_is_there(rubbing, shape):
    loads = ArmLoads(rubbing.body, [sticking(rubbing, shape)], rows_of(rubbing))
    parts, row = loads.parts(ArmChange.none(2))[1], rows_of(rubbing)[1]

    found = start_of_stiction(parts, row, shape)

    assert found["stribeck"] == pytest.approx(STICTION, rel=0.2)
    assert found["v_s"] == pytest.approx(FADES, rel=0.4)
    begun = with_values(row, {**found, "delta": shape})
    assert mean_distance(parts, begun) < 0.5 * mean_distance(parts, row)


def test_a_joint_without_dry_friction_is_tried_with_little_stiction(rubbing):
    loads = ArmLoads(rubbing.body, [sticking(rubbing, 1.0)], rows_of(rubbing))
    parts = loads.parts(ArmChange.none(2))[1]
    bare = with_values(rows_of(rubbing)[1], {COULOMB: 0.0})

    found = start_of_stiction(parts, bare, 1.0)

    assert found["stribeck"] > 0.0


def test_dry_friction_that_was_raised_in_its_place_is_lowered(rubbing):
    loads = ArmLoads(rubbing.body, [sticking(rubbing, 2.0)], rows_of(rubbing))
    parts = loads.parts(ArmChange.none(2))[1]
    raised = with_values(rows_of(rubbing)[1], {COULOMB: 1.2 * DRY})

    found = start_of_stiction(parts, raised, 2.0)

    assert found[COULOMB] == pytest.approx(DRY, rel=0.03)
