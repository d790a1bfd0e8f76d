"""IOs and transformations that the application names, and clients of another version."""

from __future__ import annotations

import pytest
from controller_runs import session
from lanes import sampled

from backends.fri.codec.codec import encode_command
from backends.fri.codec.messages import (
    Command,
    CommandData,
    FriVersion,
    Generation,
    Header,
    IoDirection,
    IoType,
    IoValue,
    Transformation,
)
from backends.fri.simulator.judge import (
    Signals,
    check_signal_name,
    display_name,
    monitored_as_of,
    parse_io,
)
from limo_driver.errors import ConfigError

pytestmark = pytest.mark.waits

SEVEN = (0.1,) * 7
SET = IoValue("FRI.Seconds", IoType.DIGITAL, IoDirection.OUTPUT, digital=7)


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("A.On:bool:input", IoValue("A.On", IoType.BOOLEAN, IoDirection.INPUT, digital=0)),
        ("A.On:bool:output:1", IoValue("A.On", IoType.BOOLEAN, IoDirection.OUTPUT, digital=1)),
        ("A.N:digital:input:12", IoValue("A.N", IoType.DIGITAL, IoDirection.INPUT, digital=12)),
        ("A.V:analog:output:-1.5", IoValue("A.V", IoType.ANALOG, IoDirection.OUTPUT, analog=-1.5)),
    ],
)
def test_ios_are_read_from_options(text: str, expected: IoValue) -> None:
    assert parse_io(text) == expected


@pytest.mark.parametrize(
    "text",
    ["A", "A:bool", "A:int:input", "A:bool:both", "A:bool:input:2", "A:digital:input:-1",
     "A:analog:input:nan", ":bool:input", "A:bool:input:1:2", f"{'x' * 64}:bool:input"],
)  # fmt: skip
def test_what_is_no_io_is_refused_by_name(text: str) -> None:
    with pytest.raises(ConfigError):
        parse_io(text)


def test_no_more_are_named_than_a_message_holds_and_each_once() -> None:
    with pytest.raises(ConfigError, match="at most 10 IOs"):
        Signals(tuple(parse_io(f"A.N{k}:bool:input") for k in range(11)))
    with pytest.raises(ConfigError, match="at most 5 transformations"):
        Signals((), ("A", "A"))
    with pytest.raises(ConfigError, match="no name"):
        check_signal_name("")


def test_outputs_and_frames_that_were_asked_for_are_kept() -> None:
    ios = tuple(map(parse_io, ("FRI.Seconds:digital:output", "FRI.Clock:bool:input:1")))
    signals = Signals(ios, ("PickPos",))
    frame = Transformation("PickPos", (0.1, 0.2, 0.3, 1.0, 0.0, 0.0, 0.0))
    assert list(signals.take(CommandData(SEVEN, io=(SET,), transformations=(frame,)))) == []
    assert signals.as_json() == {
        "ios": {"FRI.Seconds": 7, "FRI.Clock": True},
        "transformations": {"PickPos": [0.1, 0.2, 0.3, 1.0, 0.0, 0.0, 0.0]},
    }
    assert signals.requested(Generation.TWO_FIVE)[0].name == "PickPos"


@pytest.mark.parametrize(
    ("given", "said"),
    [
        (IoValue("FRI.X", IoType.DIGITAL, IoDirection.OUTPUT, digital=1), "does not name"),
        (IoValue("FRI.Clock", IoType.BOOLEAN, IoDirection.INPUT, digital=1), "is an input"),
        (IoValue("FRI.Seconds", IoType.ANALOG, IoDirection.OUTPUT, analog=1.0), "as analog"),
    ],
)
def test_what_a_client_may_not_set_is_said_and_has_no_effect(given: IoValue, said: str) -> None:
    ios = tuple(map(parse_io, ("FRI.Seconds:digital:output", "FRI.Clock:bool:input")))
    signals = Signals(ios)
    [complaint] = signals.take(CommandData(SEVEN, io=(given,)))
    assert said in complaint
    assert signals.ios == ios


def command(version: FriVersion, data: CommandData | None) -> bytes:
    return encode_command(Command(Header(0, 0), data), version)


def test_clients_of_another_version_are_told_by_how_they_answer() -> None:
    old, new, framed = (FriVersion.named(name) for name in ("1.15", "2.5", "2.7"))
    mirrored, header = CommandData(SEVEN), None
    assert "version mismatch" in display_name(command(framed, header), old)
    assert "not framed" in display_name(command(old, mirrored), framed)
    assert display_name(b"GET / HTTP/1.1", framed) == ""
    for version, data, said in (
        (old, mirrored, ""),
        (old, header, "as those of FRI 2.5"),
        (new, header, ""),
        (new, mirrored, "as those of FRI 1.x"),
        (framed, mirrored, "as those of FRI 1.x"),
    ):
        assert said in monitored_as_of(Command(Header(0, 0), data), version)
        assert bool(said) == bool(monitored_as_of(Command(Header(0, 0), data), version))


@sampled(
    ("spoken_by", "fri", "mismatch"),
    [("2.5", "1.15", True), ("2.5", "2.5", False), ("1", "1.15", False)],
    "a session each, at the pace of a real controller",
)
def test_a_client_of_another_version_is_told_over_udp(
    spoken_by: str, fri: str, *, mismatch: bool
) -> None:
    ran = session(("--generation", spoken_by), fri=fri)
    assert ("version mismatch" in ran.complaints) == mismatch
