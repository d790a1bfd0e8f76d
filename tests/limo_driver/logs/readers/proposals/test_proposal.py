import re
from dataclasses import replace

import numpy as np
import pytest
from logged import arm, measured, numbered

from limo_driver.app.library.inspecting import inspect
from limo_driver.errors import ConfigError, RecordingError
from limo_driver.logs.readers.proposals.proposal import propose
from limo_driver.logs.readers.table import table_of
from limo_driver.model import RobotModel

TIME, POSITION, VELOCITY, TORQUE = measured()


def chain_of(folder, joints):
    """An arm of so many joints that stands upright."""
    limit = '<limit lower="-3" upper="3" effort="50" velocity="2"/>'
    inertia = '<inertia ixx="0.02" iyy="0.02" izz="0.01" ixy="0" ixz="0" iyz="0"/>'
    parts = [
        f'<joint name="j{j}" type="revolute"><parent link="l{j}"/><child link="l{j + 1}"/>'
        f'<origin xyz="0 0 0.3"/><axis xyz="0 1 0"/>{limit}</joint><link name="l{j + 1}">'
        f'<inertial><origin xyz="0 0 0.15"/><mass value="2"/>{inertia}</inertial></link>'
        for j in range(joints)
    ]
    path = folder / "chain.urdf"
    path.write_text(
        f'<robot name="chain"><link name="l0"/>{"".join(parts)}</robot>', encoding="utf-8"
    )
    return RobotModel(path)


def proposed(**columns):
    return propose(table_of({"t": TIME, **columns}), arm())


def test_degrees_milliseconds_and_counting_from_zero():
    log = {"t_ms": 1e3 * TIME, **numbered("q{}", np.rad2deg(POSITION))}
    log |= {**numbered("dq{}", np.rad2deg(VELOCITY)), **numbered("tau{}", TORQUE)}
    found = propose(table_of(log | {"gripper_width": TIME}), arm())
    assert found.mapping.undecided == ()
    assert found.mapping.left_out == ("gripper_width",)
    columns = found.mapping.columns(table_of(log), arm())
    np.testing.assert_allclose(columns.time, TIME, atol=1e-9)
    np.testing.assert_allclose(columns.position, POSITION, atol=1e-12)
    np.testing.assert_allclose(columns.velocity, VELOCITY, atol=1e-12)
    np.testing.assert_allclose(columns.torque, TORQUE)
    why = {item.quantity: item.why for item in found.taken}
    assert "beyond the limits of joint 1 in rad" in why["position"]
    assert "rate of change" in why["velocity"]


def test_a_clock_that_counts_is_told_by_velocities_of_the_joint_that_moves():
    """What a joint that rests is measured to do has a rate of its own, which says nothing."""
    moved, speed = np.zeros_like(POSITION), np.zeros_like(VELOCITY)
    moved[:, 0], speed[:, 0] = POSITION[:, 0], VELOCITY[:, 0]
    rests = np.sin(np.outer(TIME, np.arange(3.0, 10.0)))
    log = {**numbered("q{}", moved + 1e-5 * rests), **numbered("tau{}", TORQUE)}
    per_ms = 1e3 * (TIME[1] - TIME[0])  # of what a row takes

    def asked(velocity):
        velocities = numbered("dq{}", velocity + 3e-4 * rests)
        found = propose(table_of({"t": np.arange(TIME.size), **log, **velocities}), arm())
        return [question for question in found.mapping.undecided if "count" in question]

    assert asked(speed * per_ms) == []
    assert asked(speed * per_ms * 3.0) == ["time: does it count milliseconds, or rows?"]


def test_degrees_that_limits_alone_say_are_asked_about(tmp_path):
    """Seven units are beyond limits of 3 rad; so they are where a joint turns on."""
    chain = chain_of(tmp_path, 2)
    swing = np.stack([7 * np.sin(0.02 * TIME), 5 * np.cos(0.01 * TIME)], axis=1)  # slow in rad, too

    def asked(position, **more):
        log = {"t": TIME, **numbered("q{}", position), **numbered("q{}_cmd", position + 0.1)}
        found = propose(table_of(log | more), chain)
        assert set(found.mapping.position.unit) == {"deg"}
        return [text for text in found.mapping.undecided if "in rad or deg" in text]

    (question,) = asked(swing)
    assert "limits alone say deg (beyond the limits of joint 2 in rad" in question
    assert len(asked(10 * swing)) == 1  # no arm turns eleven times, but its motors do
    torque = chain.gravity_torque(np.deg2rad(10 * swing))
    assert asked(10 * swing, **numbered("tau{}", torque)) == []
    velocity = np.gradient(np.deg2rad(swing), TIME, axis=0)
    assert asked(swing, **numbered("dq{}_rads", velocity)) == []


@pytest.mark.parametrize(
    ("scale", "unit"), [(1.0, "rad"), (180 / np.pi, "deg")], ids=["rad", "deg"]
)
def test_small_motion_has_its_unit_from_gravity(scale, unit):
    """Motion of some degrees is within the limits in either unit."""
    rows = slice(0, 400)
    q = POSITION[rows] if unit == "rad" else 0.05 * POSITION[rows]
    v = np.gradient(q, TIME[rows], axis=0)
    torque = arm().inverse_dynamics(q, v, np.gradient(v, TIME[rows], axis=0)) + 0.3 * np.sign(v)
    log = {"t": TIME[rows], "q": scale * q, "tau": torque}
    found = propose(table_of(log), arm())
    assert found.mapping.position.unit == (unit,) or found.mapping.undecided
    if not found.mapping.undecided:
        assert re.search("torques are those|in rad, joint 4 would move", found.taken[1].why)


@pytest.mark.parametrize("down", [(9.81, 0.0, 0.0), (0.0, -9.81, 0.0)])
def test_an_arm_on_a_wall_has_its_units_from_gravity_although_its_description_stands(down):
    torque = arm().with_gravity(down).gravity_torque(POSITION)
    torque += np.random.default_rng(2).normal(0, 0.05, torque.shape)
    found = proposed(q=POSITION, tau=torque)
    assert (found.mapping.position.unit, found.mapping.undecided) == (("rad",), ())
    assert "times the gravity torque of the arm" in found.taken[2].why


def test_two_readings_that_fit_are_a_question():
    found = proposed(q=0.01 * POSITION)  # no torque says which
    assert found.mapping.undecided == (
        "position: are the columns in rad or deg? both fit the limits, and no torque says which",
    )
    assert found.mapping.torque is None
    assert found.taken[1].why == "in rad and in deg within the limits, and no torque says which"


@pytest.mark.parametrize("velocity", [{}, numbered("vel_A{}", VELOCITY, 1)], ids=["no", "yes"])
def test_joints_named_like_an_ampere_are_joints(velocity):
    log = {**numbered("pos_A{}", POSITION, 1), **velocity, **numbered("tau_A{}", TORQUE, 1)}
    mapping = proposed(**log).mapping
    assert mapping.undecided == ()
    assert (mapping.position.unit, mapping.torque.unit) == (("rad",), ("N m",))
    assert mapping.velocity is None or mapping.velocity.unit == ("rad/s",)
    assert mapping.left_out == ()


def test_degrees_and_radians_in_one_log_are_a_question_that_names_the_joints():
    mixed = np.array(POSITION)
    mixed[:, [1, 3]] = np.rad2deg(mixed[:, [1, 3]])
    found = proposed(q=mixed, tau=TORQUE)
    (question,) = found.mapping.undecided
    assert "joints 2, 4 fit degrees only, others radians" in question
    assert found.mapping.position.unit == ("rad", "deg", "rad", "deg", "rad", "rad", "rad")


@pytest.mark.parametrize(("scale", "asked"), [(1.0, True), (57.3, False), (0.02, False)])
def test_a_column_in_radians_of_a_joint_that_gravity_does_not_tell_is_a_question(scale, asked):
    q = np.rad2deg(POSITION)
    q[:, 6] = scale * POSITION[:, 6]
    found = proposed(q=q, tau=TORQUE)
    assert found.mapping.position.unit == ("deg",)
    assert any("joints 7 hardly move in degrees" in x for x in found.mapping.undecided) == asked


@pytest.mark.parametrize("factor", [180 / np.pi, np.pi / 180], ids=["rad-deg", "deg-rad"])
def test_positions_that_go_on_in_another_unit_are_refused(factor):
    mixed = np.array(POSITION) if factor > 1 else np.rad2deg(POSITION)
    mixed[700:] *= factor
    with pytest.raises(RecordingError, match=r"jump by a factor of 57\.3 at row 700"):
        proposed(q=mixed, tau=TORQUE)


@pytest.mark.parametrize("joints", [1, 2, 3])
@pytest.mark.parametrize("size", [0.0, 1e-4, 1e-2])
def test_noise_about_zero_says_nothing_of_the_unit_and_is_no_question(tmp_path, joints, size):
    model = chain_of(tmp_path, joints)
    random = np.random.default_rng(joints)
    position = random.normal(0, 1, (2500, joints)) * size
    torque = model.gravity_torque(position) + random.normal(0, 0.05, position.shape)
    log = {"t": 0.004 * np.arange(2500), **numbered("q{}", position), **numbered("tau{}", torque)}
    found = propose(table_of(log), model)
    assert not [text for text in found.mapping.undecided if "deg" in text]
    assert found.taken[1].unit == "rad"
    assert "says nothing" in found.taken[1].why


DEG = 180 / np.pi
SMALL = 0.02 * POSITION  # [rad], of which the values are within the limits as degrees and radians


@pytest.mark.parametrize("scale", [1.0, DEG], ids=["rad", "deg"])
@pytest.mark.parametrize("named", ["dq{}_rad_s", "dq{}_deg_s"])
def test_velocities_in_a_stated_unit_say_which_positions_have(scale, named):
    velocity = 0.02 * VELOCITY * (DEG if "deg" in named else 1.0)
    log = {"t": TIME, **numbered("q{}", scale * SMALL), **numbered(named, velocity)}
    found = propose(table_of(log), arm())
    unit = "rad" if scale == 1.0 else "deg"
    assert (found.mapping.position.unit, found.mapping.undecided) == ((unit,), ())
    assert f"times their rate of change in {unit}" in found.taken[1].why


def test_velocities_in_no_stated_unit_or_of_something_else_leave_the_question():
    log = {"t": TIME, **numbered("q{}", SMALL)}
    for more in (numbered("dq{}", VELOCITY), numbered("dq{}_rad_s", 5 * VELOCITY)):
        assert "rad or deg" in propose(table_of(log | more), arm()).mapping.undecided[0]


def test_torques_and_velocities_that_contradict_each_other_are_a_question():
    log = {"t": TIME, **numbered("q{}", POSITION), **numbered("tau{}", TORQUE)}
    log |= numbered("dq{}_deg_s", VELOCITY)  # as if the positions were in degrees
    (question,) = propose(table_of(log), arm()).mapping.undecided
    assert (
        "the torques fit rad, but the velocities are 1 times their rate of change in deg"
        in question
    )


@pytest.mark.parametrize(("hertz", "asked"), [(2.0, False), (0.05, True)])
def test_a_motion_that_would_be_too_fast_in_radians_is_in_degrees(tmp_path, hertz, asked):
    q = 2 * np.sin(2 * np.pi * hertz * TIME[:, None] + np.arange(2))
    log = {"t": TIME, **numbered("q{}", q)}
    found = propose(table_of(log), chain_of(tmp_path, 2))
    assert bool(found.mapping.undecided) == asked
    if not asked:
        assert found.mapping.position.unit == ("deg",)
        assert "in rad, joint 1 would move at 23.5 of 2 rad/s" in found.taken[1].why


@pytest.mark.parametrize(("named", "gear"), [("tau{}_Nm", 1), ("tau{}_mNm", 1e3), ("tau{}", 1)])
def test_gravity_in_a_known_unit_is_too_much_for_a_small_motion_in_degrees(named, gear):
    torque = arm().gravity_torque(SMALL) + np.random.default_rng(0).normal(0, 1e-3, SMALL.shape)
    log = {"t": TIME, **numbered("q{}", SMALL), **numbered(named, gear * torque)}
    found = propose(table_of(log), arm())
    if named == "tau{}":  # which may be in any unit
        assert "rad or deg" in found.mapping.undecided[0]
    else:
        assert (found.mapping.position.unit, found.mapping.undecided) == (("rad",), ())


def test_a_torque_before_the_gear_does_not_make_degrees_of_radians():
    torque = arm().gravity_torque(SMALL) / 57 + np.random.default_rng(0).normal(
        0, 1e-5, SMALL.shape
    )
    log = {"t": TIME, **numbered("q{}", SMALL), **numbered("tau{}_Nm", torque)}
    assert "rad or deg" in " ".join(propose(table_of(log), arm()).mapping.undecided)


def test_a_small_pose_away_from_zero_is_a_question_still(tmp_path):
    model = chain_of(tmp_path, 2)
    random = np.random.default_rng(0)
    position = 0.05 + random.normal(0, 1e-4, (2500, 2))
    torque = random.normal(0, 0.05, position.shape)
    log = {"t": 0.004 * np.arange(2500), **numbered("q{}", position), **numbered("tau{}", torque)}
    assert any("rad or deg" in text for text in propose(table_of(log), model).mapping.undecided)


def test_measured_goes_before_commanded_and_derived():
    log = {"actual_q": POSITION, "target_q": POSITION + 0.01, "tau": TORQUE}
    found = proposed(**log, tau_ext=0.1 * TORQUE)
    assert found.mapping.position.columns[0] == "actual_q[0]"
    assert found.mapping.torque.columns[0] == "tau[0]"
    assert found.mapping.command.columns[0] == "target_q[0]"
    assert found.mapping.undecided == ()


@pytest.mark.parametrize(("scale", "unit"), [(1.0, "rad"), (180 / np.pi, "deg")])
def test_commands_are_in_the_unit_in_which_positions_follow_them(scale, unit):
    target = {"target_q": scale * POSITION + 0.01, "actual_q": POSITION}
    assert proposed(**target, tau=TORQUE).mapping.command.unit == (unit,)


@pytest.mark.parametrize(("scale", "unit"), [(1.0, "rad"), (180 / np.pi, "deg")])
def test_commands_that_are_badly_followed_are_in_their_unit_all_the_same(scale, unit):
    """Half a swing apart, positions lie as near to commands of nearly nothing."""
    led = {"target_q": -1.2 * scale * POSITION, "actual_q": POSITION}
    assert proposed(**led, tau=TORQUE).mapping.command.unit == (unit,)


def test_arrays_of_mujoco_are_known_by_their_names():
    arrays = {"qpos": 0.01 * POSITION, "qvel": 0.01 * VELOCITY, "qfrc_actuator": TORQUE}
    mapping = proposed(**arrays, qfrc_bias=2 * TORQUE, qacc=VELOCITY).mapping
    assert mapping.undecided == ()
    assert mapping.position.unit == ("rad",)
    assert mapping.torque.columns[0] == "qfrc_actuator[0]"


def test_arrays_of_a_whole_mujoco_model_have_each_joint_where_the_model_has_it(tmp_path):
    link = '<geom type="capsule" fromto="0 0 0 0 0 .3" size=".04" mass="2"/>'
    path = tmp_path / "cell.xml"
    path.write_text(
        '<mujoco><compiler angle="radian"/><worldbody>'
        f'<body name="crate" pos="2 0 0"><freejoint name="crate"/>{link}</body>'
        f'<body name="upper"><joint name="a" axis="0 1 0"/>{link}'
        f'<body name="lower" pos="0 0 .3"><joint name="b" axis="0 1 0"/>{link}'
        f'<body name="tip" pos="0 0 .3"><joint name="f" type="slide" axis="0 1 0"/>{link}'
        "</body></body></body></worldbody></mujoco>",
        encoding="utf-8",
    )
    robot = RobotModel.load(path)
    q, v = np.zeros((TIME.size, 10)), np.zeros((TIME.size, 9))
    q[:, 7:9], v[:, 6:8] = POSITION[:, :2], VELOCITY[:, :2]
    log = {"time": TIME, "qpos": q, "qvel": v, "qfrc_actuator": v}
    found = propose(table_of(log), robot).mapping
    assert found.position.columns == ("qpos[7]", "qpos[8]")
    assert found.velocity is not None
    assert found.velocity.columns == ("qvel[6]", "qvel[7]")
    assert found.torque is not None
    assert found.torque.columns == ("qfrc_actuator[6]", "qfrc_actuator[7]")
    narrow = propose(table_of(log | {"qpos": q[:, :9]}), robot).mapping
    assert any("are the first 2 meant?" in question for question in narrow.undecided)


def test_commands_make_up_for_torques():
    found = inspect({"t": TIME, "actual_q_rad": POSITION, "target_q_rad": POSITION + 0.01}, arm())
    assert found.questions == ()
    assert not found.recording.has_torque
    np.testing.assert_array_equal(found.recording.command, POSITION + 0.01)
    assert "no torque: commands and positions identify" in found.telemetry[-1]


@pytest.mark.parametrize(
    ("scale", "unit"), [(1.0, "rad/s"), (180 / np.pi, "deg/s")], ids=["rad", "deg"]
)
def test_commanded_velocities_make_up_for_torques_and_commanded_positions(scale, unit):
    told = 0.98 * np.concatenate([VELOCITY[5:], VELOCITY[-5:]])  # the arm follows a little later
    log = {"t": TIME, "actual_q_rad": POSITION, "actual_dq": VELOCITY, "target_dq": scale * told}
    found = inspect(log, arm())
    assert found.questions == ()
    assert not found.recording.has_torque
    assert found.recording.channels == ("command_velocity",) * 7
    np.testing.assert_allclose(found.recording.command, told, atol=1e-12)
    assert found.mapping.command_velocity.unit == (unit,)
    assert found.mapping.velocity.columns[0] == "actual_dq[0]"


def test_commanded_velocities_are_not_asked_for_beside_positions_or_torques():
    velocities = {"actual_q": POSITION, "target_dq": VELOCITY}
    for more in ({"target_q": POSITION + 0.01}, {"tau": TORQUE}):
        assert proposed(**velocities, **more).mapping.command_velocity is None


def test_commands_cost_no_row_that_has_a_torque():
    target = POSITION.copy()
    target[:9] = np.nan
    mapping = proposed(actual_q=POSITION, target_q=target, tau=TORQUE).mapping
    assert mapping.command is None
    assert "target_q[0]" in mapping.left_out


def test_motor_and_link_side_are_a_question():
    found = proposed(q=POSITION, theta=POSITION + 0.01, tau=TORQUE)
    assert found.mapping.undecided == (
        "position: q[0] … q[6] or theta[0] … theta[6]? both fit the names",
    )


def test_a_column_that_stands_twice_is_no_question():
    assert proposed(q=POSITION, theta=POSITION, tau=TORQUE).mapping.undecided == ()


def test_a_sensor_that_is_not_there_is_no_question():
    """Its columns are zero in every row."""
    mapping = proposed(q=POSITION, TorqueSensor=np.zeros_like(TORQUE), tau=TORQUE).mapping
    assert mapping.undecided == ()
    assert mapping.torque.columns == tuple(f"tau[{j}]" for j in range(7))


def test_torque_of_a_current_beside_that_of_a_sensor_is_a_question():
    (question,) = proposed(q=POSITION, tau=TORQUE, TorqueCur=1.1 * TORQUE).mapping.undecided
    assert "tau[0] … tau[6] or TorqueCur[0] … TorqueCur[6]" in question


def test_two_arms_are_a_question():
    left = numbered("left_q{}", POSITION) | numbered("left_tau{}", TORQUE)
    right = numbered("right_q{}", -POSITION) | numbered("right_tau{}", -TORQUE)
    questions = proposed(**left, **right).mapping.undecided
    assert [question.partition(":")[0] for question in questions] == ["position", "torque"]
    assert "left_q0 … left_q6 or right_q0 … right_q6" in questions[0]


def test_only_commanded_values_are_a_question():
    (question,) = proposed(q_cmd=POSITION, tau=TORQUE).mapping.undecided
    assert "only commanded values are named" in question
    (question,) = proposed(q=POSITION, tau_cmd=TORQUE).mapping.undecided
    assert question.endswith("name them under `command_torque:`, not `torque:`")


def test_currents_are_a_question_for_their_factor():
    (question,) = proposed(q=POSITION, current=TORQUE / 12).mapping.undecided
    assert "how many N m does one A make" in question


def test_what_weight_makes_of_currents_is_said_with_its_sign():
    constants = np.array([12, 12, 12, -9, 9, 5, 5])
    friction = 2.0 * np.sign(np.gradient(POSITION, axis=0))
    currents = (arm().gravity_torque(POSITION) + friction) / constants
    currents[:, 5] = np.random.default_rng(0).normal(size=len(TIME))  # of something else
    (question,) = proposed(q=POSITION, current=currents).mapping.undecided
    said = {
        int(joint): float(value) for value, joint in re.findall(r"(\S+) at joint(\d)", question)
    }
    assert said.keys() >= {2, 4}
    assert not said.keys() & {1, 6}  # a vertical axis, and what no weight explains
    for joint, value in said.items():
        assert value == pytest.approx(constants[joint - 1], rel=0.02)


def test_joints_come_by_name_in_any_order():
    order = [4, 2, 0, 6, 1, 3, 5]
    names = arm().joint_names
    log = {f"{names[j]}_pos": POSITION[:, j] for j in order}
    log |= {f"{names[j]}_effort": TORQUE[:, j] for j in reversed(order)}
    found = proposed(**log, finger_pos=TIME, finger_effort=TIME)
    columns = found.mapping.columns(table_of({"t": TIME, **log}), arm())
    np.testing.assert_array_equal(columns.position, POSITION)
    np.testing.assert_array_equal(columns.torque, TORQUE)
    assert found.mapping.left_out == ("finger_pos", "finger_effort")
    assert found.mapping.undecided == ()


def test_names_that_are_no_joints_of_the_robot_are_a_question():
    words = ("pan", "lift", "elbow", "roll", "wrist", "turn", "tip")
    log = {f"{word}.pos": POSITION[:, j] for j, word in enumerate(words)}
    questions = proposed(**log, tau=TORQUE).mapping.undecided
    assert len(questions) == 1
    assert "do not name joints of iiwa14" in questions[0]


@pytest.mark.parametrize("name", ["panda_joint{}", "fr3.joint{}", "robot.xarm.axis[{}]"])
def test_numbers_of_another_robots_joints_are_a_question_asked_once(name):
    log = numbered(f"position.{name}", POSITION, 1) | numbered(f"effort.{name}", TORQUE, 1)
    (question,) = proposed(**log).mapping.undecided
    other = next(word for word in ("panda", "fr", "xarm") if word in name)
    assert f"name {other}, which iiwa14 does not (its joints are joint1, " in question


@pytest.mark.parametrize(
    "name",
    ["q{}", "joint_{}_pos", "A{}", "state.joint{}_pos_raw", "axisQMsr_LBR_iiwa_14_R820_{}"],
)
def test_numbers_alone_and_the_robots_own_name_are_no_question(name):
    log = numbered(f"{name} [rad]", POSITION, 1)
    assert proposed(**log, tau=TORQUE).mapping.undecided == ()


def test_a_mapping_may_state_that_another_name_is_meant():
    log = numbered("panda_joint{}_pos", POSITION, 1) | numbered("panda_joint{}_tau", TORQUE, 1)
    found = proposed(**log).mapping
    with pytest.raises(ConfigError, match="name panda, which iiwa14 does not"):
        found.columns(table_of({"t": TIME, **log}), arm())
    stated = replace(found, undecided=()).columns(table_of({"t": TIME, **log}), arm())
    np.testing.assert_array_equal(stated.position, POSITION)


def test_missing_joints_are_named():
    log = {name: v for name, v in numbered("joint_{}_pos", POSITION, 1).items() if "5" not in name}
    with pytest.raises(RecordingError, match=r"no positions of the 7 joints of iiwa14: .* lacks"):
        proposed(**log, tau=TORQUE)


def test_a_column_that_cannot_be_read_is_named_among_the_missing():
    log = numbered("q{}", POSITION) | {"q3": np.full(TIME.size, np.nan)}
    with pytest.raises(RecordingError, match=r"lacks number 3, and q3 holds no number"):
        proposed(**log, tau=TORQUE)
    with pytest.raises(RecordingError, match=r"of shape \(7, 3000\), expected \(3000, 7\): a row"):
        proposed(q=POSITION.T, tau=TORQUE)


def test_values_that_are_not_finite_cost_their_rows_only():
    torque, position = TORQUE.copy(), POSITION.copy()
    torque[::7, 1], position[3::50, 2] = np.inf, np.nan
    found = proposed(q=np.rad2deg(position), tau=torque).mapping
    assert found.position.unit == ("deg",)
    assert found.torque.unit == ("N m",)
    position[::2, 0] = position[1::2, 1] = np.nan
    with pytest.raises(RecordingError, match="no row with a number in each of"):
        proposed(q=position, tau=torque)


@pytest.mark.parametrize("between", [False, True])
def test_columns_without_names_are_asked_as_time_positions_and_torques(between):
    parts = [1e3 * TIME, np.rad2deg(POSITION), np.rad2deg(VELOCITY), TORQUE]
    table = np.column_stack(parts if between else [*parts[:2], parts[3]])
    log = {f"column_{k + 1}": values for k, values in enumerate(table.T)}
    found = propose(table_of(log), arm()).mapping
    (question,) = found.undecided
    assert "time: column_1; position: column_2 … column_8; " in question
    answered = replace(found, undecided=()).columns(table_of(log), arm())
    np.testing.assert_allclose(answered.time, TIME, atol=1e-9)
    np.testing.assert_allclose(answered.position, POSITION, atol=1e-9)
    np.testing.assert_allclose(answered.torque, TORQUE)
    if between:
        np.testing.assert_allclose(answered.velocity, VELOCITY, atol=1e-9)


def test_columns_without_names_that_hold_no_torque_are_positions():
    table = np.column_stack([TIME, POSITION])
    log = {f"column_{k + 1}": values for k, values in enumerate(table.T)}
    asked = propose(table_of(log), arm()).mapping.undecided[0]
    assert "is it time: column_1; position: column_2 … column_8, in the order" in asked


def named(letters, **values):
    """Columns of joints under names that say nothing, with letters or numbers."""
    ends = "ABCDEFG" if letters else range(1, 8)
    return {f"{k}{x}": own[:, j] for k, own in values.items() for j, x in enumerate(ends)}


@pytest.mark.parametrize("letters", [True, False])
@pytest.mark.parametrize("scale", [1.0, 180 / np.pi])
def test_where_names_say_nothing_numbers_do(letters, scale):
    log = {"t": TIME, **named(letters, drv=TORQUE, ax=scale * POSITION, spd=scale * VELOCITY)}
    table = table_of(log)
    mapping = propose(table, arm()).mapping
    assert mapping.undecided[0].startswith(
        "columns: no name says what they are: is it position: ax"
    )
    found = replace(mapping, undecided=()).columns(table, arm())
    np.testing.assert_allclose(found.position, POSITION, atol=1e-9)
    np.testing.assert_allclose(found.velocity, VELOCITY, atol=1e-9)
    np.testing.assert_allclose(found.torque, TORQUE)


def test_torques_alone_may_have_names_that_say_nothing():
    log = {"t": TIME, **numbered("q{}_rad", POSITION), **named(True, noise=VELOCITY, drv=TORQUE)}
    mapping = propose(table_of(log), arm()).mapping
    assert mapping.torque.columns[0] == "drvA"
    assert "is it velocity: noiseA … noiseG; torque: drvA … drvG" in mapping.undecided[0]


@pytest.mark.parametrize("word", ["goal", "target", "cmd", "setpoint", "desired", "reference"])
def test_what_positions_follow_are_their_set_points_and_no_torque(word):
    late = np.roll(POSITION, 5, axis=0)
    log = {
        "t": TIME,
        **numbered("joint_{}.pos", late, 1),
        **numbered(f"joint_{{}}.{word}", POSITION, 1),
    }
    mapping = propose(table_of(log), arm()).mapping
    assert mapping.torque is None
    assert mapping.command.columns == tuple(f"joint_{j}.{word}" for j in range(1, 8))
    assert mapping.command.unit == mapping.position.unit == ("rad",)
    assert f"is it command: joint_1.{word}" in mapping.undecided[0]
    assert "the positions follow them" in mapping.undecided[0]


def test_commands_that_no_position_follows_are_no_set_points():
    log = {"t": TIME, **numbered("joint_{}.pos", POSITION, 1)}
    log |= numbered("joint_{}.goal", POSITION[::-1] ** 2, 1)
    assert propose(table_of(log), arm()).mapping.command is None


def test_columns_that_are_no_joint_of_the_arm_are_taken_for_nothing():
    random = np.random.default_rng(0).normal(size=(TIME.size, 7))
    log = {"t": TIME, **numbered("q{}_rad", POSITION), **numbered("tau{}", TORQUE)}
    mapping = propose(table_of({**log, **named(False, foo=random)}), arm()).mapping
    assert mapping.undecided == ()
    without = {"t": TIME, **numbered("q{}_rad", POSITION), **named(False, foo=random)}
    assert propose(table_of(without), arm()).mapping.torque is None


def test_a_gripper_in_percent_is_asked_about_with_its_range(tmp_path):
    model = chain_of(tmp_path, 2)
    path = tmp_path / "gripper.urdf"
    path.write_text(model.urdf.read_text().replace('name="j1"', 'name="gripper"'))
    q = np.column_stack([100 * np.sin(0.3 * TIME), 50 + 45 * np.sin(0.2 * TIME)])
    log = {"t": TIME, "observation.state.j0": q[:, 0], "observation.state.gripper": q[:, 1]}
    log |= {"action.j0": q[:, 0], "action.gripper": q[:, 1]}
    table = table_of(log)
    mapping = propose(table, RobotModel(path)).mapping
    (question,) = (x for x in mapping.undecided if "gripper" in x)
    assert "count a gripper from 0 to 100 % of its range" in question
    found = replace(mapping, undecided=()).columns(table, RobotModel(path))
    np.testing.assert_allclose(found.position[:, 1], 0.06 * q[:, 1] - 3.0)  # from -3 to 3 rad
    np.testing.assert_allclose(found.command, found.position)
    np.testing.assert_allclose(found.position[:, 0], np.deg2rad(q[:, 0]))


def test_a_time_that_does_not_go_forward_is_named():
    log = {"t_ms": -TIME, "q": POSITION, "tau": TORQUE}
    (question,) = propose(table_of(log), arm()).mapping.undecided
    assert "t_ms does not go forward" in question


def test_more_joints_than_the_robot_has_are_a_question():
    wide = np.column_stack([POSITION, TIME])
    questions = proposed(q=wide, tau=TORQUE).mapping.undecided
    assert questions == (
        "position: q[0] … q[6] has columns for more than 7 joints (q[7] beyond): are the first 7 "
        "meant?",
    )


@pytest.mark.slow("proposes for 4000 columns")
def test_an_array_with_rows_and_columns_exchanged_makes_short_questions():
    rows = 2000
    on_its_side = np.random.default_rng(0).normal(size=(7, rows))
    questions = proposed(q=on_its_side, tau=on_its_side).mapping.undecided
    assert any(f"and {rows - 7 - 8} more beyond" in question for question in questions)
    assert max(map(len, questions)) < 400


@pytest.mark.parametrize(("scale", "unit"), [(1e3, "mN m"), (1e2, "N cm"), (1.0, "N m")])
def test_torque_in_another_unit_than_newton_metres_is_a_question_that_names_it(scale, unit):
    mapping = proposed(q=POSITION, tau=scale * TORQUE).mapping
    assert mapping.torque.unit == (unit,)
    assert any(f"is it in {unit}, or a current" in q for q in mapping.undecided) == (scale > 1)


@pytest.mark.parametrize(("scale", "asked"), [(1e-4, True), (1.0, False), (1e3, True)])
def test_torques_of_which_gravity_says_nothing_are_held_against_the_drives(tmp_path, scale, asked):
    path = tmp_path / "table.urdf"
    model = chain_of(tmp_path, 2)
    path.write_text(model.urdf.read_text().replace('xyz="0 1 0"', 'xyz="0 0 1"'))
    torque = scale * 20 * np.sin(TIME[:, None] + np.arange(2))
    log = {"t": TIME, **numbered("q{}", POSITION[:, :2]), **numbered("tau{}", torque)}
    questions = propose(table_of(log), RobotModel(path)).mapping.undecided
    assert any("what the drives of the description can do" in q for q in questions) == asked


def test_currents_of_held_poses_that_are_named_as_torques_are_a_question():
    """Gravity makes all of them, which no load makes a fifth of what it is."""
    poses = np.random.default_rng(1).uniform(-1, 1, (30, 7)).repeat(100, axis=0)
    torque = arm().gravity_torque(poses) + np.random.default_rng(0).normal(0, 0.05, poses.shape)
    log = {"t": 0.01 * np.arange(len(poses)), **numbered("q{}", poses)}
    for gain, asked in ((np.array([8, 9, 5, 6, 3, 2, 1.5]), True), (1.0, False), (0.6, False)):
        mapping = propose(table_of(log | numbered("tau{}", torque / gain)), arm()).mapping
        assert any("or a current (`unit: A`)" in q for q in mapping.undecided) == asked


def test_a_slide_with_a_force_beside_a_joint_with_a_torque_is_one_arm(tmp_path):
    path = tmp_path / "lift.urdf"
    text = chain_of(tmp_path, 2).urdf.read_text().replace('name="j0"', 'name="lift"')
    text = text.replace('type="revolute"', 'type="prismatic"', 1)
    path.write_text(text.replace('name="j1"', 'name="elbow"'))
    log = {
        "t": TIME,
        "lift position [mm]": 1e3 * POSITION[:, 0],
        "elbow position [deg]": np.rad2deg(POSITION[:, 1]),
        "lift force [kN]": 1e-3 * TORQUE[:, 0],
        "elbow torque [Nm]": TORQUE[:, 1],
    }
    table, model = table_of(log), RobotModel(path)
    found = propose(table, model)
    assert found.mapping.undecided == ()
    read = found.mapping.columns(table, model)
    np.testing.assert_allclose(read.position, POSITION[:, :2])
    np.testing.assert_allclose(read.torque, TORQUE[:, :2])
    log["lift torque [Nm]"] = TORQUE[:, 2]  # which of the two is it?
    assert propose(table_of(log), model).model.joint_names == ("lift", "elbow")


def test_measured_currents_beside_commanded_torques_are_named():
    log = {"t": TIME, **numbered("actual_q_{}", POSITION)}
    log |= numbered("target_moment_{}", TORQUE) | numbered("actual_current_{}", TORQUE / 9)
    (question,) = propose(table_of(log), arm()).mapping.undecided
    assert "only commanded values are named (target_moment_0" in question
    assert "actual_current_0 … actual_current_6 (measured) are currents" in question


def test_velocities_are_no_question_where_there_is_no_time():
    mapping = propose(table_of(numbered("q{}", POSITION) | numbered("qd{}", VELOCITY)), arm())
    assert [q for q in mapping.mapping.undecided if "velocities" in q] == []


@pytest.mark.parametrize(("factor", "asked"), [(1.1, True), (0.95, True), (1.01, False)])
def test_a_small_factor_is_asked_for_where_all_velocities_have_it(factor, asked):
    log = {"t": TIME, **numbered("q{}", POSITION), **numbered("tau{}", TORQUE)}
    alike = propose(table_of(log | numbered("dq{}", factor * VELOCITY)), arm()).mapping
    assert any(q.startswith("time:") for q in alike.undecided) == asked
    apart = VELOCITY * (1 + (factor - 1) * np.linspace(0.9, 1.1, 7))  # as a filter makes it
    table = table_of(log | numbered("dq{}", apart))
    assert not any(q.startswith("time:") for q in propose(table, arm()).mapping.undecided)


@pytest.mark.parametrize("factor", [0.5, 2.0])
@pytest.mark.parametrize(
    ("name", "scale"), [("dq{}", 1.0), ("dq{}_rad_s", 1.0), ("dq{}", 180 / np.pi)]
)
def test_a_time_that_runs_at_another_speed_is_asked_for_once(factor, name, scale):
    log = {"t": TIME / factor, **numbered("q{}", POSITION), **numbered(name, scale * VELOCITY)}
    table = table_of(log | numbered("tau{}", TORQUE))
    mapping = propose(table, arm()).mapping
    (question,) = (q for q in mapping.undecided if q.startswith("time:"))
    assert f"do {factor:.3g} s pass in one of the log (`factor: {factor:.3g}`" in question
    answered = replace(mapping, time=replace(mapping.time, factor=factor), undecided=())
    np.testing.assert_allclose(answered.columns(table, arm()).time, TIME, atol=1e-9)
    np.testing.assert_allclose(answered.columns(table, arm()).velocity, VELOCITY, atol=1e-9)


def test_velocities_of_one_joint_that_are_off_are_no_question_for_the_time():
    off = VELOCITY * [1, 1, 1, 1, 1, 1, 2.0]
    log = {"t": TIME, **numbered("q{}", POSITION), **numbered("dq{}", off)}
    mapping = propose(table_of(log | numbered("tau{}", TORQUE)), arm()).mapping
    assert not [question for question in mapping.undecided if question.startswith("time:")]


def test_poses_held_one_after_the_other_are_no_motion_in_degrees():
    """As of a calibration at 125 Hz, three rows in each pose, with currents."""
    poses = np.random.default_rng(1).uniform(-2, 2, (300, 7)).repeat(3, axis=0)
    currents = arm().gravity_torque(poses) / 10 + np.sin(np.arange(900)[:, None] + np.arange(7))
    log = {"t": 0.008 * np.arange(900), **numbered("q{}", poses)}
    mapping = propose(table_of(log | numbered("current{}", currents)), arm()).mapping
    assert mapping.position.unit == ("rad",)


@pytest.mark.parametrize(
    ("name", "values", "unit"),
    [
        ("time", TIME, "s"),
        ("tick_ms", 1e3 * TIME, "ms"),
        ("stamp", 1e9 * TIME, "ns"),
        ("clock", 1e6 * TIME, "us"),
        ("timestamp", 1e3 * TIME, "ms"),
        ("stamp", (1.7e18 + 1e9 * TIME).astype(np.int64), "ns"),
    ],
)
def test_time_has_its_unit_from_its_steps(name, values, unit):
    log = {name: values, "q": POSITION, "tau": TORQUE}
    mapping = propose(table_of(log), arm()).mapping
    assert (mapping.time.columns, mapping.time.unit) == ((name,), (unit,))
    assert mapping.undecided == ()
    read = mapping.columns(table_of(log), arm()).time
    np.testing.assert_allclose(read, TIME, atol=1e-6)


@pytest.mark.parametrize(
    ("first", "then"), [(1.0, 1e3), (1e9, 1e3), (1e3, 1e9)], ids=["s-ms", "ns-ms", "ms-ns"]
)
def test_a_time_that_goes_on_in_another_unit_is_refused(first, then):
    mixed = np.concatenate([first * TIME[: TIME.size // 2], then * TIME[TIME.size // 2 :]])
    with pytest.raises(RecordingError, match=r"stamp goes in steps of .* expected a time in one"):
        propose(table_of({"stamp": mixed, "q": POSITION, "tau": TORQUE}), arm())


def test_a_pause_and_a_slower_clock_are_no_other_unit():
    slower = np.concatenate([TIME[:500:2], TIME[499] + 60.0 + 3 * TIME[:500]])
    log = {"stamp": slower, "q": POSITION[: slower.size], "tau": TORQUE[: slower.size]}
    assert propose(table_of(log), arm()).mapping.time.unit == ("s",)


def test_seconds_and_nanoseconds_in_two_columns():
    stamps = (1_700_000_000 * 10**9 + np.round(1e9 * TIME)).astype(np.int64)
    log = {"ZeitinSec": stamps // 10**9, "ZeitinNanoSec": stamps % 10**9}
    log |= {"axisQMsr": POSITION, "axisTauMsr": TORQUE}
    mapping = propose(table_of(log), arm()).mapping
    np.testing.assert_allclose(mapping.columns(table_of(log), arm()).time, TIME, atol=1e-8)


def test_a_name_and_steps_that_disagree_are_a_question():
    questions = propose(table_of({"t_ms": TIME, "q": POSITION, "tau": TORQUE}), arm())
    assert "the name says ms" in questions.mapping.undecided[0]


def test_no_time_is_a_question():
    (question,) = propose(table_of({"q": POSITION, "tau": TORQUE}), arm()).mapping.undecided
    assert question.startswith("time: none was found")
