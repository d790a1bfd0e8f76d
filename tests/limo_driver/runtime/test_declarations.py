"""Declarations: YAML and JSON are read alike, and every mistake is reported at its place."""

from dataclasses import dataclass
from pathlib import Path

import pytest

from limo_driver.errors import ConfigError, ModelStoreError
from limo_driver.runtime.declarations import ConfigNode, read_json, read_yaml
from limo_driver.runtime.parameters import JOINT, WHOLE, Declared, Parameter, parameter


@dataclass(frozen=True, kw_only=True)
class Push(Declared):
    joint: int = parameter(JOINT)
    torque: float = parameter("N m", lower=-300.0, upper=300.0)
    until: float = parameter("s", lower=0.0, default=1.0, key="for")

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.torque == 0:
            raise self._refused("torque", "some torque")
        if self.until > 100:
            raise ConfigError("pushes for too long")


@dataclass(frozen=True, kw_only=True)
class Silence(Declared):
    pass


KINDS = {"push": Push, "silence": Silence}


def yaml(tmp_path: Path, text: str) -> ConfigNode:
    path = tmp_path / "a.yaml"
    path.write_text(text)
    return read_yaml(path, needs="`events:`")


def json(tmp_path: Path, text: str) -> ConfigNode:
    path = tmp_path / "a.json"
    path.write_text(text)
    return read_json(path, ModelStoreError, 1)


def events(given: ConfigNode) -> list[Declared]:
    return [entry.make_one_of("event", KINDS, 7) for entry in given["events"].sections()]


FOUND = [Push(joint=2, torque=10.0), Silence(), Push(joint=1, torque=-1.5, until=3.0)]


def test_both_formats_say_the_same(tmp_path):
    text = (
        '{"schema": 1, "events": [{"event": "push", "joint": 2, "torque": 10}, '
        '{"event": "silence"}, {"event": "push", "joint": 1, "torque": -1.5, "for": 3}]}'
    )
    assert events(yaml(tmp_path, text)) == FOUND
    assert events(json(tmp_path, text)) == FOUND


def test_yaml_takes_numbers_as_python_does(tmp_path):
    given = yaml(tmp_path, "a: 1e-5\nb: 0x1F\nc: 2e3\nd: '4'\ne: 7\nf: true\ng: 3.0")
    assert given.number("a") == 1e-5
    assert given.number("d") == 4.0
    assert [given.take(Parameter(name, kind=WHOLE)) for name in "bceg"] == [31, 2000, 7, 3]
    assert given.text("e") == "7"
    assert given.flag("f") is True
    assert given.numbers("a") == (1e-5,)


@pytest.mark.parametrize(
    ("text", "line", "message"),
    [
        ("", None, "a.yaml: is empty; it needs `events:`"),
        ("[]", 1, "is a list, expected a mapping of `key: value`"),
        ("seed: 1", 1, "lacks events"),
        ("events: 3", 1, "events is '3', expected a list of mappings"),
        ("events: {a: 1}", 1, "events is a mapping, expected a list of mappings"),
        ("events:\n  - 3", 2, "events: number 1 is '3', expected a mapping"),
        ("events:\n  - {}", 2, "events: number 1: lacks `event:`, one of push, silence"),
        ("events:\n  - event: rain", 2, "event is 'rain', expected one of push, silence"),
        (
            "events:\n  - event: push\n    at: 1",
            3,
            "events: push: has no 'at'; it has event, joint",
        ),
        ("events:\n  - event: push\n    joint: 1", 2, "events: push: lacks torque"),
        (
            "events:\n  - event: push\n    torque: 1\n    joint: 8",
            4,
            "events: push: joint is 8, expected a joint from 1 to 7",
        ),
        (
            "events:\n  - event: push\n    joint: 1\n    torque: x",
            4,
            "events: push: torque is 'x', expected a number from -300 to 300 N m",
        ),
        (
            "events:\n  - event: push\n    joint: 1\n    torque: 0",
            4,
            "events: push: torque is 0 N m, expected some torque",
        ),
        ("events:\n  - {event: push, joint: 1, torque: 1, for: 101}", 2, "pushes for too long"),
        ("events:\n  - {event: push, joint: 1, joint: 2}", 2, "has 'joint' twice"),
        ("events:\n  - {[1]: 2}", 2, "has a list as a name, expected a text"),
        ("events: [", 1, "is no YAML"),
    ],
)
def test_a_mistake_in_yaml_is_reported_at_its_line(tmp_path, text, line, message):
    with pytest.raises(ConfigError) as refused:
        events(yaml(tmp_path, text))
    assert message in str(refused.value)
    assert str(tmp_path / "a.yaml") in str(refused.value)
    if message != "is no YAML":
        assert refused.value.line == line


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("{", "a.json: is no JSON"),
        ("[]", "a.json: its schema is not 1"),
        ('{"schema": 1}', "a.json: lacks events"),
        ('{"schema": 1, "events": null}', "events is None, expected a list of objects"),
        ('{"schema": 1, "events": [3]}', "events: number 1 is 3, expected an object"),
        (
            '{"schema": 1, "events": [{"event": "push", "joint": "1", "torque": 1}]}',
            "events: push: joint is '1', expected a joint from 1 to 7",
        ),
        (
            '{"schema": 1, "events": [{"event": "push", "joint": 1, "torque": true}]}',
            "events: push: torque is True, expected a number",
        ),
    ],
)
def test_a_mistake_in_json_is_reported_by_the_way_to_it(tmp_path, text, message):
    with pytest.raises(ModelStoreError) as refused:
        events(json(tmp_path, text))
    assert message in str(refused.value)


def test_a_file_that_is_not_there_is_named(tmp_path):
    with pytest.raises(ConfigError, match=r"none\.yaml: cannot be read: No such file"):
        read_yaml(tmp_path / "none.yaml")
    with pytest.raises(ModelStoreError, match=r"none\.json: cannot be read: No such file"):
        read_json(tmp_path / "none.json", ModelStoreError, 1)
