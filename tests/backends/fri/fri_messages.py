"""What the FRI tests share: messages of every version, made or drawn."""

from pathlib import Path
from subprocess import run
from sys import executable

from hypothesis import settings
from hypothesis import strategies as st

from backends.fri.codec import messages as m
from backends.fri.codec.messages import FriVersion, Generation

some = settings(max_examples=12, deadline=None)  # each runs for every generation
GENERATIONS = tuple(Generation)
VERSIONS = tuple(FriVersion)
SCHEMA = Path(__file__).with_name("fri.proto")
POSE = (0.0, 0.5, 0.0, -1.2, 0.0, 0.9, 0.0)

uint32 = st.integers(0, 2**32 - 1)
int32 = st.integers(-(2**31), 2**31 - 1)
real = st.floats()
joints = st.tuples(*[real] * 7)
names = st.text(max_size=15)


def maybe(strategy):
    return st.none() | strategy


def an(enum):
    return st.sampled_from(list(enum))


headers = st.builds(m.Header, uint32, uint32)
timestamps = st.builds(m.Timestamp, uint32, uint32)
io_values = st.builds(
    m.IoValue,
    names,
    an(m.IoType),
    an(m.IoDirection),
    maybe(st.integers(0, 2**64 - 1)),
    maybe(real),
)
redundancies = st.builds(m.Redundancy, an(m.RedundancyStrategy), real)
robots = st.builds(
    m.RobotInfo,
    maybe(int32),
    maybe(an(m.SafetyState)),
    st.lists(an(m.DriveState), max_size=7).map(tuple),
    maybe(an(m.OperationMode)),
    maybe(an(m.ControlMode)),
)
connections = st.builds(
    m.ConnectionInfo, an(m.SessionState), an(m.Quality), maybe(uint32), maybe(uint32)
)
checksums = st.builds(m.Checksum, maybe(int32))
ends = st.builds(m.EndOfMessage, maybe(int32), maybe(checksums))


def transformations(generation):
    count = 12 if generation is Generation.ONE else 7
    return st.builds(m.Transformation, names, st.tuples(*[real] * count), maybe(timestamps))


def only(allowed, strategy):
    return maybe(strategy) if allowed else st.none()


def monitorings(generation):
    two = generation is not Generation.ONE
    frame = transformations(generation)
    data = st.builds(
        m.MonitorData,
        measured_position=maybe(joints),
        measured_torque=maybe(joints),
        commanded_position=only(not two, joints),
        commanded_torque=maybe(joints),
        external_torque=maybe(joints),
        external_force=only(generation.framed, st.tuples(*[real] * 6)),
        io=st.lists(io_values, max_size=3).map(tuple),
        measured_pose=only(two, frame),
        measured_redundancy=only(two, redundancies),
        timestamp=maybe(timestamps),
    )
    ipo = st.builds(
        m.IpoData,
        maybe(joints),
        only(two, frame),
        only(two, redundancies),
        maybe(an(m.CommandMode)),
        maybe(an(m.OverlayType)),
        maybe(real),
    )
    return st.builds(
        m.Monitoring,
        headers,
        maybe(robots),
        maybe(data),
        maybe(connections),
        maybe(ipo),
        st.lists(frame, max_size=2).map(tuple),
        only(not generation.framed, ends),
    )


def commands(generation):
    two = generation is not Generation.ONE
    frame = transformations(generation)
    data = st.builds(
        m.CommandData,
        maybe(joints),
        maybe(st.tuples(*[real] * 6)),
        maybe(joints),
        st.lists(frame, max_size=2).map(tuple),
        st.lists(io_values, max_size=3).map(tuple),
        only(two, frame),
        only(two, redundancies),
    )
    return st.builds(m.Command, headers, maybe(data), only(not generation.framed, ends))


def monitoring(
    generation=Generation.ONE, sequence=0, state=m.SessionState.COMMANDING_ACTIVE, **changes
):
    """A message as an arm sends it."""
    one = generation is Generation.ONE
    message = m.Monitoring(
        m.Header(sequence, 0),
        m.RobotInfo(
            7,
            m.SafetyState.NORMAL,
            (m.DriveState.ACTIVE,) * 7,
            m.OperationMode.AUT,
            m.ControlMode.POSITION,
        ),
        m.MonitorData(
            measured_position=POSE,
            measured_torque=(1.0,) * 7,
            commanded_position=POSE if one else None,
            commanded_torque=(2.0,) * 7,
            external_torque=(0.5,) * 7,
            measured_pose=None if one else m.Transformation("tip", (0.1, 0, 1, 1, 0, 0, 0)),
            timestamp=m.Timestamp(1_700_000_000, 500_000_000),
        ),
        m.ConnectionInfo(state, m.Quality.EXCELLENT, 1, 1),
        m.IpoData(
            POSE,
            command_mode=m.CommandMode.POSITION,
            overlay_type=m.OverlayType.JOINT,
            tracking_performance=1.0,
        ),
    )
    return message._replace(**changes)


def compile_schema(folder):
    """Compile the schema with protobuf's own compiler; return the generated module."""
    import importlib.util

    out = f"--python_out={folder}"
    run([executable, "-m", "grpc_tools.protoc", f"-I{SCHEMA.parent}", out, SCHEMA.name], check=True)
    spec = importlib.util.spec_from_file_location("fri_pb2", Path(folder) / "fri_pb2.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module
