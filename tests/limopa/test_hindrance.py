"""What cannot be planned: the message says which argument is in the way, and what would do."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest

from limo_driver.app.console.command_line import in_options
from limo_driver.errors import InfeasiblePathError
from limopa import Exploring, Feasibility, PlanRequest, Surroundings, Workspace, plan
from limopa.feasibility import Condition
from limopa.scaffold import hindrance

FAR = Workspace(radius=np.inf, lower=(1.2, 0.0, 0.0), upper=(1.4, 0.1, 0.1), throughout=True)
NUMBER = r"(-?[\d.e+-]+)"


@pytest.mark.parametrize(
    ("robot", "request_", "message"),
    [
        ("ur5", {"surroundings": Surroundings(table_height=0.3)}, "0.3 m .*table-height"),
        ("iiwa", {"surroundings": Surroundings(joint_margin=np.radians(70))}, "--joint-margin"),
        ("iiwa", {"workspace": Workspace(radius=0.1)}, "0.1 m of the base .--workspace-radius"),
        ("iiwa", {"workspace": FAR}, r"region from \[1.2, 0, 0\] .*--region"),
        ("iiwa", {"surroundings": Surroundings(clearance=0.12)}, "0.12 m apart.*--clearance"),
        ("iiwa", {"surroundings": Surroundings(clearance=0.5)}, "0.5 m off the .*--clearance"),
        ("ur5", {"surroundings": Surroundings(clearance=0.08)}, "0.08 m .*--clearance"),
        ("iiwa", {"surroundings": Surroundings(joint_margin=2.5)}, "joint 2 no range .--joint-mar"),
    ],
)
def test_the_option_in_the_way_is_named(request, robot, request_, message):
    model = request.getfixturevalue(robot)
    with pytest.raises(InfeasiblePathError) as caught:
        plan(model, PlanRequest(candidates=20_000, **request_))
    assert re.search(message, in_options(str(caught.value)))


def test_a_table_that_is_as_low_as_the_message_says_lets_some_pose_be(ur5):
    high = Surroundings(table_height=0.3)
    with pytest.raises(InfeasiblePathError) as caught:
        plan(ur5, PlanRequest(surroundings=high, candidates=20_000))
    best = float(re.search(f"at most {NUMBER} m", str(caught.value))[1])
    assert best < 0.3
    probes = np.random.default_rng(0)
    space = Feasibility(ur5, replace(high, table_height=best - 0.001), Workspace())
    found = probes.uniform(space.lower - space.margin, space.upper + space.margin, (4096, 6))
    assert space.check_scaffold(found).feasible.any()


def test_a_margin_that_is_as_small_as_the_message_says_lets_some_pose_be(iiwa):
    wide = Surroundings(joint_margin=np.radians(70))
    with pytest.raises(InfeasiblePathError) as caught:
        plan(iiwa, PlanRequest(surroundings=wide, candidates=20_000))
    best = np.radians(float(re.search(f"at most {NUMBER} deg", str(caught.value))[1]))
    assert best < wide.joint_margin
    near = replace(wide, joint_margin=0.98 * best)
    assert len(plan(iiwa, PlanRequest(scaffolds=1, surroundings=near)).scaffolds) == 1


def test_where_either_of_two_conditions_alone_is_enough_both_are_named(iiwa):
    space = Feasibility(iiwa, Surroundings(table_height=0.4), FAR)
    probes = np.random.default_rng(0).uniform(space.lower, space.upper, (2048, 7))
    found = hindrance(space, probes)
    assert re.search(r"region.*\(`region`\); .*0.4 m.*\(`table_height`\)", found.message)
    assert found.condition == Condition.WORKSPACE
    for one in (replace(space.surroundings, table_height=-1.0), space.surroundings):
        alone = Feasibility(iiwa, one, FAR if one.table_height < 0 else Workspace())
        assert ";" not in hindrance(alone, probes).message


def test_where_poses_cannot_be_explored_the_message_names_what_stops_that(iiwa):
    wide = PlanRequest(exploring=Exploring(amplitude=(1.0, 1.5)), exploring_tries=3, repairs=3)
    with pytest.raises(InfeasiblePathError, match=r"exploring phases .* in the way is `joint_mar"):
        plan(iiwa, wide)
    narrow = replace(wide, workspace=Workspace(radius=0.7))
    with pytest.raises(InfeasiblePathError, match=r"is `joint_margin` or `Workspace.radius`$"):
        plan(iiwa, narrow)
    thin = replace(FAR, lower=(0.5, 0.0, 0.3), upper=(0.62, 0.12, 0.42))
    small = PlanRequest(workspace=thin, exploring_tries=3, repairs=3)
    with pytest.raises(InfeasiblePathError, match=r"in the way is `region`"):
        plan(iiwa, small)


@pytest.mark.parametrize("robot", ["iiwa", "panda", "ur5"])
def test_a_quick_verdict_is_the_same_verdict(request, robot):
    model = request.getfixturevalue(robot)
    space = Feasibility(model, Surroundings(), Workspace())
    probes = np.random.default_rng(5).uniform(space.lower - 0.1, space.upper + 0.1, (300, model.n))
    for check in (space.check, space.check_scaffold):
        whole, quick = check(probes), check(probes, all_of=False)
        np.testing.assert_array_equal(quick.feasible, whole.feasible)
        for condition, rows in quick.broken.items():
            assert not np.any(rows & ~whole.broken[condition])
