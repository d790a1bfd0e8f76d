"""FRI messages: golden bytes, round trips of every version, and bytes that are none."""

import struct
import zlib
from contextlib import suppress

import pytest
from fri_messages import GENERATIONS, POSE, VERSIONS, commands, monitoring, monitorings, some
from hypothesis import given
from hypothesis import strategies as st

from backends.fri.codec.codec import (
    decode_command,
    decode_monitoring,
    detect,
    encode_command,
    encode_monitoring,
)
from backends.fri.codec.messages import (
    Command,
    CommandData,
    ConnectionInfo,
    FriVersion,
    Generation,
    Header,
    IoDirection,
    IoType,
    IoValue,
    MonitorData,
    Monitoring,
    Quality,
    SessionState,
    Timestamp,
    Transformation,
    frame,
)
from limo_driver.errors import ConfigError, WireFormatError

V1 = FriVersion.V1_15
FIRST_REPLY = bytes.fromhex("0a080881800d1000180012410a3f") + b"".join(
    b"\x09" + struct.pack("<d", value) for value in (0, 0.5, 0, -1.2, 0, 0.9, 0)
)


def delimited(number, content):
    low, high = len(content) & 0x7F, len(content) >> 7
    return bytes([number << 3 | 2, *([low | 0x80, high] if high else [low])]) + content


def double(value):
    return struct.pack("<d", value)


def command(**data):
    return Command(Header(0, 0), CommandData(**data))


def test_first_reply_is_the_golden_one():
    assert encode_command(command(joint_position=POSE), V1) == FIRST_REPLY
    assert decode_command(FIRST_REPLY, V1) == command(joint_position=POSE)


def test_commands_have_their_known_sizes():
    assert len(FIRST_REPLY) == 77
    wrench = command(joint_position=POSE, wrench=(1, 2, 3, 4, 5, 6))
    assert len(encode_command(wrench, V1)) == 129
    assert len(encode_command(command(joint_position=POSE, joint_torque=POSE), V1)) == 143


def test_poses_are_packed():
    pose = Transformation("flange", (1.0, 2.0, 3.0, 1.0, 0.0, 0.0, 0.0))
    data = encode_command(command(joint_position=POSE, pose=pose), FriVersion.V2_5)
    assert data.endswith(b"\x0a\x06flange\x12\x38" + struct.pack("<7d", *pose.elements))
    assert decode_command(data, FriVersion.V2_5).data.pose == pose


def test_wrench_is_packed():
    data = encode_command(command(wrench=(1, 2, 3, 4, 5, 6)), V1)
    assert bytes.fromhex("12320a30") + struct.pack("<6d", 1, 2, 3, 4, 5, 6) in data


def test_later_version_is_framed_with_length_and_checksum():
    data = encode_command(command(joint_position=POSE), FriVersion.V2_7)
    assert data[4:-4] == FIRST_REPLY
    assert struct.unpack("<I", data[:4]) == (77,)
    assert struct.unpack("<I", data[-4:]) == (zlib.crc32(FIRST_REPLY),)


@pytest.mark.parametrize("generation", GENERATIONS)
@some
@given(data=st.data())
def test_monitoring_comes_back_bit_for_bit(generation, data):
    message = data.draw(monitorings(generation))
    encoded = encode_monitoring(message, generation)
    decoded = decode_monitoring(encoded, generation)
    assert repr(decoded) == repr(message)  # NaN is not equal to itself
    assert encode_monitoring(decoded, generation) == encoded


@pytest.mark.parametrize("generation", GENERATIONS)
@some
@given(data=st.data())
def test_commands_come_back_bit_for_bit(generation, data):
    message = data.draw(commands(generation))
    assert repr(decode_command(encode_command(message, generation), generation)) == repr(message)


@pytest.mark.parametrize("version", VERSIONS)
def test_version_is_told_from_the_bytes(version):
    message = monitoring(version.generation)
    data = encode_monitoring(message, version)
    assert detect(data) is version.generation
    assert version in detect(data).versions
    assert decode_monitoring(data) == message


def test_versions_of_one_generation_cannot_be_told_apart():
    assert len({encode_monitoring(monitoring(), v) for v in Generation.ONE.versions}) == 1
    assert [v.value for v in Generation.ONE.versions] == ["1.11", "1.14", "1.15", "1.16"]


def test_bare_message_without_telling_fields_leaves_the_version_open():
    message = Monitoring(Header(1, 0), connection=ConnectionInfo(SessionState.IDLE, Quality.POOR))
    assert detect(encode_monitoring(message, V1)) is None
    assert decode_monitoring(encode_monitoring(message, V1)) == message


def test_version_is_named_or_refused_with_the_known_ones():
    assert FriVersion.V2_5 is FriVersion.V2_5
    with pytest.raises(ConfigError, match=r"'3.0' is not known; known: 1.11, 1.14.*2.7"):
        FriVersion.named("3.0")


def test_packed_joints_padded_integers_and_unknown_fields_are_read():
    header = b"\x08\x81\x80\x8d\x00\x10\x85\x80\x00\x18\x07"  # padded identifier and sequence
    packed = delimited(1, b"".join(map(double, POSE)))
    unknown = bytes.fromhex("9806b960ed0461626364f20402ffff")  # 99: 12345, 77: float, 78
    data = delimited(1, header + unknown) + delimited(2, delimited(1, packed)) + unknown
    assert decode_command(data, V1) == Command(Header(5, 7), CommandData(joint_position=POSE))


def test_messages_that_come_twice_merge_and_the_last_number_counts():
    second = delimited(1, b"\x10\x09")  # sequence 9
    assert decode_command(FIRST_REPLY + second, V1).header == Header(9, 0)


@pytest.mark.parametrize("count", [0, 6, 8, 14])
def test_any_other_number_of_joints_is_refused_both_ways(count):
    values = b"".join(b"\x09" + double(1.0) for _ in range(count))
    data = FIRST_REPLY[:10] + delimited(2, delimited(1, values))
    with pytest.raises(WireFormatError, match=rf"joint_position has {count} values, expected 7"):
        decode_command(data, V1)
    with pytest.raises(WireFormatError, match=rf"joint_position has {count} values, expected 7"):
        encode_command(command(joint_position=(1.0,) * count), V1)


@pytest.mark.parametrize(
    ("data", "said", "offset"),
    [
        (b"", "header is missing", None),
        (b"\x0a", "header is an integer that does not end", 1),
        (b"\x0a\x05\x08", "header ends 4 bytes after its message", 0),
        (b"\x0a" + b"\x80" * 10 + b"\x00", "header is an integer that does not end", 1),
        (b"\x00\x00", "field 0 is integer, of which FRI has none", 0),
        (b"\x0f", "header is type 7, of which FRI has none", 0),
        (FIRST_REPLY + b"\x12\x03\x0a\x01\x09", "data.joint_position.values ends 8 bytes", 81),
        (FIRST_REPLY + b"\x12\x01\x80", "data.tag is an integer that does not end", 79),
        (FIRST_REPLY + b"\x12\x05\x0a\x03\x0a\x01t", "n.values has 1 bytes, which are no doub", 83),
        (b"\x0b\x0c", "header is group, expected message or text", None),
        (b"\x08\x01", "header is integer, expected message or text", None),
        (FIRST_REPLY + b"\xf3\x04\xf4\x04", "field 78 is a group, of which FRI has none", None),
        (FIRST_REPLY + b"\x0d1234", "header is float, expected message or text", None),
        (FIRST_REPLY + b"\x0a\x09\x09" + bytes(8), "fier is double, expected integer", None),
        (FIRST_REPLY + b"\x12\x04\x0a\x02\x08\x01", "values is integer, expected double", None),
        (FIRST_REPLY[:2] + b"\x08\x81\x80\x0c" + FIRST_REPLY[6:], "no message of FRI", None),
        (FIRST_REPLY[:3] + FIRST_REPLY[3:].replace(b"\x10\x00", b"\x18\x00"), "ence is miss", None),
        (b"\x0a\x04\x10\x00\x18\x00", "header.identifier is missing", None),
        (FIRST_REPLY + b"\x0a\x06\x10\x80\x80\x80\x80\x10", "ence = 4294967296 is outside 0", None),
        (FIRST_REPLY + bytes.fromhex("120b 2a070a01611000 1801 2a00"), "data.io.1.name is", None),
    ],
)
def test_bad_bytes_say_what_and_where(data, said, offset):
    with pytest.raises(WireFormatError, match=said) as error:
        decode_command(data, V1)
    assert error.value.offset == offset


def test_the_other_message_is_named():
    with pytest.raises(WireFormatError, match=r"0x34001 \(command\), expected 0x245142"):
        decode_monitoring(FIRST_REPLY, V1)


def test_broken_frame_is_refused():
    data = encode_monitoring(monitoring(Generation.TWO_SEVEN), Generation.TWO_SEVEN)
    broken = data[:40] + bytes([data[40] ^ 1]) + data[41:]
    for version in (None, Generation.TWO_SEVEN):
        with pytest.raises(WireFormatError, match="checksum"):
            decode_monitoring(broken, version)
    for bad, said in ((data[:-1], "frame says"), (frame(b"\x0a\x05\x08"), "message at byte 4")):
        with pytest.raises(WireFormatError, match=said):
            decode_monitoring(bad, Generation.TWO_SEVEN)
    with pytest.raises(WireFormatError, match=r"framed as in 2\.7"):
        decode_monitoring(data, V1)
    with pytest.raises(WireFormatError, match="neither a bare nor a framed"):
        decode_monitoring(b"hello, robot")


def test_unknown_enum_is_left_out_where_it_may_be_and_refused_where_not():
    data = encode_monitoring(monitoring(), V1)
    assert b"\x38\x00" in data  # control mode position
    assert decode_monitoring(data.replace(b"\x38\x00", b"\x38\x7f")).robot.control_mode is None
    with pytest.raises(WireFormatError, match="quality is missing"):
        decode_monitoring(data.replace(b"\x08\x04\x10\x03", b"\x08\x04\x10\x7f"))


@pytest.mark.parametrize(
    ("message", "said"),
    [
        (command(joint_torque=("a",) * 7), "cannot be written"),
        (command(joint_position=(1.0,) * 7, pose=Transformation("a", (0.0,) * 7)), "has no data.p"),
        (Command(Header(-1, 0)), r"header.sequence = -1 is outside 0"),
        (Command(Header(2**32, 0)), "header.sequence = 4294967296"),
        (command(io=(IoValue("n" * 64, IoType.ANALOG, IoDirection.INPUT),)), "at most 63"),
        (command(io=(IoValue("n", IoType.ANALOG, IoDirection.INPUT),) * 11), "11 values"),
        (command(io=(IoValue("\ud800", IoType.ANALOG, IoDirection.INPUT),)), "cannot be written"),
        (command(transformations=(Transformation("t" * 60, (0.0,) * 12),) * 6), "at most 5"),
    ],
)
def test_what_does_not_fit_is_not_written(message, said):
    with pytest.raises(WireFormatError, match=said):
        encode_command(message, V1)


def test_largest_message_fits_into_a_datagram_or_is_refused():
    largest = Transformation("t" * 63, (0.0,) * 12, Timestamp(1, 2))
    io = (IoValue("n" * 63, IoType.ANALOG, IoDirection.INPUT, None, 1.0),) * 10
    message = Monitoring(
        Header(1, 1), data=MonitorData(io=io), requested_transformations=(largest,)
    )
    assert decode_monitoring(encode_monitoring(message, V1), V1) == message
    with pytest.raises(WireFormatError, match="at most 1500"):
        encode_monitoring(
            Monitoring(
                Header(1, 1), data=MonitorData(io=io), requested_transformations=(largest,) * 5
            ),
            V1,
        )
    with pytest.raises(WireFormatError, match="1501 bytes"):
        decode_command(FIRST_REPLY + b"\x00" * (1501 - 77), V1)


def test_values_of_ios_have_their_type():
    assert IoValue("a", IoType.BOOLEAN, IoDirection.INPUT, 1).value is True
    assert IoValue("a", IoType.DIGITAL, IoDirection.INPUT, 5).value == 5
    assert IoValue("a", IoType.ANALOG, IoDirection.OUTPUT, None, 0.5).value == 0.5
    assert IoValue("a", IoType.BOOLEAN, IoDirection.INPUT).value is None


@some
@given(st.binary(max_size=1600))
def test_random_bytes_are_refused_and_nothing_else(data):
    for generation in (None, *GENERATIONS):
        with pytest.raises(WireFormatError) as error:
            decode_monitoring(data, generation)
        assert "no message of protobuf" not in str(error.value)  # without a word where


@pytest.mark.parametrize("generation", GENERATIONS)
@some
@given(data=st.data())
def test_mutated_messages_are_read_or_refused_and_nothing_else(generation, data):
    original = encode_monitoring(data.draw(monitorings(generation)), generation)
    mutated = bytearray(original)
    for _ in range(data.draw(st.integers(1, 4))):
        at = data.draw(st.integers(0, max(len(mutated) - 1, 0)))
        match data.draw(st.integers(0, 2)):
            case 0:
                mutated[at : at + 1] = data.draw(st.binary(min_size=1, max_size=1))
            case 1:
                del mutated[at : at + data.draw(st.integers(1, 9))]
            case _:
                mutated[at:at] = data.draw(st.binary(min_size=1, max_size=9))
    if generation.framed and data.draw(st.booleans()):  # behind the checksum, too
        inside = bytes(mutated[4:-4])
        mutated = (
            len(inside).to_bytes(4, "little") + inside + zlib.crc32(inside).to_bytes(4, "little")
        )
    for version in (None, generation):
        with suppress(WireFormatError):
            assert isinstance(decode_monitoring(bytes(mutated), version), Monitoring)
