"""Batched kinematics and capsule distances against pinocchio and brute force."""

from __future__ import annotations

import coal
import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from limo_driver.model import RobotModel
from limo_driver.model.kinematics import KinematicChain
from limopa import Feasibility, Surroundings, Workspace
from limopa.distances import segment_distance

POINT = arrays(np.float64, 3, elements=st.floats(-1, 1, width=32))


@given(POINT, POINT, POINT, POINT)
@settings(max_examples=30, deadline=None)
def test_segment_distance_is_the_least_over_both_segments(p1, q1, p2, q2):
    s = np.linspace(0, 1, 201)[:, None]
    first, second = p1 + s * (q1 - p1), p2 + s * (q2 - p2)
    brute = np.linalg.norm(first[:, None] - second[None], axis=2).min()
    found = segment_distance(p1, q1, p2, q2)
    step = (np.linalg.norm(q1 - p1) + np.linalg.norm(q2 - p2)) / 200
    assert found <= brute + 1e-12
    assert found >= brute - step


@pytest.mark.parametrize("name", ["iiwa", "panda", "tiago"])
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


def test_hulls_of_meshes_are_as_far_apart_as_pinocchio_says(tmp_path):
    """Three boxes as meshes, of which the last turns about the first: an exact peer for hulls."""
    corners = " ".join(f"{x} {y} {z}" for x in (0, 0.1) for y in (0, 0.02) for z in (0, 0.3))
    body = '<geom type="mesh" mesh="bar"/>'
    (tmp_path / "arm.xml").write_text(
        f"""<mujoco><compiler angle="radian"/><asset><mesh name="bar" vertex="{corners}"/></asset>
        <worldbody><body name="a"><joint name="j1" axis="0 0 1" range="-3 3"/>{body}
        <body name="b" pos="0 0 0.3"><joint name="j2" axis="0 1 0" range="-3 3"/>{body}
        <body name="c" pos="0 0 0.3"><joint name="j3" axis="0 1 0" range="-3 3"/>{body}
        </body></body></body></worldbody></mujoco>"""
    )
    arm = RobotModel.load(tmp_path / "arm.xml")
    feasibility = Feasibility(arm, Surroundings(joint_margin=0, table_height=-5), Workspace())
    boxes = pin.GeometryModel()
    for joint in (1, 3):
        middle = pin.SE3(np.eye(3), np.array([0.05, 0.01, 0.15]))
        box = coal.Box(0.1, 0.02, 0.3)
        boxes.addGeometryObject(pin.GeometryObject(f"box{joint}", joint, middle, box))
    boxes.addCollisionPair(pin.CollisionPair(0, 1))
    data, found = arm.pin_model.createData(), boxes.createData()
    positions = np.random.default_rng(0).uniform(-3, 3, (500, 3))
    theirs = []
    for q in positions:
        pin.computeDistances(arm.pin_model, data, boxes, found, q)
        theirs.append(found.distanceResults[0].min_distance)
    collides = feasibility.check(positions).broken["self-collision"]
    decided = np.abs(np.array(theirs) - 0.02) > 1e-5
    assert 20 < collides.sum() < 480
    np.testing.assert_array_equal(collides[decided], (np.array(theirs) < 0.02)[decided])


def test_heights_over_the_table_are_those_of_the_shapes(ur5):
    """A capsule around the upper arm of a UR5 reaches below the table that the arm stands on."""
    feasibility = Feasibility(ur5, Surroundings(), Workspace())
    upright = np.radians([[0, -90, 0, -90, 0, 0]])
    assert feasibility.check(upright).conditions() == ()
    lying = np.radians([[0, 5, 0, 0, 0, 0]])
    assert "table" in feasibility.check(lying).conditions()


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
