"""Take declared values from one place of a file, whatever its format."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Generator, Iterable, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import MISSING, fields, replace
from functools import cached_property
from pathlib import Path
from typing import Any, ClassVar, NoReturn, TypeVar

from limo_driver.errors import ConfigError, ParameterError, PlacedError
from limo_driver.runtime import written_by
from limo_driver.runtime.parameters import (
    FLAG,
    JOINT,
    TEXT,
    Declared,
    Parameter,
    parameters_of,
    word,
)

_Declared = TypeVar("_Declared", bound=Declared)
_Node = TypeVar("_Node", bound="ConfigNode")


class ConfigNode(ABC):
    """What stands at one place of a file: a value, a list, or a mapping whose entries are taken.

    Args:
        content: What stands there, as its format has it.
        path: The file.
        error: Raised for every mistake.
        within: What it is an entry or item of.
        called: Its name there.
    """

    mapping: ClassVar[str]  # word of the format
    line: int | None = None  # 1-based, where the format knows lines
    writer: object = None  # version of the limo that wrote the file, if it says so

    def __init__(
        self,
        content: Any,  # noqa: ANN401  # of the format
        path: Path,
        error: type[PlacedError] = ConfigError,
        within: ConfigNode | None = None,
        called: str = "",
    ) -> None:
        self.content, self.path, self.error = content, path, error
        self.within, self.called = within, called
        if within is not None:
            self.writer = within.writer

    @property
    def place(self) -> str:
        """The way here, for example `inputs: number 3`; empty for the whole file."""
        way = self.within.place if self.within else ""
        return f"{way}: {self.called}" if way else self.called

    @property
    @abstractmethod
    def is_empty(self) -> bool:
        """Whether nothing is given."""

    @cached_property
    @abstractmethod
    def entries(self) -> Mapping[str, ConfigNode]:
        """The entries of a mapping, by name; refuses what is none."""

    @cached_property
    @abstractmethod
    def items(self) -> Sequence[ConfigNode] | None:
        """The items of a list; None if it is none."""

    @abstractmethod
    def scalar(self, kind: str) -> Any:  # noqa: ANN401  # of that kind, if it can be
        """Return one value; as it is given, where it is not of that kind."""

    @abstractmethod
    def plain(self) -> Any:  # noqa: ANN401  # of any type that the format knows
        """Return one value of the type that the format itself takes it for."""

    def __contains__(self, name: str) -> bool:
        """Say whether an entry is given."""
        return name in self.entries

    def __getitem__(self, name: str) -> ConfigNode:
        """Return an entry, which has to be given."""
        if name not in self.entries:
            self.fail(f"lacks {name}")
        return self.entries[name]

    def optional(self, name: str) -> ConfigNode:
        """Return an entry, one that is empty where it is not given."""
        return self.entries.get(name) or type(self)(None, self.path, self.error, self, name)

    def only(self: _Node, *known: str) -> _Node:
        """Refuse entries that are not known."""
        for name, entry in self.entries.items():
            if name not in known and not (name == written_by.KEY and self.within is None):
                self.fail(f"has no {name!r}; it has {', '.join(known)}", entry.line)
        return self

    def needs(self: _Node, *names: str) -> _Node:
        """Refuse the lack of entries."""
        if missing := [name for name in names if name not in self.entries]:
            self.fail(f"lacks {', '.join(missing)}")
        return self

    def sections(self) -> tuple[ConfigNode, ...]:
        """Return the items of a list of mappings."""
        if self.items is None or self.items[:1] == [self]:  # a value alone
            self.refuse(f"a list of {self.mapping.split()[-1]}s")
        for item in self.items:
            item.entries  # noqa: B018  # refuses what is no mapping
        return tuple(self.items)

    def take(self, known: Parameter, joints: int | None = None) -> Any:  # noqa: ANN401  # of its kind
        """Return the value of an entry.

        Args:
            known: What it can be.
            joints: Of the arm, for numbers of joints.
        """
        return self[known.in_file].value(known, joints)

    def value(self, known: Parameter, joints: int | None = None) -> Any:  # noqa: ANN401  # of its kind
        """Return the value of a parameter that stands here."""
        if known.unit == JOINT and joints is not None:
            known = replace(known, upper=min(known.upper, joints))
        value = self._list(known) if known.is_list else self.scalar(known.kind)
        if known.of and value not in known.of:
            value = next((item for item in known.of if word(item) == value), value)
        try:
            return known.checked(value)
        except ParameterError as error:
            self.refuse(error.expected, error.given)

    def _list(self, known: Parameter) -> tuple[Any, ...]:
        one = replace(known, is_list=False, length=None, columns=None)
        if self.items is None or (known.columns and self.items[:1] == [self]):  # a value alone
            self.refuse(known.expected)
        if known.columns is None:
            return tuple(item.value(one) for item in self.items)
        row = replace(known, length=known.columns, columns=None)
        return tuple(item.value(row) for item in self.items)

    def text(self, name: str, of: Sequence[str] = ()) -> str:
        """Return a text, one of those there are if they can be counted."""
        return self.take(Parameter(name, kind=TEXT, of=tuple(of)))

    def texts(self, name: str) -> tuple[str, ...]:
        """Return a list of texts."""
        return self.take(Parameter(name, kind=TEXT, is_list=True))

    def flag(self, name: str) -> bool:
        """Return true or false."""
        return self.take(Parameter(name, kind=FLAG))

    def number(self, name: str, **bounds: Any) -> float:  # noqa: ANN401  # of a `Parameter`
        """Return a finite number within bounds."""
        return float(self.take(Parameter(name, **bounds)))

    def numbers(self, name: str, length: int | None = None, **bounds: Any) -> tuple[float, ...]:  # noqa: ANN401  # of a `Parameter`
        """Return a list of finite numbers within bounds, of a length if one is given."""
        return self.take(Parameter(name, is_list=True, length=length, **bounds))

    def of_kind(self: _Node, kind: type[Declared], beside: Iterable[str] = ()) -> _Node:
        """Refuse entries that a kind does not have, and the lack of those that it needs."""
        keys = {item.name: item.in_file for item in parameters_of(kind)}
        declared = fields(kind)  # type: ignore[arg-type]  # each subclass is a dataclass
        self.only(*beside, *(keys.get(item.name, item.name) for item in declared))
        needed = [x for x in declared if x.default is MISSING and x.default_factory is MISSING]
        return self.needs(*(keys.get(item.name, item.name) for item in needed))

    def make(
        self,
        kind: type[_Declared],
        parts: Mapping[str, Any] | None = None,
        *,
        joints: int | None = None,
        beside: Iterable[str] = (),
    ) -> _Declared:
        """Return the object that the entries declare.

        Args:
            kind: Dataclass of parameters.
            parts: Fields that are read already, by name.
            joints: Of the arm, for numbers of joints.
            beside: Names of entries that may stand here too.
        """
        parts = parts or {}
        self.of_kind(kind, beside)
        values = {
            item.name: self.take(item, joints)
            for item in parameters_of(kind)
            if item.in_file in self.entries and item.name not in parts
        }
        with self.blamed():
            return kind(**parts, **values)

    @contextmanager
    def blamed(self) -> Generator[None]:
        """Report what is refused meanwhile at the entry that it is about, or here."""
        try:
            yield
        except ParameterError as error:
            at = self.entries.get(error.name, self)
            self.fail(f"{error.name} is {error.given}, expected {error.expected}", at.line)
        except ConfigError as error:
            self._raise(str(error), self.line)

    def make_one_of(
        self, tag: str, kinds: Mapping[str, type[_Declared]], joints: int | None = None
    ) -> _Declared:
        """Return the object that the entries declare, of the kind that one of them names."""
        kind = kinds[self.named(tag, tuple(kinds))]
        return self.make(kind, joints=joints, beside=(tag,))

    def named(self, tag: str, of: Sequence[str]) -> str:
        """Return the kind that an entry names, and be called by it."""
        if tag not in self.entries:
            self.fail(f"lacks `{tag}:`, one of {', '.join(of)}")
        self.called = self.text(tag, of)
        return self.called

    @property
    @abstractmethod
    def said(self) -> str:
        """What is given, for messages."""

    def refuse(self, expected: str, given: str = "") -> NoReturn:
        """Refuse what stands here; by default all of it was given."""
        message = f"is {given or self.said}, expected {expected}"
        self._raise(f"{self.place} {message}".strip(), self.line)

    def fail(self, message: str, line: int | None = None) -> NoReturn:
        """Refuse a mapping for something about its entries, at a line if it is not its own."""
        where = f"{self.place}: " if self.place else ""
        self._raise(where + message, line or self.line)

    def _raise(self, message: str, line: int | None) -> NoReturn:
        advice = written_by.advice_to_update(self.writer)
        raise self.error(message + advice, path=self.path, line=line)
