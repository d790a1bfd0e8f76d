"""The mass of a body lies where its link is known to be, and a little around."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from estimators.rigid_body.fitting.consistent import nearest_body, pseudo_inertia
from estimators.rigid_body.fitting.extent import Extent, Extents
from estimators.rigid_body.regressor import parameters_of
from limo_driver.model import RobotModel
from limo_driver.model.descriptions.geometry import Inertial


@pytest.fixture(scope="module")
def iiwa():
    return RobotModel.load("iiwa14")


def compact(mass, com, radius=0.03):
    """Return the parameters of a ball."""
    size = 0.4 * mass * radius**2
    return parameters_of(Inertial(mass, com, (size, 0.0, 0.0, size, 0.0, size)))


def test_what_is_within_is_summed_over_all_mass():
    random = np.random.default_rng(0)
    points, masses = random.normal(size=(20, 3)), random.uniform(0.1, 1.0, 20)
    moments = np.einsum("k,ka,kb->ab", masses, points, points)
    I = np.trace(moments) * np.eye(3) - moments  # noqa: E741
    body = np.array([masses.sum(), *(masses @ points), *I[[0, 0, 1, 0, 1, 2], [0, 1, 1, 2, 2, 2]]])
    sphere = Extent(np.array([0.3, -0.1, 0.2]), 1.7)
    inside = 1.7**2 - np.sum((points - sphere.centre) ** 2, axis=1)
    assert sphere.slope @ body == pytest.approx(masses @ inside)


def test_what_is_known_of_a_link_is_within_its_extent(iiwa):
    extents = Extents(iiwa)
    for link, name in enumerate(iiwa.link_names):
        assert extents.of(link).holds(parameters_of(iiwa.inertials[name]))
    for capsule in iiwa.capsules():
        if capsule.joint >= 0:
            extent = extents.of(capsule.joint)
            for end in (capsule.start, capsule.end):
                assert np.linalg.norm(end - extent.centre) + capsule.radius < extent.radius


def test_a_tool_may_stick_out_of_the_last_link_and_of_no_other(iiwa):
    extents, tool = Extents(iiwa), compact(2.0, (0.0, 0.3, 0.5))
    assert extents.of(6).holds(tool)
    assert not extents.of(4).holds(tool)
    assert not extents.of(6).holds(compact(2.0, (0.0, 0.0, 2.0)))


def test_a_counterbalance_may_be_as_far_behind_a_joint_as_the_link_is_long(two_links_urdf):
    arm = RobotModel.load(two_links_urdf)
    placement = np.array(arm.pin_tree.jointPlacements[2].translation)
    behind = -0.5 * placement
    extent = Extents(arm).of(0)
    assert extent.holds(compact(5.0, tuple(behind.tolist())))
    assert not extent.holds(compact(5.0, tuple((-3.0 * placement).tolist())))


def test_moments_that_no_body_has_do_not_hide_a_centre_of_mass_out_of_reach():
    extent, body = Extent(np.zeros(3), 0.3), compact(1.0, (0.0, 0.0, 0.5))
    body[[4, 6, 9]] = 0.0
    assert extent.slope @ body > 0.0
    assert not extent.holds(body)
    assert not extent.holds(-compact(1.0, (0.0, 0.0, 0.1)))


def test_of_a_change_that_part_stays_within_that_has_no_more_before_the_edge():
    extent, start = Extent(np.array([0.0, 0.0, 0.1]), 0.3), compact(1.0, (0.0, 0.0, 0.0))
    change = compact(2.0, (0.5, 0.0, 0.0)) - start
    part = extent.part(start, change)
    assert 0.0 < part < 1.0
    assert extent.holds(start + part * change)
    assert not extent.holds(start + (part + 1e-5) * change)
    assert extent.part(start, 0.5 * part * change) == 1.0


def test_a_bare_link_has_room_for_a_drive(iiwa):
    """Of a point at its joint nothing is known but that something has to turn it."""
    point = Inertial(1.0, (0.0, 0.0, 0.0), (1e-9, 0.0, 0.0, 1e-9, 0.0, 1e-9))
    bare = iiwa.with_inertials({name: replace(point) for name in iiwa.link_names})
    assert all(Extents(bare).of(link).radius > 0.05 * iiwa.length for link in range(7))


def test_the_nearest_body_within_an_extent_is_nearer_than_its_neighbours():
    random = np.random.default_rng(3)
    root = random.normal(size=(10, 10))
    metric = 1e4 * (root @ root.T + np.eye(10))
    extent, far = Extent(np.array([0.0, 0.0, 0.1]), 0.2), compact(1.0, (0.0, 0.1, 1.0))
    near = compact(1.0, (0.0, 0.1, 0.15))
    np.testing.assert_allclose(nearest_body(near, metric, extent), near, atol=1e-4)
    nearest = nearest_body(far, metric, extent)
    assert extent.holds(nearest)
    assert np.linalg.eigvalsh(pseudo_inertia(nearest))[0] > 0

    def distance(parameters):
        return (parameters - far) @ metric @ (parameters - far)

    for _ in range(100):  # all that lies between two bodies within an extent is one, too
        com = extent.centre + random.uniform(-0.1, 0.1, 3)
        other = compact(float(random.uniform(0.1, 3.0)), tuple(com.tolist()), 0.05)
        assert extent.holds(other)
        for part in (0.03, 0.3, 1.0):
            assert distance(nearest + part * (other - nearest)) > distance(nearest)
