"""What every backend promises, kept by the FRI driver at the wire.

The tests are the contract suite's own. Left out are those of simulated time and saved states, which
a real arm has not, of impedances, which FRI does not command, and of changing the control mode,
which a session fixes.
"""

import importlib

import pytest
from lanes import sampled
from robot_commands import START
from stepped_arm import stepped

from backends.fri.codec.messages import CommandMode, Generation

POSITION = {
    "test_robot": [
        "test_time_starts_at_zero_and_advances_by_cycles",
        "test_feasible_motion_is_followed_unchanged",
        "test_send_before_receive_is_refused",
        "test_first_command_far_from_the_measured_pose_is_refused",
        "test_first_command_within_tolerance_is_approached_within_the_limits",
        "test_limited_command_is_returned_and_converges_without_overshoot",
        "test_range_is_kept_and_said",
        "test_command_for_another_number_of_joints_is_refused",
        "test_refused_command_leaves_the_one_in_force",
        "test_lost_measurement_is_flagged_and_never_zero",
        "test_states_cannot_be_written_to",
    ],
    "test_robot_holding": [
        "test_expired_command_leads_to_a_hold_within_the_limits",
        "test_nothing_resumes_without_being_told",
        "test_resuming_starts_from_the_measured_pose",
        "test_hold_from_full_speed_keeps_the_limits",
        "test_long_loss_of_measurements_leads_to_a_hold",
        "test_stream_starts_only_from_a_fresh_measurement",
    ],
}
TORQUE = {
    "test_robot_compliance": [
        "test_torque_and_its_rate_are_limited",
        "test_zero_torque_floats_under_compensated_gravity",
    ],
}


LONG = {
    "test_expired_command_leads_to_a_hold_within_the_limits",
    "test_limited_command_is_returned_and_converges_without_overshoot",
    "test_range_is_kept_and_said",
}


def promises(suite):
    marks = {name: pytest.mark.slow("thousands of cycles at the wire") for name in LONG}
    return [
        pytest.param(
            getattr(importlib.import_module(module), name), id=name, marks=marks.get(name, ())
        )
        for module, names in suite.items()
        for name in names
    ]


@pytest.fixture
def robot():
    with stepped(position=START) as opened:
        yield opened


@pytest.fixture
def compliant():
    with stepped(position=START, mode=CommandMode.TORQUE) as opened:
        yield opened


@pytest.mark.parametrize("promise", promises(POSITION))
def test_position_session_keeps(promise, robot):
    promise(robot)


@pytest.mark.parametrize("promise", promises(TORQUE))
def test_torque_session_keeps(promise, compliant):
    promise(compliant)


@sampled("generation", [Generation.TWO_FIVE, Generation.TWO_SEVEN], "seconds of cycles each")
def test_later_versions_are_driven_alike(generation):
    module = importlib.import_module("test_robot")
    for promise in (
        module.test_feasible_motion_is_followed_unchanged,
        module.test_lost_measurement_is_flagged_and_never_zero,
    ):
        with stepped(position=START, generation=generation) as robot:
            promise(robot)


@sampled("commanded", [False, True], "seconds of cycles each")
def test_resuming_while_braking_keeps(commanded, robot):
    module = importlib.import_module("test_robot_holding")
    module.test_resuming_while_braking_keeps_the_limits(robot, commanded)


@sampled("answered", [False, True], "seconds of cycles each")
@sampled("resumed", [False, True], "seconds of cycles each")
def test_closing_keeps(answered, resumed, robot):
    module = importlib.import_module("test_robot_holding")
    module.test_closing_at_full_speed_brakes_within_the_limits(robot, answered, resumed)


@pytest.mark.parametrize("bad", [float("nan"), float("inf")])
def test_position_that_is_not_finite_is_refused(bad, robot):
    robot.receive()
    with pytest.raises(ValueError, match="joint 5: position"):
        robot.send(importlib.import_module("robot_commands").position([0, 0, 0, 0, bad, 0, 0]))
    robot.receive()
    assert robot.arm.listen() == []
