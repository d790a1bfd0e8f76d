"""arm.yaml: an arm of drives on a CAN bus.

```yaml
bus: {interface: socketcan, channel: can0, bitrate: 1000000}
convention: cia402
robot: iiwa14
joints:
  - {node: 11, counts_per_turn: 524288, gear: 1, rated_torque: 320}
  - {node: 12, counts_per_turn: 524288, gear: 1, rated_torque: 320, direction: -1}
```

Errors of one CAN drive, named by joint and node.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any, Final, Literal

from limo_driver.errors import BackendError, ConfigError
from limo_driver.model import RobotModel
from limo_driver.model.robot_model import beside
from limo_driver.runtime.declarations import ConfigNode, read_yaml
from limo_driver.runtime.parameters import Declared, parameter
from limo_driver.types import FloatArray, RobotSpec

CIA402: Final = "cia402"
DAMIAO: Final = "damiao"
CONVENTIONS: Final = (CIA402, DAMIAO)
LARGEST_COUNT: Final = 2**31 - 1  # of a position in 32 bits
REPLY_OFFSET: Final = 0x10  # of Damiao's replies, as OpenArm sets it

Option = bool | int | float | str
# And of nobody else.
OF_CIA402: Final = {"master", "on_lost", "status_every", "temperature", "following_error"}


@dataclass(frozen=True, kw_only=True)
class Bus(Declared):
    """Connection to the bus, in python-can's terms; `options` hold all others that it takes.

    Args:
        interface: Python-can's name: socketcan, udp_multicast, virtual, pcan, ...
        channel: Of the interface.
        bitrate: Of the arbitration.
        fd: Whether frames are CAN FD.
        data_bitrate: Of the data of FD.
    """

    interface: str = parameter("")
    channel: str = parameter("")
    bitrate: int = parameter("bit/s", default=1_000_000, lower=10_000, upper=1_000_000)
    fd: bool = parameter("", default=False)
    data_bitrate: int = parameter("bit/s", default=5_000_000, lower=10_000, upper=8_000_000)
    options: Mapping[str, Option] = field(default_factory=dict)

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.fd and self.data_bitrate < self.bitrate:
            raise self._refused("data_bitrate", f"at least the bitrate of {self.bitrate} bit/s")


@dataclass(frozen=True, kw_only=True)
class Temperature(Declared):
    """Object in which CiA 402 drives keep their temperature; no standard object is for it.

    Args:
        object: Index, of an i16.
        subindex: Of the object.
        step: Of one count.
    """

    object: int = parameter("", lower=0x2000, upper=0x9FFF)
    subindex: int = parameter("", default=0, lower=0, upper=254)
    step: float = parameter("°C", default=0.1, lower=0.0, upper=100.0, above=True)


@dataclass(frozen=True, kw_only=True)
class Cia402Joint(Declared):
    """A joint with a CiA 402 drive.

    count = direction (q - offset) counts_per_turn gear / 2 pi

    Args:
        node: CANopen node id.
        counts_per_turn: Of the encoder.
        gear: Encoder turns per joint turn.
        rated_torque: At the joint.
        torque_ratio: Torque at the joint over object 6076.
        direction: Of the count.
        offset: Joint position at count 0.
        serial: Object 1018:04, where known.
        vendor: Object 1018:01, where known.
    """

    node: int = parameter("", lower=1, upper=127)
    counts_per_turn: float = parameter("1", lower=0.0, upper=2.0**32, above=True)
    gear: float = parameter("1", default=1.0, lower=0.0, upper=1e5, above=True)
    rated_torque: float = parameter("N m", lower=0.0, upper=1e5, above=True)
    torque_ratio: float = parameter("1", default=1.0, lower=0.0, upper=1e5, above=True)
    direction: int = parameter("", default=1, of=(1, -1))
    offset: float = parameter("rad", default=0.0, lower=-1e3, upper=1e3)
    serial: int | None = parameter("", default=None, lower=0, upper=2**32 - 1)
    vendor: int | None = parameter("", default=None, lower=0, upper=2**32 - 1)

    @property
    def counts_per_radian(self) -> float:
        """Counts of the drive's position per radian of the joint, with its sign."""
        return self.direction * self.counts_per_turn * self.gear / math.tau


@dataclass(frozen=True, kw_only=True)
class DamiaoJoint(Declared):
    """A joint with a Damiao motor in MIT mode: q = direction (motor - offset).

    Args:
        node: Id that it takes commands on.
        reply: Id of its replies; 0 is node + 0x10.
        direction: Of the count.
        offset: Motor position at joint zero.
        stiffness: Kp of positions.
        damping: Kd of positions.
    """

    node: int = parameter("", lower=1, upper=0x7F)
    reply: int = parameter("", default=0, lower=0, upper=0x7FE)
    direction: int = parameter("", default=1, of=(1, -1))
    offset: float = parameter("rad", default=0.0, lower=-1e3, upper=1e3)
    stiffness: float = parameter("N m/rad", default=50.0, lower=0.0, upper=500.0)
    damping: float = parameter("N m s/rad", default=1.0, lower=0.0, upper=5.0)

    @property
    def reply_id(self) -> int:
        """Arbitration id of its replies."""
        return self.reply or self.node + REPLY_OFFSET


Joint = Cia402Joint | DamiaoJoint


@dataclass(frozen=True, kw_only=True)
class ArmConfig(Declared):
    """All that is to be known of an arm before its bus is opened.

    Args:
        convention: Of the drives.
        robot: Built-in name or URDF.
        rate: Of control cycles.
        master: Node id of this program's heartbeat.
        watchdog: Of silence, after which drives stop.
        on_lost: What drives then do.
        hold_after: Cycles of a silent joint.
        following_error: By which a joint may be off its latest set-points.
        status_every: Cycles between drive statuses.
        answer_timeout: For the answer of a drive at start-up.
    """

    bus: Bus
    convention: Literal["cia402", "damiao"] = parameter("", default=CIA402, of=CONVENTIONS)
    robot: str = parameter("")
    joints: tuple[Joint, ...]
    rate: float = parameter("Hz", default=250.0, lower=1.0, upper=4000.0)
    master: int = parameter("", default=127, lower=1, upper=127)
    watchdog: float = parameter("s", default=0.1, lower=0.002, upper=5.0)
    on_lost: str = parameter("", default="quick_stop", of=("quick_stop", "fault", "disable"))
    hold_after: int = parameter("", default=2, lower=1, upper=1000)
    following_error: float = parameter("rad", default=0.05, lower=0.001, upper=3.0)
    status_every: int = parameter("", default=10, lower=1, upper=240)
    answer_timeout: float = parameter("s", default=1.0, lower=0.01, upper=60.0)
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
            raise self._refused("watchdog", f"at least two cycles of {1 / self.rate:g} s")
        self._check_counts()

    @classmethod
    def load(cls, path: Path | str) -> ArmConfig:
        """Read an `arm.yaml`.

        Raises:
            ConfigError: Names the line, what was given and what exists.
        """
        return _read(Path(path))

    @cached_property
    def model(self) -> RobotModel:
        """The robot: its kinematics, inertias, which hold it against gravity, and limits."""
        model = RobotModel.load(self.robot)
        model.check_masses()
        return model

    def spec(self, torque_resolution: FloatArray) -> RobotSpec:
        """Return the specification of the arm.

        Args:
            torque_resolution: Smallest change that its measured torques show, (n,) [N m].

        Raises:
            ConfigError: A joint has no limit of velocity or torque.
        """
        model = self.model
        model.check_runnable()
        return RobotSpec(
            model.name,
            model.joint_names,
            model.limits,
            1.0 / self.rate,
            torque_resolution=torque_resolution,
            measures_temperature=self.convention != CIA402 or self.temperature is not None,
            jerk=model.jerk,
        )

    def _check_nodes(self) -> None:
        counted = Counter(joint.node for joint in self.joints)
        node, times = counted.most_common(1)[0]
        if times > 1:
            both = [str(j) for j, joint in enumerate(self.joints, 1) if joint.node == node]
            raise ConfigError(f"joints {' and '.join(both)} have the same node {node}")
        if self.convention == CIA402 and self.master in counted:
            raise self._refused("master", "no node of a joint")

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


def _read(path: Path) -> ArmConfig:
    given = read_yaml(path, needs="bus, robot and joints").of_kind(ArmConfig)
    robot, listed = beside(given.text("robot"), path.parent), given["joints"].sections()
    convention = CIA402
    if "convention" in given:
        convention = given.text("convention", CONVENTIONS)
    if convention != CIA402 and (foreign := OF_CIA402 & given.entries.keys()):
        for name in foreign:
            given[name].fail(f"is for CiA 402 drives; {convention} motors have no such thing")
    kind = Cia402Joint if convention == CIA402 else DamiaoJoint
    joints: list[Joint] = [entry.make(kind) for entry in listed]
    parts: dict[str, Any] = {"robot": robot, "joints": tuple(joints), "bus": _bus(given["bus"])}
    if not given.optional("temperature").is_empty:
        parts["temperature"] = given["temperature"].make(Temperature)
    return given.make(ArmConfig, parts)


def _bus(given: ConfigNode) -> Bus:
    options = given.optional("options").entries
    return given.make(Bus, {"options": {name: value.plain() for name, value in options.items()}})


class DriveError(BackendError):
    """One drive of an arm does not do what it has to.

    Args:
        joint: 1-based joint.
        node: Node id of its drive.
        message: What is wrong, and what to do about it.
    """

    def __init__(self, joint: int, node: int, message: str) -> None:
        self.joint, self.node = joint, node
        super().__init__(f"joint {joint} (node {node}) {message}")


class SdoAbortError(DriveError):
    """A drive refuses to read or write one of its objects.

    Args:
        joint: 1-based joint.
        node: Node id of its drive.
        index: Object.
        subindex: Its part.
        code: Abort code of CiA 301.
    """

    def __init__(self, joint: int, node: int, index: int, subindex: int, code: int) -> None:
        self.index, self.subindex, self.code = index, subindex, code
        text = _ABORTS.get(code, "a reason of its own")
        super().__init__(
            joint, node, f"refuses object {index:04X}:{subindex:02X}: {text} ({code:08X})"
        )

    @property
    def is_absent(self) -> bool:
        """Whether the drive has no such object."""
        return self.code in {0x06020000, 0x06090011}


# Source: CiA 301, table 22.
_ABORTS = {
    0x05030000: "toggle bit not alternated",
    0x05040000: "protocol timed out",
    0x05040001: "command unknown",
    0x06010000: "unsupported access",
    0x06010001: "object can only be written",
    0x06010002: "object can only be read",
    0x06020000: "object does not exist",
    0x06040041: "object cannot be mapped to a PDO",
    0x06040042: "mapped objects are longer than a PDO",
    0x06040043: "parameters do not fit together",
    0x06060000: "hardware error",
    0x06070010: "length of the value is wrong",
    0x06070012: "value is too long",
    0x06070013: "value is too short",
    0x06090011: "subindex does not exist",
    0x06090030: "value is out of range",
    0x06090031: "value is too high",
    0x06090032: "value is too low",
    0x08000000: "general error",
    0x08000020: "value cannot be stored",
    0x08000021: "local control has the drive",
    0x08000022: "the present state of the drive does not allow it",
}
