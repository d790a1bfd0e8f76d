"""The contract of the robot, kept by an arm of CiA 402 drives."""

import math
from contextlib import contextmanager
from dataclasses import replace

import pytest
import test_robot
import test_robot_holding
from arms import NODES, arm_config, counts_at
from canopen_drives import CanopenArm
from lanes import sampled
from robot_commands import START
from sync_bus import SyncBus
from test_robot import (  # noqa: F401  # collected here, for another robot
    test_command_for_another_number_of_joints_is_refused,
    test_command_that_is_not_finite_is_refused,
    test_feasible_motion_is_followed_unchanged,
    test_first_command_far_from_the_measured_pose_is_refused,
    test_first_command_within_tolerance_is_approached_within_the_limits,
    test_last_command_of_a_cycle_counts,
    test_lost_measurement_is_flagged_and_never_zero,
    test_refused_command_leaves_the_one_in_force,
    test_send_before_receive_is_refused,
    test_states_cannot_be_written_to,
    test_validity_has_to_be_a_time,
)
from test_robot_holding import (  # noqa: F401
    test_hold_asked_for_after_a_command_keeps_the_limits,
    test_hold_from_full_speed_keeps_the_limits,
    test_long_loss_of_measurements_leads_to_a_hold,
    test_nothing_resumes_without_being_told,
    test_resuming_starts_from_the_measured_pose,
    test_stream_starts_only_from_a_fresh_measurement,
)

from backends.can import CanRobot


class LossyRobot(CanRobot):
    """Loses measurements when it is told to."""

    def lose_measurements(self, count):
        self._port._bus.losing = count


@contextmanager
def open_arm():
    config = arm_config(rate=1000.0, hold_after=1000)
    exact = {"counts_per_turn": math.tau * 1e8, "gear": 1.0}  # the suite starts at such counts
    joints = tuple(replace(joint, **exact) for joint in config.joints)
    config = replace(config, bus=replace(config.bus, fd=True), joints=joints)
    bus = SyncBus()
    with (
        CanopenArm(bus, NODES, counts_at(config, START)),
        LossyRobot(config, bus=bus, clock=bus.now) as robot,
    ):
        yield robot


@pytest.fixture
def robot():
    with open_arm() as opened:
        yield opened


@pytest.mark.slow("thousands of cycles of seven drives each")
@pytest.mark.parametrize(
    "promise",
    [
        test_robot.test_limited_command_is_returned_and_converges_without_overshoot,
        test_robot.test_range_is_kept_and_said,
        test_robot_holding.test_expired_command_leads_to_a_hold_within_the_limits,
    ],
)
def test_it_keeps(promise, robot):
    promise(robot)


@sampled("resumed", [False, True], "seconds of cycles each")
@sampled("answered", [False, True], "seconds of cycles each")
def test_closing_keeps(answered, resumed, robot):
    promise = test_robot_holding.test_closing_at_full_speed_brakes_within_the_limits
    promise(robot, answered, resumed)
