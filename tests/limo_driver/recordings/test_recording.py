"""Recordings: what is left out and why, what is refused, and parts of one."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from recorded_columns import RATE, make_columns, write

from limo_driver.errors import RecordingError, ShapeError
from limo_driver.model import RobotModel
from limo_driver.recordings.gate.doubts import LeftOut
from limo_driver.recordings.recording import Recording


def reasons(recording):
    return {item.reason: item.rows for item in recording.left_out}


def test_arrays_are_read_only():
    recording = Recording(np.arange(50) / RATE, np.zeros((50, 2)), np.zeros((50, 2)))
    with pytest.raises(ValueError, match="read-only"):
        recording.position[0] = 1.0


def test_wrong_shapes_are_refused():
    with pytest.raises(ShapeError, match=r"torque has shape \(50, 3\), expected \(50, 2\)"):
        Recording(np.arange(50) / RATE, np.zeros((50, 2)), np.zeros((50, 3)))


@pytest.mark.parametrize(
    ("time", "said"),
    [
        (np.arange(50) * 10_000_000, "time holds int64 values, expected seconds as real numbers"),
        (np.arange("2026-01-01", "2026-02-20", dtype="M8[D]"), "time holds datetime64"),
        (np.arange(50.0)[::-1], "time does not increase at row 1, from 49 s to 48 s"),
        (np.zeros(50), "time does not increase at row 1, from 0 s to 0 s"),
        (np.r_[np.nan, np.arange(49.0)], "is not finite in 1 of 50 rows"),
    ],
)
def test_nonsense_is_refused_without_a_door_as_well(time, said):
    with pytest.raises(RecordingError, match=said):
        Recording(time, np.zeros((50, 2)), np.zeros((50, 2)))


def test_values_that_no_filter_takes_are_refused():
    t, holes = np.arange(50) / RATE, np.zeros((50, 2))
    holes[7, 1] = np.nan
    for arrays in ((holes, np.zeros((50, 2))), (np.zeros((50, 2)), holes)):
        with pytest.raises(RecordingError, match="is not finite in 1 of 50 rows") as found:
            Recording(t, *arrays)
        assert found.value.rows == (7,)
    with pytest.raises(ShapeError, match=r"rows has shape \(3,\), expected \(50,\)"):
        Recording(t, np.zeros((50, 2)), np.zeros((50, 2)), rows=np.arange(3))
    with pytest.raises(ShapeError, match=r"torque_resolution has shape \(3,\), expected \(2,\)"):
        Recording(t, np.zeros((50, 2)), np.zeros((50, 2)), torque_resolution=np.zeros(3))


def test_nan_and_corrupt_rows_are_left_out_by_name(tmp_path):
    columns = make_columns()
    columns["torque_2"][17] = np.nan
    columns["position_1"][100] = 1e17
    columns["time"][200] = columns["time"][199]
    columns["position_3"][300] += 0.9
    recording = Recording.load(write(columns, tmp_path / "a.parquet"))
    assert reasons(recording) == {
        "a value is missing or not finite": (17,),
        "a value is impossible": (100,),
        "the time repeats that of the row before": (200,),
        "a spike that no motion makes": (300,),
    }
    assert len(recording) == 396
    assert not set(recording.rows) & {17, 100, 200, 300}


def test_one_wild_time_costs_one_row(tmp_path):
    for wild in (1e9, -1e9, 2.5):
        columns = make_columns()
        columns["time"][150] = wild
        recording = Recording.load(write(columns, tmp_path / "a.parquet"))
        assert [row for item in recording.left_out for row in item.rows] == [150]


def test_gap_splits_the_recording_and_is_told(tmp_path):
    columns = make_columns()
    keep = np.r_[0:150, 220:400]
    columns = {name: values[keep] for name, values in columns.items()}
    recording = Recording.load(write(columns, tmp_path / "a.parquet"))
    assert recording.segments == (slice(0, 150), slice(150, 330))
    assert any("1 gap; the longest, 0.71 s, after 1.49 s" in text for text in recording.warnings)


def test_few_rows_between_gaps_are_left_out(tmp_path):
    columns = make_columns()
    keep = np.r_[0:150, 200:204, 260:400]
    columns = {name: values[keep] for name, values in columns.items()}
    recording = Recording.load(write(columns, tmp_path / "a.parquet"))
    assert reasons(recording) == {"fewer than 10 rows between gaps": (150, 151, 152, 153)}


def test_still_joints_are_told_but_kept(tmp_path):
    columns = make_columns()
    columns["position_1"][:] = 0.4
    recording = Recording.load(write(columns, tmp_path / "a.parquet"))
    assert len(recording) == 400
    assert any(text.startswith("joint 1 never moves") for text in recording.warnings)


def test_rows_with_a_held_position_are_left_out_whenever_it_is_held(tmp_path):
    columns = make_columns()
    held = (range(100, 125), range(250, 262))
    for rows in held:
        columns["position_2"][list(rows)] = columns["position_2"][rows[0]]
    recording = Recording.load(write(columns, tmp_path / "a.parquet"))
    assert reasons(recording) == {
        "position_2 repeats a value while the joint moves": tuple(
            r for rows in held for r in rows[1:]
        )
    }


def noisy_columns(T=4000):
    """Torque has noise; a joint swings slowly enough to reach a limit for many samples."""
    columns = make_columns(T)
    random = np.random.default_rng(0)
    for j in (1, 2, 3):
        columns[f"torque_{j}"] += np.round(0.05 * random.standard_normal(T), 3)
    return columns


def test_rows_with_a_saturated_torque_are_left_out(tmp_path):
    columns = noisy_columns()
    free = columns["torque_2"]
    columns["torque_2"] = np.minimum(free, 5.0)
    recording = Recording.load(write(columns, tmp_path / "a.parquet"))
    left_out = reasons(recording)
    clipped = set(np.flatnonzero(free >= 5.0).tolist())
    assert set(left_out.pop("torque_2 is saturated or repeats a value in motion")) >= clipped - {
        row for rows in left_out.values() for row in rows
    }
    assert set(left_out) <= {"less than 0.2 s between gaps"}
    assert recording.torque[:, 1].max() < 5.0
    assert len(recording) > 1500


def test_rows_with_a_held_torque_are_left_out(tmp_path):
    columns = noisy_columns()
    columns["torque_3"][1000:1200] = columns["torque_3"][1000]
    recording = Recording.load(write(columns, tmp_path / "a.parquet"))
    assert reasons(recording) == {
        "torque_3 is saturated or repeats a value in motion": tuple(range(1000, 1200))
    }


def test_by_joint_a_held_torque_costs_no_row_of_the_others(tmp_path):
    columns = noisy_columns()
    columns["torque_3"][1000:1200] = columns["torque_3"][1000]
    columns["torque_1"][300:302] = np.nan
    recording = Recording.load(write(columns, tmp_path / "a.parquet"))
    every = recording.by_joint()
    assert replace(recording, source="elsewhere").by_joint() is every
    assert len(recording) == len(every) - 202
    assert every.unmeasured.sum(axis=0).tolist() == [2, 0, 200]
    assert every.unmeasured[1000:1200, 2].all()
    assert every.unmeasured[300:302, 0].all()
    assert np.isfinite(every.torque).all()
    told = "torque_3 is missing, saturated or held in 200 rows; nothing is said of that joint there"
    assert told in every.warnings
    part = every[900:1100]
    assert part.unmeasured.sum(axis=0).tolist() == [0, 0, 100]


def test_by_joint_a_recording_without_such_rows_and_any_cut_are_themselves(tmp_path):
    columns = noisy_columns()
    whole = Recording.load(write(columns, tmp_path / "a.parquet"))
    assert whole.by_joint() is whole
    columns["torque_3"][1000:1200] = columns["torque_3"][1000]
    part = Recording.load(write(columns, tmp_path / "b.parquet"))[:500]
    assert part.by_joint() is part


def test_a_joint_without_any_torque_is_told_and_kept_as_zero(tmp_path):
    columns = noisy_columns()
    columns["torque_2"] = np.full(len(columns["torque_2"]), np.nan)
    recording = Recording.load(write(columns, tmp_path / "a.parquet"))
    assert "torque_2 is never measured; it is kept as 0" in recording.warnings
    assert not recording.torque[:, 1].any()


def test_a_torque_that_is_one_value_in_most_of_a_motion_is_told_and_kept_as_zero(tmp_path):
    """As the current of a drive that wakes above some load, or a sensor that hangs at its limit."""
    columns = noisy_columns()
    whole = columns["torque_2"].copy()
    columns["torque_2"] = np.where(np.abs(whole - 1.0) < 4.5, 0.0, whole)
    recording = Recording.load(write(columns, tmp_path / "a.parquet"))
    (told,) = [said for said in recording.warnings if said.startswith("torque_2")]
    assert told.endswith(
        "of the rows in which its joint moves, and measures nothing; it is kept as 0"
    )
    assert "torque_2 is 0 in 7" in told
    assert not recording.torque[:, 1].any()
    assert recording.left_out == ()  # it costs the other joints nothing
    columns["torque_2"] = np.where(np.abs(whole - 1.0) < 2.0, 0.0, whole)  # a quarter of the rows
    part = Recording.load(write(columns, tmp_path / "b.parquet"))
    assert part.torque[:, 1].any()


def mostly_zero():
    columns = noisy_columns()
    values = columns["torque_2"]
    return columns | {"torque_2": np.where(np.abs(values - 1.0) < 4.5, 0.0, values)}


def test_one_row_out_of_time_does_not_hide_that_a_torque_measures_nothing(tmp_path):
    columns = mostly_zero()
    columns["time"][1000] = columns["time"][999]
    recording = Recording.load(write(columns, tmp_path / "a.parquet"))
    assert not recording.torque[:, 1].any()
    assert len(recording) > 3900


def coarse(middle, T=4000):
    random = np.random.default_rng(1)
    return middle + 0.5 * random.choice([-1, 0, 1], T, p=[0.02, 0.96, 0.02])


def flicker(T=4000):
    return 1.5e-3 * np.random.default_rng(2).integers(0, 2, T)


@pytest.mark.parametrize(
    "change",
    [
        # dry friction of a joint that turns one way, by a coarse sensor
        lambda c: c | {"position_2": 0.2 * c["time"], "torque_2": coarse(2.5)},
        # a joint that rests between two steps of its encoder
        lambda c: c | {"position_2": flicker(), "torque_2": coarse(0.0)},
    ],
)
def test_torques_that_seldom_change_are_measurements_where_they_may(tmp_path, change):
    recording = Recording.load(write(change(noisy_columns()), tmp_path / "a.parquet"))
    assert not any("measures nothing" in told for told in recording.warnings)


def test_a_file_says_again_that_a_torque_was_not_measured(tmp_path):
    recording = Recording.load(write(mostly_zero(), tmp_path / "a.parquet"))
    recording.save(tmp_path / "b.parquet")
    again = Recording.load(tmp_path / "b.parquet")
    assert "torque_2 is never measured; it is kept as 0" in again.warnings
    np.testing.assert_array_equal(again.torque, recording.torque)


@pytest.mark.parametrize(
    "change",
    [
        lambda c: c | {"torque_2": np.round(c["torque_2"], 0)},  # coarser than its noise
        lambda c: c | {"torque_2": np.repeat(c["torque_2"][::20], 20)},  # slower than the log
        lambda c: c | {"torque_2": np.sign(np.gradient(c["position_2"]))},  # dry friction, computed
        lambda c: c | {"torque_2": 0 * c["torque_2"] + 1.0, "position_2": 0 * c["position_2"]},
    ],
)
def test_torques_that_repeat_values_by_their_nature_are_kept(tmp_path, change):
    recording = Recording.load(write(change(noisy_columns()), tmp_path / "a.parquet"))
    assert recording.left_out == ()


def refuse(change, message, tmp_path, T=400):
    columns = make_columns(T)
    path = write(change(columns) or columns, tmp_path / "bad.parquet")
    with pytest.raises(RecordingError, match=message) as caught:
        Recording.load(path)
    assert str(path) in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda c: {k: v for k, v in c.items() if k != "time"}, "lacks time;"),
        (lambda c: {k: v for k, v in c.items() if k != "position_2"}, "lacks position_2;"),
        (lambda c: {k: v for k, v in c.items() if "position" not in k}, "lacks position_1, pos"),
        (lambda c: {k.replace("n_2", "n_" + 5000 * "9"): c[k] for k in c}, "lacks position_2;"),
        (
            lambda c: c | {"time": c["time"] * 1e3},
            "sampled at 0.1 Hz.*is the time in millis",
        ),
        (lambda c: c | {"time": c["time"] % 2.0}, "runs backwards at row 200"),
        (lambda c: c | {"time": c["time"][::-1]}, "runs backwards in 399 of 400 rows, at row 1"),
        (lambda c: c | {"torque_1": c["torque_1"] * 1e7}, "torque_1 is beyond ±1e\\+06.*N mm"),
        (
            lambda c: c | {f"torque_{j}": np.full(400, np.nan) for j in (1, 2, 3)},
            "has 0 usable rows of 400.*; no number in torque_1, torque_2, torque_3",
        ),
        (
            lambda c: c | {"position_2": np.full(400, np.nan)},
            "has 0 usable rows of 400.*; no number in position_2",
        ),
        (lambda c: c | {"torque_1": [str(v) for v in c["torque_1"]]}, "torque_1 holds string"),
        (lambda c: {k: v[:15] for k, v in c.items()}, "has 15 usable rows of 15"),
        (lambda c: {k: v[:30] for k, v in c.items()}, "lasts 0.29 s, expected at least 0.5 s"),
    ],
)
def test_unusable_files_are_refused_with_a_reason(change, message, tmp_path):
    refuse(change, message, tmp_path)


def test_many_turns_are_told_and_refused_of_a_joint_that_does_not_turn(tmp_path):
    columns = make_columns(400)
    columns["position_2"] = np.degrees(columns["position_2"])
    reach = np.abs(columns["position_2"]).max()
    recording = Recording.load(write(columns, tmp_path / "degrees.parquet"))
    told = [warning for warning in recording.warnings if "position_2 reaches" in warning]
    assert told == [
        f"position_2 reaches {reach:.4g} rad, {reach / 2 / np.pi:.3g} turns; is it in degrees?"
    ]
    with pytest.raises(
        RecordingError, match=r"position_2 spans .*is it in degrees or normalised, as -100 to 100"
    ):
        recording.check_robot(arm_of(recording.n, "revolute", tmp_path))
    recording.check_robot(arm_of(recording.n, "continuous", tmp_path))


def arm_of(n, joint, tmp_path):
    """Return an arm of n joints of a kind, each on the one before."""
    links = "".join(
        f'<link name="link{k}"><inertial><origin xyz="0 0 0.1"/><mass value="1"/>'
        '<inertia ixx="0.1" iyy="0.1" izz="0.1" ixy="0" ixz="0" iyz="0"/></inertial></link>'
        f'<joint name="joint{k}" type="{joint}"><parent link="link{k - 1}"/><child link="link{k}"/>'
        '<axis xyz="0 1 0"/><limit lower="-3" upper="3" velocity="2" effort="50"/></joint>'
        for k in range(1, n + 1)
    )
    path = tmp_path / f"{joint}.urdf"
    path.write_text(f'<robot name="{joint}"><link name="link0"/>{links}</robot>')
    return RobotModel.load(path)


def test_small_angles_in_degrees_show_against_the_velocity(tmp_path):
    def in_degrees(columns):
        for j in (1, 2, 3):
            columns[f"velocity_{j}"] = np.gradient(columns[f"position_{j}"], 1 / RATE) / 10
            columns[f"position_{j}"] = np.degrees(columns[f"position_{j}"] / 10)

    refuse(in_degrees, r"57\.3 times as fast as the velocities", tmp_path)


def test_a_position_that_stands_while_its_velocity_moves_is_refused(tmp_path):
    def stuck(columns):
        columns["velocity_2"] = np.gradient(columns["position_2"], 1 / RATE)
        for j in (1, 3):
            columns[f"velocity_{j}"] = np.gradient(columns[f"position_{j}"], 1 / RATE)
        columns["position_2"] = np.full(400, 0.3)

    refuse(stuck, r"position_2 never changes, but velocity_2 .* swing over 2(\.\d)? rad", tmp_path)


@pytest.mark.parametrize("factor", [180 / np.pi, -1.0, -np.pi / 180 * 0.5, 0.0])
def test_velocities_of_other_units_or_sign_are_told_but_not_used(tmp_path, factor):
    columns = make_columns()
    for j in (1, 2, 3):
        scale = factor if j == 2 else 1.0
        columns[f"velocity_{j}"] = scale * np.gradient(columns[f"position_{j}"], 1 / RATE)
    recording = Recording.load(write(columns, tmp_path / "a.parquet"))
    (warning,) = recording.warnings
    said = re.fullmatch(
        r"velocity_2 is (\S+) times the rate of change of position_2; it is not used", warning
    )
    assert float(said[1]) == pytest.approx(factor, rel=0.02, abs=1e-9)


def test_noisy_velocities_with_holes_of_joints_that_hardly_move_are_no_news():
    random = np.random.default_rng(0)
    t = np.arange(4000) / 1000.0
    position = np.array([0.5, 0.004]) * np.sin(t)[:, None]
    velocity = np.array([0.5, 0.004]) * np.cos(t)[:, None] + 0.2 * random.standard_normal((4000, 2))
    velocity[::50] = np.nan
    position += 1e-4 * random.standard_normal(position.shape)
    recording = Recording.from_arrays(t, position, position, velocity)
    assert recording.warnings == ("velocity is missing in 80 rows",)


def test_lists_are_read_as_arrays():
    columns = make_columns()
    position = [[row] for row in columns["position_1"]]
    recording = Recording.from_arrays(columns["time"].tolist(), position, position)
    np.testing.assert_array_equal(recording.position[:, 0], columns["position_1"])


@pytest.mark.parametrize(
    ("name", "values", "error", "message"),
    [
        ("time", np.zeros(49), ShapeError, r"time has shape \(49,\), expected \(50,\)"),
        ("time", np.zeros((50, 1)), ShapeError, r"time has shape \(50, 1\)"),
        ("time", None, ShapeError, r"time has shape \(\)"),
        ("position", np.zeros(50), ShapeError, r"position has shape \(50,\), expected \(T, n\)"),
        ("position", np.zeros((50, 0)), ShapeError, r"position has shape \(50, 0\)"),
        (
            "torque",
            np.zeros((50, 3)),
            ShapeError,
            r"torque has shape \(50, 3\), expected \(50, 2\)",
        ),
        ("velocity", np.zeros(50), ShapeError, r"velocity has shape \(50,\)"),
        ("extras", {"temperature": [1.0]}, ShapeError, r"temperature has shape \(1,\)"),
        ("torque", [[1.0, 2.0], [1.0]], RecordingError, "torque is no array of real numbers"),
        ("torque", "high", RecordingError, "torque is no array of real numbers"),
    ],
)
def test_arrays_of_other_shapes_are_refused(name, values, error, message):
    arrays = {
        "time": np.arange(50) / RATE,
        "position": np.zeros((50, 2)),
        "torque": np.zeros((50, 2)),
    }
    with pytest.raises(error, match=message):
        Recording.from_arrays(**arrays | {name: values})


def test_rows_left_out_are_named_in_stretches():
    assert str(LeftOut("is odd", (4,))) == "1 row left out: is odd (row 4)"
    assert str(LeftOut("is odd", (1, 2, 3, 7))) == "4 rows left out: is odd (rows 1-3, 7)"
    assert str(LeftOut("is odd", tuple(range(0, 60, 2)))).endswith("22 and 18 more stretches)")


def test_slices_and_masks_select_samples():
    columns = make_columns()
    stacked = [
        np.stack([columns[f"{q}_{j}"] for j in (1, 2, 3)], 1) for q in ("position", "torque")
    ]
    recording = Recording.from_arrays(columns["time"], *stacked)
    part = recording[100:200]
    assert len(part) == 100
    assert part.rows[0] == 100
    mask = np.ones(400, dtype=bool)
    mask[50:120] = False
    assert recording[mask].segments == (slice(0, 50), slice(50, 330))


def test_recording_of_another_robot_is_refused(tmp_path):
    model = RobotModel.load("iiwa14")
    recording = Recording.load(write(make_columns(n=6), tmp_path / "six.parquet"))
    with pytest.raises(RecordingError, match=r"has 6 joints, but iiwa14 has 7$"):
        recording.check_robot(model)
    more = Recording.load(write(make_columns(n=8), tmp_path / "eight.parquet"))
    with pytest.raises(RecordingError, match="but iiwa14 has 7; is joint 8 a gripper"):
        more.check_robot(model)
    columns = make_columns(n=7)
    columns["position_4"] *= 4.0
    recording = Recording.load(write(columns, tmp_path / "far.parquet"))
    with pytest.raises(RecordingError, match=r"position_4 spans -4 to 4 rad, but joint 4"):
        recording.check_robot(model)


BODY = """<inertial><mass value="1"/>
    <inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial>"""
ARM = f"""<robot name="arm">
  <link name="base"/><link name="upper">{BODY}</link><link name="finger">{BODY}</link>
  <joint name="shoulder" type="revolute"><parent link="base"/><child link="upper"/>
    <axis xyz="0 0 1"/><limit lower="-1" upper="1" effort="9" velocity="2"/></joint>
  <joint name="gripper" type="revolute"><parent link="upper"/><child link="finger"/>
    <axis xyz="0 0 1"/><limit lower="-1" upper="1" effort="9" velocity="2"/></joint>
</robot>"""


def test_a_recording_of_fewer_joints_is_told_how_to_lock_the_others(tmp_path):
    file = tmp_path / "arm.urdf"
    file.write_text(ARM)
    recording = Recording(np.arange(50) / RATE, np.zeros((50, 1)), np.zeros((50, 1)))
    with pytest.raises(RecordingError, match=r"has 1 joints, but .*arm\.urdf has 2; ") as found:
        recording.check_robot(RobotModel.load(file))
    offered = re.search("the robot is '(.*)'", str(found.value)).group(1)
    assert offered == f"{file}#gripper=0"
    recording.check_robot(RobotModel.load(offered))


@pytest.mark.parametrize("factor", [1e3, 1e4])
def test_torques_beyond_what_the_drives_can_do_are_of_another_unit(factor):
    t = np.arange(100) / RATE
    model = RobotModel.load("iiwa14")
    torque = np.tile(0.3 * model.limits.torque, (100, 1))
    Recording(t, np.zeros((100, 7)), torque, source="run").check_robot(model)
    torque[:, 2] *= factor
    with pytest.raises(
        RecordingError, match=r"^run: torque_3 is .* N m in the median, [\d.e+]+ times"
    ):
        Recording(t, np.zeros((100, 7)), torque, source="run").check_robot(model)


def test_torques_of_an_arm_of_a_tonne_are_read(tmp_path):
    columns = make_columns()
    columns["torque_1"] *= 5e4
    recording = Recording.load(write(columns, tmp_path / "large.parquet"))
    assert np.abs(recording.torque[:, 0]).max() > 1e4
    assert recording.left_out == ()


def test_recording_that_names_another_robot_is_refused():
    t = np.arange(100) / RATE
    arrays = t, np.zeros((100, 7)), np.zeros((100, 7))
    model = RobotModel.load("iiwa14")
    for name in ("", "iiwa14", "/elsewhere/iiwa14.urdf"):
        Recording(*arrays, robot=name).check_robot(model)
    with pytest.raises(RecordingError, match=r"^run: is of robot arms/panda.urdf, expected iiwa14"):
        Recording(*arrays, source="run", robot="arms/panda.urdf").check_robot(model)


@settings(max_examples=40, deadline=None)
@given(
    rows=st.sets(st.integers(0, 399), max_size=8) | st.integers(0, 398).map(lambda k: {k, k + 1}),
    value=st.sampled_from([np.nan, np.inf, -1e300, 1.7e308, 1e5]),
    column=st.sampled_from(["time", "position_2", "torque_3"]),
)
def test_whatever_is_corrupt_exactly_those_rows_go(rows, value, column):
    columns = make_columns()
    columns[column][list(rows)] = value
    position, torque = (
        np.stack([columns[f"{q}_{j}"] for j in (1, 2, 3)], 1) for q in ("position", "torque")
    )
    recording = Recording.from_arrays(columns["time"], position, torque)
    left_out = {row for item in recording.left_out for row in item.rows}
    assert rows <= left_out
    assert len(recording) + len(left_out) == recording.rows_total == 400
    assert (np.diff(recording.time) > 0).all()
    kept = set(range(400)) - left_out
    between = {r for r in left_out - rows if 0 < r < 399}
    assert kept | between | rows | {0, 399} >= set(range(400))
    assert len(between) <= 9 * len(rows)
