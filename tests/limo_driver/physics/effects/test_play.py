"""Play with a drag: how much of a joint's friction may be gone within a gap."""

from __future__ import annotations

import numpy as np
import pytest

from limo_driver.physics import AsymmetricFriction, Backlash, CoulombFriction, ViscousFriction
from limo_driver.physics.effect import Recorded
from limo_driver.physics.effects.play import DRAGGED_GAPS, MOST_DRAG

DRY = CoulombFriction(joint=2, tau_c=3.0, v_eps=0.01)


def recorded(*effects):
    return Recorded(
        position=np.zeros((10, 2)),
        temperature=None,
        start=0.0,
        end=1.0,
        longest=1.0,
        gravity=np.array([0.0, 0.0, -9.81]),
        effects=effects,
    )


def drags_at(joint, *effects):
    every = Backlash.at_joint(joint, recorded(*effects))
    return [item for item in every if not item.terms[0].displaces]


@pytest.mark.parametrize(
    ("effects", "dry"),
    [
        ((DRY,), 3.0),
        ((AsymmetricFriction(joint=2, tau_plus=4.0, tau_minus=2.5),), 2.5),
        ((DRY, CoulombFriction(joint=1, tau_c=9.0), ViscousFriction(joint=2, f_v=5.0)), 3.0),
    ],
)
def test_a_drag_is_part_of_the_dry_friction_of_its_joint(effects, dry):
    found = drags_at(2, *effects)
    assert [item.settings for item in found] == [(gap,) for gap in DRAGGED_GAPS]
    assert [item.most for item in found] == [MOST_DRAG * dry] * len(found)
    refined = found[0].family(2e-4)
    assert (refined.most, refined.settings) == (MOST_DRAG * dry, (2e-4,))


def test_no_drag_is_looked_for_where_nothing_rubs():
    assert drags_at(1, DRY) == []
    assert len(drags_at(2, DRY)) == len(DRAGGED_GAPS)
