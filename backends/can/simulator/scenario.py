"""What happens to simulated drives, and when: faults in a scenario.

Scenario files: what goes wrong, and when.

```yaml
seed: 1
faults:
  - {fault: lose_frames, probability: 0.01, way: from_drives}
  - {fault: drive_fault, joint: 3, at: 2.5, code: 0x4310}
```

Faults of a bus of simulated drives, one class for each kind.

Times are in seconds since a drive was first enabled, or since the drives were switched on, as
`from` says; wrong and swapped ids are there from the start.
"""

from __future__ import annotations

import math
from abc import ABC
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, Final

from limo_driver.errors import ConfigError
from limo_driver.runtime.declarations import read_yaml
from limo_driver.runtime.parameters import JOINT, Declared, parameter

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    import numpy as np

    from backends.can.config import Joint
    from backends.can.simulator.drive import SimulatedDrive

ENABLED, SWITCHED_ON = "enabled", "start"
TO_DRIVES, FROM_DRIVES, BOTH = "to_drives", "from_drives", "both"
MOST_BABBLE: Final = 100  # frames at once


@dataclass(frozen=True)
class BusScenario(Declared):
    """Faults, and the seed of their chances.

    Args:
        seed: Of chances.
        origin: From when times count; those of hands that guide the arm count from the start.
    """

    faults: tuple[Fault, ...] = ()
    seed: int = parameter("", lower=0, default=0)
    origin: str = parameter("", default=ENABLED, of=(ENABLED, SWITCHED_ON), key="from")

    @classmethod
    def load(cls, path: Path | str, joints: Sequence[Joint]) -> BusScenario:
        """Read a scenario for an arm.

        Raises:
            ConfigError: Names the line, what was given and what exists.
        """
        given = read_yaml(Path(path), needs="`faults:`")
        if "faults" not in given:
            given.fail("lacks `faults:`, a list of `- {fault: ..., at: ...}`")
        faults: list[Fault] = []
        for entry in given["faults"].sections():
            faults.append(entry.make_one_of("fault", KINDS, len(joints)))
            with entry.blamed():
                faults[-1].check(joints)
        return given.make(cls, {"faults": tuple(faults)})


@dataclass(frozen=True, kw_only=True)
class Fault(Declared, ABC):
    """Something that goes wrong at some time, for some time."""

    name: ClassVar[str]
    at: float = parameter(default=0.0, lower=0.0)  # [s]
    lasts: float | None = parameter(
        default=None, lower=0.0, above=True
    )  # [s]; for ever if not given

    @property
    def ends(self) -> float:
        """When it is over [s]."""
        return math.inf if self.lasts is None else self.at + self.lasts

    def check(self, joints: Sequence[Joint]) -> None:
        """Refuse a fault that this arm cannot have.

        Raises:
            ParameterError: Names the entry that is wrong.
        """

    def rewire(self, nodes: list[int]) -> None:
        """Change the node ids of the drives, joint by joint, before they are switched on."""

    def loses(self, joint: int, way: str, random: np.random.Generator) -> bool:  # noqa: ARG002
        """Say whether a frame to or from the drive of a joint (from 1) is lost."""
        return False

    def begin(self, drives: Sequence[SimulatedDrive]) -> None:
        """Go wrong."""

    def end(self, drives: Sequence[SimulatedDrive]) -> None:
        """Be over."""

    def disturb(self, elapsed: float, send: Callable[[int, bytes], None]) -> None:
        """Send what nobody asked for, `elapsed` seconds after the last time."""


@dataclass(frozen=True, kw_only=True)
class LostFrames(Fault):
    """Frames are lost at random.

    Args:
        joint: All if not given.
    """

    name = "lose_frames"
    probability: float = parameter(lower=0.0, upper=1.0)
    way: str = parameter(default=BOTH, of=(TO_DRIVES, FROM_DRIVES, BOTH))
    joint: int | None = parameter(JOINT, default=None)

    def loses(self, joint: int, way: str, random: np.random.Generator) -> bool:
        """Say whether a frame to or from the drive of a joint (from 1) is lost."""
        concerns = self.joint in {None, joint} and self.way in {BOTH, way}
        return concerns and random.random() < self.probability


@dataclass(frozen=True, kw_only=True)
class BusOff(Fault):
    """A drive is off the bus: it neither hears nor speaks, but it has its watchdogs."""

    name = "bus_off"
    joint: int = parameter(JOINT)

    def loses(self, joint: int, way: str, random: np.random.Generator) -> bool:  # noqa: ARG002
        """Say whether a frame to or from the drive of a joint (from 1) is lost."""
        return joint == self.joint

    def end(self, drives: Sequence[SimulatedDrive]) -> None:
        """Be back on the bus."""
        drives[self.joint - 1].recover()


@dataclass(frozen=True, kw_only=True)
class Babble(Fault):
    """A node that belongs to nobody fills the bus with frames."""

    name = "babble"
    id: int = parameter(default=0x7F0, lower=0, upper=0x7FF)
    rate: float = parameter(default=2000.0, lower=1.0, upper=20_000.0)  # [Hz]
    data: str = parameter(default="5555555555555555")  # hexadecimal

    def __post_init__(self) -> None:
        super().__post_init__()
        try:
            length = len(bytes.fromhex(self.data))
        except ValueError:
            length = -1
        if not 0 <= length <= 8:  # noqa: PLR2004  # bytes of a frame
            raise self._refused("data", "up to 8 bytes in hexadecimal")

    def disturb(self, elapsed: float, send: Callable[[int, bytes], None]) -> None:
        """Send as many frames as are due."""
        data = bytes.fromhex(self.data)
        for _ in range(min(round(elapsed * self.rate), MOST_BABBLE)):
            send(self.id, data)


@dataclass(frozen=True, kw_only=True)
class DriveFault(Fault):
    """A drive has a fault of its own."""

    name = "drive_fault"
    joint: int = parameter(JOINT)
    code: int = parameter(default=0x4310, lower=1, upper=0xFFFF)  # 4310: the drive is too hot

    def begin(self, drives: Sequence[SimulatedDrive]) -> None:
        """Have the fault."""
        drives[self.joint - 1].fail(self.code)


@dataclass(frozen=True, kw_only=True)
class WrongNode(Fault):
    """A drive has another node id than the configuration says."""

    name = "wrong_node"
    joint: int = parameter(JOINT)
    node: int = parameter(lower=1, upper=127)

    def check(self, joints: Sequence[Joint]) -> None:
        """Refuse a node id that another drive has."""
        for j, joint in enumerate(joints, start=1):
            if j != self.joint and joint.node == self.node:
                raise self._refused("node", f"another than that of joint {j}")

    def rewire(self, nodes: list[int]) -> None:
        """Give the drive its other id."""
        nodes[self.joint - 1] = self.node


@dataclass(frozen=True, kw_only=True)
class SwappedJoints(Fault):
    """The drives of two joints have each other's node id."""

    name = "swap_joints"
    joint: int = parameter(JOINT)
    other: int = parameter(JOINT)

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.joint == self.other:
            raise self._refused("other", "another joint")

    def rewire(self, nodes: list[int]) -> None:
        """Swap the ids."""
        a, b = self.joint - 1, self.other - 1
        nodes[a], nodes[b] = nodes[b], nodes[a]


@dataclass(frozen=True, kw_only=True)
class Guide(Fault):
    """Somebody guides the arm by hand to a pose, and it stays there.

    Times count from when the drives are switched on, and joints that have power do not give way.
    """

    name = "guide"
    position: tuple[float, ...] = parameter("rad", lower=-10.0, upper=10.0)

    def check(self, joints: Sequence[Joint]) -> None:
        """Refuse a pose of another arm."""
        if len(self.position) != len(joints):
            raise self._refused("position", f"{len(joints)} angles, one for each joint")
        if math.isinf(self.ends):
            raise ConfigError(f"{self.name} needs a time in which the hand is there")

    def on_way(self, start: np.ndarray, elapsed: float) -> np.ndarray:
        """Return where the hand has the arm, (n,) [rad], so long after the start [s]."""
        u = min((elapsed - self.at) / (self.ends - self.at), 1.0)
        return start + (self.position - start) * u**3 * (10.0 - 15.0 * u + 6.0 * u**2)


KINDS: Final[dict[str, type[Fault]]] = {kind.name: kind for kind in Fault.__subclasses__()}


def rewired(joints: Sequence[Joint], faults: Sequence[Fault]) -> tuple[Joint, ...]:
    """Return the joints with the node ids that their drives really have."""
    nodes = [joint.node for joint in joints]
    for fault in faults:
        fault.rewire(nodes)
    changed: list[Any] = [
        replace(joint, node=node) for joint, node in zip(joints, nodes, strict=True)
    ]
    return tuple(changed)
