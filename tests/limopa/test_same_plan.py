"""A seed makes the same plan on every processor: its scaffolds, its choices, its samples.

`make test-numerics` runs this with the kernels of others, whose sums differ in the last digits.
Chosen are arms whose shapes are round, and meshes, whose capsules are found by decompositions.
"""

from __future__ import annotations

import numpy as np
import pytest

from limopa import Exploring, PlanRequest, plan

REQUEST = PlanRequest(scaffolds=4, rate=100.0, exploring=Exploring(waypoints=(400, 500)))
# samples, poses drawn, where phases end; first joint of each scaffold, mean position of each joint,
# mean speed of each [rad, rad/s]
FROZEN = {
    "iiwa": ([3255, 512, 798, 1119, 1821, 2216, 2698, 2977, 3255], [
        1.8573651401, -1.4559528851, -1.7193055862, 0.7151131252, -0.2328613028, 0.8455310146,
        0.82150552, 0.4452723544, -0.2355961102, -1.4543562204, 0.9779933345, 0.2275605254,
        0.1739871594, 0.1417168347, 0.2026262215, 0.252352132, 0.1220204738, 0.1659038977,
    ]),
    "meshed_panda": ([1826, 512, 552, 639, 909, 1024, 1291, 1574, 1826], [
        -1.6344901982, -0.860654959, -0.3378406363, 2.415107168, -0.2430445983, 0.2273755582,
        1.2232517984, -2.4319613034, -0.0169359878, 2.7347677266, -0.6011147214, 0.3002283821,
        0.1702510296, 0.3112771915, 0.207663557, 0.1929554255, 0.1418692052, 0.1918076326,
    ]),
    "ur5": ([1973, 512, 329, 570, 834, 1117, 1351, 1517, 1973], [
        -2.8983783219, -3.7955330207, -2.4241062844, -2.0447361557, -2.8232490761, 4.1611249333,
        -0.1493925022, 1.9994725708, 0.6874805826, -0.3843063609, 0.1938313282, 0.1999692589,
        0.5330183905, 0.20416778, 0.2468518314, 0.6879858789,
    ]),
}  # fmt: skip


def facts(model):
    planned = plan(model, REQUEST, seed=4)
    motion = planned.trajectory
    whole = [len(motion), planned.candidates, *(s.stop for s in motion.segments)]
    real = [planned.scaffolds[:, 0], motion.position.mean(axis=0)]
    real += [np.abs(motion.velocity).mean(axis=0)]
    return whole, np.concatenate(real)


@pytest.mark.parametrize("robot", ["iiwa", "meshed_panda", "ur5"])
def test_a_seed_makes_this_plan_on_any_processor(request, robot):
    whole, real = facts(request.getfixturevalue(robot))
    assert whole == FROZEN[robot][0]
    np.testing.assert_allclose(real, FROZEN[robot][1], rtol=0, atol=1e-9)
