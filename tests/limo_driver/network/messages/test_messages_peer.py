"""Messages against an independent implementation of CDR and of message definitions."""

import numpy as np
import pytest
from rosbags import typesys

from limo_driver.network.messages import (
    JOINT_STATE,
    LOG,
    MATRIX,
    SCHEMAS,
    TORQUE_ESTIMATE,
    WRENCH,
    Event,
    JointStateCodec,
    Level,
    TorqueEstimateCodec,
    decode_event,
    decode_joint_state,
    decode_torque_estimate,
    encode_matrix,
    encode_wrench,
)

STAMP = 1_700_000_000_123_456_789
NAMES = {n: tuple(f"iiwa_joint_{j + 1}" * (j % 3) for j in range(n)) for n in range(9)}


@pytest.fixture(scope="module")
def store():
    """The types of ROS 2 Jazzy and, by its own definition, ours."""
    jazzy = typesys.get_typestore(typesys.Stores.ROS2_JAZZY)
    ours = typesys.get_types_from_msg(SCHEMAS[TORQUE_ESTIMATE], TORQUE_ESTIMATE)
    jazzy.register({TORQUE_ESTIMATE: ours[TORQUE_ESTIMATE]})
    return jazzy


def time(store):
    return store.types["builtin_interfaces/msg/Time"](*divmod(STAMP, 10**9))


def header(store, frame_id):
    return store.types["std_msgs/msg/Header"](time(store), frame_id)


@pytest.mark.parametrize("name", [JOINT_STATE, LOG])
def test_definitions_are_those_of_ros(store, name):
    ours = typesys.get_types_from_msg(SCHEMAS[name], name)
    assert ours[name][1] == store.fielddefs[name][1]
    if name == LOG:
        constants = {c: v for c, _, v in store.fielddefs[name][0]}
        assert constants == {level.name: level.value for level in Level}


@pytest.mark.parametrize("n", [0, 1, 2, 7, 8])
@pytest.mark.parametrize("frame_id", ["", "x", "base"])
@pytest.mark.parametrize("given", ["111", "100", "101", "011", "000"])
def test_joint_state(store, n, frame_id, given):
    random = np.random.default_rng(n)
    arrays = [random.standard_normal(n * int(flag)) for flag in given]
    theirs = store.types[JOINT_STATE](header(store, frame_id), list(NAMES[n]), *arrays)
    codec = JointStateCodec(NAMES[n], frame_id)
    for little_endian in (True, False):
        payload = bytes(store.serialize_cdr(theirs, JOINT_STATE, little_endian=little_endian))
        for message in (decode_joint_state(payload), codec.decode(payload)):
            assert (message.stamp_ns, message.frame_id) == (STAMP, frame_id)
            assert message.names == NAMES[n]
            for ours, expected in zip(
                (message.position, message.velocity, message.torque), arrays, strict=True
            ):
                np.testing.assert_array_equal(ours, expected)
        if little_endian:
            assert codec.encode(STAMP, *arrays).hex(" ") == payload.hex(" ")


@pytest.mark.parametrize("n", [1, 7])
@pytest.mark.parametrize("model", ["", "12", "hybrid/3"])
def test_estimate(store, n, model):
    random = np.random.default_rng(n)
    arrays = [random.standard_normal(n) for _ in range(3)]
    outside = random.random(n) < 0.5
    payload = TorqueEstimateCodec(NAMES[n], "base").encode(
        STAMP, *arrays, outside, model=model, fallback=True, reset=False, since_gap=70.0
    )
    theirs = store.deserialize_cdr(payload, TORQUE_ESTIMATE)
    assert (theirs.header.stamp.sec, theirs.header.frame_id) == (STAMP // 10**9, "base")
    assert (theirs.model, theirs.fallback, theirs.reset) == (model, True, False)
    for ours, read in zip(
        (*arrays, outside),
        (theirs.torque, theirs.std, theirs.external, theirs.outside),
        strict=True,
    ):
        np.testing.assert_array_equal(ours, read)
    for little_endian in (True, False):
        again = store.serialize_cdr(theirs, TORQUE_ESTIMATE, little_endian=little_endian)
        estimate = decode_torque_estimate(bytes(again))
        np.testing.assert_array_equal(estimate.external, arrays[2])
        np.testing.assert_array_equal(estimate.outside, outside)
        assert (estimate.names, estimate.model) == (NAMES[n], model)
        assert estimate.since_gap == 70.0
    assert bytes(store.serialize_cdr(theirs, TORQUE_ESTIMATE)) == payload


def test_event(store):
    event = Event(
        STAMP, Level.ERROR, "swap", "refused: größer", {"joint": [1, 2]}, "serve.py", "swap", 42
    )
    theirs = store.deserialize_cdr(event.encode(), LOG)
    assert (theirs.level, theirs.name, theirs.function) == (40, "swap", "swap")
    assert (theirs.file, theirs.line) == ("serve.py", 42)
    assert bytes(store.serialize_cdr(theirs, LOG)) == event.encode()
    big_endian = bytes(store.serialize_cdr(theirs, LOG, little_endian=False))
    assert decode_event(big_endian) == event


def test_wrench(store):
    values = np.arange(6.0)
    types = store.types
    force, torque = (
        types["geometry_msgs/msg/Vector3"](*v.tolist()) for v in (values[:3], values[3:])
    )
    wrench = types["geometry_msgs/msg/Wrench"](force, torque)
    for frame in ("", "flange", "tool0"):
        theirs = types[WRENCH](header(store, frame), wrench)
        assert encode_wrench(STAMP, frame, values) == bytes(store.serialize_cdr(theirs, WRENCH))


def test_matrix(store):
    values = np.arange(36.0).reshape(6, 6)
    for label in ("", "flange", "tool0", "wrench in tool0"):
        dimension, layout = (
            store.types[f"std_msgs/msg/MultiArray{of}"] for of in ("Dimension", "Layout")
        )
        dimensions = [dimension(label, 6, 36), dimension(label, 6, 6)]
        theirs = store.types[MATRIX](layout(dimensions, 0), values.ravel())
        assert encode_matrix(label, values) == bytes(store.serialize_cdr(theirs, MATRIX))
