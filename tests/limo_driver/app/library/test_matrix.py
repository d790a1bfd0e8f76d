"""Every kind of log with every kind of robot, as the table of docs/formats.md says."""

from __future__ import annotations

import json
import re
from importlib.metadata import files
from pathlib import Path

import h5py
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from lanes import sampled
from logged import written
from mjcf_arms import arm_of
from rosbags.rosbag1 import Writer as Ros1Writer
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore
from scipy.io import savemat
from tables import rows_of

import limo_driver as limo
from limo_driver.errors import LimoError
from limo_driver.physics import CoulombFriction, Simulation, ViscousFriction
from limo_driver.types import Motion

ROBOTS = ("iiwa14", "panda.urdf", "model.xml")
STORE, ROS1 = get_typestore(Stores.ROS2_HUMBLE), get_typestore(Stores.ROS1_NOETIC)
JointState = STORE.types["sensor_msgs/msg/JointState"]
Header = STORE.types["std_msgs/msg/Header"]
Stamp = STORE.types["builtin_interfaces/msg/Time"]


@pytest.fixture(scope="module")
def robots(tmp_path_factory):
    """Each robot's reference, and 16 s of its motion with friction."""
    folder = tmp_path_factory.mktemp("robots")
    (folder / "model.xml").write_text(arm_of(11, 5, dynamics=False), encoding="utf-8")
    panda = next(x for x in files("example-robot-data") if x.name == "panda.urdf")
    places = {
        "iiwa14": "iiwa14",
        "panda.urdf": str(Path(str(panda.locate())).resolve()),
        "model.xml": str(folder / "model.xml"),
    }
    return {name: (place, motion_of(place)) for name, place in places.items()}


def motion_of(place):
    model = limo.RobotModel.load(place)
    time = np.arange(0, 16, 0.01)
    rate = 2 * np.pi * (0.11 + 0.05 * np.arange(model.n))
    phase = np.outer(time, rate) + np.arange(model.n)
    middle = (model.limits.position_min + model.limits.position_max) / 2
    reach = np.minimum(0.8, 0.4 * (model.limits.position_max - model.limits.position_min))
    q = middle + reach * np.sin(phase)
    v, a = reach * rate * np.cos(phase), -reach * rate**2 * np.sin(phase)
    friction = [CoulombFriction(joint=j + 1, tau_c=0.6, v_eps=0.005) for j in range(model.n)]
    friction += [ViscousFriction(joint=j + 1, f_v=0.4) for j in range(model.n)]
    torque = Simulation(place, tuple(friction)).predict(Motion(time, q, v, a))
    return time, q, torque + np.random.default_rng(0).normal(0, 0.02, q.shape)


def named(name, values):
    return {f"{name}{j}": values[:, j] for j in range(values.shape[1])}


def csv(folder, _names, time, q, torque):
    log = {"t_ms": 1e3 * time, **named("q", np.rad2deg(q)), **named("tau", torque)}
    return written(log, folder / "log.csv")


def decimal_commas(folder, _names, time, q, torque):
    log = {"time": time, **named("pos_", q), **named("torque_", torque)}
    path = written(log, folder / "log.txt", ";")
    path.write_text(path.read_text().replace(".", ","))
    return path


def parquet(folder, _names, time, q, torque):
    table = {"stamp": (1e9 * time).astype(np.int64), "q": list(q), "effort": list(torque)}
    pq.write_table(pa.table(table), folder / "log.parquet")
    return folder / "log.parquet"


def npz(folder, _names, time, q, torque):
    np.savez(folder / "log.npz", t=time, qpos=q, torque=torque)
    return folder / "log.npz"


def records(folder, _names, time, q, torque):
    keys = ("time", "position", "effort")
    rows = zip(time.tolist(), q.tolist(), torque.tolist(), strict=True)
    listed = [dict(zip(keys, row, strict=True)) for row in rows]
    (folder / "log.json").write_text(json.dumps(listed), encoding="utf-8")
    return folder / "log.json"


def mat(folder, _names, time, q, torque):
    savemat(folder / "log.mat", {"run": {"t": time, "q": q.T, "tau": torque.T}})
    return folder / "log.mat"


def arrays(_folder, _names, time, q, torque):
    return {"t": time, "position": q, "torque": torque}


def bag(storage):
    def write(folder, names, time, q, torque):
        order = np.random.default_rng(0).permutation(len(names))
        path = folder / "bag"
        with Writer(path, version=9, storage_plugin=storage) as writer:
            topic = writer.add_connection("/js", JointState.__msgtype__, typestore=STORE)
            shuffled = [names[j] for j in order]
            for k, stamp in enumerate((1e18 + 1e9 * time).astype(np.int64).tolist()):
                header = Header(Stamp(stamp // 10**9, stamp % 10**9), "")
                values = np.ascontiguousarray(q[k, order]), np.zeros(0), torque[k, order].copy()
                data = STORE.serialize_cdr(
                    JointState(header, shuffled, *values), JointState.__msgtype__
                )
                writer.write(topic, stamp, data)
        return path

    return write


def ros1(folder, names, time, q, torque):
    with Ros1Writer(folder / "log.bag") as writer:
        topic = writer.add_connection("/js", JointState.__msgtype__, typestore=ROS1)
        for k, stamp in enumerate((1e18 + 1e9 * time).astype(np.int64).tolist()):
            header = ROS1.types["std_msgs/msg/Header"](k, Stamp(stamp // 10**9, stamp % 10**9), "")
            state = JointState(header, list(names), q[k], np.zeros(0), torque[k])
            data = ROS1.serialize_ros1(state, JointState.__msgtype__)
            writer.write(topic, stamp, bytes(data))
    return folder / "log.bag"


def hdf5(folder, _names, time, q, torque):
    with h5py.File(folder / "log.h5", "w") as file:
        file["time"], file["observations/qpos"], file["observations/effort"] = time, q, torque
    return folder / "log.h5"


def lerobot(version):
    def write(folder, names, time, q, torque):
        path = folder / "set"
        (path / "meta").mkdir(parents=True)
        (path / "data" / "chunk-000").mkdir(parents=True)
        features = {
            "observation.state": {"names": {"motors": [f"{name}.pos" for name in names]}},
            "observation.effort": {"names": [f"{name}.effort" for name in names]},
        }
        info = {"codebase_version": version, "fps": 100, "features": features}
        (path / "meta" / "info.json").write_text(json.dumps(info))
        table = {
            "observation.state": list(q),
            "observation.effort": list(torque),
            "timestamp": time,
            "episode_index": np.zeros(time.size, dtype=np.int64),
        }
        file = "file-000.parquet" if version == "v3.0" else "episode_000000.parquet"
        pq.write_table(pa.table(table), path / "data" / "chunk-000" / file)
        return path

    return write


KINDS = {
    "CSV, degrees and milliseconds": csv,
    "text with semicolons and decimal commas": decimal_commas,
    "Parquet, lists": parquet,
    "NumPy .npz": npz,
    "JSON records": records,
    "MATLAB .mat": mat,
    "arrays in Python": arrays,
    "ROS 2 bag, MCAP": bag(StoragePlugin.MCAP),
    "ROS 2 bag, .db3": bag(StoragePlugin.SQLITE3),
    "ROS 1 bag": ros1,
    "HDF5": hdf5,
    "LeRobotDataset v2.1": lerobot("v2.1"),
    "LeRobotDataset v3.0": lerobot("v3.0"),
}


def test_the_table_is_that_of_the_document():
    heading, logs = rows_of("log")
    assert tuple(heading[1:]) == ROBOTS
    assert [row[0] for row in logs] == list(KINDS)
    assert {cell for row in logs for cell in row[1:]} == {"yes"}


@pytest.mark.parametrize("robot", ROBOTS)
@sampled("kind", KINDS, "writes and reads a log each")
def test_a_log_is_read_as_what_was_measured(kind, robot, robots, tmp_path):
    place, (time, q, torque) = robots[robot]
    names = limo.RobotModel.load(place).joint_names
    recording = limo.read(KINDS[kind](tmp_path, names, time, q, torque), place)
    assert len(recording) == time.size
    np.testing.assert_allclose(recording.time, time - time[0], atol=2e-6)
    np.testing.assert_allclose(recording.position, q, atol=1e-6)
    np.testing.assert_allclose(recording.torque, torque, atol=1e-6)
    assert re.match("read as .*position.*torque", recording.warnings[0])


def degrees_in_every_second_column(time, q, torque):
    return time, np.where(np.arange(q.shape[1]) % 2, np.rad2deg(q), q), torque


def degrees_from_the_middle_on(time, q, torque):
    late = np.arange(time.size) >= time.size // 2
    return time, np.where(late[:, None], np.rad2deg(q), q), torque


def milliseconds_from_the_middle_on(time, q, torque):
    k = time.size // 2
    return np.append(time[:k], time[k] + 1e3 * (time[k:] - time[k])), q, torque


FAULTS = (
    degrees_in_every_second_column,
    degrees_from_the_middle_on,
    milliseconds_from_the_middle_on,
)


def told(log, place):
    """The recording that a log is read as; None where it is refused in one line."""
    refused = ""
    recording = None
    try:
        recording = limo.read(log, place)
    except LimoError as error:
        refused = str(error)
    assert bool(refused) == (recording is None)
    assert "\n" not in refused
    return recording


@pytest.mark.parametrize("fault", FAULTS)
@sampled("kind", KINDS, "writes and reads a log each")
def test_units_that_are_mixed_are_refused_or_read_right(kind, fault, robots, tmp_path):
    place, measured = robots["iiwa14"]
    names = limo.RobotModel.load(place).joint_names
    recording = told(KINDS[kind](tmp_path, names, *fault(*measured)), place)
    if recording is not None:
        np.testing.assert_allclose(recording.position, measured[1][recording.rows], atol=1e-6)


@pytest.mark.parametrize("kind", [kind for kind in KINDS if kind != "arrays in Python"])
@sampled("share", [0.02, 0.6, 0.999], "writes and reads a log each")
def test_files_that_are_cut_off_are_refused_or_read_as_far_as_they_go(
    kind, share, robots, tmp_path
):
    place, measured = robots["iiwa14"]
    log = KINDS[kind](tmp_path, limo.RobotModel.load(place).joint_names, *measured)
    parts = [path for path in tmp_path.rglob("*") if path.is_file()]
    largest = max(parts, key=lambda path: path.stat().st_size)
    data = largest.read_bytes()
    largest.write_bytes(data[: int(share * len(data))])
    recording = told(log, place)
    if recording is not None:
        assert len(recording) < measured[0].size or share > 0.99
        np.testing.assert_allclose(recording.position, measured[1][recording.rows], atol=1e-6)


@pytest.mark.parametrize("kind", KINDS)
def test_logs_of_another_robot_are_refused(kind, robots, tmp_path):
    _, measured = robots["model.xml"]
    names = limo.RobotModel.load(robots["model.xml"][0]).joint_names
    assert told(KINDS[kind](tmp_path, names, *measured), "iiwa14") is None
