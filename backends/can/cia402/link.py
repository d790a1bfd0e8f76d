"""Cia402Link: seven drives (or any number) over CANopen, in cycles that SYNC starts.

The set-points of a cycle travel as RPDOs and take effect at its SYNC, which is also when drives
measure; their TPDOs answer. A drive that leaves operation is told to stop, and has to be reset
before it is enabled again, at the pose where it stands.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Final

import numpy as np

from backends.can.cia402.codec import (
    HEARTBEATS_PER_WATCHDOG,
    MOST_PER_MILLE,
    Codec,
    Controlword,
    OperatingMode,
    State,
    bus_load,
    describe,
    towards_enabled,
)
from backends.can.cia402.commissioning import Commissioning
from backends.can.cia402.drive import OPERATIONAL, Drive, FollowingCheck
from backends.can.cia402.sdo import QUIET, SdoClient, require_answer, require_quiet
from backends.can.config import ArmConfig, Cia402Joint, DriveError
from backends.can.link import DriveSample, DriveStatus, Link
from backends.can.port import (
    EMERGENCY,
    HEARTBEAT,
    NMT,
    RPDO1,
    RPDO2,
    RPDO3,
    RPDO4,
    SYNC,
    TPDO1,
    TPDO2,
    TPDO3,
    BusPort,
)
from limo_driver.errors import BackendError, ConfigError
from limo_driver.robot.measured import SLACK
from limo_driver.robot.output import Setpoint
from limo_driver.robot.setpoints import VELOCITY_TOLERANCE
from limo_driver.types import FloatArray, JointCommand, PositionCommand, TorqueCommand

START, PRE_OPERATIONAL = 0x01, 0x80  # NMT commands
MODE_PATIENCE: Final = 3  # drive statuses after which a mode has to be taken
CATCH_UP: Final = 0.5  # [s] at most, to read what came before drives are enabled
SHORT_TIMEOUT: Final = 0.05  # [s] at least, for an answer that others wait for


class Cia402Link(Link):
    """The drives of an arm.

    Args:
        config: The arm.
        port: Its bus.
        reset: Whether faults that drives have already may be reset.

    Raises:
        ConfigError: The bus cannot carry the rate; shows the arithmetic.
    """

    def __init__(self, config: ArmConfig, port: BusPort, *, reset: bool = False) -> None:
        bus_load(config).require(config.rate)
        super().__init__(port, 1.0 / config.rate, config.model)
        self.config, self._reset = config, reset
        self._joints: tuple[Cia402Joint, ...] = config.joints  # type: ignore[assignment]
        self._drives = [Drive(j, joint.node) for j, joint in enumerate(self._joints, start=1)]
        self._handlers = self._dispatch()
        self._codec = Codec(self._joints, [1.0] * len(self._joints))
        counts = np.abs(self._codec.counts_per_radian)
        self._fastest = (counts * VELOCITY_TOLERANCE * config.model.limits.velocity).tolist()
        self._slack = (counts * SLACK).tolist()
        n = len(self._drives)
        self._torque = np.zeros(n)  # [N m]
        self._pinned = np.ones(n, dtype=bool)  # joints that keep the pose they have
        self._mode, self._mode_cycles = OperatingMode.POSITION, 0
        self._commanded = self._powered = False
        self._heartbeat_due = 0.0
        self._following = FollowingCheck(n, self._period, config.following_error)

    @property
    def torque_resolution(self) -> FloatArray:
        """Smallest change that the measured torques show, (n,) [N m]."""
        return self._codec.torque_resolution

    @property
    def most_torque(self) -> FloatArray:
        """Highest torque that can be said to the drives, (n,) [N m]."""
        return MOST_PER_MILLE * self._codec.torque_resolution

    # start and end ------------------------------------------------------------------------------

    def connect(self) -> None:
        """Find every drive, check that it is the right one, and configure it; none moves."""
        require_quiet(self.port, self.config)
        for drive in self._drives:
            self.port.send(NMT, bytes((PRE_OPERATIONAL, drive.node)))
        rated: list[int] = []
        for drive in self._drives:
            commissioning = self._commissioning(drive)
            require_answer(commissioning.sdo, [joint.node for joint in self._joints])
            rated.append(commissioning.identify())
        self._codec = Codec(self._joints, rated)
        for drive in self._drives:
            self._start(drive)
        self._await_measurements()

    def enable(self, *, reset: bool = False) -> None:
        """Let the drives hold the pose that they measure."""
        reset = reset or self._reset
        self._catch_up()
        until = self.port.now() + self.config.answer_timeout
        self._mode, self._commanded = OperatingMode.POSITION, False
        self.port.bus_off, self.intruder = False, ""
        for drive in self._drives:
            if self._has_forgotten(drive):
                self._start(drive)
        waiting = [drive for drive in self._drives if drive.state is not State.ENABLED]
        for drive in waiting:
            self._ask_where(drive, reset=reset)
            self._pinned[drive.joint - 1] = True
        self._powered = True
        self._follow([drive for drive in self._drives if self._pinned[drive.joint - 1]])
        while missing := waiting or [drive for drive in self._drives if not drive.prompt]:
            if self.port.now() > until:
                self._give_up(missing[0])
            for drive in waiting:
                drive.controlword = towards_enabled(drive.state, drive.controlword, reset=reset)
            self._follow(waiting)
            self._run_cycle()
            waiting = [drive for drive in waiting if drive.state is not State.ENABLED]
        self._reset = False

    def versions(self) -> tuple[dict[str, int], ...]:
        """Return object 1018 of each drive."""
        return tuple(self._commissioning(drive).versions() for drive in self._drives)

    def disable(self) -> None:
        """Switch the drives off, one after the other, the last joint first."""
        if self._powered:
            if self._mode is OperatingMode.TORQUE:
                self._keep_pose()  # while one after the other is switched off
            for drive in reversed(self._drives):
                self._switch_off(drive)
        self._powered = False
        for drive in self._drives:
            self.port.send(NMT, bytes((PRE_OPERATIONAL, drive.node)))
            if drive.silent:
                continue
            try:
                self._commissioning(drive, SHORT_TIMEOUT).forget_master()
            except DriveError:
                continue  # it will complain to the next program

    # the cycle ----------------------------------------------------------------------------------

    def check(self, command: JointCommand) -> None:
        """Refuse a command that the drives cannot carry out."""
        if isinstance(command, PositionCommand):
            return
        if not isinstance(command, TorqueCommand):
            raise BackendError(
                "CiA 402 drives follow positions (CSP) or torques (CST), "
                f"given {type(command).__name__}"
            )
        try:
            bus_load(self.config, torque=True).require(self.config.rate)
        except ConfigError as error:
            raise BackendError(f"no torques at this rate: {error}") from None

    def command(self, setpoint: Setpoint) -> None:
        """Take the set-points of the coming cycle."""
        self._commanded = True
        if setpoint.mode is TorqueCommand:
            self._set_mode(OperatingMode.TORQUE)
            self._torque = (
                setpoint.torque if setpoint.gravity is None else setpoint.torque + setpoint.gravity
            )
        else:
            self._set_mode(OperatingMode.POSITION)
            self.target = np.where(self._pinned, self.target, setpoint.position)

    def begin(self) -> None:
        """Follow commands again."""
        self._pinned[:] = False

    def send(self) -> None:
        """Put the set-points of this cycle on the bus, commanded or not."""
        fallen = [drive for drive in self._drives if drive.state is not State.ENABLED]
        for drive in self._drives:
            drive.controlword = Controlword.ENABLE
        for drive in fallen:
            drive.controlword = Controlword.QUICK_STOP  # until it is reset
            self._pinned[drive.joint - 1] = True
        self._follow(fallen)
        if (
            not self._commanded and self._mode is OperatingMode.TORQUE
        ):  # at rest: nobody wants torque
            self._keep_pose()
        self._commanded = False
        self._put()

    def measure(self, until: float) -> DriveSample | None:
        """Start a cycle and return what all drives measured; None if one was not heard in time."""
        if not self._sync(until):
            return None
        drives = self._drives
        if self.config.status_every == 1 and all(drive.speed is not None for drive in drives):
            speeds: list[float] = [drive.speed or 0 for drive in drives]
        else:
            speeds = [drive.velocity(self._period) for drive in drives]
        position = self._position()
        if self._mode is OperatingMode.POSITION:
            self._following.judge(position)
        return DriveSample(
            position=position,
            velocity=self._codec.velocities(speeds),
            torque=self._codec.measured_torques([drive.per_mille for drive in drives]),
        )

    def _trouble_of_drives(self) -> str:
        now, mode = self.port.now(), self._mode
        positions = mode is OperatingMode.POSITION
        for drive in self._drives:
            if text := drive.complaint(self.config.hold_after, self.config.watchdog, now):
                return f"joint {drive.joint} (node {drive.node}) {text}"
            if drive.mode is not None and drive.mode != mode and self._mode_is_late:
                return f"joint {drive.joint} (node {drive.node}) stays in mode {drive.mode}"
            if drive.lags and positions:
                return f"joint {drive.joint} (node {drive.node}) does not follow, as it says itself"
        return self._following.complaint(self._drives)

    def drives(self) -> tuple[DriveStatus, ...]:
        """Return the latest values of every drive."""
        position = self._position()
        velocity = self._codec.velocities(
            [np.nan if drive.speed is None else drive.speed for drive in self._drives]
        )
        torque = self._codec.measured_torques([drive.per_mille for drive in self._drives])
        heat = self.config.temperature
        return tuple(
            drive.told(*values, degree=np.nan if heat is None else heat.step)
            for drive, *values in zip(
                self._drives, position.tolist(), velocity.tolist(), torque.tolist(), strict=True
            )
        )

    def condition(self) -> tuple[FloatArray | None, tuple[str, ...]]:
        """Return temperatures (n,) [°C], None if there are none, and statuses, in every cycle."""
        heat, temperature = self.config.temperature, None
        if heat is not None:
            degrees = [np.nan if d.temperature is None else d.temperature for d in self._drives]
            temperature = heat.step * np.array(degrees)
        return temperature, tuple([drive.status for drive in self._drives])

    # within -------------------------------------------------------------------------------------

    def _dispatch(self) -> dict[int, Callable[[bytes], None]]:
        """Return who takes the frames of each id; those of this program are nobody else's."""
        beat = HEARTBEAT + self.config.master
        handlers = {SYNC: self._intrude("SYNC", SYNC), beat: self._intrude("its heartbeat", beat)}
        for drive in self._drives:
            for pdo in (RPDO1, RPDO2, RPDO3, RPDO4):
                cob_id = pdo + drive.node
                handlers[cob_id] = self._intrude(f"a set-point of joint {drive.joint}", cob_id)
            handlers[TPDO1 + drive.node] = drive.take_measured
            handlers[TPDO2 + drive.node] = drive.take_status
            handlers[TPDO3 + drive.node] = drive.take_temperature
            handlers[EMERGENCY + drive.node] = drive.take_emergency
            handlers[HEARTBEAT + drive.node] = lambda data, drive=drive: drive.take_heartbeat(
                data, self.port.now()
            )
        return handlers

    def _sync(self, until: float) -> bool:
        """Start a cycle; say whether every drive answered until then."""
        now = self.port.now()
        for drive, fastest, slack in zip(self._drives, self._fastest, self._slack, strict=True):
            drive.open_cycle(now, fastest * (now - drive.heard_at + self._period) + slack)
        self.port.send(SYNC, b"")
        self._started = True
        patient = not any(drive.silent for drive in self._drives)
        self._hear_answers(until, self._all_heard, patient=patient)
        for drive in self._drives:
            drive.close_cycle()
        return self._all_heard()

    def _all_heard(self) -> bool:
        for drive in self._drives:  # noqa: SIM110  # after every frame: a generator costs more
            if not drive.heard:
                return False
        return True

    def _catch_up(self) -> None:
        """Take in what came while nobody listened, heartbeats of minutes perhaps."""
        until = self.port.now() + CATCH_UP
        while self.port.now() < until and (frame := self.port.receive(0.0)) is not None:
            self._take(frame)

    def _put(self) -> None:
        """Send the RPDOs, and the heartbeat when it is due."""
        self._started = False
        if self._mode is OperatingMode.POSITION:
            self._following.note(self.target)
        words = [drive.controlword for drive in self._drives]
        frames = self._codec.targets(self.target, words)
        for drive, data in zip(self._drives, frames, strict=True):
            self.port.send(RPDO1 + drive.node, data)
        mode = self._mode
        others = [d for d in self._drives if d.mode is not None and d.mode != mode]
        changing = self._drives if self._mode is OperatingMode.TORQUE else others
        if changing or not self._mode_cycles:
            torques = self._codec.torques(self._torque, self._mode)
            for drive in changing or self._drives:
                self.port.send(RPDO2 + drive.node, torques[drive.joint - 1])
        self._mode_cycles += 1
        if (now := self.port.now()) >= self._heartbeat_due:
            self._heartbeat_due = now + self.config.watchdog / HEARTBEATS_PER_WATCHDOG
            self.port.send(HEARTBEAT + self.config.master, bytes((OPERATIONAL,)))

    def _run_cycle(self) -> None:
        """Run one cycle apart from the robot's own."""
        began = self.port.now()
        self._put()
        self._sync(began + self._period)
        self.listen(began + self._period)

    def _keep_pose(self) -> None:
        """Let all joints stay where they are, instead of following torques."""
        self._set_mode(OperatingMode.POSITION)
        self._pinned[:] = True
        self._follow(self._drives)

    def _follow(self, drives: list[Drive]) -> None:
        """Make what joints measure their target, so that none moves when it is enabled."""
        if drives:
            measured = self._position()
            for drive in drives:
                self.target[drive.joint - 1] = measured[drive.joint - 1]
                self._following.begin(drive.joint - 1, self.target)

    def _position(self) -> FloatArray:
        return self._codec.positions([drive.count for drive in self._drives])

    def _set_mode(self, mode: OperatingMode) -> None:
        if mode is not self._mode:
            self._mode, self._mode_cycles = mode, 0
            self._following.begin(slice(None), self._position())
        if mode is OperatingMode.TORQUE:
            self.target = self._position()  # to be there when positions are followed again

    @property
    def _mode_is_late(self) -> bool:
        return self._mode_cycles > MODE_PATIENCE * self.config.status_every

    def _commissioning(self, drive: Drive, timeout: float | None = None) -> Commissioning:
        wait = self.config.answer_timeout if timeout is None else timeout
        sdo = SdoClient(self.port, drive.joint, drive.node, wait, self._take)
        return Commissioning(self.config, self._joints[drive.joint - 1], drive, sdo)

    def _start(self, drive: Drive) -> None:
        """Configure a drive and let it send and take PDOs."""
        self._commissioning(drive).configure()
        self._ask_where(drive, reset=self._reset or self._powered)
        drive.nmt = None
        self.port.send(NMT, bytes((START, drive.node)))

    def _has_forgotten(self, drive: Drive) -> bool:
        """Say whether a drive restarted; it may have become operational by itself since then."""
        if drive.nmt not in {None, OPERATIONAL}:
            return True
        enabled = drive.state is State.ENABLED
        return not enabled and not self._commissioning(drive, self._patience).is_watched()

    @property
    def _patience(self) -> float | None:
        """How long an answer may take [s]: others that hold stop by themselves if it is longer."""
        return max(self.config.watchdog, SHORT_TIMEOUT) if self._powered else None

    def _ask_where(self, drive: Drive, *, reset: bool) -> None:
        """Ask for the position, which is answered for sure, where measurements are only heard."""
        self._commissioning(drive, self._patience).start_values(reset=reset)
        drive.refer(self.port.now())

    def _await_measurements(self) -> None:
        """Start cycles without set-points until every drive has measured."""
        until = self.port.now() + self.config.answer_timeout
        while not self._sync(self.port.now() + max(self._period, QUIET)):
            if self.port.now() > until:
                drive = next(drive for drive in self._drives if not drive.heard)
                raise DriveError(
                    drive.joint,
                    drive.node,
                    "answers SDO, but sends no measurement (TPDO1) at SYNC",
                )

    def _give_up(self, drive: Drive) -> None:
        text = f"is not enabled: it is in state {drive.state.words!r}"
        if not drive.heard:
            text = "does not answer SYNC"
        elif drive.error:
            text += f", {describe(drive.error)}"
        raise DriveError(
            drive.joint, drive.node, f"{text}, for {self.config.answer_timeout:g} s by now"
        )

    def _switch_off(self, drive: Drive) -> None:
        """Shut a drive down, while those nearer to the base still hold; then take its voltage."""
        until = self.port.now() + self.config.answer_timeout
        drive.controlword = Controlword.SHUTDOWN
        while drive.state is State.ENABLED and not drive.silent and self.port.now() < until:
            self._run_cycle()
        drive.controlword = Controlword.DISABLE_VOLTAGE
        self._run_cycle()
