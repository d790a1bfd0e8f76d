"""CanRobot: an arm of drives on a CAN bus; it keeps the time of the cycles."""

from __future__ import annotations

import math
import time
from contextlib import suppress
from pathlib import Path  # the constructor's signature is read at run time
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from backends.can.config import CIA402, ArmConfig
from backends.can.port import BusPort
from limo_driver.errors import BackendError, ConfigError, ConnectionLostError
from limo_driver.robot.output import Setpoint, instead
from limo_driver.robot.realtime import LatencyHistogram, excuse
from limo_driver.robot.robot import LISTENS, Robot
from limo_driver.robot.safety import START_TOLERANCE, warm_up
from limo_driver.robot.setpoints import VELOCITY_TOLERANCE
from limo_driver.types import FloatArray, JointCommand, JointState

if TYPE_CHECKING:
    from collections.abc import Callable

    import can

    from backends.can.link import DriveSample, DriveStatus, Link
    from limo_driver.model import RobotModel

# Of a period, after a cycle that began late: sooner, the next set-point would be a faster motion
# than any that may be measured.
SHORTEST_CYCLE: Final = 1.0 / VELOCITY_TOLERANCE
ROUNDING: Final = 1e-6  # of a period
REFUSED: Final = 0.02  # [s] for which a bus may take no set-point
REFUSED_PERIODS: Final = 3  # or so many periods, if those are longer


class CanRobot(Robot):
    """An arm of CiA 402 drives, or of Damiao motors.

    Opening it finds and configures the drives; the first `receive` enables them, and from then on
    they stop by themselves once no set-points come for the arm's `watchdog`. A drive that is silent
    or leaves operation leads to hold. Closing brakes, then switches off drive by drive.

    Args:
        config: The arm, or its `arm.yaml`.
        reset_faults: Reset faults that drives have when they are enabled.
        bus: An open python-can bus instead of the arm's; it is closed with the robot.
        clock: Tells the time [s]; a bus that is simulated with its drives has its own.
        start_tolerance: How far the first position may be from the measured pose [rad].
        listen_only: Leave the drives as they are, without power and set-points; they measure, and
            commands are refused.

    Raises:
        ConfigError: The file cannot be used, or the bus cannot carry the rate.
        BackendError: No bus, or a drive that is missing, of another joint, or in fault.
    """

    def __init__(
        self,
        config: ArmConfig | Path | str | None = None,
        *,
        reset_faults: bool = False,
        bus: can.BusABC | None = None,
        clock: Callable[[], float] = time.monotonic,
        start_tolerance: float = START_TOLERANCE,
        listen_only: bool = False,
    ) -> None:
        self._listen_only = listen_only
        self.config = _config(config)
        warm_up(self.config.spec(np.zeros(len(self.config.joints))))
        self._port = BusPort(self.config.bus, bus, clock)
        try:
            self._link = _link(self.config, self._port, reset=reset_faults)
            self._link.connect()
            self._port.settle()
            super().__init__(self._link.limit(self.config), start_tolerance)
        except BaseException:
            self._port.close()
            raise
        self._link.where = lambda: self._contract.believed
        self.lateness = LatencyHistogram()
        self._enabled = False
        self._wanted: Setpoint | None = None  # of the next cycle, if it is another
        self._unfinished: Setpoint | None = None  # of a cycle that the bus took too few frames of
        self._refused_at = math.inf  # when that was first [s]
        self._began = self._due = self._last = self._free = 0.0  # [s], of the port's clock
        self._late = 0.0  # by which this program began the last cycle [s]
        self._cycle = -1  # counts SYNCs, or what else starts a cycle
        self._slipped = 0.0  # time by which cycles came later than their grid, in all [s]
        self._stall = (0.0, -math.inf)  # how late this program came last [s], to which cycle
        self._silent = 0  # cycles in which not every drive was heard

    @classmethod
    def model_for(
        cls,
        *,
        config: ArmConfig | Path | str | None = None,
        **_options: Any,  # noqa: ANN401
    ) -> RobotModel:
        """Return the arm of an `arm.yaml`."""
        return _config(config).model

    @property
    def drives(self) -> tuple[DriveStatus, ...]:
        """Latest values of every drive, joint 1 first."""
        return self._link.drives()

    @property
    def overruns(self) -> int:
        """Cycles that did not take place: this program came too late, or an answer did."""
        return int(self._slipped / self.spec.period + ROUNDING)

    @property
    def lost(self) -> int:
        """Cycles in which not every drive was heard."""
        return self._silent

    @property
    def silent_joints(self) -> tuple[int, ...]:
        """Joints, from 1, whose drives were not heard in the last cycle."""
        return tuple(j for j, drive in enumerate(self.drives, start=1) if drive.stale)

    def now(self) -> float:
        """Return the time of the bus's clock [s]."""
        return self._port.now()

    def versions(self) -> tuple[dict[str, int], ...]:
        """Return vendor, product, revision and serial number of each drive that tells them."""
        return self._link.versions()

    def link_figures(self) -> dict[str, Any]:
        """Return what was counted on the bus, and how late cycles began."""
        return {
            "cycles": self._cycle + 1,
            "missed_cycles": self.overruns,
            "silent_cycles": self._silent,
            **{f"{name}_frames": count for name, count in vars(self._port.counts).items()},
            "late": self.lateness.as_json(),
        }

    def reset_faults(self) -> None:
        """Reset the faults of drives, and enable them where they stand; the arm goes on holding.

        What still moves comes to rest first.

        Raises:
            ConnectionLostError: The robot is closed.
            BackendError: A drive stays in fault.
        """
        if not self._open:
            raise ConnectionLostError("the robot is closed; open it again")
        self.hold("drives were reset")
        self._brake()
        self._enable(reset=True)

    def resume(self) -> None:
        """Take commands again, starting from the measured pose.

        Raises:
            ConnectionLostError: The robot is closed.
            BackendError: A drive is not ready for that.
        """
        if self._open and self._enabled and (reason := self._link.trouble()):
            raise BackendError(f"{reason}; call reset_faults() once that is cured")
        super().resume()

    def _receive(self, timeout: float | None) -> JointState | None:
        if self._listen_only:
            return self._listen(timeout)
        if not self._enabled:
            self._enable()
        if (command := self._wanted or self._unfinished) is not None:
            self._link.command(command)
            self._wanted = None
        try:
            sample = self._run_cycle(timeout)
        except ConnectionLostError:
            self._note_refusal()
            raise
        if self._unfinished is not None:
            self._note_end_of_refusal()
        if (late := max(self._late, self._link.overslept)) > self.spec.period:
            self._stall = (late, self._cycle)
        if reason := self._link.trouble():
            self.hold(reason + self._excuse())
        return self._state_from(sample)

    def _listen(self, timeout: float | None) -> JointState | None:
        """Wait for a cycle of drives that have no power."""
        if not self._began:
            self._restart_clock()
        sample = self._run_cycle(timeout)
        if reason := self._link.trouble_of_bus():
            raise BackendError(reason)
        return self._state_from(sample)

    def _state_from(self, sample: DriveSample | None) -> JointState | None:
        if sample is None:
            self._silent += 1
            return None
        temperature, drives = self._condition()
        return JointState.trusted(
            time=self._last - self._began,
            position=sample.position,
            velocity=sample.velocity,
            torque=sample.torque,
            sequence=self._cycle,
            temperature=temperature,
            drives=drives,
        )

    def _run_cycle(self, timeout: float | None) -> DriveSample | None:
        """Let the set-points of this cycle count once it is due, and hear what drives measured."""
        if not self._listen_only:
            self._link.send()
        self._link.listen(self._due)
        now = self._port.now()
        self.lateness.add(max(now - self._due, 0.0))
        self._late = now - max(self._due, self._free)  # waiting for answers is not being late
        self._advance_clock(now)
        measure = self._link.observe if self._listen_only else self._link.measure
        sample = measure(self._due if timeout is None else min(self._due, now + timeout))
        self._free = self._port.now()
        return sample

    def _note_refusal(self) -> None:
        """Note that the bus took nothing more: what had effect counts, and the rest is tried again.

        Whatever is commanded meanwhile waits until those set-points have left.
        """
        effect = self._contract.following
        if self._link.started:
            self._contract.take_back(effect)
            self._unfinished = None
            return
        self._unfinished = effect
        self._refused_at = min(self._refused_at, self._port.now())

    def _note_end_of_refusal(self) -> None:
        """Go on after set-points that have left late; hold if that took long."""
        late = self._port.now() - self._refused_at
        self._unfinished, self._refused_at = None, math.inf
        if late > max(REFUSED, REFUSED_PERIODS * self.spec.period):
            self.hold(f"{self._port.name} took no frame for {late:.3g} s")

    def _condition(self) -> tuple[FloatArray | None, tuple[str, ...]]:
        return self._link.condition()

    def _enable(self, *, reset: bool = False) -> None:
        """Enable the drives where they stand, and lead set-points from there."""
        self._link.enable(reset=reset)
        self._enabled = True
        self._contract.lead(self._link.target.copy(), self._link.carried)
        self._restart_clock()

    def _restart_clock(self) -> None:
        self._due = self._port.now()
        self._began = self._began or self._due

    def _advance_clock(self, now: float) -> None:
        """Note the cycle that starts now, and when the next is due; cycles may be skipped."""
        period = self.spec.period
        missed = max(int((now - self._due) / period), 0)
        self._cycle += 1
        self._last = now
        due = max(self._due + (1 + missed) * period, now + SHORTEST_CYCLE * period)
        self._slipped += due - (self._due + period)
        self._due = due

    def _excuse(self) -> str:
        """Say that the computer may be to blame, where it is late itself."""
        late, cycle = self._stall
        if self._cycle - cycle > self.config.hold_after:
            return ""
        return f"{excuse(late)}, or the arm more patience (hold_after, watchdog)"

    def _send(self, command: JointCommand) -> JointCommand | None:
        if self._unfinished is not None:
            self._contract.withhold(self._unfinished)
            return instead(command, self._unfinished)
        self._wanted = self._contract.following
        return None

    def _gravity(self) -> Callable[[], FloatArray]:
        return self._link.gravity

    def _gains(self) -> tuple[FloatArray, FloatArray] | None:
        return self._link.gains

    def _check(self, command: JointCommand) -> None:
        if self._listen_only:
            raise BackendError(LISTENS)
        self._link.check(command)

    def _begin(self) -> None:
        self._link.begin()

    def _close(self) -> None:
        try:
            with suppress(BackendError):  # where the bus is gone, the drives' watchdogs stop them
                self._link.disable()
        finally:
            self._port.close()


def _link(config: ArmConfig, port: BusPort, *, reset: bool) -> Link:
    if config.convention == CIA402:
        from backends.can.cia402.link import Cia402Link

        return Cia402Link(config, port, reset=reset)
    from backends.can.damiao.link import DamiaoLink

    return DamiaoLink(config, port, reset=reset)


def _config(config: ArmConfig | Path | str | None) -> ArmConfig:
    if config is None:
        raise ConfigError(
            'an arm on a CAN bus needs its arm.yaml: config, in a run `link["config"]`'
        )
    return config if isinstance(config, ArmConfig) else ArmConfig.load(config)
