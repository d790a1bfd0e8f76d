"""Loads of an arm that differs from its description, against the same arm described so."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from servo_arms import commands, recorded, write_arm

from estimators.drives.arm_findings import turned
from estimators.drives.arm_loads import ArmChange, ArmLoads
from estimators.drives.one_joint import loaded_joints
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
    other = turned(recording, [1])

    (first, second) = ArmLoads(bare.body, [other]).parts(replace(NONE, sign=(1, -1)))

    described = loaded_joints(bare.body, [recording])
    np.testing.assert_allclose(first[0].load, described[0][0].load, atol=1e-9)
    np.testing.assert_allclose(second[0].load, -described[1][0].load, atol=1e-9)
    np.testing.assert_array_equal(turned(other, [1]).position, recording.position)


def test_rows_of_fast_recordings_are_thinned(bare):
    time, command = commands(2.0, 1000.0)
    (first, _) = ArmLoads(bare.body, [recorded(time, command, command)]).parts(NONE)

    assert first[0].time.size == 400
