"""Read an arm.yaml, with the line of every mistake."""

from __future__ import annotations

from dataclasses import MISSING, fields
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, TypeVar

import yaml

from backends.can.config import (
    CIA402,
    CONVENTIONS,
    ArmConfig,
    Bus,
    Cia402Joint,
    DamiaoJoint,
    Temperature,
)
from backends.can.entries import FLAG, REAL, WHOLE, Section
from limo_driver.errors import ConfigError
from limo_driver.model import BUILT_IN
from limo_driver.yaml_reader import YamlReader, is_null

if TYPE_CHECKING:
    from backends.can.config import Joint, Option

OF_CIA402: Final = {"master", "on_lost", "status_every", "temperature"}  # and of nobody else

_Section = TypeVar("_Section", bound=Section)


def load(path: Path | str) -> ArmConfig:
    """Read an `arm.yaml`.

    Raises:
        ConfigError: Names the line, what was given and what exists.
    """
    return _Reader(Path(path)).arm()


class _Reader(YamlReader):
    """Makes an arm of the nodes of one file."""

    def arm(self) -> ArmConfig:
        if self.root is None:
            raise ConfigError("is empty; it needs bus, robot and joints", path=self.path)
        given = self._mapping(self.root, "the file", [item.name for item in fields(ArmConfig)])
        self._require(self.root, "the file", ArmConfig, given)
        convention = self._text(given["convention"]) if "convention" in given else CIA402
        if convention not in CONVENTIONS:
            known = ", ".join(CONVENTIONS)
            self._fail(given["convention"], f"convention is {convention}, expected one of {known}")
        if convention != CIA402:
            self._refuse_of_cia402(given, convention)
        parts: dict[str, Any] = {
            "bus": self._bus(given.pop("bus")),
            "joints": self._joints(given.pop("joints"), convention),
            "robot": self._robot(given.pop("robot")),
        }
        if (temperature := given.pop("temperature", None)) is not None and not is_null(temperature):
            parts["temperature"] = self._section(temperature, "temperature", Temperature)
        return self._made(self.root, ArmConfig, given, parts)

    def _refuse_of_cia402(self, given: dict[str, yaml.Node], convention: str) -> None:
        for name in OF_CIA402 & given.keys():
            self._fail(
                given[name], f"{name} is for CiA 402 drives; {convention} motors have no such thing"
            )

    def _robot(self, node: yaml.Node) -> str:
        name = self._text(node)
        beside = self.path.parent / name
        return name if name in BUILT_IN or not beside.is_file() else str(beside.resolve())

    def _bus(self, node: yaml.Node) -> Bus:
        given = self._mapping(node, "bus", [item.name for item in fields(Bus)])
        self._require(node, "bus", Bus, given)
        options = self._optional(given.pop("options", None), "options", None)
        parts = {"options": {key: self._option(value) for key, value in options.items()}}
        return self._made(node, Bus, given, parts)

    def _option(self, node: yaml.Node) -> Option:
        self._text(node)
        value: Option = yaml.SafeLoader("").construct_object(node)
        return value

    def _joints(self, node: yaml.Node, convention: str) -> tuple[Joint, ...]:
        if not isinstance(node, yaml.SequenceNode):
            self._fail(node, "joints: has to be a list of `- {node: ..., ...}`")
        kind = Cia402Joint if convention == CIA402 else DamiaoJoint
        return tuple(
            self._section(item, f"joint {j}", kind) for j, item in enumerate(node.value, start=1)
        )

    def _section(self, node: yaml.Node, what: str, kind: type[_Section]) -> _Section:
        given = self._mapping(node, what, [item.name for item in _entries(kind)])
        self._require(node, what, kind, given)
        return self._made(node, kind, given, {})

    def _require(
        self, node: yaml.Node, what: str, kind: type[Section], given: dict[str, yaml.Node]
    ) -> None:
        missing = [
            item.name
            for item in _entries(kind)
            if item.default is MISSING and item.default_factory is MISSING
        ]
        if missing := [name for name in missing if name not in given]:
            self._fail(node, f"{what} lacks {', '.join(missing)}")

    def _made(
        self,
        node: yaml.Node,
        kind: type[_Section],
        given: dict[str, yaml.Node],
        parts: dict[str, Any],
    ) -> _Section:
        known = {item.name: item.metadata["kind"] for item in _entries(kind) if item.metadata}
        values = {name: self._value(value, known[name]) for name, value in given.items()}
        try:
            return kind(**parts, **values)
        except ConfigError as error:
            # The message begins with the name of the entry that is wrong, where it is one entry.
            name = str(error).split(maxsplit=1)[0]
            self._fail(given.get(name, node), str(error))

    def _value(self, node: yaml.Node, kind: str) -> Any:  # noqa: ANN401  # of the field's own type
        if kind == FLAG:
            return self._flag(node)
        if kind == WHOLE:
            return self._whole(node)
        return self._number(node) if kind == REAL else self._text(node)


def _entries(kind: type[Section]) -> tuple[Any, ...]:
    return fields(kind)  # type: ignore[arg-type]  # each section is a dataclass
