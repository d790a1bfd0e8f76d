"""The session of the simulated controller: which state follows which, and when.

IDLE → MONITORING_WAIT → MONITORING_READY → COMMANDING_WAIT → COMMANDING_ACTIVE, one at a time:

- a session opens in MONITORING_WAIT, and is READY when the quality is at least GOOD;
- the robot's application then asks for an overlay (COMMANDING_WAIT), after `monitor` seconds;
- the client's commands count (COMMANDING_ACTIVE) once it has confirmed the set-point `confirm`
  times in a row;
- bad quality leads back to MONITORING_WAIT, a stop to MONITORING_READY, and a state that is capped
  from outside to that state. The application asks again after `monitor`, or, after a stop, once
  that is over and `restart` seconds have passed.

The times are limo's, as an application on a real controller would choose its own.

With it, the monitoring packets that the controller writes.

Settings of the simulated controller, and whether a client can command with them.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Final

import numpy as np

from backends.fri.codec.messages import (
    JOINTS,
    CommandMode,
    ConnectionInfo,
    ControlMode,
    DriveState,
    FriVersion,
    Generation,
    Header,
    IoValue,
    IpoData,
    MonitorData,
    Monitoring,
    OperationMode,
    OverlayType,
    Quality,
    Redundancy,
    RedundancyStrategy,
    RobotInfo,
    SafetyState,
    SessionState,
    Timestamp,
    Transformation,
)
from backends.fri.codec.template import MonitoringTemplate
from backends.fri.simulator.arm import Compliance
from backends.fri.simulator.connection.port import Address, QualityModel
from backends.fri.simulator.judge import CommandLimits
from limo_driver.errors import ConfigError
from limo_driver.runtime.parameters import Declared, parameter

if TYPE_CHECKING:
    from backends.fri.simulator.arm import ArmState
    from limo_driver.model import RobotModel
    from limo_driver.types import FloatArray


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


MOST_VISITS: Final = 10_000  # remembered; a controller may run for days
_EPSILON: Final = 1e-9  # [s]


@dataclass(frozen=True)
class ControllerVisit:
    """A session state, and when it was entered."""

    state: SessionState
    at: float  # [s] since the start
    reason: str  # why the session went down; empty if it went up


@dataclass(frozen=True)
class Circumstances:
    """Inputs of the session's state machine in one cycle."""

    quality: Quality
    confirmed: int  # answers in a row that confirm the set-point
    cap: SessionState = SessionState.COMMANDING_ACTIVE  # the highest state allowed,
    cap_reason: str = ""  # and what capped it
    stop: str = ""  # why the arm has to stop; empty if it need not


class ControllerSession:
    """State machine of the session.

    Args:
        times: What the application chose.
    """

    def __init__(self, times: SessionTimes) -> None:
        self.times = times
        self.state = SessionState.IDLE
        self.visits = [ControllerVisit(SessionState.IDLE, 0.0, "")]
        self.forgotten = 0  # visits beyond the most
        self._entered = 0.0
        self._commanding_from = 0.0  # before which no overlay is asked for

    @property
    def commanding(self) -> bool:
        """Whether an overlay was asked for."""
        return self.state >= SessionState.COMMANDING_WAIT

    @property
    def active(self) -> bool:
        """Whether the client's commands move the arm."""
        return self.state is SessionState.COMMANDING_ACTIVE

    def update(self, now: float, given: Circumstances) -> SessionState:
        """Go on by at most one state up, or down to where it has to be.

        Args:
            now: Since the start [s].
            given: What it depends on.
        """
        if given.stop:
            self._commanding_from = now + self.times.restart
        # The highest state that may be kept, and why no higher one
        bounds = [(given.cap, given.cap_reason)]
        if given.quality < Quality.GOOD:
            reason = f"the quality of the connection is {given.quality.name}"
            bounds.append((SessionState.MONITORING_WAIT, reason))
        if given.stop:
            bounds.append((SessionState.MONITORING_READY, given.stop))
        lower, reason = min(bounds, key=lambda bound: bound[0])
        if lower < self.state:
            self._enter(lower, now, reason)
        elif self._may_rise(now, given):
            self._enter(SessionState(self.state + 1), now, "")
        return self.state

    def _may_rise(self, now: float, given: Circumstances) -> bool:
        if self.state >= given.cap or self.active:
            return False
        if self.state is SessionState.IDLE:
            return True
        if self.state is SessionState.MONITORING_WAIT:
            return given.quality >= Quality.GOOD
        if self.state is SessionState.MONITORING_READY:
            since = max(self._entered + self.times.monitor, self._commanding_from)
            return now >= since - _EPSILON and not given.stop
        return given.confirmed >= self.times.confirm

    def _enter(self, state: SessionState, now: float, reason: str) -> None:
        self.state, self._entered = state, now
        if len(self.visits) < MOST_VISITS:
            self.visits.append(ControllerVisit(state, now, reason))
        else:
            self.forgotten += 1


POSE_NAME: Final = "flange"  # of the Cartesian pose, from 2.5 on
_ELBOW: Final = 2  # 0-based joint whose angle is the redundancy E1
_ON: Final = (DriveState.ACTIVE,) * JOINTS
_OFF: Final = (DriveState.OFF,) * JOINTS
_NANO: Final = 1_000_000_000


@dataclass(frozen=True)
class Standing:
    """State of session and arm in one cycle."""

    stamp_ns: int  # of the controller's own clock, in Unix time
    session: SessionState
    quality: Quality
    safety: SafetyState
    control: ControlMode
    arm: ArmState
    setpoint: FloatArray  # (7,) [rad]
    ipo: FloatArray  # (7,) [rad], of the robot's own program
    commanded_torque: FloatArray  # (7,) [N m]
    tracking: float  # 0 to 1
    ios: tuple[IoValue, ...] = ()


class MonitoringWriter:
    """Writes the packets of one session.

    Args:
        version: Of FRI.
        mode: What the application lets the client command.
        period_ms: Send period [ms].
        multiplier: Receive multiplier.
        model: The robot's own model, for Cartesian poses.
        requested: Transformations that the client shall send.
    """

    def __init__(
        self,
        version: FriVersion,
        mode: CommandMode,
        period_ms: int,
        multiplier: int,
        model: RobotModel,
        requested: tuple[Transformation, ...] = (),
    ) -> None:
        self._template = MonitoringTemplate(version)
        self._generation = version.generation
        self._mode, self._period, self._multiplier = mode, period_ms, multiplier
        self._model, self._requested = model, requested
        wrench = mode is CommandMode.WRENCH
        self._overlay = OverlayType.CARTESIAN if wrench else OverlayType.JOINT

    def write(self, sequence: int, reflected: int, at: Standing) -> bytes:
        """Return the packet of a cycle.

        Args:
            sequence: The controller's own counter.
            reflected: The client's last counter.
            at: How things stand.
        """
        return self._template.encode(
            Monitoring(
                header=Header(sequence, reflected),
                robot=RobotInfo(
                    number_of_joints=JOINTS,
                    safety_state=at.safety,
                    drive_states=_OFF if at.safety is SafetyState.STOP0_OR_1 else _ON,
                    operation_mode=OperationMode.AUT,
                    control_mode=at.control,
                ),
                data=self._data(at),
                connection=ConnectionInfo(at.session, at.quality, self._period, self._multiplier),
                ipo=self._ipo(at),
                requested_transformations=self._requested,
            )
        )

    def _data(self, at: Standing) -> MonitorData:
        arm, one = at.arm, self._generation is Generation.ONE
        external = at.arm.external_torque
        return MonitorData(
            measured_position=tuple(arm.position.tolist()),
            measured_torque=tuple(arm.torque.tolist()),
            commanded_position=tuple(at.setpoint.tolist()) if one else None,
            commanded_torque=tuple(at.commanded_torque.tolist()),
            external_torque=tuple(external.tolist()),
            external_force=self._force(arm) if self._generation is Generation.TWO_SEVEN else None,
            io=at.ios,
            measured_pose=None if one else self._pose(arm.position),
            measured_redundancy=None if one else _redundancy(arm.position),
            timestamp=Timestamp(*divmod(at.stamp_ns, _NANO)),
        )

    def _ipo(self, at: Standing) -> IpoData:
        if at.session < SessionState.COMMANDING_WAIT:
            return IpoData(
                command_mode=CommandMode.NONE,
                overlay_type=OverlayType.NONE,
                tracking_performance=0.0,
            )
        one = self._generation is Generation.ONE
        return IpoData(
            joint_position=tuple(at.ipo.tolist()),
            pose=None if one else self._pose(at.ipo),
            redundancy=None if one else _redundancy(at.ipo),
            command_mode=self._mode,
            overlay_type=self._overlay,
            tracking_performance=at.tracking,
        )

    def _pose(self, position: FloatArray) -> Transformation:
        """Return the flange in the base, [x y z qw qx qy qz]."""
        pose = self._model.flange_pose(position)
        return Transformation(POSE_NAME, (*pose[:3, 3].tolist(), *quaternion(pose[:3, :3])))

    def _force(self, arm: ArmState) -> tuple[float, ...]:
        """Return the force and moment at the flange that explain the external torque best."""
        jacobian = self._model.flange_jacobian(arm.position)
        return tuple(np.linalg.lstsq(jacobian.T, arm.external_torque, rcond=1e-3)[0].tolist())


def _redundancy(position: FloatArray) -> Redundancy:
    return Redundancy(RedundancyStrategy.E1, float(position[_ELBOW]))


def quaternion(rotation: FloatArray) -> tuple[float, float, float, float]:
    """Return [w x y z] of a rotation matrix, with w >= 0."""
    xx, yy, zz = (float(rotation[k, k]) for k in range(3))
    squares = np.array([1 + xx + yy + zz, 1 + xx - yy - zz, 1 - xx + yy - zz, 1 - xx - yy + zz])
    largest = int(np.argmax(squares))
    R = rotation
    products = np.array(
        [
            [squares[0], R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]],
            [R[2, 1] - R[1, 2], squares[1], R[1, 0] + R[0, 1], R[0, 2] + R[2, 0]],
            [R[0, 2] - R[2, 0], R[1, 0] + R[0, 1], squares[2], R[2, 1] + R[1, 2]],
            [R[1, 0] - R[0, 1], R[0, 2] + R[2, 0], R[2, 1] + R[1, 2], squares[3]],
        ]
    )
    w, x, y, z = (products[largest] / np.linalg.norm(products[largest])).tolist()
    return (w, x, y, z) if w >= 0 else (-w, -x, -y, -z)
