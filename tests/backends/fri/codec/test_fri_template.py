"""The hot path gives what the codec gives, to the bit."""

import pytest
from fri_messages import GENERATIONS, commands, monitoring, monitorings, some
from hypothesis import given
from hypothesis import strategies as st

from backends.fri.codec.codec import (
    decode_command,
    decode_monitoring,
    encode_command,
    encode_monitoring,
)
from backends.fri.codec.messages import (
    Command,
    CommandData,
    ConnectionInfo,
    Generation,
    Header,
    IoDirection,
    IoType,
    IoValue,
    Quality,
    SessionState,
    Timestamp,
)
from backends.fri.codec.template import (
    MOST_LAYOUTS,
    MOST_WRITTEN,
    CommandTemplate,
    MonitoringTemplate,
)
from limo_driver.errors import WireFormatError


def cycles(generation, count=300):
    for k in range(count):
        message = monitoring(generation, sequence=2**14 - 150 + k)
        data = message.data._replace(
            measured_position=tuple(0.1 * j + 1e-3 * k for j in range(7)),
            timestamp=Timestamp(1_700_000_000, 268_000_000 + k * 2_000_000 - 300_000),
        )
        yield message._replace(header=Header(2**14 - 150 + k, 120 + k), data=data)


@pytest.mark.parametrize("generation", GENERATIONS)
def test_cycles_are_read_and_written_as_by_the_codec(generation):
    template = MonitoringTemplate(generation)
    for message in cycles(generation):
        data = encode_monitoring(message, generation)
        assert template.decode(data) == message
        assert template.encode(message) == data


@pytest.mark.parametrize("generation", GENERATIONS)
@some
@given(data=st.data())
def test_any_messages_are_read_and_written_as_by_the_codec(generation, data):
    for draw, template, decode, encode in (
        (monitorings, MonitoringTemplate(generation), decode_monitoring, encode_monitoring),
        (commands, CommandTemplate(generation), decode_command, encode_command),
    ):
        for message in data.draw(st.lists(draw(generation), min_size=1, max_size=3)) * 2:
            datagram = encode(message, generation)
            assert template.encode(message) == datagram
            assert repr(template.decode(datagram)) == repr(decode(datagram, generation))


@pytest.mark.parametrize("generation", GENERATIONS)
@some
@given(data=st.data())
def test_mutated_datagrams_are_judged_as_by_the_codec(generation, data):
    original = encode_monitoring(monitoring(generation, sequence=300), generation)
    template = MonitoringTemplate(generation)
    template.decode(original)
    mutated = bytearray(original)
    for _ in range(data.draw(st.integers(1, 3))):
        mutated[data.draw(st.integers(0, len(mutated) - 1))] ^= data.draw(st.integers(1, 255))
    outcomes = []
    for decode in (template.decode, lambda d: decode_monitoring(d, generation)):
        try:
            outcomes.append(repr(decode(bytes(mutated))))
        except WireFormatError as error:
            outcomes.append(str(error))
    assert outcomes[0] == outcomes[1]


def test_change_of_state_is_seen_at_once():
    template = MonitoringTemplate(Generation.ONE)
    for state in (*SessionState, *reversed(SessionState)):
        for quality in Quality:
            info = ConnectionInfo(state, quality, 1, 1)
            message = monitoring(sequence=9, connection=info)
            data = encode_monitoring(message, Generation.ONE)
            assert template.decode(data).connection == info
            assert template.encode(message) == data
    assert len(template._written) == MOST_WRITTEN


def test_analog_inputs_do_not_leave_the_hot_path(monkeypatch):
    def message(k):
        io = tuple(
            IoValue(f"Tool.Force{j}", IoType.ANALOG, IoDirection.INPUT, analog=0.1 * k + j)
            for j in range(3)
        )
        plain = monitoring(sequence=200 + k)
        return plain._replace(data=plain.data._replace(io=io))

    template = MonitoringTemplate(Generation.ONE)
    first = encode_monitoring(message(0), Generation.ONE)
    assert template.decode(first) == message(0)
    assert template.encode(message(0)) == first
    monkeypatch.setattr("backends.fri.codec.template.decode", None)
    for k in range(1, 20):
        data = encode_monitoring(message(k), Generation.ONE)
        assert template.decode(data) == message(k)
        assert template.encode(message(k)) == data


def test_integer_padded_to_the_length_of_a_double_stays_an_integer():
    data = encode_monitoring(monitoring(), Generation.ONE)
    at = data.index(bytes.fromhex("08041003"))  # state and quality
    template = MonitoringTemplate(Generation.ONE)
    for quality in (3, 2, 0):
        padded = bytes((0x08, 0x04, 0x10, quality | 0x80, *[0x80] * 6, 0x00))
        size = data[at - 1]
        inner = padded + data[at + 4 : at + size]
        spoiled = data[: at - 1] + bytes([len(inner)]) + inner + data[at + size :]
        assert template.decode(spoiled) == decode_monitoring(spoiled, Generation.ONE)
        assert template.decode(spoiled).connection.quality is Quality(quality)


def test_negative_zero_is_not_taken_for_zero():
    template = CommandTemplate(Generation.ONE)
    for value in (0.0, -0.0):
        io = (IoValue("a", IoType.ANALOG, IoDirection.OUTPUT, None, value),)
        message = Command(Header(1, 1), CommandData((value,) * 7, io=io))
        assert template.encode(message) == encode_command(message, Generation.ONE)


def test_what_does_not_fit_is_refused_in_the_hot_path_too():
    template = CommandTemplate(Generation.ONE)
    good = Command(Header(1, 1), CommandData((0.0,) * 7))
    template.encode(good)
    for bad in (
        good._replace(header=Header(-1, 1)),
        good._replace(header=Header(2**32, 1)),
        good._replace(data=CommandData((0.0,) * 6)),
        good._replace(data=CommandData(("a",) * 7)),
    ):
        with pytest.raises(WireFormatError):
            template.encode(bad)
    assert template.encode(good) == encode_command(good, Generation.ONE)


def test_memory_of_layouts_is_bounded():
    template = MonitoringTemplate(Generation.ONE)
    for k in range(3 * MOST_LAYOUTS):
        io = (IoValue("n" * (k % 60), IoType.DIGITAL, IoDirection.INPUT, 2**k if k < 64 else 0),)
        message = monitoring(sequence=k)
        message = message._replace(data=message.data._replace(io=io))
        data = encode_monitoring(message, Generation.ONE)
        assert template.decode(data) == message
        assert template.encode(message) == data
    assert len(template._by_length) <= MOST_LAYOUTS
