from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from estimators.hybrid.features import Features, feature_set
from limo_driver.errors import ConfigError
from limo_driver.model import RobotModel
from limo_driver.types import FloatArray, Motion

MODEL = RobotModel.load("iiwa14")
REVERSAL = 2e-4


def motion_of(position: FloatArray) -> Motion:
    position = np.broadcast_to(np.asarray(position)[:, None], (len(position), 7))
    return Motion(np.arange(len(position)) * 1e-3, position, 0 * position, 0 * position)


def inputs(features: Features, position: FloatArray, name: str) -> FloatArray:
    motion = motion_of(position)
    x, _ = features.advance(features.init(), motion, 0 * motion.position, MODEL)
    return x[:, [feature.name for feature in features.inputs].index(name)]


def rotation(position: FloatArray) -> FloatArray:
    return inputs(Features(7), position, "rotation_since_reversal_1")


def test_rotation_is_counted_from_the_last_reversal() -> None:
    up, down = np.linspace(0, 0.1, 101), np.linspace(0.1, 0.04, 61)
    r = rotation(np.concatenate([up, down]))
    np.testing.assert_allclose(r[:101], up)
    np.testing.assert_allclose(r[102:], down[1:] - 0.1)  # from the second millirad back


def test_rotation_is_clipped_to_ten_degrees() -> None:
    r = rotation(np.deg2rad(np.concatenate([np.linspace(0, 30, 301), np.linspace(30, 0, 301)])))
    assert np.rad2deg(r.max()) == pytest.approx(10.0)
    assert np.rad2deg(r.min()) == pytest.approx(-10.0)


def test_jitter_below_the_threshold_is_no_reversal() -> None:
    ramp = np.linspace(0, 0.1, 2001)
    jitter = 0.4 * REVERSAL * np.where(np.arange(2001) % 2, 1, -1)
    np.testing.assert_allclose(rotation(ramp + jitter), ramp, atol=2 * REVERSAL)


def test_a_reversal_is_seen_once_it_exceeds_the_threshold() -> None:
    r = rotation(np.array([0.0, 0.01, 0.02, 0.02 - 0.9 * REVERSAL, 0.02 - 1.1 * REVERSAL]))
    assert r[3] == pytest.approx(0.02 - 0.9 * REVERSAL)  # still on the way up
    assert r[4] == pytest.approx(-1.1 * REVERSAL)


def test_at_rest_nothing_is_remembered() -> None:
    np.testing.assert_array_equal(rotation(np.full(10, 0.7)), 0.0)


@settings(deadline=None)  # the first call compiles
@given(st.lists(st.floats(-0.2, 0.2), min_size=2, max_size=40), st.integers(1, 38))
def test_memory_continues_where_it_was_cut(positions: list[float], cut: int) -> None:
    features = feature_set("drive", 7)
    motion = motion_of(np.array(positions))
    torque = np.ones_like(motion.position)
    whole, _ = features.advance(features.init(), motion, torque, MODEL)
    first, memory = features.advance(features.init(), motion[:cut], torque[:cut], MODEL)
    second, _ = features.advance(memory, motion[cut:], torque[cut:], MODEL)
    np.testing.assert_allclose(np.concatenate([first, second]), whole, atol=1e-12)


def test_a_stop_operator_remembers_more_than_the_last_reversal() -> None:
    features = Features(7, stop_widths=(0.05,))
    from_afar = np.concatenate([np.linspace(0, 0.2, 50), np.linspace(0.2, 0.19, 20)])
    from_near = np.concatenate([np.linspace(0.17, 0.2, 50), np.linspace(0.2, 0.19, 20)])
    name = "stop_0.05rad_1"
    assert rotation(from_afar)[-1] == pytest.approx(rotation(from_near)[-1])
    assert inputs(features, from_afar, name)[-1] == pytest.approx(0.04)
    assert inputs(features, from_near, name)[-1] == pytest.approx(0.02)


def test_deflection_is_what_a_joint_that_gives_way_adds() -> None:
    features = Features(7, compliance=1e-4)
    q = np.deg2rad([[0, 60, 0, -60, 0, 60, 0]]).astype(float)
    motion = Motion(np.zeros(1), q, 0 * q, 0 * q)
    gravity = MODEL.gravity_torque(q)
    x, _ = features.advance(features.init(), motion, gravity, MODEL)
    expected = MODEL.gravity_torque(q - 1e-4 * gravity) - gravity
    np.testing.assert_allclose(x[:, -7:], expected, atol=1e-12)
    assert np.abs(expected).max() > 0.01


def test_paper_inputs_come_first_and_every_network_sees_them_all() -> None:
    features = feature_set("all-joints", 7)
    assert [f.name for f in features.inputs][::7] == [
        "position_1",
        "velocity_1",
        "acceleration_1",
        "rotation_since_reversal_1",
        "rigid_body_torque_1",
    ]
    np.testing.assert_array_equal(features.columns, np.tile(np.arange(35), (7, 1)))


def test_a_drive_shows_no_pose_to_learn_by_heart() -> None:
    names = {feature.name for feature in feature_set("drive", 7).inputs}
    assert not {"position_1", "acceleration_1"} & names
    assert {"velocity_1", "rotation_since_reversal_1", "rigid_body_torque_1"} <= names


def test_what_is_left_out_leaves_the_other_columns_alone() -> None:
    q = np.linspace(0.0, 0.3, 20)
    whole = inputs(Features(7, stop_widths=(0.05,)), q, "stop_0.05rad_3")
    part = Features(7, stop_widths=(0.05,), without=("position", "rigid_body_torque"))
    np.testing.assert_array_equal(inputs(part, q, "stop_0.05rad_3"), whole)
    assert part.columns.shape == (7, 4 * 7)


@pytest.mark.parametrize("name", ["own-joint", "drive"])
def test_own_joint_networks_see_no_other_joint(name: str) -> None:
    features = feature_set(name, 7)
    for j, columns in enumerate(features.columns):
        assert all(features.inputs[i].name.endswith(f"_{j + 1}") for i in columns)


def test_unknown_set_names_the_known_ones() -> None:
    with pytest.raises(ConfigError, match="'magic'; known: all-joints, own-joint, drive"):
        feature_set("magic", 7)
