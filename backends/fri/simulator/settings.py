"""Settings of the simulated controller, and whether a client can command with them."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Final

from backends.fri.codec.messages import CommandMode, ControlMode, FriVersion, IoValue
from backends.fri.simulator.arm import Compliance
from backends.fri.simulator.connection.port import Address, QualityModel
from backends.fri.simulator.judge import CommandLimits
from limo_driver.errors import ConfigError
from limo_driver.runtime.parameters import Declared, parameter

SHORTEST_PERIOD, LONGEST_PERIOD = 1, 100  # [ms]
COMMANDING_INTERVAL: Final = 10  # [ms], longest receive interval in which positions are commanded
COMPLIANT_INTERVAL: Final = 5  # [ms], for torque and wrench
ANYWHERE: Final = Address("0.0.0.0", 0)  # noqa: S104  # as a controller listens
POSE: Final = (0.0, 0.5, 0.0, -1.2, 0.0, 0.9, 0.0)  # [rad], where the arm stands at first
MODES: Final = {
    "position": CommandMode.POSITION,
    "torque": CommandMode.TORQUE,
    "wrench": CommandMode.WRENCH,
}
_CONTROL: Final = {
    CommandMode.POSITION: ControlMode.POSITION,
    CommandMode.TORQUE: ControlMode.JOINT_IMPEDANCE,
    CommandMode.WRENCH: ControlMode.CARTESIAN_IMPEDANCE,
}


@dataclass(frozen=True)
class SessionTimes(Declared):
    """Settings that the robot's application would choose."""

    monitor: float = parameter(
        "s", "in MONITORING_READY before an overlay is asked for", lower=0, default=0.5
    )
    confirm: int = parameter("", "answers in a row, before an overlay begins", lower=1, default=10)
    restart: float = parameter("s", "from a stop to the next overlay", lower=0, default=1.0)
    stop: float = parameter(
        "s", "for which a stop of the controller's own is shown", lower=0, default=0.5
    )


@dataclass(frozen=True)
class ControllerSettings(Declared):
    """Settings of one controller.

    Raises:
        ConfigError: Out of bounds.
    """

    client: Address
    version: FriVersion = FriVersion.V1_15
    bind: Address = ANYWHERE
    mode: CommandMode = CommandMode.POSITION
    period_ms: int = parameter("ms", lower=SHORTEST_PERIOD, upper=LONGEST_PERIOD, default=2)
    multiplier: int = parameter(
        "", "packets in one receive interval", lower=1, upper=LONGEST_PERIOD, default=1
    )
    duration: float | None = parameter(
        "s", "until told to stop if None", lower=0, above=True, finite=False, default=None
    )
    late_after: float | None = parameter(
        "s", "answers slower than that are counted as slow", lower=0, default=None
    )
    position: tuple[float, ...] = POSE  # [rad]
    seed: int = 0  # of the sensors' noise
    fifo: bool = False  # ask for SCHED_FIFO
    ios: tuple[IoValue, ...] = ()  # that the application names
    transformations: tuple[str, ...] = ()  # that it requests
    quality: QualityModel = field(default_factory=QualityModel)
    times: SessionTimes = field(default_factory=SessionTimes)
    limits: CommandLimits = field(default_factory=CommandLimits)
    compliance: Compliance = field(default_factory=Compliance)

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.client.port == 0:
            raise ConfigError(f"client {self.client} has no port to send to")

    @property
    def interval_ms(self) -> int:
        """Time in which one answer is expected [ms]."""
        return self.period_ms * self.multiplier

    @property
    def note(self) -> str:
        """Remark to print before the first packet, in one line."""
        about = f"{self.mode.name.lower()} mode, every {self.period_ms} ms"
        return f"{about}; {self.monitoring_only}" if self.monitoring_only else about

    @property
    def control(self) -> ControlMode:
        """Control mode of the arm while the client commands it."""
        return _CONTROL[self.mode]

    @property
    def monitoring_only(self) -> str:
        """Why a client cannot command with these settings; empty if it can."""
        most = COMMANDING_INTERVAL if self.mode is CommandMode.POSITION else COMPLIANT_INTERVAL
        if self.interval_ms <= most:
            return ""
        return (
            f"period x multiplier is {self.interval_ms} ms; to command {self.mode.name.lower()} "
            f"it has to be at most {most} ms, so the session stays in MONITORING_READY"
        )
