"""The codec agrees with code that protobuf generates from `fri.proto`."""

import pytest
from fri_messages import GENERATIONS, commands, compile_schema, monitorings, some
from hypothesis import given
from hypothesis import strategies as st

from backends.fri.codec.codec import decode_monitoring, encode_command, encode_monitoring
from backends.fri.codec.messages import Generation
from limo_driver.errors import WireFormatError


@pytest.fixture(scope="module")
def generated(tmp_path_factory):
    return compile_schema(tmp_path_factory.mktemp("proto"))


def bare(data, generation):
    return data[4:-4] if generation.framed else data


@pytest.mark.parametrize("generation", GENERATIONS)
@some
@given(data=st.data())
def test_generated_code_reads_and_writes_the_same_bytes(generated, generation, data):
    for kind, drawn, encode in (
        (generated.Monitoring, monitorings(generation), encode_monitoring),
        (generated.Command, commands(generation), encode_command),
    ):
        encoded = bare(encode(data.draw(drawn), generation), generation)
        message = kind.FromString(encoded)
        assert message.SerializeToString(deterministic=True) == encoded
        assert not unknown(message)


def unknown(message):
    from google.protobuf.unknown_fields import UnknownFieldSet

    return len(UnknownFieldSet(message)) or any(
        unknown(part)
        for field, value in message.ListFields()
        if field.type == field.TYPE_MESSAGE
        for part in (value if not hasattr(value, "ListFields") else [value])
    )


@some
@given(data=st.data())
def test_what_limo_reads_generated_code_reads_alike(generated, data):
    from google.protobuf.message import DecodeError

    original = encode_monitoring(data.draw(monitorings(Generation.ONE)), Generation.ONE)
    mutated = bytearray(original)
    for _ in range(data.draw(st.integers(0, 3))):
        mutated[data.draw(st.integers(0, len(mutated) - 1))] = data.draw(st.integers(0, 255))
    try:
        ours = decode_monitoring(bytes(mutated), Generation.ONE)
    except WireFormatError:
        return  # limo is the stricter one
    try:
        theirs = generated.Monitoring.FromString(bytes(mutated))
    except DecodeError as error:
        raise AssertionError(f"limo read {mutated.hex()}") from error
    assert ours.header.sequence == theirs.header.sequence_counter
    assert ours.header.reflected == theirs.header.reflected_sequence_counter
    for name in ("measured_position", "measured_torque", "external_torque"):
        given_values = getattr(ours.data, name, None) or ()
        assert repr(list(given_values)) == repr(list(getattr(theirs.data, name).value))
    if ours.connection is not None:
        assert ours.connection.session_state == theirs.connection.session_state
        assert ours.connection.quality == theirs.connection.quality
        assert (ours.connection.send_period or 0) == theirs.connection.send_period
