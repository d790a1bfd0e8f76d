"""Parameters: named values with kind, unit and bounds, declared once and checked wherever given.

```python
@dataclass(frozen=True, kw_only=True)
class Push(Declared):  # its docstring says under `Args:` what they are
    joint: int = parameter(JOINT, upper=7)
    torque: float = parameter("N m", lower=-300.0, upper=300.0)
```
`limo_driver.runtime.declarations` reads such a class from a file.
"""

from __future__ import annotations

import math
import operator
import re
from collections.abc import Iterable
from dataclasses import MISSING, dataclass, field, fields
from enum import Enum
from functools import cache, cached_property
from inspect import cleandoc
from itertools import pairwise
from typing import Any, ClassVar, Final, Literal, cast

from limo_driver.errors import ConfigError, ParameterError

REAL, WHOLE, FLAG, TEXT = "a number", "a whole number", "true or false", "a text"
JOINT: Final = "joint"  # unit of the 1-based number of a joint
_KINDS: Final = {"float": REAL, "int": WHOLE, "bool": FLAG, "str": TEXT}
ARGS: Final = re.compile(r"\n\nArgs:\n((?:    .*(?:\n|\Z))+)")  # of a docstring
_ARGUMENT: Final = re.compile(r"^    (\w+): (.*(?:\n     .*)*)", re.MULTILINE)
_ANNOTATED: Final = re.compile(r"\b(?:float|int|bool|str)\b")
_SHOWN: Final = 60  # characters of a value that a message repeats


@dataclass(frozen=True)
class Parameter:
    """Declaration of a parameter: unit, bounds and default."""

    name: str
    unit: str = ""  # SI; `JOINT` for the number of a joint
    description: str = ""
    kind: str = REAL  # of the value, or of each number of a list
    lower: float = -math.inf
    upper: float = math.inf
    above: bool = False  # whether `lower` itself is too low
    finite: bool = True
    of: tuple[Any, ...] = ()  # the values there are, where they can be counted
    is_list: bool = False
    optional: bool = False
    length: int | None = None  # of a list, where it is fixed
    columns: int | None = None  # of each row, for a list of rows
    key: str = ""  # in files, where that is not the name
    adds: bool = False  # of two effects at one place, the sum of these makes one effect
    smooths: bool = False  # a width that smooths rather than describes; its logarithm is linear
    inverse: bool = False  # the torque is linear in its inverse
    scales: bool = False  # a size, though its unit is 1
    chosen: bool = False  # where or when something is, which no data are asked for
    deviation: float | Literal["largest"] | None = None  # before any data; None: its own value

    @property
    def is_number(self) -> bool:
        """Whether the parameter is one real number, which can be fitted."""
        return self.kind == REAL and not self.is_list

    @property
    def is_size(self) -> bool:
        """Whether it is a number that is neither a shape nor a sign."""
        return self.is_number and (self.unit != "1" or self.scales)

    @property
    def in_file(self) -> str:
        """The name in files."""
        return self.key or self.name

    @property
    def _in_unit(self) -> str:
        return "" if self.kind == TEXT or self.unit in {"", "1", JOINT} else f" {self.unit}"

    @cached_property
    def expected(self) -> str:
        """The permitted values, in words."""
        if self.of:
            return f"one of {', '.join(map(word, self.of))}"
        noun = "a joint" if self.unit == JOINT else self.kind
        if self.is_list:
            many = "" if self.length is None else f"{self.length} "
            row = f"rows of {self.columns} " if self.columns else ""
            noun = f"a list of {many}{row}{noun.removeprefix('a ')}s"
        return noun + self._limits()

    def checked(self, value: Any) -> Any:  # noqa: ANN401  # of the parameter's own kind
        """Return a value that the parameter can have, a list as a tuple.

        Raises:
            ParameterError: It cannot have it.
        """
        if not self.is_list:
            self._check(value)
            return value
        given = list(value) if hasattr(value, "__len__") and not isinstance(value, str) else [value]
        if self.length not in {None, len(given)}:
            raise self.refused(given)
        if self.columns is None:
            return tuple(self._number(item) for item in given)
        rows = [tuple(row) if hasattr(row, "__len__") else () for row in given]
        for row in rows:
            if len(row) != self.columns:
                raise self.refused(given)
        return tuple(tuple(self._number(item) for item in row) for row in rows)

    def refused(self, value: object) -> ParameterError:
        """Return the error that a value makes."""
        is_number = isinstance(value, (int, float)) and not isinstance(value, bool)
        unit = self._in_unit if is_number and not self.is_list else ""
        return ParameterError(self.in_file, shown(value) + unit, self.expected)

    def _number(self, value: Any) -> Any:  # noqa: ANN401  # of the parameter's own kind
        self._check(value)
        return float(value) if self.kind == REAL else value

    def _check(self, value: Any) -> None:  # noqa: ANN401  # of any kind
        if self.of:
            possible = not isinstance(value, bool) and value in self.of
        elif self.kind == REAL:
            possible = self._is_real(value)
        elif self.kind == WHOLE:
            possible = _is_whole(value) and self._is_within(value)
        elif self.kind == FLAG:
            possible = isinstance(value, bool)
        else:
            possible = isinstance(value, str) and bool(value)
        if not possible:
            raise self.refused(value)

    def _is_real(self, value: Any) -> bool:  # noqa: ANN401  # of any kind
        if type(value) is not float:
            if isinstance(value, (bool, str)):
                return False
            try:
                value = float(value)
            except (TypeError, ValueError, OverflowError):
                return False
        return self._is_within(value) and (not self.finite or math.isfinite(value))

    def _is_within(self, value: float) -> bool:
        return self.lower <= value <= self.upper and not (self.above and value == self.lower)

    def _limits(self) -> str:
        unit = self._in_unit
        low, high = shown(self.lower), shown(self.upper)
        if self.lower == -math.inf:
            return f" up to {high}{unit}" if self.upper < math.inf else ""
        if self.above:
            return f" above {low}{f' and up to {high}' if self.upper < math.inf else ''}{unit}"
        return (
            f" from {low} to {high}{unit}" if self.upper < math.inf else f" of {low}{unit} or more"
        )


def seed_of(seed: Any) -> int:  # noqa: ANN401  # whatever a user gave
    """Return the seed of random draws.

    Raises:
        ConfigError: It is no whole number, or below 0.
    """
    try:
        number = -1 if isinstance(seed, bool) else operator.index(seed)
    except TypeError:
        number = -1
    if number < 0:
        raise ConfigError(f"seed is {seed!r}, expected a whole number of 0 or more")
    return number


def parameter(  # noqa: ANN201  # a dataclass field, whose type is the annotation's
    unit: str = "",
    description: str = "",
    *,
    lower: float = -math.inf,
    upper: float = math.inf,
    above: bool = False,
    finite: bool = True,
    of: Iterable[Any] = (),
    default: Any = MISSING,  # noqa: ANN401  # of the field's own type
    length: int | None = None,
    columns: int | None = None,
    key: str = "",
    adds: bool = False,
    smooths: bool = False,
    inverse: bool = False,
    scales: bool = False,
    chosen: bool = False,
    deviation: float | Literal["largest"] | None = None,
):
    """Declare a parameter as a dataclass field; its kind is that of the annotation.

    What stands after `key` is the use of a parameter of an effect.

    Args:
        unit: SI unit; empty if it has none, `JOINT` for the 1-based number of a joint.
        description: What it is, in a few words; if not given, what the docstring of the class says
            of it under `Args:`.
        lower: Lowest value.
        upper: Highest value.
        above: Whether `lower` itself is too low.
        finite: Whether infinity is refused.
        of: The values there are, where they can be counted; members of an `Enum` stand in files by
            their names in lower case.
        default: Where it is not given; without one, it has to be.
        length: Of a list, where it is fixed.
        columns: Of each row, for a list of rows.
        key: Name in files, where that is another.
        adds: Two effects at one place are one effect with the sum of these.
        smooths: It is the width of a smoothed sign, known to be there and not how wide.
        inverse: The torque is linear in its inverse, as a stiffness that winds up.
        scales: It is a size, though its unit is 1.
        chosen: It says where or when something is, and is not estimated.
        deviation: How far it may be off before any data, in the unit; "largest" of a list as far as
            its largest entry. Where nothing is said, as far as it is large, and a 0 stays.
    """
    known = {"unit": unit, "description": description, "lower": lower, "upper": upper}
    known |= {"above": above, "finite": finite, "of": tuple(of), "length": length}
    known |= {"columns": columns, "key": key, "adds": adds, "smooths": smooths, "inverse": inverse}
    known |= {"scales": scales, "chosen": chosen, "deviation": deviation}
    return field(default=default, metadata={"parameter": known})


def arguments_of(doc: str) -> dict[str, str]:
    """Return what a docstring says under `Args:`, on one line each, by name."""
    section = ARGS.search(cleandoc(doc))
    found = _ARGUMENT.findall(section[1] if section else "")
    return {name: " ".join(text.split()) for name, text in found}


@cache
def parameters_of(kind: type) -> tuple[Parameter, ...]:
    """Return the parameters that a dataclass declares, in order."""
    found: list[Parameter] = []
    docs = [arguments_of(owner.__doc__ or "") for owner in kind.__mro__]
    described = {name: text for doc in reversed(docs) for name, text in doc.items()}
    for item in fields(kind):
        if "parameter" not in item.metadata:
            continue
        annotated = str(item.type)
        known = item.metadata["parameter"]
        known |= {"description": known["description"] or described.get(item.name, "")}
        word_of_kind = _ANNOTATED.search(annotated)
        found.append(
            Parameter(
                item.name,
                kind=_KINDS[word_of_kind.group()] if word_of_kind else TEXT,
                is_list="tuple" in annotated,
                optional=item.default is not MISSING,
                **known | ({"lower": max(1, known["lower"])} if known["unit"] == JOINT else {}),
            )
        )
    return tuple(found)


class Declared:
    """A frozen dataclass of parameters, checked when it is made; None is a value not given.

    Raises:
        ParameterError: Names the parameter, what was given and what is possible.
    """

    _called: ClassVar[str] = ""  # in messages; empty where the names of its parameters are enough

    @property
    def place(self) -> str:
        """Its name in messages."""
        return self._called

    def __post_init__(self) -> None:
        for known in parameters_of(type(self)):
            given = getattr(self, known.name)
            if given is None:
                continue
            try:
                value = known.checked(given)
            except ParameterError as error:
                raise ParameterError(known.name, error.given, error.expected, self.place) from None
            if value is not given:
                object.__setattr__(self, known.name, value)

    def _refused(self, name: str, expected: str) -> ParameterError:
        """Return the error that a value makes beside the others."""
        known = next(item for item in parameters_of(type(self)) if item.name == name)
        given = known.refused(getattr(self, name)).given
        return ParameterError(known.in_file, given, expected, self.place)

    def _same_length(self, *names: str) -> None:
        """Refuse lists that do not belong together entry by entry, and empty ones."""
        lengths = {name: len(getattr(self, name)) for name in names}
        if len(set(lengths.values())) > 1 or 0 in lengths.values():
            listed = ", ".join(f"{size} {name}" for name, size in lengths.items())
            place = f"{self.place}: " if self.place else ""
            raise ConfigError(f"{place}has {listed}; each entry needs all of them")

    def _increasing(self, *names: str, strictly: bool = True) -> None:
        """Refuse lists that do not increase."""
        for name in names:
            for before, after in pairwise(getattr(self, name)):
                if before > after or (strictly and before == after):
                    raise self._refused(
                        name, f"numbers that increase, not {shown(after)} after {shown(before)}"
                    )


def word(value: object) -> str:
    """Return a value as it stands in files."""
    return value.name.lower() if isinstance(value, Enum) else str(value)


def shown(value: object) -> str:
    """Return a value as messages repeat it."""
    if isinstance(value, Enum):
        return word(value)
    if isinstance(value, float):
        return f"{value:.10g}"
    is_list = isinstance(value, (tuple, list))
    text = f"[{', '.join(map(shown, cast('list[object]', value)))}]" if is_list else repr(value)
    return text if len(text) <= _SHOWN else f"{text[:_SHOWN]}…"


def _is_whole(value: object) -> bool:
    try:
        operator.index(value)  # type: ignore[arg-type]  # that is the question
    except TypeError:
        return False
    return not isinstance(value, bool)
