"""Batched kinematics and capsule distances against pinocchio and brute force."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from limo_driver.kinematics import KinematicChain
from limopa import Feasibility, Surroundings, Workspace
from limopa.capsules import segment_distance

POINT = arrays(np.float64, 3, elements=st.floats(-1, 1, width=32))


@given(POINT, POINT, POINT, POINT)
@settings(max_examples=100, deadline=None)
def test_segment_distance_is_the_least_over_both_segments(p1, q1, p2, q2):
    s = np.linspace(0, 1, 201)[:, None]
    first, second = p1 + s * (q1 - p1), p2 + s * (q2 - p2)
    brute = np.linalg.norm(first[:, None] - second[None], axis=2).min()
    found = segment_distance(p1, q1, p2, q2)
    step = (np.linalg.norm(q1 - p1) + np.linalg.norm(q2 - p2)) / 200
    assert found <= brute + 1e-12
    assert found >= brute - step


@pytest.mark.parametrize("name", ["iiwa", "panda"])
def test_batched_kinematics_equal_pinocchio(name, request):
    model = request.getfixturevalue(name)
    limits = model.limits
    positions = np.random.default_rng(0).uniform(
        limits.position_min, limits.position_max, (50, model.n)
    )
    chain = KinematicChain.of(model)
    expected = np.array([model.joint_poses(q) for q in positions])
    np.testing.assert_allclose(chain.joint_poses(positions), expected, atol=1e-12)
    flange = [model.flange_pose(q)[:3, 3] for q in positions]
    np.testing.assert_allclose(chain.flange_position(positions), flange, atol=1e-12)


class _Peer:
    """Self-collision of the iiwa by pinocchio's own distance routine."""

    def __init__(self, model, skipped):
        self.model = model.pin_model
        self.geometry = pin.buildGeomFromUrdf(
            self.model, str(model.urdf), pin.GeometryType.COLLISION
        )
        objects = self.geometry.geometryObjects
        links = [self.model.frames[item.parentFrame].name for item in objects]
        for i in range(len(objects)):
            for k in range(i):
                apart = abs(objects[i].parentJoint - objects[k].parentJoint) > 1
                if apart and {links[i], links[k]} not in skipped:
                    self.geometry.addCollisionPair(pin.CollisionPair(k, i))
        self.data, self.found = self.model.createData(), self.geometry.createData()

    def gap(self, position):
        pin.computeDistances(self.model, self.data, self.geometry, self.found, position)
        return min(result.min_distance for result in self.found.distanceResults)


def test_self_collision_agrees_with_pinocchio(iiwa):
    clearance = 0.02
    feasibility = Feasibility(iiwa, Surroundings(joint_margin=0, clearance=clearance), Workspace())
    peer = _Peer(iiwa, [set(pair) for pair in feasibility.overlapping_pairs])
    positions = np.random.default_rng(1).uniform(
        iiwa.limits.position_min, iiwa.limits.position_max, (4000, iiwa.n)
    )
    ours = feasibility.check(positions).broken["self-collision"]
    theirs = np.array([peer.gap(q) for q in positions])
    decided = np.abs(theirs - clearance) > 1e-6
    assert 20 < ours.sum() < 1000
    np.testing.assert_array_equal(ours[decided], theirs[decided] < clearance)


@pytest.mark.parametrize(
    "degrees",
    [
        [0, 0, 0, 0, 0, 0, 0],
        [0, 30, 0, -60, 0, 90, 0],
        [45, 45, 0, -90, 0, 45, 0],
        [-90, 60, 30, 80, -45, -60, 90],
        [0, -60, 0, -60, 90, 110, 170],
    ],
)
def test_typical_poses_of_the_iiwa_are_free(iiwa, degrees):
    feasibility = Feasibility(iiwa, Surroundings(), Workspace())
    assert feasibility.check(np.radians([degrees])).conditions() == ()


@pytest.mark.parametrize(
    "degrees",
    [[0, 110, 0, -120, 0, 90, 0], [0, -120, 0, 120, 0, -110, 0], [90, 100, 0, -119, 0, 60, 45]],
)
def test_folded_poses_of_the_iiwa_collide(iiwa, degrees):
    surroundings = Surroundings(joint_margin=0, clearance=0.001, table_height=-5)
    feasibility = Feasibility(iiwa, surroundings, Workspace())
    assert feasibility.check(np.radians([degrees])).conditions() == ("self-collision",)


def test_links_that_always_overlap_are_named(iiwa):
    feasibility = Feasibility(iiwa, Surroundings(), Workspace())
    assert feasibility.overlapping_pairs == (("link5", "link7"),)
