"""Drives and friction of an arm that MuJoCo moves, from commands and positions alone."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from one_file import check_page, drawn
from servo_arms import ARMATURE, DAMPING, KD, KP, commands, recorded, simulated, write_arm

from estimators.diagnosis.from_motion import diagnose_drives, free_run, identify_drives
from estimators.diagnosis.from_motion.checks.conventions import (
    Convention,
    confirmed,
    conventions_of,
    likeliest_order,
)
from estimators.diagnosis.from_motion.fitting import extras
from estimators.diagnosis.from_motion.fitting.identification import with_servos
from estimators.diagnosis.from_motion.fitting.joint import (
    JointFit,
    between,
    errors,
    fit_joint,
    independent,
    left_out,
)
from estimators.diagnosis.from_motion.pipeline import drives_page
from estimators.diagnosis.from_motion.simulation.constants import (
    ABSENT,
    BASE,
    value_in,
    with_values,
)
from estimators.diagnosis.from_motion.simulation.loads import loaded_joints
from estimators.diagnosis.from_motion.simulation.plant import rows_of
from limo_driver.physics import GravityDirection, Simulation

RATE = 100.0
FRICTION = 0.25  # [N m]
STEP = 2 * np.pi / 4096  # [rad], of the encoder


@pytest.fixture(scope="module")
def arm(tmp_path_factory):
    return write_arm(tmp_path_factory.mktemp("arm") / "arm.xml", friction=FRICTION)


@pytest.fixture(scope="module")
def recordings(arm):
    """Two motions of the arm behind encoders of 12 bit."""
    found = []
    for pace in (1.0, 0.6):
        time, command = commands(30.0, RATE, pace)
        position = STEP * np.round(simulated(arm, time, command) / STEP)
        found.append(recorded(time, command, position))
    return found


@pytest.fixture(scope="module")
def bare(arm):
    """Return the rigid body alone: nothing is known of drives and friction."""
    return Simulation(str(arm))


@pytest.fixture(scope="module")
def found(bare, recordings):
    return identify_drives(bare, recordings[:1])


@pytest.mark.slow("fits servos")
def test_what_moves_a_joint_alike_is_tried_once(arm, bare, monkeypatch):
    """Commands that never repeat follow a profile whether or not it leads to repeated ones."""
    given = Simulation.load(arm)
    led = replace(given, drives=tuple(replace(drive, acceleration=3.0) for drive in given.drives))
    time, command = commands(8.0, RATE)
    short = recorded(time, command, free_run(led, recorded(time, command, command)))
    followed = list[bool]()

    def counted(parts, row, names=BASE, *more):
        if "acceleration" in names:
            followed.append(value_in(row, "straight") > 0.0)
        return fit_joint(parts, row, names, *more)

    monkeypatch.setattr(extras, "fit_joint", counted)
    identify_drives(bare, [short], intervals=False)
    assert followed
    assert not any(followed)


def test_gains_and_friction_are_found_in_newton_metres(found):
    for joint, fit in enumerate(found.fits):
        assert fit.value("kp") == pytest.approx(KP[joint], rel=0.1)
        assert fit.value("coulomb") == pytest.approx(FRICTION, rel=0.2)
        assert fit.value("damping") == pytest.approx(KD[joint] + DAMPING, rel=0.2)
    assert found.scaled == (True, True)


@pytest.mark.slow("fits many effects to fast motion")
def test_a_profile_that_repeated_commands_leave_is_found(arm):
    given = Simulation.load(arm)
    servos = tuple(replace(drive, acceleration=12.0, straight=1.0) for drive in given.drives)
    own = replace(given, drives=servos)
    time = np.arange(1500) / 50.0
    phase = 2 * np.pi * (0.2 * time + 0.5 * 2.3 * time**2 / 30.0)  # up to 2.5 Hz
    command = np.stack([-0.4 + 0.15 * np.sin(phase), 0.3 * np.sin(0.7 * time)], axis=1)
    command[700:950, 0] = -0.4 + 0.15 * np.sign(np.sin(4.0 * time[700:950]))
    start = recorded(time, command, np.tile(command[0], (time.size, 1)))
    position = STEP * np.round(free_run(own, start) / STEP)

    found = identify_drives(Simulation(str(arm)), [recorded(time, command, position)])

    shoulder, _ = found.simulation.drives
    assert "profile_acceleration" in found.extras[0]
    assert shoulder.straight == 1.0
    assert shoulder.acceleration == pytest.approx(12.0, rel=0.25)  # fits take longer steps


def test_its_page_has_the_constants_of_each_joint(found):
    text = drives_page(found, "sim.yaml").html()
    check_page(text)
    assert f"{found.fits[0].value('kp'):.3g}</td>" in text
    assert [bar["x"] for bar in drawn(text)[0]["data"]] == [
        pytest.approx([fit.mean_error for fit in found.fits], rel=1e-3)
    ]


def test_a_start_whose_errors_are_all_large_leads_to_the_same_constants(bare, recordings):
    """Fast motion: with a lag four times its own, errors are many times what counts as one."""
    (part,) = loaded_joints(bare.body, recordings[:1])[0]
    far = {"kp": KP[0] / 3, "damping": 2.0 * KD[0], "inertia": 3.0 * ARMATURE}
    row = with_values(rows_of(with_servos(bare, [])[0])[0], far)
    assert np.median(np.abs(errors([part], row))) > 0.03

    fit = fit_joint([part], row, ("kp", "damping", "coulomb", "inertia", "offset"))

    assert fit.value("kp") == pytest.approx(KP[0], rel=0.1)
    assert fit.value("damping") == pytest.approx(KD[0] + DAMPING, rel=0.2)


def test_other_motion_is_predicted_from_commands(found, recordings):
    error = np.abs(free_run(found.simulation, recordings[1]) - recordings[1].position)
    lag = np.abs(recordings[1].command - recordings[1].position)

    assert error.mean() < 2 * STEP
    assert error.mean() < 0.05 * lag.mean()


def test_the_armature_is_within_its_interval_or_said_to_be_undecided(found):
    for joint, fit in enumerate(found.fits, start=1):
        low, high = fit.interval("inertia")
        assert (joint, "inertia") in found.undecided or low < 1.5 * ARMATURE < 3.0 * high


@pytest.mark.slow("fits servos")
def test_without_gravity_only_ratios_are_known(bare, recordings):
    weightless = replace(bare, effects=(GravityDirection(gravity=(0.0, 0.0, 0.0)),))

    ratios = identify_drives(weightless, recordings[:1])

    assert ratios.scaled == (False, False)
    assert all("kp" not in fit.names for fit in ratios.fits)


def test_gravity_tells_a_joint_that_counts_the_other_way(bare, recordings):
    turned = [recorded(r.time, r.command * [1, -1], r.position * [1, -1]) for r in recordings]

    assert conventions_of(bare.body, recordings).as_described
    told = confirmed(with_servos(bare, [])[0], turned, conventions_of(bare.body, turned))
    assert told.best.sign == (1, -1)
    assert told.sentence().startswith("By gravity, positions are counted otherwise: joint 2 with")


@pytest.mark.slow("fits servos")
def test_another_convention_that_predicts_no_better_is_not_told(bare, recordings):
    found = conventions_of(bare.body, recordings)
    misled = replace(
        found,
        best=Convention((1, -1), (0.0, 0.0)),
        odds=(50.0, -50.0),
        log_odds=50.0,
        as_described=False,
    )

    told = confirmed(with_servos(bare, [])[0], recordings, misled)
    assert not told.confirmed
    assert told.sentence() == (
        "Signs and zeros of joint 1 are those of the description (beyond doubt likelier than "
        "others). Gravity does not decide how joint 2 is counted."
    )


def test_a_joint_that_no_command_moves_is_like_the_others(bare, recordings):
    one = recordings[0]
    still = np.tile(one.command[:1, 1:], (len(one), 1))
    told, did = (np.hstack([x[:, :1], still]) for x in (one.command, one.position))
    found = identify_drives(bare, [recorded(one.time, told, did)])

    assert found.moved == (True, False)
    assert found.fits[1].names == ()
    assert found.fits[1].value("kp") == pytest.approx(found.fits[0].value("kp"))


@pytest.mark.slow("simulates and fits forty seconds of servos")
def test_the_torque_at_which_a_servo_saturates_is_found(bare, tmp_path):
    """Of MuJoCo's own servos without damping: the voltage limits them, and their motors brake."""
    limit = 1.9  # [N m]; gravity takes 2.1 at full reach
    path = write_arm(tmp_path / "weak.xml", friction=0.05, limit=limit, kd=(0.0, 0.0), damping=1.5)
    time, command = commands(40.0, RATE, 0.6)
    weak = recorded(time, command, simulated(path, time, command))

    found = identify_drives(bare, [weak], intervals=False)
    assert found.extras == (("torque_limit",), ())
    # always reached upwards: an offset that helps is a higher limit
    reached = found.fits[0].value("torque_limit") + found.fits[0].value("offset")
    assert reached == pytest.approx(limit, rel=0.05)
    assert found.fits[0].mean_error < 0.002
    assert found.simulation.drives[0].torque_limit == found.fits[0].value("torque_limit")


def test_gravity_tells_columns_that_are_exchanged(bare, recordings):
    exchanged = [
        recorded(one.time, one.command[:, ::-1], one.position[:, ::-1]) for one in recordings
    ]

    assert likeliest_order(bare.body, recordings) == (0, 1)
    assert likeliest_order(bare.body, exchanged) == (1, 0)


@pytest.mark.slow("diagnoses an arm of servos")
def test_a_diagnosis_scores_positions(bare, recordings, tmp_path):
    diagnosis = diagnose_drives(bare, recordings)

    assert diagnosis.verdict.fit.unit == "rad"
    assert max(diagnosis.verdict.fit.heldout_rmse_after) < 3 * STEP
    assert min(diagnosis.verdict.fit.heldout_rmse_before) > 10 * STEP
    assert {item.effect for item in diagnosis.verdict.identified} >= {
        "position_servo",
        "coulomb_friction",
    }
    assert any("sags" in note for note in diagnosis.verdict.notes)
    diagnosis.save(tmp_path / "out")
    assert Simulation.load(tmp_path / "out" / "sim.yaml").drives == diagnosis.simulation.drives
    assert {path.name for path in (tmp_path / "out").iterdir()} == {
        "verdict.json",
        "sim.yaml",
        "report.html",
    }


def test_a_joint_that_never_moves_tells_no_floor_and_ends_no_report(bare, recordings, tmp_path):
    still = []
    for one in recordings:
        command, position = one.command.copy(), one.position.copy()
        command[:, 0] = position[:, 0] = position[0, 0]
        still.append(recorded(one.time, command, position))

    diagnosis = diagnose_drives(bare, still)
    assert diagnosis.verdict.fit.noise_floor[0] == 0.0
    assert 1 not in diagnosis.verdict.unexplained.joints
    assert not any("Joint 1 sags" in note for note in diagnosis.verdict.notes)
    diagnosis.save(tmp_path / "out")
    page = (tmp_path / "out" / "report.html").read_text()
    assert "Identified drives and friction" in page


@pytest.mark.slow("diagnoses an arm of servos")
def test_a_wrong_gain_is_a_finding(found, recordings):
    wrong = replace(
        found.simulation,
        drives=tuple(
            replace(drive, kp=5 * drive.kp) if drive.joint == 1 else drive
            for drive in found.simulation.drives
        ),
    )

    verdict = diagnose_drives(wrong, recordings).verdict

    assert [(x.effect, x.kind, x.joints) for x in verdict.findings] == [
        ("position_servo", "wrong_parameter", (1,))
    ]


def test_correlated_errors_count_less():
    rng = np.random.default_rng(0)
    white = rng.normal(size=4000)

    assert independent(white) > 2000
    assert independent(np.repeat(white[:40], 100)) < 200


def test_a_gain_that_differs_from_motion_to_motion_is_less_sure(found, recordings):
    body, row = found.simulation.body, rows_of(found.simulation)[0]
    one = recordings[0]
    weaker = recorded(one.time, one.command + 0.25 * (one.position - one.command), one.position)
    same, mixed = (
        fit_joint(parts, row, ("kp", "coulomb"))
        for parts in (
            loaded_joints(body, [one] * 4)[0],
            loaded_joints(body, [one, weaker, one, weaker])[0],
        )
    )
    parts = loaded_joints(body, [one, weaker, one, weaker])[0]

    told = left_out(mixed, parts)

    assert told.deviation["kp"] > 3 * mixed.deviation["kp"]
    low, high = told.interval("kp")
    assert low < fit_joint(parts[:1], row, ("kp", "coulomb")).value("kp") < high
    of_same = left_out(same, loaded_joints(body, [one] * 4)[0])
    assert of_same.deviation["kp"] < told.deviation["kp"] / 3


def test_a_constant_that_motion_does_not_show_has_an_interval_that_says_nothing():
    row = with_values(np.zeros_like(ABSENT), {"kp": 100.0})
    fit = JointFit(row, ("kp", "offset"), {"kp": np.inf, "offset": np.inf}, np.zeros(3))
    for name in fit.names:
        low, high = fit.interval(name)
        assert low < fit.value(name) < high
        assert np.isfinite([low, high]).all()
        assert high - low >= 100.0


def test_fits_without_a_block_that_agree_leave_no_deviation():
    assert not between(np.full((8, 2), 1 / 3)).any()
