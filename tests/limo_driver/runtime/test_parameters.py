"""Parameters: what each kind takes, held from both sides, and how a refusal reads."""

from dataclasses import dataclass
from enum import Enum
from math import inf, nan, nextafter

import numpy as np
import pytest

from limo_driver.errors import ConfigError, ParameterError
from limo_driver.runtime.parameters import (
    FLAG,
    JOINT,
    TEXT,
    WHOLE,
    Declared,
    Parameter,
    parameter,
    parameters_of,
)


class Side(Enum):
    LEFT = 1
    RIGHT = 2


TORQUE = Parameter("torque", "N m", lower=-2.0, upper=3.0)
GEAR = Parameter("gear", "1", lower=0.0, upper=9.0, above=True)
JOINTS = Parameter("joint", JOINT, kind=WHOLE, lower=1, upper=7)
TIMES = Parameter("times", "s", is_list=True, length=2, lower=0.0)
ROWS = Parameter("rows", is_list=True, columns=2)


@pytest.mark.parametrize(
    ("known", "given", "value"),
    [
        (TORQUE, -2.0, -2.0),
        (TORQUE, 3, 3),
        (TORQUE, np.float64(1.5), 1.5),
        (GEAR, nextafter(0.0, 1.0), nextafter(0.0, 1.0)),
        (Parameter("free"), -1e300, -1e300),
        (Parameter("end", finite=False), inf, inf),
        (JOINTS, np.int64(7), 7),
        (Parameter("n", kind=WHOLE), 2**70, 2**70),
        (Parameter("on", kind=FLAG), False, False),
        (Parameter("name", kind=TEXT), "a", "a"),
        (Parameter("side", of=tuple(Side)), Side.LEFT, Side.LEFT),
        (Parameter("way", of=(1, -1), kind=WHOLE), -1, -1),
        (TIMES, [0, 1.5], (0.0, 1.5)),
        (TIMES, np.array([0.0, 2.0]), (0.0, 2.0)),
        (Parameter("one", is_list=True), 3.0, (3.0,)),
        (ROWS, [[1, 2], np.array([3.0, 4.0])], ((1.0, 2.0), (3.0, 4.0))),
        (ROWS, (), ()),
    ],
)
def test_what_can_be_is_taken(known, given, value):
    assert known.checked(given) == value


@pytest.mark.parametrize(
    ("known", "given", "message"),
    [
        (TORQUE, -2.0001, "torque is -2.0001 N m, expected a number from -2 to 3 N m"),
        (TORQUE, 3.1, "torque is 3.1 N m, expected"),
        (TORQUE, nan, "torque is nan N m, expected"),
        (TORQUE, True, "torque is True, expected"),
        (TORQUE, "1", "torque is '1', expected"),
        (TORQUE, None, "torque is None, expected"),
        (GEAR, 0.0, "gear is 0, expected a number above 0 and up to 9"),
        (Parameter("free"), inf, "free is inf, expected a number"),
        (Parameter("free"), 10**400, "expected a number"),
        (Parameter("most", "s", upper=1.0), 2.0, "most is 2 s, expected a number up to 1 s"),
        (JOINTS, 8, "joint is 8, expected a joint from 1 to 7"),
        (JOINTS, 0, "joint is 0, expected a joint"),
        (JOINTS, 1.0, "joint is 1, expected a joint"),
        (Parameter("on", kind=FLAG), 1, "on is 1, expected true or false"),
        (Parameter("name", kind=TEXT), "", "name is '', expected a text"),
        (Parameter("side", of=tuple(Side)), "left", "side is 'left', expected one of left, right"),
        (Parameter("way", of=(1, -1), kind=WHOLE), True, "way is True, expected one of 1, -1"),
        (TIMES, [1.0], "times is [1], expected a list of 2 numbers of 0 s or more"),
        (TIMES, [1.0, -1.0], "times is -1, expected a list of 2 numbers of 0 s or more"),
        (ROWS, [[1, 2], [3]], "rows is [[1, 2], [3]], expected a list of rows of 2 numbers"),
        (ROWS, [1, 2], "rows is [1, 2], expected a list of rows"),
        (Parameter("n", kind=TEXT, key="in_file"), 3, "in_file is 3, expected a text"),
        (Parameter("long", of=(1,)), "x" * 99, f"long is '{'x' * 59}…, expected one of 1"),
    ],
)
def test_what_cannot_be_is_refused_in_words(known, given, message):
    with pytest.raises(ParameterError) as refused:
        known.checked(given)
    assert message in str(refused.value)


@dataclass(frozen=True, kw_only=True)
class Wheel(Declared):
    _called = "wheel"
    radius: float = parameter("m", "of the tyre", lower=0.0, above=True)
    spokes: int = parameter(lower=0, default=8)
    side: Side = parameter(of=Side, default=Side.LEFT, key="where")
    angles: tuple[float, ...] = parameter("rad", default=())
    other: int | None = parameter(JOINT, default=None)
    name: str = "front"

    def __post_init__(self) -> None:
        super().__post_init__()
        self._increasing("angles")
        if self.spokes == 1:
            raise self._refused("spokes", "none, or 2 or more")


def test_kinds_come_from_annotations():
    known = {item.name: item for item in parameters_of(Wheel)}
    assert list(known) == ["radius", "spokes", "side", "angles", "other"]
    assert [known[name].kind for name in ("spokes", "side", "other")] == [WHOLE, TEXT, WHOLE]
    assert known["radius"].is_number
    assert not known["radius"].optional
    assert known["angles"].is_list
    assert not known["angles"].is_number
    assert known["other"].lower == 1
    assert known["side"].in_file == "where"
    assert known["radius"].description == "of the tyre"


def test_what_is_made_is_checked_and_lists_become_tuples():
    assert Wheel(radius=1, angles=[0, 1]).angles == (0.0, 1.0)
    assert Wheel(radius=1).other is None


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"radius": 0}, "wheel: radius is 0 m, expected a number above 0 m"),
        ({"radius": 1, "spokes": 1}, "wheel: spokes is 1, expected none, or 2 or more"),
        (
            {"radius": 1, "angles": (1, 1)},
            "angles is [1, 1], expected numbers that increase, not 1",
        ),
        ({"radius": 1, "side": "up"}, "wheel: side is 'up', expected one of left, right"),
        ({"radius": 1, "other": 0}, "wheel: other is 0, expected a joint of 1 or more"),
    ],
)
def test_what_cannot_be_made_names_place_and_parameter(values, message):
    with pytest.raises(ConfigError) as refused:
        Wheel(**values)
    assert message in str(refused.value)
    assert isinstance(refused.value, ParameterError)
    assert refused.value.name in values
