"""Where a fit of stiction begins: with the amount and the fading that come nearest of a grid."""

from __future__ import annotations

from dataclasses import replace

import pytest
from servo_arms import commands, recorded, write_arm

from estimators.diagnosis.from_motion import free_run
from estimators.diagnosis.from_motion.fitting.starts import away
from estimators.diagnosis.from_motion.hypotheses.suspects import SHAPES, stiction_begun_at
from estimators.diagnosis.from_motion.simulation.constants import COULOMB, with_values
from estimators.diagnosis.from_motion.simulation.loads import ArmChange, ArmLoads
from estimators.diagnosis.from_motion.simulation.plant import rows_of
from limo_driver.physics import Simulation, StribeckFriction

FRICTION, STICTION, FADES = 0.4, 0.6, 0.03  # [N m], [N m], [rad/s]


@pytest.fixture(scope="module")
def stated(tmp_path_factory):
    path = write_arm(tmp_path_factory.mktemp("arm") / "arm.xml", friction=FRICTION)
    return Simulation.load(path)


def recording_of(stated, shape):
    """Return a slow motion of an arm whose elbow has stiction of that shape."""
    sticky = StribeckFriction(joint=2, tau_s=STICTION, v_s=FADES, delta=shape)
    time, command = commands(30.0, 200.0, 0.3)
    start = recorded(time, command, command)
    moved = free_run(replace(stated, effects=(*stated.effects, sticky)), start)
    return recorded(time, command, moved)


@pytest.mark.parametrize("shape", SHAPES)
def test_the_nearest_of_the_grid_is_near_what_is_there(stated, shape):
    loads = ArmLoads(stated.body, [recording_of(stated, shape)], rows_of(stated))
    parts, row = loads.parts(ArmChange.none(2))[1], rows_of(stated)[1]

    found = stiction_begun_at(parts, row, shape)

    assert found["stribeck"] == pytest.approx(STICTION, rel=0.2)
    assert found["v_s"] == pytest.approx(FADES, rel=0.4)
    assert away(parts, with_values(row, {**found, "delta": shape})) < 0.5 * away(parts, row)


def test_a_joint_without_dry_friction_is_tried_with_little_stiction(stated):
    loads = ArmLoads(stated.body, [recording_of(stated, 1.0)], rows_of(stated))
    parts = loads.parts(ArmChange.none(2))[1]
    bare = with_values(rows_of(stated)[1], {COULOMB: 0.0})

    found = stiction_begun_at(parts, bare, 1.0)

    assert found["stribeck"] > 0.0


def test_dry_friction_that_was_raised_in_its_place_is_lowered(stated):
    loads = ArmLoads(stated.body, [recording_of(stated, 2.0)], rows_of(stated))
    parts = loads.parts(ArmChange.none(2))[1]
    raised = with_values(rows_of(stated)[1], {COULOMB: 1.2 * FRICTION})

    found = stiction_begun_at(parts, raised, 2.0)

    assert found[COULOMB] == pytest.approx(FRICTION, rel=0.03)
