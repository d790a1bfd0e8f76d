"""sim.yaml: read a simulation with the line of every mistake; write one that reads back equal."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import MISSING, Field, dataclass, field, fields, replace
from pathlib import Path
from typing import Any, TypeVar, cast

import yaml

from limo_driver.errors import ConfigError, PlugInError
from limo_driver.model import RobotModel
from limo_driver.model.descriptions.geometry import Inertial
from limo_driver.model.robot_model import beside
from limo_driver.physics.catalogue import effect_called, known_names
from limo_driver.physics.described import described_effects
from limo_driver.physics.domain import Domain
from limo_driver.physics.drives import DRIVES, TOLERANCE, JointDrive, described_drives
from limo_driver.physics.effect import Effect, TorqueEffect
from limo_driver.physics.effects.body import Payload
from limo_driver.physics.effects.sensing import Sensors
from limo_driver.runtime import written_by
from limo_driver.runtime.declarations import ConfigNode, read_yaml
from limo_driver.runtime.outputs import whole
from limo_driver.runtime.parameters import TEXT, Declared, Parameter, parameter, parameters_of

_Vector = TypeVar("_Vector", bound=tuple[float, ...])
_DOMAIN = "domain"  # of an effect, in which it was learned
_FRAME = "frame"  # of a payload, in which it is stated: a link or site that the last link carries
_SECTIONS = ("robot", "inertials", "tolerances", "sensors", "drives", "effects", "bandwidth")
_BANDWIDTH = Parameter("bandwidth", "Hz", lower=0.0, above=True)
_GUESSED = "guessed"  # of tolerances: names of those that nobody has stated
_INERTIAL = ("mass", "com", "inertia")


@dataclass(frozen=True)
class Tolerances(Declared):
    """Relative standard deviations of the nominal values (1 sigma).

    What nobody states is assumed, which is limo's guess. A file that limo writes says of which that
    is so under `guessed`.

    Args:
        inertia: Of masses and moments.
        friction: Of the parameters of friction.
        drive: Of the parameters of drives.
        gain: Of the scale of each joint's torque.
    """

    inertia: float = parameter("1", lower=0, default=0.02)
    friction: float = parameter("1", lower=0, default=0.15)
    drive: float = parameter("1", lower=0, default=0.3)
    gain: float = parameter("1", lower=0, default=0.0)
    stated: frozenset[str] | None = field(default=None, compare=False)  # None: what is not usual

    @property
    def all_names(self) -> frozenset[str]:
        """Names of all of them."""
        return frozenset(item.name for item in parameters_of(Tolerances))

    @property
    def usual(self) -> frozenset[str]:
        """Names of those that are as large as where nobody says anything."""
        same = (name for name in self.all_names if getattr(self, name) == getattr(_USUAL, name))
        return frozenset(same)

    @property
    def assumed(self) -> frozenset[str]:
        """Names of those that nobody has stated."""
        return self.usual if self.stated is None else self.all_names - self.stated

    def as_values(self) -> dict[str, float]:
        """Return each of them by name."""
        return {item.name: getattr(self, item.name) for item in parameters_of(Tolerances)}

    def with_stated(self, **values: float) -> Tolerances:
        """Return the same with some that somebody states."""
        own = (self.all_names - self.assumed) | {*values}
        return replace(self, **values, stated=own)


_USUAL = Tolerances()


@dataclass(frozen=True)
class SimulationFile:
    """Content of a `sim.yaml`, section by section."""

    robot: str  # built-in name or path of a URDF or MJCF, see `RobotModel.load`
    effects: tuple[Effect, ...]
    inertials: Mapping[str, Inertial]  # by link
    tolerances: Tolerances
    sensors: Sensors
    drives: tuple[JointDrive, ...] = ()
    bandwidth: float | None = None  # at which it was identified [Hz], if that is not the usual one


def load(path: Path) -> SimulationFile:
    """Read a `sim.yaml`; the path of its robot no longer depends on where it lies.

    Without `effects:` the robot has what its description states of its joints; a list, also an
    empty one, stands for all of it.

    Raises:
        ConfigError: Names the line, what was given and what exists.
    """
    given = read_yaml(path, needs="at least `robot:`")
    given.only(*_SECTIONS)
    if "robot" not in given:
        given.fail("lacks `robot:`, a built-in name or a URDF file")
    robot = beside(given.text("robot"), path.parent)
    try:
        model = RobotModel.load(robot)
    except ConfigError as error:
        given["robot"].fail(str(error))
    inertials = given.optional("inertials").only(*model.link_names).entries
    stated = described_effects(model) if "effects" not in given else ()
    effects = given.optional("effects").sections()
    names = tuple(item.name for item in parameters_of(Tolerances))
    known = given.optional("tolerances").only(*names, _GUESSED)
    of = Parameter(_GUESSED, kind=TEXT, is_list=True, of=names)
    guessed = known.take(of) if _GUESSED in known else ()
    own = frozenset(known.entries).intersection(names).difference(guessed)
    return SimulationFile(
        robot=robot,
        inertials={link: _inertial(inertials[link], model.inertials[link]) for link in inertials},
        tolerances=replace(known.make(Tolerances, beside=(_GUESSED,)), stated=own),
        sensors=_sensors(given.optional("sensors"), model.n),
        drives=_drives(given, model),
        effects=stated or tuple(_effect(entry, model) for entry in effects),
        bandwidth=float(given.take(_BANDWIDTH)) if "bandwidth" in given else None,
    )


def save(simulation: SimulationFile, path: Path) -> None:
    """Write a `sim.yaml`; its robot as it is given."""
    content: dict[str, Any] = {
        written_by.KEY: written_by.installed(),
        "robot": simulation.robot,
    }
    if simulation.bandwidth is not None:
        content["bandwidth"] = simulation.bandwidth
    if simulation.inertials:
        content["inertials"] = _inertial_entries(simulation.inertials)
    known = simulation.tolerances
    names = [item.name for item in parameters_of(Tolerances)]
    if not simulation.drives:
        names.remove("drive")
    if not known.gain:  # nobody doubts it
        names.remove("gain")
    content["tolerances"] = {name: getattr(known, name) for name in names}
    if guessed := [name for name in names if name in known.assumed]:
        content["tolerances"][_GUESSED] = guessed
    if simulation.sensors != Sensors():
        content["sensors"] = {k: list(v) for k, v in _values(simulation.sensors).items()}
    if simulation.drives:
        content["drives"] = [_drive_entry(drive) for drive in simulation.drives]
    content["effects"] = [_effect_entry(effect) for effect in simulation.effects]
    with whole(path) as draft:
        draft.write_text(_text(content), encoding="utf-8")


def sections_of(
    inertials: Mapping[str, Inertial],
    effects: Sequence[Effect],
    drives: Sequence[JointDrive] = (),
) -> str:
    """Return inertials, drives and effects as they stand in a `sim.yaml`, to five digits.

    Args:
        inertials: By link name.
        effects: In the order in which they are written.
        drives: Likewise.

    Returns:
        Text, "" if there is none of them.
    """
    content: dict[str, Any] = {}
    if inertials:
        content["inertials"] = _shortened(_inertial_entries(inertials))
    if drives:
        content["drives"] = [_shortened(_drive_entry(drive)) for drive in drives]
    if effects:
        content["effects"] = [_shortened(_effect_entry(effect)) for effect in effects]
    return _text(content) if content else ""


def _text(content: dict[str, Any]) -> str:
    return yaml.dump(content, Dumper=_Dumper, sort_keys=False, default_flow_style=None, width=100)


def _inertial_entries(inertials: Mapping[str, Inertial]) -> dict[str, Any]:
    return {
        link: {"mass": body.mass, "com": list(body.com), "inertia": list(body.inertia)}
        for link, body in inertials.items()
    }


def _shortened(value: Any) -> Any:  # noqa: ANN401  # values of YAML
    if isinstance(value, dict):
        return {key: _shortened(item) for key, item in cast("dict[str, Any]", value).items()}
    if isinstance(value, list):
        return [_shortened(item) for item in cast("list[Any]", value)]
    return float(f"{value:.5g}") if isinstance(value, float) else value


def _drives(given: ConfigNode, model: RobotModel) -> tuple[JointDrive, ...]:
    if "drives" not in given:
        return described_drives(model)
    return tuple(_drive(entry, model.n) for entry in given["drives"].sections())


def _drive(given: ConfigNode, n: int) -> JointDrive:
    """Read a drive, which may tell how well each of its parameters is known."""
    kind = DRIVES[given.named("drive", tuple(DRIVES))]
    own = given.of_kind(kind, ("drive",)).optional("tolerances")
    tolerances = {name: float(item.value(TOLERANCE)) for name, item in own.entries.items()}
    return given.make(kind, {"tolerances": tolerances}, joints=n, beside=("drive",))


def _drive_entry(drive: JointDrive) -> dict[str, Any]:
    """Return what differs from the defaults; a drive has a default where it may do without."""
    values = {
        item.name: getattr(drive, item.name)
        for item in fields(drive)
        if getattr(drive, item.name) != _default(item)
    }
    tolerances = {name: values.pop(name) for name in ("tolerances",) if name in values}
    return {"drive": drive.name, **values, **tolerances}


def _default(item: Field[Any]) -> Any:  # noqa: ANN401  # of the field's own type
    return item.default if item.default_factory is MISSING else item.default_factory()


class _Dumper(yaml.SafeDumper):
    """Dumps one effect or inertial a line."""


def _values(section: Tolerances | Sensors) -> dict[str, Any]:
    return {item.name: getattr(section, item.name) for item in fields(section)}


def _effect_entry(effect: Effect) -> dict[str, Any]:
    entry: dict[str, Any] = {"effect": effect.name}
    if any(item.name == "joint" for item in fields(effect)):
        entry["joint"] = effect.joints[0]
    for known in effect.parameters():
        value = getattr(effect, known.name)
        if value is None or (known.is_list and not value):
            continue  # of another form of the effect
        if known.columns:
            value = [list(row) for row in value]
        entry[known.name] = list(value) if known.is_list else value
    if isinstance(effect, TorqueEffect) and effect.domain is not None:
        own = {item.name: getattr(effect.domain, item.name) for item in fields(effect.domain)}
        known = {name: value for name, value in own.items() if value is not None}
        entry[_DOMAIN] = {k: list(v) if isinstance(v, tuple) else v for k, v in known.items()}
    return entry


def _inertial(given: ConfigNode, nominal: Inertial) -> Inertial:
    """Read mass, centre of mass and inertia; what is not given stays nominal."""
    given.only(*_INERTIAL)
    body = Inertial(
        given.number("mass") if "mass" in given else nominal.mass,
        _vector(given, "com", nominal.com),
        _vector(given, "inertia", nominal.inertia),
    )
    if not body.is_consistent():
        given.fail("no rigid body has the mass and inertia given")
    return body


def _vector(given: ConfigNode, name: str, nominal: _Vector) -> _Vector:
    """Read as many numbers as the nominal vector has; the nominal ones if none are given."""
    if name not in given:
        return nominal
    return cast("_Vector", given.numbers(name, len(nominal)))


def _effect(given: ConfigNode, model: RobotModel) -> Effect:
    """Read an effect; one of another distribution is imported when its name is read."""
    name = given.named("effect", known_names())
    try:
        effect = effect_called(name)
    except PlugInError as error:
        given.fail(str(error), given["effect"].line)
    if effect is not Payload or _FRAME not in given:
        known = effect.known_by if issubclass(effect, TorqueEffect) else ()
        keys = {item.name: item.in_file for item in effect.parameters()}
        declared = (item.name for item in fields(effect) if item.name != _DOMAIN or known)
        given.only("effect", *(keys.get(name, name) for name in declared))
        parts: dict[str, Any] = {}
        if _DOMAIN in given:
            more = ("slope",) if "speed" in known else ()
            parts[_DOMAIN] = given[_DOMAIN].only(*known, *more).make(Domain)
        return given.make(effect, parts, joints=model.n, beside=("effect",))
    frames = model.last_frames
    pose = frames[given.text(_FRAME, tuple(frames))]
    stated = given.make(effect, joints=model.n, beside=("effect", _FRAME))
    body = stated.load.moved(pose)
    return Payload(mass=body.mass, com=body.com, inertia=body.inertia)


def _sensors(given: ConfigNode, n: int) -> Sensors:
    sensors = given.make(Sensors)
    for name, entry in given.entries.items():
        if len(getattr(sensors, name)) not in {1, n}:
            entry.refuse(f"one number for all {n} joints, or one each")
    return sensors
