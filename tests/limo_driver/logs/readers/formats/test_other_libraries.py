"""Logs that other libraries read: bags of ROS 1, MCAP in JSON and protobuf, HDF5 and .mat 7.3."""

import json
from dataclasses import replace

import h5py
import numpy as np
import pytest
from google.protobuf.descriptor_pb2 import FileDescriptorProto, FileDescriptorSet
from google.protobuf.descriptor_pool import DescriptorPool
from google.protobuf.message_factory import GetMessageClass
from google.protobuf.timestamp_pb2 import DESCRIPTOR as TIMESTAMP
from logged import arm, measured
from mcap.writer import Writer as McapWriter
from rosbags.rosbag1 import Writer as Ros1Writer
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from scipy.io import savemat

import limo_driver as limo
from limo_driver.errors import LimoError, RecordingError
from limo_driver.logs.readers.formats.reading import read_table
from limo_driver.logs.readers.proposals.proposal import propose

TIME, POSITION, VELOCITY, TORQUE = measured(2.0)
STAMPS = (10**18 + np.round(TIME * 1e9)).astype(np.int64).tolist()
NAMES = list(arm().joint_names)
ROS1 = get_typestore(Stores.ROS1_NOETIC)
ROS1.register(
    get_types_from_msg(
        "Header header\nuint8 MODE_IDLE=0\nstring note\nuint8[] raw\ntime sent\n"
        "geometry_msgs/Point[] corners\nfloat64[7] q\nfloat64[7] tau_J\n",
        "lab_msgs/msg/ArmState",
    )
)
TYPES = ROS1.types
PACKINGS = (None, Ros1Writer.CompressionFormat.BZ2, Ros1Writer.CompressionFormat.LZ4)


def ros1(path, packing=None):
    """Write joint states, and messages of a type of nobody else's, in other places and sizes."""
    kinds = ("sensor_msgs/msg/JointState", "lab_msgs/msg/ArmState")
    writer = Ros1Writer(path)
    if packing:
        writer.set_compression(packing)
    with writer:
        topics = [writer.add_connection(f"/{kind[:3]}", kind, typestore=ROS1) for kind in kinds]
        for k, stamp in enumerate(STAMPS):
            time = TYPES["builtin_interfaces/msg/Time"](stamp // 10**9, stamp % 10**9)
            head = TYPES["std_msgs/msg/Header"](k, time, "base")
            raw = np.arange(k % 5, dtype=np.uint8)
            corners = [TYPES["geometry_msgs/msg/Point"](1.0, 2.0, 3.0)] * (k % 3)
            own = (POSITION[k], VELOCITY[k], TORQUE[k])
            states = (
                TYPES[kinds[0]](head, NAMES, *own),
                TYPES[kinds[1]](head, "free", raw, time, corners, own[0], own[2]),
            )
            for topic, kind, state in zip(topics, kinds, states, strict=True):
                writer.write(topic, stamp, bytes(ROS1.serialize_ros1(state, kind)))
    return path


@pytest.mark.parametrize("packing", PACKINGS)
def test_a_bag_of_ros_1_is_read_with_any_message_that_it_defines(tmp_path, packing):
    path = ros1(tmp_path / "log.bag", packing)
    read = limo.read(path, "iiwa14")
    np.testing.assert_array_equal(read.position, POSITION)
    np.testing.assert_array_equal(read.torque, TORQUE)
    np.testing.assert_allclose(read.time, TIME, atol=1e-9)
    table = read_table(path, topic="/lab")
    assert table.kind == "ROS 1 bag, topic /lab"
    np.testing.assert_array_equal(table.columns["time"], STAMPS)
    for j in range(7):
        np.testing.assert_array_equal(table.columns[f"q[{j}]"], POSITION[:, j])
        np.testing.assert_array_equal(table.columns[f"tau_J[{j}]"], TORQUE[:, j])


def test_a_bag_of_ros_1_is_read_to_where_it_is_damaged(tmp_path):
    path = ros1(tmp_path / "log.bag")
    data = bytearray(path.read_bytes())
    middle = len(data) // 2
    data[middle : middle + 4000] = b"\xff" * 4000
    path.write_bytes(data)
    table = read_table(path)
    assert 0 < table.rows < len(TIME)
    assert "is damaged after" in " ".join(table.notes)


@pytest.mark.parametrize("content", [b"", b"#ROSBAG V1.2\n", b"#ROSBAG V2.0\n" + b"\xff" * 500])
def test_what_is_no_bag_of_ros_1_is_refused_in_one_line(tmp_path, content):
    (tmp_path / "log.bag").write_bytes(content)
    with pytest.raises(RecordingError, match="cannot be read as a bag of ROS 1") as refused:
        read_table(tmp_path / "log.bag")
    assert str(refused.value).isprintable()


@pytest.mark.parametrize(
    ("name", "package"), [("log.bag", "rosbags"), ("log.h5", "h5py"), ("log.mat", "h5py")]
)
def test_what_needs_a_package_says_which(tmp_path, monkeypatch, name, package):
    mat = b"MATLAB 7.3 MAT-file".ljust(124) + b"\x00\x02IM"
    (tmp_path / name).write_bytes(mat if name == "log.mat" else b"")
    (tmp_path / "hidden").mkdir()
    (tmp_path / "hidden" / "sitecustomize.py").write_text(
        f"import sys\nsys.modules[{package!r}] = None"
    )
    monkeypatch.setenv("PYTHONPATH", str(tmp_path / "hidden"))
    monkeypatch.setitem(__import__("sys").modules, package, None)
    said = rf"needs {package}, which is not installed: pip install '{package}"
    with pytest.raises(LimoError, match=said):
        read_table(tmp_path / name)


def states_of_foxglove():
    """Return the descriptors of foxglove.JointStates, in no good order, and its class."""
    file = FileDescriptorProto(name="states.proto", package="foxglove", syntax="proto3")
    file.dependency.append(TIMESTAMP.name)
    joint, states = (file.message_type.add(name=name) for name in ("JointState", "JointStates"))
    for k, (name, kind) in enumerate((("name", 9), ("position", 1), ("effort", 1)), start=1):
        joint.field.add(name=name, number=k, type=kind, label=1)
    stamp, inner = ".google.protobuf.Timestamp", ".foxglove.JointState"
    states.field.add(name="timestamp", number=1, type=11, label=1, type_name=stamp)
    states.field.add(name="joints", number=2, type=11, label=3, type_name=inner)
    time = FileDescriptorProto()
    TIMESTAMP.CopyToProto(time)
    pool = DescriptorPool()
    pool.Add(time)
    pool.Add(file)
    made = GetMessageClass(pool.FindMessageTypeByName("foxglove.JointStates"))
    return FileDescriptorSet(file=[file, time]).SerializeToString(), made


def protobuf(k):
    state = states_of_foxglove()[1]()
    state.timestamp.FromNanoseconds(STAMPS[k])
    for j in np.random.default_rng(0).permutation(7).tolist():
        state.joints.add(name=NAMES[j], position=POSITION[k, j], effort=TORQUE[k, j])
    return state.SerializeToString()


def lists(k):
    stamp = {"sec": STAMPS[k] // 10**9, "nanosec": STAMPS[k] % 10**9}
    own = {"position": POSITION[k].tolist(), "effort": TORQUE[k].tolist()}
    return json.dumps({"header": {"stamp": stamp}, "name": NAMES, **own}).encode()


def mixed(k):
    order = np.random.default_rng(k).permutation(7).tolist()
    own = {"position": POSITION[k, order].tolist(), "effort": TORQUE[k, order].tolist()}
    return json.dumps({"name": [NAMES[j] for j in order], **own}).encode()


def objects(k):
    own = zip(NAMES, POSITION[k].tolist(), TORQUE[k].tolist(), strict=True)
    states = [{"name": name, "position": q, "effort": tau} for name, q, tau in own]
    return json.dumps({"state": {"joints": states}, "mode": 3}).encode()


@pytest.mark.parametrize(
    ("encoding", "payload", "schema"),
    [
        ("protobuf", protobuf, ("foxglove.JointStates", "protobuf", states_of_foxglove()[0])),
        ("json", lists, ("lab.States", "jsonschema", b"{}")),
        ("json", objects, None),
        ("json", mixed, None),
    ],
)
def test_mcap_files_in_json_and_protobuf_are_read(tmp_path, encoding, payload, schema):
    path = tmp_path / "log.mcap"
    with path.open("wb") as file:
        writer = McapWriter(file)
        writer.start()
        known = 0 if schema is None else writer.register_schema(*schema)
        topic = writer.register_channel("/arm", encoding, known)
        noise = writer.register_channel("/temperature", "json", 0)
        for k, stamp in enumerate(STAMPS):
            late = stamp + (0 if schema is None else 10**6 * (k % 3))
            writer.add_message(topic, late, payload(k), late, k)
            writer.add_message(noise, stamp, b'{"celsius": 21.5}', stamp, k)
        writer.finish()
    read = limo.read(path, "iiwa14")
    np.testing.assert_array_equal(read.position, POSITION)
    np.testing.assert_array_equal(read.torque, TORQUE)
    np.testing.assert_allclose(read.time, TIME, atol=1e-9)
    assert read_table(path).kind == f"MCAP file in {encoding}, topic /arm"


def test_arrays_of_hdf5_are_read_and_nothing_from_elsewhere(tmp_path):
    with h5py.File(tmp_path / "other.h5", "w") as other:
        other["stolen"] = TORQUE
    with h5py.File(tmp_path / "log.h5", "w") as file:
        file["observations/qpos"], file["observations/effort"] = POSITION, TORQUE
        file["observations/images"] = np.zeros((len(TIME), 4, 4, 3), np.uint8)
        file["time"] = TIME
        file["joint_names"] = np.array(NAMES, dtype=h5py.string_dtype())
        file["outside"] = h5py.ExternalLink(str(tmp_path / "other.h5"), "/stolen")
        layout = h5py.VirtualLayout(TORQUE.shape, "f8")
        layout[:] = h5py.VirtualSource(str(tmp_path / "other.h5"), "stolen", TORQUE.shape)
        file.create_virtual_dataset("virtual", layout)
    table = read_table(tmp_path / "log.h5")
    assert not [name for name in table.columns if name.startswith(("outside", "virtual"))]
    np.testing.assert_array_equal(table.columns[f"observations.qpos[{NAMES[2]}]"], POSITION[:, 2])
    read = limo.read(tmp_path / "log.h5", "iiwa14")
    np.testing.assert_array_equal(read.torque, TORQUE)


def test_rows_of_fields_in_hdf5_are_read_by_field(tmp_path):
    kinds = [("t", "f8"), ("q", "f8", 7), ("tau", "f4", 7), ("note", "S3"), ("eye", "f4", (2, 2))]
    rows = np.zeros(len(TIME), dtype=kinds)
    rows["t"], rows["q"], rows["tau"] = TIME, POSITION, TORQUE
    with h5py.File(tmp_path / "log.h5", "w") as file:
        file["run/log"] = rows
    read = limo.read(tmp_path / "log.h5", "iiwa14")
    np.testing.assert_array_equal(read.position, POSITION)
    np.testing.assert_allclose(read.torque, TORQUE, atol=1e-4)


def test_signals_of_simulink_are_read_by_their_label(tmp_path):
    signals = np.zeros(2, dtype=[("values", "O"), ("dimensions", "O"), ("label", "O")])
    signals[0], signals[1] = (TORQUE, 7.0, "tau"), (POSITION, 7.0, "q")
    savemat(tmp_path / "log.mat", {"out": {"time": TIME, "signals": signals}})
    read = limo.read(tmp_path / "log.mat", "iiwa14")
    np.testing.assert_array_equal(read.position, POSITION)
    np.testing.assert_array_equal(read.torque, TORQUE)


def test_variables_of_matlab_7_3_are_read(tmp_path):
    """Turned, as MATLAB writes all of them, with names in cells."""
    path = tmp_path / "log.mat"
    with h5py.File(path, "w", userblock_size=512) as file:
        for name, values in (("q", POSITION.T), ("tau", TORQUE.T), ("t", TIME[:, None])):
            written = file.create_dataset(f"run/{name}", data=values)
            written.attrs["MATLAB_class"] = np.bytes_("double")
        cells = list[h5py.Reference]()
        for k, name in enumerate(NAMES):
            cell = file.create_dataset(f"#refs#/{k}", data=np.array([[*map(ord, name)]], np.uint16))
            cell.attrs["MATLAB_class"] = np.bytes_("char")
            cells.append(cell.ref)
        file.create_dataset("run/names", data=np.array([cells], dtype=h5py.ref_dtype))
    data = bytearray(path.read_bytes())
    data[:128] = b"MATLAB 7.3 MAT-file, Platform: GLNXA64".ljust(124) + b"\x00\x02IM"
    path.write_bytes(data)
    table = read_table(path)
    np.testing.assert_array_equal(table.columns[f"q[{NAMES[3]}]"], POSITION[:, 3])
    read = limo.read(path, "iiwa14")
    np.testing.assert_array_equal(read.position, POSITION)
    np.testing.assert_array_equal(read.torque, TORQUE)
    assert read.time == pytest.approx(TIME)


def test_positions_of_ros_beyond_the_limits_are_asked_about_not_read_as_degrees(tmp_path):
    """As those of another arm are: 6 rad at a joint that reaches 2.1."""
    table = read_table(ros1(tmp_path / "log.bag"))
    columns = {**table.columns, "position.joint2": table.columns["position.joint2"] + 6.0}
    found = propose(replace(table, columns=columns), arm())
    assert any("are the columns in rad or deg?" in text for text in found.mapping.undecided)


def test_stamps_that_follow_each_other_as_no_samples_do_are_asked_about(tmp_path):
    """As those of a program that writes its whole log at once; in microseconds, they would fit."""
    table = read_table(ros1(tmp_path / "log.bag"))
    at_once = table.columns["time"][0] + 40_000 * np.arange(len(TIME))
    found = propose(replace(table, columns={**table.columns, "time": at_once}), arm())
    assert found.mapping.time.unit == ("ns",)
    assert any(text.startswith("time: the format has ns") for text in found.mapping.undecided)
