"""Loads of an arm that differs from its description, and single joints that are moved by them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from servo_arms import KP, commands, recorded, simulated, write_arm

from estimators.diagnosis.from_motion import free_run
from estimators.diagnosis.from_motion.held_out import row_errors
from estimators.diagnosis.from_motion.simulation.constants import with_values
from estimators.diagnosis.from_motion.simulation.loads import (
    ArmChange,
    ArmLoads,
    as_described,
    loaded_joints,
)
from estimators.diagnosis.from_motion.simulation.one_joint import LoadedJoint
from estimators.diagnosis.from_motion.simulation.plant import rows_of, with_rows
from limo_driver.model.descriptions.geometry import Inertial
from limo_driver.physics import Payload, Simulation

NONE = ArmChange.none(2)


@pytest.fixture(scope="module")
def bare(tmp_path_factory):
    return Simulation(str(write_arm(tmp_path_factory.mktemp("arm") / "arm.xml")))


@pytest.fixture(scope="module")
def recording():
    time, command = commands(6.0, 100.0)
    return recorded(time, command, command - 0.05)


def test_an_arm_as_described_is_loaded_as_described(bare, recording):
    for own, described in zip(
        ArmLoads(bare.body, [recording]).parts(NONE),
        loaded_joints(bare.body, [recording]),
        strict=True,
    ):
        np.testing.assert_allclose(own[0].load, described[0].load)
        np.testing.assert_allclose(own[0].inertia, described[0].inertia)


def test_a_body_at_the_last_link_is_a_payload(bare, recording):
    mass, com = 0.2, (0.1, 0.02, -0.01)
    held = replace(NONE, mass=mass, com=com)
    heavy = replace(bare, effects=(Payload(mass=mass, com=com),))

    for own, described in zip(
        ArmLoads(bare.body, [recording]).parts(held),
        loaded_joints(heavy.body, [recording]),
        strict=True,
    ):
        np.testing.assert_allclose(own[0].load, described[0].load, atol=1e-9)
        np.testing.assert_allclose(own[0].inertia, described[0].inertia, atol=1e-9)


def test_a_body_at_the_link_before_loads_as_that_link_does_with_it(bare, recording):
    mass, com = 0.2, (0.1, 0.02, -0.01)
    loads = ArmLoads(bare.body, [recording])
    assert loads.carriers == (None, 0)
    first = bare.model.link_names[0]
    load = Inertial(mass, com, (0.0,) * 6)
    heavy = replace(bare, inertials={first: bare.model.inertials[first].joined(load)})
    for own, described in zip(
        loads.parts(replace(NONE, mass=mass, com=com, carrier=0)),
        loaded_joints(heavy.body, [recording]),
        strict=True,
    ):
        np.testing.assert_allclose(own[0].load, described[0].load, atol=1e-9)
        np.testing.assert_allclose(own[0].inertia, described[0].inertia, atol=1e-9)


def test_a_zero_elsewhere_loads_joints_as_if_the_links_stood_there(bare, recording):
    away = recorded(recording.time, recording.command, recording.position + np.array([0.0, 0.3]))

    (first, second) = ArmLoads(bare.body, [away]).parts(NONE.with_value("zero_2", 0.3))

    described = loaded_joints(bare.body, [recording])
    still = recording.motion(5.0).acceleration
    for j, own in enumerate((first, second)):
        # The inertia is of the described zero, and the load makes up for it.
        total = own[0].load + own[0].inertia * still[:, j]
        wanted = described[j][0].load + described[j][0].inertia * still[:, j]
        np.testing.assert_allclose(total, wanted, atol=0.02 * np.abs(wanted).max())


def test_a_turned_joint_is_loaded_the_other_way(bare, recording):
    against = replace(NONE, sign=(1, -1))
    other = as_described(recording, against)

    (first, second) = ArmLoads(bare.body, [other]).parts(replace(NONE, sign=(1, -1)))

    described = loaded_joints(bare.body, [recording])
    np.testing.assert_allclose(first[0].load, described[0][0].load, atol=1e-9)
    np.testing.assert_allclose(second[0].load, -described[1][0].load, atol=1e-9)
    np.testing.assert_array_equal(as_described(other, against).position, recording.position)


def test_rows_of_fast_recordings_are_thinned(bare):
    time, command = commands(2.0, 1000.0)
    (first, _) = ArmLoads(bare.body, [recorded(time, command, command)]).parts(NONE)

    assert first[0].time.size == 400


def test_exchanged_columns_are_loaded_as_the_links_that_they_tell(bare, recording):
    exchanged = replace(NONE, order=(1, 0))
    other = as_described(recording, exchanged)

    own = ArmLoads(bare.body, [other]).parts(exchanged)

    for part, described in zip(own, loaded_joints(bare.body, [recording]), strict=True):
        np.testing.assert_allclose(part[0].load, described[0].load, atol=1e-9)
        np.testing.assert_array_equal(part[0].command, described[0].command)


def test_one_joint_has_the_supply_of_the_whole_arm(tmp_path):
    arm = Simulation.load(write_arm(tmp_path / "arm.xml", limit=6.0))
    weak = replace(arm, drives=tuple(replace(drive, sag=0.8) for drive in arm.drives))
    time, command = commands(4.0, 200.0, 2.0)
    told = recorded(time, command, free_run(weak, recorded(time, command, command)))
    loads = ArmLoads(arm.body, [told], rows_of(arm))

    for j, row in enumerate(rows_of(arm)):
        strong, sagging = (
            np.abs(part.simulate(row) - told.position[:, j]).mean()
            for part in (loads.parts(NONE)[j][0], loads.parts(replace(NONE, sag=0.8))[j][0])
        )
        assert sagging < 0.2 * strong


def test_another_gear_is_constants_as_seen_at_the_joint(tmp_path, recording):
    arm = Simulation.load(write_arm(tmp_path / "arm.xml", limit=6.0))
    row = rows_of(arm)[1]

    improved = with_rows(arm, [row, with_values(row, {"gear": 0.5})])

    was, now = arm.drives[1], improved.drives[1]
    assert (now.kp, now.torque_limit) == (0.5 * was.kp, 0.5 * was.torque_limit)
    assert now.kd == 0.25 * was.kd
    part = ArmLoads(arm.body, [recording]).parts(NONE)[1][0]
    np.testing.assert_allclose(
        part.simulate(with_values(row, {"gear": 0.5})), part.simulate(rows_of(improved)[1])
    )


def test_joined_stretches_move_as_each_of_them_does(tmp_path):
    path = write_arm(tmp_path / "arm.xml")
    simulation = Simulation.load(path)
    time, command = commands(4.0, 100.0)
    recording = recorded(time, command, simulated(path, time, command))
    ((whole,), _) = loaded_joints(simulation.body, [recording])
    row = rows_of(simulation)[0]
    parts = [whole.between(150, 300), whole.between(0, 150), whole.between(20, 400)]

    each = np.concatenate([part.simulate(row) for part in parts])
    joined = LoadedJoint.joined([LoadedJoint.joined(parts[:2]), parts[2]])

    np.testing.assert_array_equal(joined.simulate(row), each)
    np.testing.assert_array_equal(joined.begins, [0, 150, 300])
    # as in one stretch it would not: each begins anew where the recorded joint was
    run_on = LoadedJoint(*(getattr(joined, name) for name in LoadedJoint.__match_args__))
    assert np.abs(run_on.simulate(row) - each).max() > 0.01


@pytest.fixture(scope="module")
def moved(tmp_path_factory):
    path = write_arm(tmp_path_factory.mktemp("arm") / "arm.xml")
    time, command = commands(8.0, 200.0)
    simulation = Simulation.load(path)
    recording = recorded(time, command, simulated(path, time, command))
    (shoulder, _) = loaded_joints(simulation.body, [recording])
    return shoulder, rows_of(simulation)[0]


def rms(values):
    return float(np.sqrt(np.mean(values[100:-100] ** 2)))  # smoothed velocities end roughly


def test_the_arm_itself_errs_little(moved):
    parts, row = moved
    errors = row_errors(parts, row)

    driven = KP[0] * np.abs(parts[0].command - parts[0].position).max()
    assert errors.step.shape == (len(parts[0].time) - 1,)
    assert rms(errors.step) < 2e-5
    assert rms(errors.torque) < 0.02 * driven


def test_a_wrong_gain_pushes_wrongly_by_its_share_of_the_lag(moved):
    parts, row = moved
    errors = row_errors(parts, with_values(row, {"kp": 1.3 * KP[0]}))

    lag = (parts[0].command - parts[0].position)[:-1]
    assert rms(errors.torque) == pytest.approx(rms(0.3 * KP[0] * lag), rel=0.1)
    assert rms(errors.step) > 3 * rms(row_errors(parts, row).step)
