"""arm.yaml: an arm of drives on a CAN bus.

```yaml
bus: {interface: socketcan, channel: can0, bitrate: 1000000}
convention: cia402
robot: iiwa14
joints:
  - {node: 11, counts_per_turn: 524288, gear: 1, rated_torque: 320}
  - {node: 12, counts_per_turn: 524288, gear: 1, rated_torque: 320, direction: -1}
```
"""

from __future__ import annotations

import math
from collections import Counter
from dataclasses import MISSING, dataclass, field, fields
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, Literal, TypeVar

import yaml

from backends.can.entries import FLAG, REAL, TEXT, WHOLE, Section, entry
from limo_driver.errors import ConfigError
from limo_driver.model import BUILT_IN, RobotModel
from limo_driver.types import RobotSpec
from limo_driver.yaml_reader import YamlReader, is_null

if TYPE_CHECKING:
    from collections.abc import Mapping

    from limo_driver.types import FloatArray

CIA402: Final = "cia402"
DAMIAO: Final = "damiao"
CONVENTIONS: Final = (CIA402, DAMIAO)
LARGEST_COUNT: Final = 2**31 - 1  # of a position in 32 bits
REPLY_OFFSET: Final = 0x10  # of Damiao's replies, as OpenArm sets it

Option = bool | int | float | str
OF_CIA402: Final = {"master", "on_lost", "status_every", "temperature"}  # and of nobody else
_Section = TypeVar("_Section", bound=Section)


@dataclass(frozen=True, kw_only=True)
class Bus(Section):
    """How the bus is reached: python-can's words, and `options` for all others that it takes."""

    interface: str = entry(TEXT)  # socketcan, udp_multicast, virtual, pcan, ...
    channel: str = entry(TEXT)
    bitrate: int = entry(WHOLE, 1_000_000, lower=10_000, upper=1_000_000)  # [bit/s], arbitration
    fd: bool = entry(FLAG, default=False)
    data_bitrate: int = entry(WHOLE, 5_000_000, lower=10_000, upper=8_000_000)  # [bit/s], of FD
    options: Mapping[str, Option] = field(default_factory=dict)

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.fd and self.data_bitrate < self.bitrate:
            raise ConfigError(
                f"data_bitrate is {self.data_bitrate} bit/s, expected at least the bitrate of "
                f"{self.bitrate} bit/s"
            )


@dataclass(frozen=True, kw_only=True)
class Temperature(Section):
    """Where CiA 402 drives keep their temperature, which no standard object is for."""

    object: int = entry(WHOLE, lower=0x2000, upper=0x9FFF)  # an i16
    subindex: int = entry(WHOLE, 0, lower=0, upper=254)
    step: float = entry(REAL, 0.1, lower=0.0, upper=100.0, above=True)  # [°C] of one count


@dataclass(frozen=True, kw_only=True)
class Cia402Joint(Section):
    """A joint with a CiA 402 drive.

    count = direction (q - offset) counts_per_turn gear / 2 pi
    """

    node: int = entry(WHOLE, lower=1, upper=127)
    counts_per_turn: float = entry(REAL, lower=0.0, upper=2.0**32, above=True)  # of the encoder
    gear: float = entry(REAL, 1.0, lower=0.0, upper=1e5, above=True)  # encoder turns per joint turn
    rated_torque: float = entry(REAL, lower=0.0, upper=1e5, above=True)  # at the joint [N m]
    torque_ratio: float = entry(REAL, 1.0, lower=0.0, upper=1e5, above=True)  # joint over 6076
    direction: int = entry(WHOLE, 1, of=(1, -1))
    offset: float = entry(REAL, 0.0, lower=-1e3, upper=1e3)  # joint position at count 0 [rad]
    serial: int | None = entry(WHOLE, None, lower=0, upper=2**32 - 1)  # 1018:04, where known
    vendor: int | None = entry(WHOLE, None, lower=0, upper=2**32 - 1)  # 1018:01

    @property
    def counts_per_radian(self) -> float:
        """Counts of the drive's position per radian of the joint, with its sign."""
        return self.direction * self.counts_per_turn * self.gear / math.tau


@dataclass(frozen=True, kw_only=True)
class DamiaoJoint(Section):
    """A joint with a Damiao motor in MIT mode: q = direction (motor - offset)."""

    node: int = entry(WHOLE, lower=1, upper=0x7F)  # id that it takes commands on
    reply: int = entry(WHOLE, 0, lower=0, upper=0x7FE)  # id of its replies; 0 is node + 0x10
    direction: int = entry(WHOLE, 1, of=(1, -1))
    offset: float = entry(REAL, 0.0, lower=-1e3, upper=1e3)  # motor position at joint zero [rad]
    stiffness: float = entry(REAL, 50.0, lower=0.0, upper=500.0)  # kp of positions [N m/rad]
    damping: float = entry(REAL, 1.0, lower=0.0, upper=5.0)  # kd of positions [N m s/rad]

    @property
    def reply_id(self) -> int:
        """Arbitration id of its replies."""
        return self.reply or self.node + REPLY_OFFSET


Joint = Cia402Joint | DamiaoJoint


@dataclass(frozen=True, kw_only=True)
class ArmConfig(Section):
    """All that is to be known of an arm before its bus is opened."""

    bus: Bus
    convention: Literal["cia402", "damiao"] = entry(TEXT, CIA402, of=CONVENTIONS)
    robot: str = entry(TEXT)  # built-in name or URDF
    joints: tuple[Joint, ...]
    rate: float = entry(REAL, 250.0, lower=1.0, upper=4000.0)  # control cycles [Hz]
    master: int = entry(WHOLE, 127, lower=1, upper=127)  # node id of this program's heartbeat
    watchdog: float = entry(REAL, 0.1, lower=0.002, upper=5.0)  # [s] of silence: drives stop
    on_lost: str = entry(TEXT, "quick_stop", of=("quick_stop", "fault", "disable"))
    hold_after: int = entry(WHOLE, 2, lower=1, upper=1000)  # cycles of a silent joint
    status_every: int = entry(WHOLE, 10, lower=1, upper=240)  # cycles between drive statuses
    answer_timeout: float = entry(REAL, 1.0, lower=0.01, upper=60.0)  # [s] of a drive, at start-up
    temperature: Temperature | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        n = self.model.n
        if len(self.joints) != n:
            raise ConfigError(f"joints has {len(self.joints)} entries, but {self.robot} has {n}")
        kind = Cia402Joint if self.convention == CIA402 else DamiaoJoint
        for j, joint in enumerate(self.joints, start=1):
            if type(joint) is not kind:
                raise ConfigError(f"joint {j} is no {self.convention} joint")
        self._check_nodes()
        if self.watchdog < 2 / self.rate:
            raise ConfigError(
                f"watchdog is {self.watchdog:g} s, expected at least two cycles "
                f"of {1 / self.rate:g} s"
            )
        self._check_counts()

    @classmethod
    def load(cls, path: Path | str) -> ArmConfig:
        """Read an `arm.yaml`.

        Raises:
            ConfigError: Names the line, what was given and what exists.
        """
        return _Reader(Path(path)).arm()

    @cached_property
    def model(self) -> RobotModel:
        """The robot: its kinematics, inertias and limits."""
        return RobotModel.load(self.robot)

    def spec(self, torque_resolution: FloatArray) -> RobotSpec:
        """Return what a user has to know of the arm.

        Args:
            torque_resolution: Smallest change that its measured torques show, (n,) [N m].
        """
        model = self.model
        return RobotSpec(
            model.name,
            model.joint_names,
            model.limits,
            1.0 / self.rate,
            torque_resolution=torque_resolution,
            measures_temperature=self.convention != CIA402 or self.temperature is not None,
        )

    def _check_nodes(self) -> None:
        counted = Counter(joint.node for joint in self.joints)
        node, times = counted.most_common(1)[0]
        if times > 1:
            both = [str(j) for j, joint in enumerate(self.joints, 1) if joint.node == node]
            raise ConfigError(f"joints {' and '.join(both)} have the same node {node}")
        if self.convention == CIA402 and self.master in counted:
            raise ConfigError(f"master is {self.master}, which is the node of a joint")

    def _check_counts(self) -> None:
        limits = self.model.limits
        for j, joint in enumerate(self.joints):
            if not isinstance(joint, Cia402Joint):
                continue
            furthest = max(
                abs(limits.position_min[j] - joint.offset),
                abs(limits.position_max[j] - joint.offset),
            )
            count = abs(joint.counts_per_radian) * furthest
            if count > LARGEST_COUNT:
                raise ConfigError(
                    f"joint {j + 1}: {furthest:.3g} rad from its zero are {count:.3g} counts, "
                    f"more than 32 bits hold ({LARGEST_COUNT})"
                )


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
