"""Small valid files of every format that limo reads, and what reads them as a command does."""

from __future__ import annotations

import gzip
import json
import sqlite3
from contextlib import closing
from dataclasses import dataclass
from functools import cache, partial
from hashlib import sha256
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any, Final

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Callable

    from limo_driver.model import RobotModel

ROWS: Final = 150
RATE: Final = 100.0  # [Hz]
_LINK: Final = (
    '  <link name="link_{0}"><inertial><origin xyz="0 0 0.1"/><mass value="2"/>'
    '<inertia ixx="0.02" iyy="0.02" izz="0.01" ixy="0" ixz="0" iyz="0"/></inertial>\n'
    '    <collision><geometry><cylinder radius="0.05" length="0.2"/></geometry></collision>\n'
    "  </link>\n"
)
_JOINT: Final = (
    '  <joint name="joint_{1}" type="revolute"><parent link="link_{0}"/><child link="link_{1}"/>\n'
    '    <origin xyz="0 0 0.2" rpy="0.3 0 0"/><axis xyz="0 1 0"/>\n'
    '    <limit lower="-2" upper="2" velocity="3" effort="60"/>'
    '<dynamics damping="0.5" friction="0.2"/></joint>\n'
)
URDF: Final = (
    '<robot name="small">\n'
    + "".join(_LINK.format(k) for k in range(4))
    + "".join(_JOINT.format(k, k + 1) for k in range(3))
    + "</robot>\n"
)
_BODY: Final = (
    '<body name="b{0}" pos="0 0 0.2"><joint name="j{0}" axis="0 1 0" range="-2 2" damping="0.5"/>'
    '<geom type="capsule" size="0.05 0.1" mass="2"/>\n'
)
MJCF: Final = (
    '<mujoco model="small"><compiler angle="radian"/><option gravity="0 0 -9.81"/>\n'
    '<asset><texture name="t" type="2d" builtin="checker" width="16" height="16"/>'
    '<hfield name="h" nrow="4" ncol="4" size="1 1 1 1"/></asset>\n<worldbody>\n'
    + "".join(_BODY.format(k) for k in range(3))
    + "</body>" * 3
    + '\n<replicate count="2" offset="1 0 0"><geom size="0.1"/></replicate></worldbody>\n'
    '<actuator><position name="a0" joint="j0" kp="50" kv="2" forcerange="-60 60"/></actuator>\n'
    "</mujoco>\n"
)
_NAMES: Final = ("joint_1", "joint_2", "joint_3")


@dataclass(frozen=True)
class Format:
    """A format: its valid files, and what reads one of them."""

    make: Callable[[Path], list[Path]]  # what is read: files or folders
    read: Callable[[Path], object]
    parts: Callable[[Path], list[Path]] = lambda path: [path]  # files of one, which are mutated
    mended: Callable[[Path], None] = lambda _: None  # what who forges one would also change


@cache
def arm() -> RobotModel:
    """Return the robot whose logs these are."""
    from limo_driver.model import RobotModel

    with TemporaryDirectory() as folder:
        (path := Path(folder) / "arm.urdf").write_text(URDF)
        return RobotModel.load(path)


@cache
def motion() -> dict[str, Any]:
    """Return time, position, velocity and torque of a motion."""
    t = np.arange(ROWS) / RATE
    rate = np.array([3.0, 4.0, 5.0])
    phase = np.outer(t, rate)
    q, v, a = 0.5 * np.sin(phase), 0.5 * rate * np.cos(phase), -0.5 * rate**2 * np.sin(phase)
    return {"t": t, "q_rad": q, "dq": v, "tau_nm": arm().inverse_dynamics(q, v, a)}


def _read_log(path: Path) -> object:
    from limo_driver.app.library.reading import read

    return read(path, arm())


def _inspect_log(path: Path) -> object:
    from limo_driver.app.library.inspecting import inspect

    return str(inspect(path, arm()))


def _columns() -> dict[str, Any]:
    own = motion()
    found = {"time": own["t"]}
    for name, key in (("position", "q_rad"), ("torque", "tau_nm")):
        found |= {f"{name}_{j + 1}": own[key][:, j] for j in range(3)}
    return found


def _foreign() -> dict[str, Any]:
    """Return the columns with names and units as somebody else's logger would have them."""
    named = {name.partition("_"): values for name, values in _columns().items()}
    other = {"position": "q{}_rad", "torque": "tau{}_nm"}
    return {other.get(of, of).format(j): values for (of, _, j), values in named.items()}


def _texts(folder: Path) -> list[Path]:
    columns = _foreign()
    lines = [",".join(f"{x:.6g}" for x in row) for row in zip(*columns.values(), strict=True)]
    text = "\n".join([",".join(columns), *lines, ""])
    (folder / "log.csv").write_text(text)
    (folder / "log.txt").write_text("# of a logger\n" + text.replace(",", ";"))
    (folder / "log.csv.gz").write_bytes(gzip.compress(text.encode()))
    return [folder / name for name in ("log.csv", "log.txt", "log.csv.gz")]


def _parquet(folder: Path) -> list[Path]:
    import pyarrow as pa
    import pyarrow.parquet as pq

    own = motion()
    flat = pa.table(_foreign())
    nested = pa.table({
        "timestamp": own["t"],
        "state": [{"q_rad": q, "names": list(_NAMES)} for q in own["q_rad"].tolist()],
        "tau_nm": own["tau_nm"].tolist(),
        "note": ["moving"] * ROWS,
    })  # fmt: skip
    pq.write_table(flat, folder / "flat.parquet", compression="none")
    pq.write_table(nested, folder / "nested.parquet", row_group_size=60)
    return [folder / "flat.parquet", folder / "nested.parquet"]


def _npz(folder: Path) -> list[Path]:
    own = motion()
    np.savez(folder / "log.npz", **own, joint_names=np.array(_NAMES))
    np.savez_compressed(folder / "packed.npz", **{k: np.asfortranarray(v) for k, v in own.items()})
    return [folder / "log.npz", folder / "packed.npz"]


def _json(folder: Path) -> list[Path]:
    lists = {name: np.round(values, 6).tolist() for name, values in motion().items()}
    records = [dict(zip(lists, row, strict=True)) for row in zip(*lists.values(), strict=True)]
    (folder / "arrays.json").write_text(json.dumps({"run": lists}, indent=1))
    (folder / "records.json").write_text(json.dumps(records))
    (folder / "lines.jsonl").write_text("".join(json.dumps(row) + "\n" for row in records))
    return [folder / name for name in ("arrays.json", "records.json", "lines.jsonl")]


def _mat(folder: Path) -> list[Path]:
    from scipy.io import savemat

    content = {**motion(), "info": {"names": np.array(_NAMES, dtype=object), "rate": RATE}}
    savemat(folder / "plain.mat", content)
    savemat(folder / "packed.mat", content, do_compression=True)
    savemat(folder / "old.mat", motion(), format="4")
    return [folder / name for name in ("plain.mat", "packed.mat", "old.mat")]


def _hdf5(folder: Path) -> list[Path]:
    import h5py

    paths = [folder / "log.h5", folder / "matlab.mat"]
    with h5py.File(paths[0], "w") as file:
        for name, values in motion().items():
            packed = {"compression": "gzip", "chunks": True} if name == "q_rad" else {}
            file.create_dataset(f"run/{name}", data=values, **packed)
        file["run/names"] = np.array(_NAMES, dtype=h5py.string_dtype())
    with h5py.File(paths[1], "w", userblock_size=512) as file:
        for name, values in motion().items():
            written = file.create_dataset(name, data=values.T)
            written.attrs["MATLAB_class"] = np.bytes_("double")
        cell = file.create_dataset("#refs#/a", data=np.array([[106, 49]], np.uint16))
        cell.attrs["MATLAB_class"] = np.bytes_("char")
        file.create_dataset("labels", data=np.array([[cell.ref]], dtype=h5py.ref_dtype))
    data = bytearray(paths[1].read_bytes())
    data[:128] = b"MATLAB 7.3 MAT-file, Platform: GLNXA64".ljust(124) + b"\x00\x02IM"
    paths[1].write_bytes(data)
    return paths


def _ros1(folder: Path) -> list[Path]:
    from rosbags.rosbag1 import Writer
    from rosbags.typesys import Stores, get_typestore

    store, own = get_typestore(Stores.ROS1_NOETIC), motion()
    kind = "sensor_msgs/msg/JointState"
    time, head, state = (
        store.types[name] for name in ("builtin_interfaces/msg/Time", "std_msgs/msg/Header", kind)
    )
    paths = {folder / "plain.bag": None, folder / "packed.bag": Writer.CompressionFormat.BZ2}
    for path, packing in paths.items():
        writer = Writer(path)
        if packing is not None:
            writer.set_compression(packing)
        with writer:
            topic = writer.add_connection("/joint_states", kind, typestore=store)
            for k in range(ROWS):
                stamp = 1_700_000_000 * 10**9 + round(own["t"][k] * 1e9)
                header = head(k, time(stamp // 10**9, stamp % 10**9), "")
                values = (np.ascontiguousarray(own[key][k]) for key in ("q_rad", "dq", "tau_nm"))
                data = store.serialize_ros1(state(header, list(_NAMES), *values), kind)
                writer.write(topic, stamp, bytes(data))
    return list(paths)


def _plain_mcap(folder: Path) -> list[Path]:
    """Write states in JSON, and in protobuf by a schema of doubles."""
    from google.protobuf.descriptor_pb2 import FileDescriptorProto, FileDescriptorSet
    from google.protobuf.descriptor_pool import DescriptorPool
    from google.protobuf.message_factory import GetMessageClass
    from mcap.writer import CompressionType, Writer

    described = FileDescriptorProto(name="state.proto", package="lab", syntax="proto3")
    kind = described.message_type.add(name="State")
    kind.field.add(name="name", number=1, type=9, label=3)
    for k, name in enumerate(("q_rad", "tau_nm"), start=2):
        kind.field.add(name=name, number=k, type=1, label=3)
    pool = DescriptorPool()
    pool.Add(described)
    made = GetMessageClass(pool.FindMessageTypeByName("lab.State"))
    own, paths = motion(), [folder / "json.mcap", folder / "protobuf.mcap"]
    schema = FileDescriptorSet(file=[described]).SerializeToString()
    for path in paths:
        with path.open("wb") as file:
            writer = Writer(file, 4000, CompressionType.NONE, enable_crcs=False)
            writer.start("", "fuzz")
            is_json = path.stem == "json"
            known = 0 if is_json else writer.register_schema("lab.State", "protobuf", schema)
            topic = writer.register_channel("/arm", path.stem, known)
            for k in range(ROWS):
                lists = {key: own[key][k].round(6).tolist() for key in ("q_rad", "tau_nm")}
                lists["name"] = list(_NAMES)
                data = json.dumps(lists).encode() if is_json else made(**lists).SerializeToString()
                stamp = 1_700_000_000 * 10**9 + round(own["t"][k] * 1e9)
                writer.add_message(topic, stamp, data, stamp, k)
            writer.finish()
    return paths


def _payloads() -> list[tuple[int, bytes]]:
    from limo_driver.network.messages import JointStateCodec

    codec, own = JointStateCodec(_NAMES), motion()
    stamps = (1_700_000_000 * 10**9 + np.round(own["t"] * 1e9)).astype(np.int64).tolist()
    rows = zip(stamps, own["q_rad"], own["dq"], own["tau_nm"], strict=True)
    return [(stamp, bytes(codec.encode(stamp, *values))) for stamp, *values in rows]


def _db3(folder: Path) -> list[Path]:
    path = folder / "log.db3"
    with closing(sqlite3.connect(path)) as bag:
        bag.execute("CREATE TABLE topics(id INTEGER PRIMARY KEY, name TEXT, type TEXT, "
                    "serialization_format TEXT, offered_qos_profiles TEXT)")  # fmt: skip
        bag.execute("CREATE TABLE messages(id INTEGER PRIMARY KEY, topic_id INTEGER, "
                    "timestamp INTEGER, data BLOB)")  # fmt: skip
        bag.execute("INSERT INTO topics VALUES(1, '/joint_states', 'sensor_msgs/msg/JointState', "
                    "'cdr', '')")  # fmt: skip
        for k, (stamp, payload) in enumerate(_payloads()):
            bag.execute("INSERT INTO messages VALUES(?, 1, ?, ?)", (k + 1, stamp, payload))
        bag.commit()
    return [path]


def _mcap(folder: Path) -> list[Path]:
    from mcap.writer import CompressionType, Writer

    from limo_driver.network.messages.cdr import SCHEMAS

    paths = [folder / "plain.mcap", folder / "packed.mcap"]
    for path, packing in zip(paths, (CompressionType.NONE, CompressionType.ZSTD), strict=True):
        with path.open("wb") as file:
            writer = Writer(file, 4000, packing, enable_crcs=False)
            writer.start("ros2", "fuzz")
            kind = "sensor_msgs/msg/JointState"
            schema = writer.register_schema(kind, "ros2msg", SCHEMAS[kind].encode())
            channel = writer.register_channel("/joint_states", "cdr", schema)
            for k, (stamp, payload) in enumerate(_payloads()):
                writer.add_message(channel, stamp, payload, stamp, k)
            writer.finish()
    return paths


def _lerobot(folder: Path) -> list[Path]:
    import pyarrow as pa
    import pyarrow.parquet as pq

    own, path = motion(), folder / "dataset"
    (path / "meta").mkdir(parents=True)
    (path / "data").mkdir()
    names = {"motors": list(_NAMES)}
    info = {"codebase_version": "v2.1", "fps": 100, "total_episodes": 2, "robot_type": "small",
            "features": {"observation.state": {"dtype": "float32", "names": names},
                         "observation.effort": {"names": names}}}  # fmt: skip
    (path / "meta" / "info.json").write_text(json.dumps(info, indent=1))
    table = pa.table({
        "observation.state": own["q_rad"].tolist(), "observation.effort": own["tau_nm"].tolist(),
        "timestamp": np.tile(own["t"][: ROWS // 2], 2),
        "episode_index": np.repeat([0, 1], ROWS // 2),
    })  # fmt: skip
    pq.write_table(table, path / "data" / "file-000.parquet", compression="none")
    return [path]


def _recordings(folder: Path) -> list[Path]:
    import pyarrow as pa
    import pyarrow.parquet as pq

    from limo_driver.recordings.files.recorder import Recorder
    from limo_driver.types import JointState

    table = pa.table(_columns())
    pq.write_table(
        table.replace_schema_metadata({"limo.recording": '{"robot": "x"}'}), folder / "run.parquet"
    )
    from pyarrow import csv

    csv.write_csv(table, folder / "run.csv")
    own = motion()
    with Recorder(folder / "cut.parquet", 3, {"robot": "x"}) as recorder:
        for k in range(ROWS):
            recorder.append(
                JointState(own["t"][k], own["q_rad"][k], own["dq"][k], own["tau_nm"][k], k)
            )
            if k % 30 == 29:
                recorder._flush()
        left = recorder.partial.read_bytes()
    (folder / "cut.parquet").unlink()
    (folder / "left.parquet.partial").write_bytes(left)
    return [folder / name for name in ("run.parquet", "run.csv", "left.parquet.partial")]


def _load_recording(path: Path) -> object:
    from limo_driver.recordings.recording import Recording

    return Recording.load(path)


def _trajectory(folder: Path) -> list[Path]:
    from limo_driver.trajectory import Segment, Trajectory

    own = motion()
    parts = (Segment("move", 0, ROWS),)
    made = Trajectory(
        own["t"], own["q_rad"], own["dq"], 0 * own["q_rad"], robot="small", segments=parts
    )
    made.save(folder / "motion.traj.parquet")
    return [folder / "motion.traj.parquet"]


def _load_trajectory(path: Path) -> object:
    from limo_driver.trajectory import Trajectory

    return Trajectory.load(path)


def _described(text: str, name: str, folder: Path) -> list[Path]:
    (folder / name).write_text(text)
    return [folder / name]


def _load_robot(path: Path) -> object:
    """Load a robot with its shapes, and what its file states of joints."""
    from limo_driver.app.library.learning import nominal

    simulation = nominal(str(path))
    q = np.zeros((1, simulation.model.n))
    return simulation.effects, simulation.model.shapes, simulation.model.gravity_torque(q)


def _usd(folder: Path) -> list[Path]:
    from pxr import Gf, Usd, UsdGeom, UsdPhysics

    path = folder / "arm.usda"
    stage = Usd.Stage.CreateNew(str(path))
    UsdGeom.SetStageMetersPerUnit(stage, 1.0)
    stage.SetDefaultPrim(UsdGeom.Xform.Define(stage, "/robot").GetPrim())
    for k in range(4):
        prim = UsdGeom.Xform.Define(stage, f"/robot/link_{k}").GetPrim()
        UsdPhysics.RigidBodyAPI.Apply(prim)
        mass = UsdPhysics.MassAPI.Apply(prim)
        mass.CreateMassAttr().Set(2.0)
        mass.CreateCenterOfMassAttr().Set(Gf.Vec3f(0, 0, 0.1))
        mass.CreateDiagonalInertiaAttr().Set(Gf.Vec3f(0.02, 0.02, 0.01))
    mount = UsdPhysics.FixedJoint.Define(stage, "/robot/mount")
    mount.CreateBody1Rel().AddTarget("/robot/link_0")
    for k in range(3):
        joint = UsdPhysics.RevoluteJoint.Define(stage, f"/robot/joint_{k}")
        joint.CreateBody0Rel().AddTarget(f"/robot/link_{k}")
        joint.CreateBody1Rel().AddTarget(f"/robot/link_{k + 1}")
        joint.CreateAxisAttr("Y")
        joint.CreateLocalPos0Attr(Gf.Vec3f(0, 0, 0.2))
        joint.CreateLowerLimitAttr(-100.0)
        joint.CreateUpperLimitAttr(100.0)
    stage.GetRootLayer().Save()
    stage.GetRootLayer().Export(str(folder / "arm.usdc"))
    return [path, folder / "arm.usdc"]


def _yaml(folder: Path) -> list[Path]:
    from limo_driver.app.library.inspecting import inspect
    from limo_driver.app.library.learning import nominal
    from limo_driver.physics import Simulation

    (folder / "arm.urdf").write_text(URDF)
    simulation = nominal(str(folder / "arm.urdf"))
    assert isinstance(simulation, Simulation)
    simulation.save(folder / "sim.yaml")
    inspect(motion(), arm()).mapping.save(folder / "mapping.yaml")
    return [folder / "sim.yaml", folder / "mapping.yaml"]


def _load_yaml(path: Path) -> object:
    from limo_driver.logs.readers.mapping import LogMapping
    from limo_driver.physics import Simulation

    return (Simulation if path.name == "sim.yaml" else LogMapping).load(path)


def _model(folder: Path) -> list[Path]:
    from estimators.joint_physics import JointPhysics
    from limo_driver.app.library.learning import nominal
    from limo_driver.recordings.channels import Columns
    from limo_driver.recordings.recording import Recording

    (folder / "arm.urdf").write_text(URDF)
    own, times = motion(), np.arange(6 * ROWS) / RATE
    long = [np.vstack([own[key]] * 6) for key in ("q_rad", "tau_nm")]
    recording = Recording.from_columns(Columns(time=times, position=long[0], torque=long[1]))
    simulation = nominal(str(folder / "arm.urdf"))
    JointPhysics(simulation).fit([recording]).save(folder / "model")
    return [folder / "model"]


def _load_model(path: Path) -> object:
    from estimators.model_folder import load_model

    return load_model(path)


def _sealed(path: Path) -> None:
    """State the digests of the files in the manifest, as who forges a model does."""
    try:
        manifest = json.loads((path / "manifest.json").read_text())
        for part in ("weights", "simulation"):
            manifest[part]["sha256"] = sha256(
                (path / manifest[part]["file"]).read_bytes()
            ).hexdigest()
        (path / "manifest.json").write_text(json.dumps(manifest, indent=1))
    except (OSError, ValueError, KeyError, TypeError):
        return


def _inside(path: Path) -> list[Path]:
    return sorted(file for file in path.rglob("*") if file.is_file())


FORMATS: Final = {
    "text": Format(_texts, _read_log),
    "parquet": Format(_parquet, _read_log),
    "npz": Format(_npz, _read_log),
    "json": Format(_json, _read_log),
    "mat": Format(_mat, _read_log),
    "db3": Format(_db3, _read_log),
    "mcap": Format(_mcap, _read_log),
    "plain-mcap": Format(_plain_mcap, _read_log),
    "ros1": Format(_ros1, _read_log),
    "hdf5": Format(_hdf5, _read_log),
    "lerobot": Format(_lerobot, _inspect_log, _inside),
    "recording": Format(_recordings, _load_recording),
    "trajectory": Format(_trajectory, _load_trajectory),
    "urdf": Format(partial(_described, URDF, "arm.urdf"), _load_robot),
    "mjcf": Format(partial(_described, MJCF, "arm.xml"), _load_robot),
    "usd": Format(_usd, _load_robot),
    "yaml": Format(_yaml, _load_yaml),
    "model": Format(_model, _load_model, _inside, _sealed),
}
