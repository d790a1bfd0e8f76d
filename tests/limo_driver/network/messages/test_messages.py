"""Messages against bytes written by hand, and against whatever a network can deliver."""

import struct
from functools import partial

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from lanes import sampled

from limo_driver.errors import ConfigError, ShapeError, WireFormatError
from limo_driver.network.messages import (
    Attachment,
    EstimateDraft,
    Event,
    JointStateCodec,
    Level,
    LiveJointStateCodec,
    RosAttachment,
    TorqueEstimateCodec,
    decode_event,
    decode_joint_state,
    decode_torque_estimate,
    relabelled,
)
from limo_driver.network.messages.cdr import CdrReader

STAMP = 1_500_000_002
TWO = (np.array([1.0, -2.0]), np.array([0.5, 0.0]), np.array([3.0, 4.0]))
NONE = np.zeros(0)

HEADER = bytes.fromhex(
    "00010000"  # CDR, little-endian
    "01000000 0265cd1d"  # 1 s and 500000002 ns
    "05000000 62617365 00 000000"  # "base", its NUL, padding
    "02000000"  # two names
    "02000000 6100 0000"  # "a", padding
    "03000000 626200 00"  # "bb", padding
)
JOINT_STATE = HEADER + bytes.fromhex(
    "02000000 00000000"  # two positions; 8-aligned already after four bytes
    "000000000000f03f 00000000000000c0"
    "02000000 00000000"
    "000000000000e03f 0000000000000000"
    "02000000 00000000"
    "0000000000000840 0000000000001040"
)
ESTIMATE = HEADER + bytes.fromhex(
    "02000000 00000000 000000000000f03f 00000000000000c0"
    "02000000 00000000 000000000000e03f 0000000000000000"
    "02000000 00000000 0000000000000840 0000000000001040"
    "02000000 0001 0000"  # False, True, padding
    "03000000 763300 00 01"  # "v3"; fallback False, reset True
    "c40900"  # 2500 ms since memory began anew
)
LOG = (
    bytes.fromhex(
        "00010000 01000000 0265cd1d"
        "1e 000000"  # WARN, padding
        "08000000 636f6e7461637400"  # "contact"
        "23000000"
    )
    + b'{"text": "hit", "facts": {"j": 2}}\x00'
    + bytes.fromhex("00 02000000 6600 0000 01000000 00 000000 07000000")  # "f", "", 7
)


def joint_state_equals(message, stamp, frame_id, names, arrays):
    assert (message.stamp_ns, message.frame_id, message.names) == (stamp, frame_id, names)
    for given_, expected in zip(
        (message.position, message.velocity, message.torque), arrays, strict=True
    ):
        np.testing.assert_array_equal(given_, expected)
        assert given_.dtype == np.float64
        assert not given_.flags.writeable
    return True


def offset_of_refusal(decode, data):
    """Decode; return where the bytes were refused, or None if they were not."""
    try:
        decode(data)
    except WireFormatError as error:
        offset = error.offset
    else:
        return None
    assert 0 <= offset <= len(data) + 7  # the next field may begin after padding
    return offset


def estimate_of(codec):
    about = {"model": "v3", "reset": True, "since_gap": 2.5}
    return codec.encode(STAMP, *TWO, np.array([False, True]), **about)


def test_joint_state_is_these_bytes():
    codec = JointStateCodec(["a", "bb"], "base")
    assert codec.encode(STAMP, *TWO).hex(" ") == JOINT_STATE.hex(" ")
    live = LiveJointStateCodec(["a", "bb"], "base")
    for decode in (codec.decode, live.decode, decode_joint_state):
        for payload in (JOINT_STATE, memoryview(JOINT_STATE), bytearray(JOINT_STATE)):
            assert joint_state_equals(decode(payload), STAMP, "base", ("a", "bb"), TWO)


def test_empty_sequences_have_no_padding():
    codec = JointStateCodec(["a", "bb"], "base")
    payload = codec.encode(STAMP, NONE, NONE, TWO[0])
    assert payload == HEADER + bytes.fromhex(
        "00000000 00000000 02000000 00000000 000000000000f03f 00000000000000c0"
    )
    assert joint_state_equals(
        codec.decode(payload), STAMP, "base", ("a", "bb"), (NONE, NONE, TWO[0])
    )


def test_big_endian_is_read_too():
    payload = (
        bytes.fromhex("00000000 00000001 1dcd6502 00000001 00 000000 00000001 00000002 6100 0000")
        + struct.pack(">Id", 1, 2.5)
        + struct.pack(">II", 0, 0)
    )
    expected = (np.array([2.5]), NONE, NONE)
    assert joint_state_equals(decode_joint_state(payload), STAMP, "", ("a",), expected)


def test_a_message_laid_out_otherwise_is_still_decoded():
    other = JointStateCodec(["b", "aa"], "base")
    message = other.decode(JOINT_STATE)
    assert joint_state_equals(message, STAMP, "base", ("a", "bb"), TWO)


@pytest.mark.parametrize("before", ["", "v2"])
def test_an_attachment_takes_the_version_of_another_model(before):
    came = Attachment(5, -6, before, holding=True).encode()
    assert relabelled(came, "v10") == Attachment(5, -6, "v10", holding=True).encode()


def test_estimate_is_these_bytes():
    codec = TorqueEstimateCodec(["a", "bb"], "base")
    assert estimate_of(codec).hex(" ") == ESTIMATE.hex(" ")
    estimate = decode_torque_estimate(ESTIMATE)
    assert (estimate.stamp_ns, estimate.frame_id) == (STAMP, "base")
    assert (estimate.names, estimate.model) == (("a", "bb"), "v3")
    assert (estimate.fallback, estimate.reset, estimate.since_gap) == (False, True, 2.5)
    for given_, expected in zip(
        (estimate.torque, estimate.std, estimate.external), TWO, strict=True
    ):
        np.testing.assert_array_equal(given_, expected)
    assert estimate.outside.tolist() == [False, True]


def test_listeners_of_before_and_after_read_how_long_memory_has_gone_on_or_all_but_that():
    before = ESTIMATE[:-3]
    for padded in range(4):  # senders that fill up to a whole word
        old = decode_torque_estimate(before + bytes(padded))
        assert old.reset
        assert np.isnan(old.since_gap)
    reader = CdrReader(ESTIMATE)  # as those of before read it
    reader.time("stamp"), reader.string("frame_id"), reader.strings("name")
    for name in ("torque", "std", "external"):
        reader.doubles(name)
    assert reader.flags("outside").tolist() == [False, True]
    assert reader.string("model") == "v3"
    assert (reader.flag("fallback"), reader.flag("reset")) == (False, True)
    reader.end()


@pytest.mark.parametrize(
    ("given_", "read"), [(0.0, 1e-3), (0.0104, 0.010), (1e9, 16777.215), (np.nan, np.nan)]
)
def test_a_gap_is_told_in_whole_milliseconds(given_, read):
    codec = TorqueEstimateCodec(["a", "bb"])
    payload = codec.encode(STAMP, *TWO, np.zeros(2, bool), since_gap=given_)
    assert decode_torque_estimate(payload).since_gap == pytest.approx(read, nan_ok=True)


def test_estimate_without_standard_deviations():
    codec = TorqueEstimateCodec(["a", "bb"])
    estimate = decode_torque_estimate(
        codec.encode(STAMP, TWO[0], NONE, TWO[2], np.zeros(0, bool), fallback=True)
    )
    assert (estimate.std.size, estimate.outside.size, estimate.model) == (0, 0, "")
    np.testing.assert_array_equal(estimate.external, TWO[2])
    assert estimate.fallback


def test_event_is_these_bytes():
    event = Event(STAMP, Level.WARN, "contact", "hit", {"j": 2}, "f", line=7)
    assert event.encode().hex(" ") == LOG.hex(" ")
    assert decode_event(LOG) == event


@pytest.mark.parametrize(
    ("attachment", "literal"),
    [
        (Attachment(5, -1), "01 00 0500000000000000 ffffffffffffffff"),
        (
            Attachment(2, 258, "v3", stale=True, holding=True),
            "01 03 0200000000000000 0201000000000000 7633",
        ),
        (
            RosAttachment(5, 258, bytes(range(16))),
            "0500000000000000 0201000000000000 10 000102030405060708090a0b0c0d0e0f",
        ),
    ],
)
def test_attachments_are_these_bytes(attachment, literal):
    assert attachment.encode() == bytes.fromhex(literal)
    assert type(attachment).decode(bytes.fromhex(literal)) == attachment


@pytest.mark.parametrize(
    ("decode", "data", "message"),
    [
        (Attachment.decode, b"", "0 bytes, expected at least 18 at byte 0"),
        (Attachment.decode, b"\x02" + bytes(17), "version 2, expected 1 at byte 0"),
        (Attachment.decode, b"\x01\x04" + bytes(16), "unknown flags 0x04 at byte 1"),
        (Attachment.decode, b"\x01" + bytes(17) + b"v\xff", "no UTF-8 at byte 19"),
        (RosAttachment.decode, bytes(32), "32 bytes, expected 33 at byte 32"),
        (RosAttachment.decode, bytes(33), "gid of 0 bytes, expected 16 at byte 16"),
        (decode_joint_state, b"", "message of 0 bytes"),
        (decode_joint_state, b"\x00\x07\x00\x00", "encoding 00 07"),
        (decode_joint_state, JOINT_STATE[:10], "stamp needs 4 bytes, 2 are left at byte 8"),
        (decode_joint_state, JOINT_STATE[:-1], "effort needs 16 bytes, 15 are left at byte 100"),
        (decode_joint_state, JOINT_STATE + bytes(4), "4 bytes after the last field at byte 116"),
        (
            decode_joint_state,
            HEADER[:8] + b"\xff" * 4 + HEADER[12:],
            "stamp has 4294967295 ns, expected less than a second at byte 8",
        ),
        (
            decode_joint_state,
            HEADER[:12] + b"\xff" * 4 + HEADER[16:],
            "frame_id needs 4294967295 bytes, .* at byte 16",
        ),
        (
            decode_joint_state,
            HEADER[:16] + b"b\xffse\x00" + HEADER[21:],
            "frame_id is no UTF-8 at byte 17",
        ),
        (
            decode_joint_state,
            HEADER[:20] + b"X" + HEADER[21:],
            "frame_id does not end in a NUL at byte 20",
        ),
        (
            decode_joint_state,
            HEADER + struct.pack("<I4xdII", 1, 1.0, 0, 0),
            "lengths name 2, position 1, velocity 0, effort 0; expected one length",
        ),
        (decode_torque_estimate, ESTIMATE[:-4], "reset needs 1 bytes, 0 are left"),
        (decode_torque_estimate, ESTIMATE[:-4] + b"\x02", "reset has 2, expected 0 or 1"),
        (decode_torque_estimate, ESTIMATE[:-16] + b"\x03" + ESTIMATE[-15:], "outside has 3"),
        (decode_event, LOG[:12] + b"\x05" + LOG[13:], "level is 5, expected one of 10, 20, 30"),
        (decode_event, LOG.replace(b'{"text"', b'["text"'), "msg is no JSON object"),
        (decode_event, LOG.replace(b'"facts"', b'"fakts"'), "with text and facts"),
        (decode_event, LOG.replace(b'"facts": {"j": 2}', b'"facts": {"j":NaN'), "no JSON object"),
    ],
)
def test_malformed_bytes_are_named_with_their_offset(decode, data, message):
    with pytest.raises(WireFormatError, match=message):
        decode(data)


@pytest.mark.parametrize("kind", [JointStateCodec, LiveJointStateCodec])
def test_a_usual_message_with_a_wrong_time_is_refused(kind):
    payload = JOINT_STATE[:8] + b"\xff" * 4 + JOINT_STATE[12:]
    with pytest.raises(WireFormatError, match="expected less than a second"):
        kind(["a", "bb"], "base").decode(payload)


def test_live_states_are_read_into_the_same_arrays_if_they_are_laid_out_alike():
    codec, other = LiveJointStateCodec(["a", "bb"], "base"), JointStateCodec(["a", "bc"], "base")
    first = codec.decode(JOINT_STATE)
    doubled = [2.0 * values for values in TWO]
    assert codec.decode(codec.encode(STAMP, *doubled)).torque is first.torque
    np.testing.assert_array_equal(first.position, doubled[0])
    for payload, names in (
        (other.encode(STAMP, *TWO), ("a", "bc")),
        (codec.encode(STAMP, TWO[0], NONE, TWO[2]), ("a", "bb")),
    ):
        assert codec.decode(payload).names == names
        np.testing.assert_array_equal(first.position, doubled[0])


def test_an_estimate_written_in_place_is_that_which_is_encoded_at_once():
    codec = TorqueEstimateCodec(["a", "bb"], "base")
    draft = EstimateDraft(codec, "v3", fallback=True)
    for reset in (True, False):
        outside = np.array([reset, True])
        draft.torque[:], draft.std[:], draft.external[:] = TWO
        draft.outside[:] = outside
        about = {"reset": reset, "since_gap": 12.3 - 12.3 * reset}
        expected = codec.encode(STAMP, *TWO, outside, model="v3", fallback=True, **about)
        assert draft.finished(STAMP, **about).hex(" ") == expected.hex(" ")
    assert all(values.flags.aligned for values in (draft.torque, draft.std, draft.external))


@pytest.mark.parametrize("wrong", [np.zeros(3), np.zeros((2, 1)), np.zeros((2, 2)), np.zeros(1)])
def test_arrays_of_another_shape_are_not_encoded(wrong):
    with pytest.raises(ShapeError, match=r"velocity has shape .*expected \(2,\) or \(0,\)"):
        JointStateCodec(["a", "bb"]).encode(0, TWO[0], wrong, TWO[2])
    with pytest.raises(ShapeError, match=r"std has shape .*expected \(2,\) or \(0,\)"):
        TorqueEstimateCodec(["a", "bb"]).encode(0, TWO[0], wrong, TWO[2], np.zeros(2, bool))


@pytest.mark.parametrize("stamp", [2**31 * 10**9, -(2**31) * 10**9 - 1])
def test_stamps_that_do_not_fit_are_not_encoded(stamp):
    with pytest.raises(WireFormatError, match="expected seconds of 32 bits"):
        JointStateCodec(["a", "bb"]).encode(stamp, *TWO)


@pytest.mark.parametrize("facts", [{"a": float("nan")}, {"a": object()}, {"a": "\ud800"}])
def test_facts_that_json_cannot_hold_are_refused(facts):
    with pytest.raises(ConfigError, match="facts of event 'drift' cannot be written as JSON"):
        Event(0, Level.INFO, "drift", "", facts).encode()


def test_attachments_that_do_not_fit_are_refused():
    with pytest.raises(ConfigError, match=f"sequence is {2**63}, expected a whole number of 64"):
        Attachment(2**63, 0).encode()
    with pytest.raises(ConfigError, match="stamp_ns is -"):
        RosAttachment(0, -(2**63) - 1, bytes(16)).encode()
    with pytest.raises(ConfigError, match="gid has 15 bytes, expected 16"):
        RosAttachment(0, 0, bytes(15)).encode()


texts = st.text(st.characters(codec="utf-8"), max_size=8)
numbers = st.floats(width=64)
stamps = st.integers(-(2**31) * 10**9, 2**31 * 10**9 - 1)


@st.composite
def joint_states(draw):
    names = draw(st.lists(texts, max_size=5))
    n = len(names)
    arrays = [
        np.array(draw(st.lists(numbers, min_size=k, max_size=k)))
        for k in draw(st.tuples(*[st.sampled_from([0, n])] * 3))
    ]
    return tuple(names), draw(texts), draw(stamps), arrays


@given(joint_states())
@example((("a",), "", 0, [np.array([np.nan]), np.array([np.inf]), np.array([-0.0])]))
def test_joint_states_come_back_as_they_were(state):
    names, frame_id, stamp, arrays = state
    codec = JointStateCodec(names, frame_id)
    payload = codec.encode(stamp, *arrays)
    for decode in (codec.decode, decode_joint_state):
        assert joint_state_equals(decode(payload), stamp, frame_id, names, arrays)


@given(st.binary(max_size=200))
@example(b"\x00\x01\x00\x00" + b"\xff" * 40)
def test_any_bytes_are_decoded_or_refused(data):
    for decode in (
        decode_joint_state,
        JointStateCodec(["a"]).decode,
        decode_torque_estimate,
        decode_event,
        Attachment.decode,
        RosAttachment.decode,
    ):
        offset_of_refusal(decode, data)


@sampled(
    ("decode", "payload"),
    [
        (partial(JointStateCodec.decode, JointStateCodec(["a", "bb"], "base")), JOINT_STATE),
        (decode_joint_state, JOINT_STATE),
        (decode_torque_estimate, ESTIMATE),
        (decode_event, LOG),
    ],
    "10 000 messages each",
    ids=["joint state", "joint state of anyone", "estimate", "event"],
)
def test_mutated_messages_are_decoded_or_refused(decode, payload):
    """Flip, cut and lengthen 10 000 times each: nothing but a WireFormatError comes of it."""
    random = np.random.default_rng(0)
    refused, rounds = 0, 10_000
    places = random.integers(0, len(payload), (rounds, 3))
    values = random.integers(0, 256, (rounds, 3))
    ends = random.integers(0, len(payload) + 6, rounds)
    for where, what, end in zip(places.tolist(), values.tolist(), ends.tolist(), strict=True):
        mutated = bytearray(payload) + bytes(6)
        for at, value in zip(where, what, strict=True):
            mutated[at] = value
        data = bytes(mutated[: end if end % 2 else len(payload)])
        refused += offset_of_refusal(decode, data) is not None
    assert 0.3 * rounds < refused < rounds
