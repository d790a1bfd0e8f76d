"""An arm of another strength, or with locked joints, is the one that its description says."""

import arm as arm_
import numpy as np
import pytest
import variant as variant_
from arm import N
from variant import MOVING, Variant
from world import World

from limo_driver.physics import Simulation

PLANT = pytest.mark.slow("compiles the plant, which no change of limo touches")


@PLANT
@pytest.mark.parametrize("joints", MOVING)
@pytest.mark.parametrize("full_scale", [0.05, 2000.0])
def test_the_description_is_of_the_arm_with_the_other_joints_locked(joints, full_scale, tmp_path):
    """Both compute the torque of one motion, from code that they do not share."""
    given = Variant(full_scale=full_scale, joints=joints)
    random = np.random.default_rng(0)
    world = World.draw(random)
    nominal = world.simulation_file(random)
    content, robot = given.simulation(nominal)
    (tmp_path / variant_.ROBOT).write_text(robot)
    simulation = Simulation(str(tmp_path / variant_.ROBOT), ())
    motion = 0.5 * random.normal(size=(3, 20, joints))
    every = [given.whole(part) for part in motion]
    true = arm_.along(variant_._stated(nominal["inertials"]), arm_.work(), *every)
    expected = given.strength * true[:, given.moving]
    said = simulation.body.inverse_dynamics(*motion)
    np.testing.assert_allclose(said, expected, rtol=1e-6, atol=1e-6 * np.abs(expected).max())
    assert simulation.model.limits.torque[0] == pytest.approx(full_scale)
    assert {entry["joint"] for entry in content["effects"]} == set(range(1, joints + 1))


@PLANT
def test_joints_that_are_locked_stay_where_they_are():
    given = Variant(joints=4)
    random = np.random.default_rng(1)
    world = World.draw(random)
    world = given.world(world)
    motion = np.cumsum(np.full((300, 4), 1e-4), axis=0)
    response = world.respond(given.whole(motion), 0, random)
    assert np.abs(response.position[:, given.locked]).max() < 1e-6
    assert np.abs(response.position[:, given.moving]).max() > 1e-3


def test_the_usual_case_is_as_it_was_drawn():
    """No draw differs from that without variants, so that seeds say what they said."""
    given, random = Variant(), np.random.default_rng(2)
    plan = [(["fourier"], 60.0), (["points"], 70.0)]
    assert given.usual
    assert given.plan(plan, random) is plan
    assert given.moving == list(range(N))
    assert random.bit_generator.state == np.random.default_rng(2).bit_generator.state
