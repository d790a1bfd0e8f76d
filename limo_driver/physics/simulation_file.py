"""sim.yaml: read a simulation with the line of every mistake; write one that reads back equal."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import TYPE_CHECKING, Any, TypeVar, cast

import yaml

from limo_driver.errors import ConfigError, PlugInError
from limo_driver.model import BUILT_IN, Inertial, RobotModel
from limo_driver.outputs import whole
from limo_driver.physics.catalogue import effect_called, known_names
from limo_driver.physics.parameters import JOINT, TEXT
from limo_driver.physics.sensing import Sensors
from limo_driver.yaml_reader import YamlReader, is_null

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping
    from pathlib import Path

    from limo_driver.physics.effect import Effect
    from limo_driver.physics.parameters import Parameter

_Vector = TypeVar("_Vector", bound=tuple[float, ...])
_SECTIONS = ("robot", "inertials", "tolerances", "sensors", "effects")
_INERTIAL = ("mass", "com", "inertia")


@dataclass(frozen=True)
class Tolerances:
    """How well the nominal values are known (relative, 1 sigma)."""

    inertia: float = 0.02
    friction: float = 0.15


@dataclass(frozen=True)
class SimulationFile:
    """What a `sim.yaml` says, section by section."""

    robot: str  # built-in name or path of a URDF
    effects: tuple[Effect, ...]
    inertials: Mapping[str, Inertial]  # by link
    tolerances: Tolerances
    sensors: Sensors


def load(path: Path) -> SimulationFile:
    """Read a `sim.yaml`; the path of its robot no longer depends on where it lies.

    Raises:
        ConfigError: Names the line, what was given and what exists.
    """
    return _Reader(path).simulation()


def save(simulation: SimulationFile, path: Path) -> None:
    """Write a `sim.yaml`; its robot as it is given."""
    content: dict[str, Any] = {"robot": simulation.robot}
    if simulation.inertials:
        content["inertials"] = {
            link: {"mass": body.mass, "com": list(body.com), "inertia": list(body.inertia)}
            for link, body in simulation.inertials.items()
        }
    content["tolerances"] = _values(simulation.tolerances)
    if simulation.sensors != Sensors():
        content["sensors"] = {k: list(v) for k, v in _values(simulation.sensors).items()}
    content["effects"] = [_effect_entry(effect) for effect in simulation.effects]
    text = yaml.dump(content, Dumper=_Dumper, sort_keys=False, default_flow_style=None, width=100)
    with whole(path) as draft:
        draft.write_text(text, encoding="utf-8")


class _Dumper(yaml.SafeDumper):
    """Dumps one effect or inertial a line."""


def _values(section: Tolerances | Sensors) -> dict[str, Any]:
    return {item.name: getattr(section, item.name) for item in fields(section)}


def _effect_entry(effect: Effect) -> dict[str, Any]:
    entry: dict[str, Any] = {"effect": effect.name}
    if _has_joint(type(effect)):
        entry["joint"] = effect.joints[0]
    for known in effect.parameters():
        value = getattr(effect, known.name)
        if value is None or (known.is_list and not value):
            continue  # of another form of the effect
        if known.columns:
            value = [list(row) for row in value]
        entry[known.name] = list(value) if known.is_list else value
    return entry


def _has_joint(effect: type[Effect]) -> bool:
    return any(item.name == "joint" for item in fields(effect))


class _Reader(YamlReader):
    """Makes a simulation of the nodes of one file."""

    def simulation(self) -> SimulationFile:
        if self.root is None:
            raise ConfigError("is empty; it needs at least `robot:`", path=self.path)
        sections = self._mapping(self.root, "the file", _SECTIONS)
        if "robot" not in sections:
            self._fail(self.root, "lacks `robot:`, a built-in name or a URDF file")
        robot, model = self._robot(sections["robot"])
        return SimulationFile(
            robot=robot,
            inertials=self._inertials(sections.get("inertials"), model),
            tolerances=self._tolerances(sections.get("tolerances")),
            sensors=self._sensors(sections.get("sensors"), model),
            effects=tuple(self._effects(sections.get("effects"), model)),
        )

    def _robot(self, node: yaml.Node) -> tuple[str, RobotModel]:
        name = self._text(node)
        beside = self.path.parent / name
        robot = name if name in BUILT_IN or not beside.is_file() else str(beside.resolve())
        try:
            return robot, RobotModel.load(robot)
        except ConfigError as error:
            self._fail(node, str(error))

    def _inertials(self, node: yaml.Node | None, model: RobotModel) -> dict[str, Inertial]:
        inertials: dict[str, Inertial] = {}
        for link, entry in self._optional(node, "inertials", model.link_names).items():
            nominal = model.inertials[link]
            given = self._mapping(entry, f"inertials of {link}", _INERTIAL)
            body = Inertial(
                self._number(given["mass"]) if "mass" in given else nominal.mass,
                self._vector(given.get("com"), nominal.com),
                self._vector(given.get("inertia"), nominal.inertia),
            )
            if not body.is_consistent():
                self._fail(entry, f"no rigid body has the mass and inertia given for {link}")
            inertials[link] = body
        return inertials

    def _tolerances(self, node: yaml.Node | None) -> Tolerances:
        names = [item.name for item in fields(Tolerances)]
        given = self._optional(node, "tolerances", names)
        values = {key: self._number(value) for key, value in given.items()}
        for key, value in values.items():
            if value < 0:
                self._fail(given[key], f"tolerance {key} = {value:g} has to be 0 or more")
        return Tolerances(**values)

    def _sensors(self, node: yaml.Node | None, model: RobotModel) -> Sensors:
        names = [item.name for item in fields(Sensors)]
        given = self._optional(node, "sensors", names)
        values = {key: tuple(self._numbers(value)) for key, value in given.items()}
        for key, value in values.items():
            if len(value) not in {1, model.n}:
                self._fail(given[key], f"{key} has {len(value)} values for {model.n} joints")
        try:
            return Sensors(**values)
        except ConfigError as error:
            self._fail(node or self.root, str(error))

    def _effects(self, node: yaml.Node | None, model: RobotModel) -> Iterable[Effect]:
        if node is None or is_null(node):
            return
        if not isinstance(node, yaml.SequenceNode):
            self._fail(node, "effects: has to be a list of `- {effect: ..., joint: ...}`")
        for entry in node.value:
            yield self._effect(entry, model)

    def _effect(self, entry: yaml.Node, model: RobotModel) -> Effect:
        given = self._mapping(entry, "an effect", None)
        if "effect" not in given:
            self._fail(entry, "lacks `effect:`, one of " + ", ".join(known_names()))
        name = self._text(given["effect"])
        try:
            effect = effect_called(name)
        except (ConfigError, PlugInError) as error:
            self._fail(given["effect"], str(error))
        known = {item.name: item for item in effect.parameters()}
        place = ("joint",) if _has_joint(effect) else ()
        self._mapping(entry, name, ("effect", *place, *known))
        required = [*place, *(key for key, item in known.items() if not item.optional)]
        if missing := [key for key in required if key not in given]:
            self._fail(entry, f"{name} lacks {', '.join(missing)}")
        values: dict[str, Any] = {key: self._joint(given[key], model) for key in place}
        values |= {
            key: self._parameter(given[key], item, model)
            for key, item in known.items()
            if key in given
        }
        try:
            return effect(**values)
        except ConfigError as error:
            self._fail(entry, str(error))

    def _joint(self, node: yaml.Node, model: RobotModel) -> int:
        number = self._number(node)
        if number != int(number) or not 1 <= number <= model.n:
            self._fail(node, f"joint {number:g} does not exist; joints are 1 to {model.n}")
        return int(number)

    def _parameter(self, node: yaml.Node, known: Parameter, model: RobotModel) -> Any:  # noqa: ANN401  # of the field's own type
        if known.unit == TEXT:
            return self._text(node)
        if known.unit == JOINT:
            return self._joint(node, model)
        if known.columns:
            if not isinstance(node, yaml.SequenceNode):
                self._fail(node, f"{known.name} has to be a list of [{known.columns} numbers]")
            return tuple(tuple(self._numbers(row)) for row in node.value)
        return tuple(self._numbers(node)) if known.is_list else self._number(node)

    def _vector(self, node: yaml.Node | None, nominal: _Vector) -> _Vector:
        """Read as many numbers as the nominal vector has; the nominal ones if none are given."""
        if node is None:
            return nominal
        numbers = self._numbers(node)
        if len(numbers) != len(nominal):
            self._fail(node, f"has {len(numbers)} numbers, expected {len(nominal)}")
        return cast("_Vector", tuple(numbers))
