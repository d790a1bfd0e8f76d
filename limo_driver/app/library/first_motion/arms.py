"""The arms that a first motion is for, each as its backend speaks to it."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, ClassVar

from limo_driver.errors import ConfigError
from limo_driver.quoting import in_shell

if TYPE_CHECKING:
    from pathlib import Path, PurePath

    from backends.can.config import ArmConfig
    from limo_driver.model import RobotModel
    from limo_driver.robot.registry import Examination
    from limo_driver.robot.robot import Robot

LINK_SECONDS = 5.0


@dataclass(frozen=True)
class RealArm(ABC):
    """An arm, and how it is reached.

    Args:
        model: Its description, with tool and mounting.
        options: That name the description on the command line, such as `--robot iiwa14`.
    """

    torque_needs_power: ClassVar[bool] = False  # as torque that is computed from current does

    model: RobotModel
    options: tuple[str, ...]

    @property
    @abstractmethod
    def address(self) -> str:
        """Where it is reached, in words; empty where that is not known yet."""

    @property
    @abstractmethod
    def command(self) -> str:
        """The command that examines it, without the step."""

    @abstractmethod
    def examine(self, seconds: float) -> Examination:
        """Find out how the link stands; nothing moves."""

    @abstractmethod
    def listen(self) -> Robot:
        """Open it so that nothing can move it."""

    @abstractmethod
    def open(self) -> Robot:
        """Open it to be commanded."""

    @abstractmethod
    def judge_link(self, found: Examination, robot: Robot) -> None:
        """Add what the link says by itself, after an arm was listened to."""

    def complete_from(self, record: dict[str, Any]) -> RealArm:  # noqa: ARG002  # most know all
        """Return the arm with what the record of its link knows more."""
        return self

    def _words(self, *words: str | PurePath) -> str:
        return " ".join(("limo doctor", *map(in_shell, words), *map(in_shell, self.options)))


@dataclass(frozen=True)
class FriArm(RealArm):
    """An iiwa behind its controller.

    Args:
        host: Address of the controller; whoever sends, if None, in the first step.
        port: UDP port of this machine.
    """

    host: str | None = None
    port: int = 30200

    @property
    def address(self) -> str:
        """Controller and port."""
        from backends.fri.connection import resolve

        return "" if self.host is None else f"FRI {resolve(self.host)}, port {self.port}"

    @property
    def command(self) -> str:
        """The command that examines it, without the step."""
        host = () if self.host is None else ("--host", self.host)
        return self._words("fri", *host, "--port", str(self.port))

    def examine(self, seconds: float) -> Examination:
        """Find out how the link stands, answering a session that is monitored only."""
        from backends.fri.doctor import examine

        return examine(self.host, self.port, seconds, listen_only=True)

    def listen(self) -> Robot:
        """Open it, answering while it is monitored only."""
        return self._open(listen_only=True)

    def open(self) -> Robot:
        """Open it to be commanded."""
        return self._open(listen_only=False)

    def _open(self, *, listen_only: bool) -> Robot:
        from backends.fri.robot import FriRobot

        return FriRobot(self.host, self.port, self.model.name, listen_only=listen_only)

    def judge_link(self, found: Examination, robot: Robot) -> None:
        """Add sessions that asked for commands, and poses that no arm can have got to."""
        from backends.fri.codec.messages import SessionState
        from backends.fri.doctor import ASKED
        from backends.fri.robot import FriRobot

        if not isinstance(robot, FriRobot):
            return
        if any(visit.state >= SessionState.COMMANDING_WAIT for visit in robot.visits):
            found.add("asks-for-commands", ASKED)
        if robot.figures.implausible:
            found.add(
                "jump",
                f"{robot.figures.implausible} measurements were none that the arm can have got to: "
                f"{robot.malformed}",
            )

    def complete_from(self, record: dict[str, Any]) -> RealArm:
        """Return the arm with the address at which the first step found it."""
        host = record["figures"].get("host")
        return replace(self, host=host) if self.host is None and isinstance(host, str) else self


@dataclass(frozen=True)
class CanArm(RealArm):
    """An arm of drives on a CAN bus.

    Args:
        config: What is to be known of it.
        path: The file of that.

    Raises:
        ConfigError: The description is of another arm than the drives.
    """

    torque_needs_power: ClassVar[bool] = True

    config: ArmConfig
    path: Path

    def __post_init__(self) -> None:
        own, given = self.config.model, self.model
        if own.joint_names != given.joint_names or own.urdf.read_bytes() != given.urdf.read_bytes():
            raise ConfigError(
                f"is of the robot {own.name}, and another description was given: {given.name}; "
                "state the same in both",
                path=self.path,
            )

    @property
    def address(self) -> str:
        """Bus and nodes."""
        bus, nodes = self.config.bus, (str(joint.node) for joint in self.config.joints)
        more = "".join(f", {name} {value}" for name, value in bus.options.items())
        return f"CAN {bus.interface} {bus.channel}{more}, nodes {' '.join(nodes)}"

    @property
    def command(self) -> str:
        """The command that examines it, without the step."""
        return self._words("can", "--config", self.path)

    def examine(self, seconds: float) -> Examination:
        """Find out how the bus stands; no drive gets power."""
        from backends.can.doctor import examine

        return examine(self.config, seconds)

    def listen(self) -> Robot:
        """Open it; no drive gets power."""
        from backends.can.robot import CanRobot

        return CanRobot(self.config, listen_only=True)

    def open(self) -> Robot:
        """Open it to be commanded."""
        from backends.can.robot import CanRobot

        return CanRobot(self.config)

    def judge_link(self, found: Examination, robot: Robot) -> None:
        """Add drives that are in fault."""
        from backends.can.robot import CanRobot

        if not isinstance(robot, CanRobot):
            return
        for joint, drive in enumerate(robot.drives, start=1):
            if drive.error:
                found.add("drive-fault", f"joint {joint} (node {drive.node}): {drive.error}")
