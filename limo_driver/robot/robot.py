"""Robot: one arm, simulated or real; the constructor opens it and `with` closes it.

A backend writes only how a measurement gets off the wire and a set-point onto it (`_receive`,
`_send`, `_close`). The base does all else: the safety contract, the one set-point of each cycle,
stale measurements, and the end of the session.
"""

from __future__ import annotations

import math
import signal
import time
from abc import abstractmethod
from contextlib import suppress
from dataclasses import replace
from typing import TYPE_CHECKING, Any, ClassVar

from limo_driver.errors import BackendError, ConfigError, ConnectionLostError, CycleTimeoutError
from limo_driver.robot import interrupts
from limo_driver.robot.safety import START_TOLERANCE, SafetyContract
from limo_driver.runtime.processes import deferred

BRAKING_TIMEOUT = 10.0  # [s] of cycles in which an arm that is closed comes to rest
BRAKING_PATIENCE = 0.5  # [s] in which it may not be heard meanwhile
LISTENS = "the robot was opened to listen only, and takes no commands"
READY_TIMEOUT = 60.0  # [s] for a person to start what has to be started on the robot's side

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from limo_driver.model import RobotModel
    from limo_driver.recordings.recording import Recording
    from limo_driver.trajectory import Planned, Trajectory
    from limo_driver.types import FloatArray, JointCommand, JointState, RobotSpec, StatesAhead


class Robot(interrupts.Interruptible):
    """An arm that is read and commanded once every cycle.

    However a program ends, an arm that moves brakes to rest within its limits: at the end of the
    `with` block, whatever was raised in it, and at SIGTERM, SIGHUP or SIGQUIT (see `exits`).

    Args:
        spec: The arm and its limits.
        start_tolerance: How far the first position may be from the measured pose [rad].

    Raises:
        BackendError: The constructor of a backend cannot open its arm.

    Example:
        >>> with limo.open_robot("mujoco", simulation="sim.yaml") as robot:
        ...     state = start = robot.receive()
        ...     for k in range(1000):
        ...         away = 0.01 * (1 - np.cos(2e-3 * np.pi * k))  # [rad] and back, in 1 s
        ...         robot.send(limo.PositionCommand(position=start.position + away))
        ...         state = robot.receive()
    """

    simulated: ClassVar[bool] = False  # it can start anywhere, and time is its own

    def __init__(self, spec: RobotSpec, start_tolerance: float = START_TOLERANCE) -> None:
        self.spec = spec
        self._contract = SafetyContract(
            spec, start_tolerance, self._check, self._gravity(), self._gains(), self._excuse
        )
        self._state: JointState | None = None
        self._answered = True  # the set-point of this cycle was sent
        self._open = True

    @classmethod
    def model_for(
        cls,
        **options: Any,  # noqa: ANN401, ARG003  # each backend has its own
    ) -> RobotModel | None:
        """Return the arm that a backend would open; None where only its link says which.

        Args:
            options: Of the constructor.
        """
        return None

    def __repr__(self) -> str:
        """Say what it is, and whether it can still be used."""
        spec = self.spec
        state = "open" if self._open else "closed"
        return (
            f"<{type(self).__name__}: {spec.name}, {spec.n} joints at {1 / spec.period:g} Hz, "
            f"{state}>"
        )

    def receive(self, timeout: float | None = None) -> JointState:
        """Wait for the next cycle and return its state.

        A cycle for which no command was sent continues the command in force, until that expires.
        When no measurement came, the last known values are returned, flagged as stale.

        Args:
            timeout: Longest wait [s]; the backend's own if not given.

        Returns:
            What was measured of all joints, with the cycle's number.

        Raises:
            CycleTimeoutError: Nothing was ever measured, or not within `timeout`.
            ConnectionLostError: The robot is closed or gone.
            ConfigError: The timeout is no number.
        """
        if not self._open:
            raise ConnectionLostError("the robot is closed; open it again")
        if timeout is not None and math.isnan(timeout):
            raise ConfigError("timeout is nan, expected seconds")
        state = self._next_state(timeout)
        if self.interrupted:
            self._heed_signal()
        return state

    def send(self, command: JointCommand) -> JointCommand:
        """Answer the last state with a command; the last one of a cycle counts.

        Args:
            command: What all joints should do next.

        Returns:
            What the drives will apply: the command within the limits, with those that changed it.

        Raises:
            ConnectionLostError: The robot is closed.
            HoldingError: The arm holds; call `resume` first.
            BackendError: A stream cannot start from a lost measurement.
            JointLimitError: Not finite, or the first position is far from the measured pose.
            ShapeError: Another number of joints.
        """
        if not self._open:
            raise ConnectionLostError("the robot is closed; open it again")
        starts = self._contract.at_rest
        sent = self._contract.admit(command)
        if starts:
            interrupts.guard(self)
            self._begin()
        applied = self._send(sent)
        self._answered = True
        if self.interrupted:
            self._heed_signal()
        return sent if applied is None else applied

    def send_ahead(self, targets: FloatArray) -> StatesAhead | None:  # noqa: ARG002  # by default none
        """Answer as many cycles in a row with positions, in one call, if that changes nothing.

        The same, bit for bit, as `send` and `receive` for each of them: what is sent, what is
        measured, and all that later cycles follow from. A robot that cannot look
        ahead, or finds that a limit, a fault or a lost measurement would come up on the way, is
        left as it was, for the cycles to be taken one by one.

        Args:
            targets: Positions, (T, n) [rad].

        Returns:
            What was measured after each command; None if nothing was sent.
        """
        return None

    def stand_by(self) -> JointState:
        """Wait for the next cycle before the motion, in which the arm stands.

        The time of a simulated arm stands, too, and its last state is returned again: its motion
        and all that acts on it begin with the first command, however long that took.

        Raises:
            CycleTimeoutError, ConnectionLostError: As for `receive`.
        """
        return self.receive()

    def follow(
        self,
        trajectory: Trajectory | Planned | Path | str,
        *,
        record: Path | str | None = None,
        stiffness: float | None = None,
        progress: Callable[[int, int], None] | None = None,
    ) -> Recording:
        """Move along a trajectory from its start to its end, and return what was measured.

        The arm has to stand where the trajectory starts; a simulated one that has not begun to move
        is put there. Afterwards it stands at the end, and holds once its last command expires.

        Args:
            trajectory: The motion, or its file, or what `plan` or `excite` returned.
            record: Parquet file that keeps the recording; a crash loses at most its last second.
            stiffness: Follow as an impedance of this stiffness [N m/rad], not by position.
            progress: Told the control cycles done and those in all, now and then.

        Returns:
            One sample for each control cycle. Its `warnings` say which limits slowed the motion.

        Raises:
            JointLimitError: The arm does not stand where the trajectory starts.
            HoldingError: The arm went into a hold by itself; what was recorded is kept in `record`.
            ConfigError: The trajectory is of another robot.
            RecordingError: The recording cannot be written.
            KeyboardInterrupt: Ctrl-C; the arm was slowed down to a hold before.

        Example:
            >>> with limo.open_robot("mujoco", simulation="sim.yaml") as robot:
            ...     run = robot.follow("limo.traj.parquet")
        """
        from limo_driver.robot import playback  # which takes long

        motion = playback.trajectory_of(trajectory)
        motion.check_robot(self.spec.n, self.spec.name)
        start = motion.position[0]
        self._stand_at(start)
        if self._state is not None and not self._contract.at_rest:  # a stream would just go on
            self._contract.check_start(start, self._state.position)
        return playback.follow(self, motion, record, stiffness, progress)

    def hold(self, reason: str = "asked to hold") -> None:
        """Slow down within the limits, then keep the pose; commands are refused until `resume`.

        Args:
            reason: What `HoldingError` will say.
        """
        self._contract.hold(reason)

    def resume(self) -> None:
        """Take commands again, starting from the measured pose.

        An arm that still brakes goes on braking until a command comes.

        Raises:
            ConnectionLostError: The robot is closed.
            BackendError: A joint is measured where it cannot have gone, and its drive keeps
                positions by stiffness.
        """
        if not self._open:
            raise ConnectionLostError("the robot is closed; open it again")
        self._contract.resume()

    def wait_until_ready(self, timeout: float = READY_TIMEOUT) -> None:
        """Wait until the robot takes commands; most do at once.

        Args:
            timeout: Longest wait [s].

        Raises:
            BackendError: It did not in time; says what to do about it.
        """

    @property
    def lost(self) -> int:
        """Measurements that did not come over the link to a real arm."""
        return 0

    @property
    def silent_joints(self) -> tuple[int, ...]:
        """Joints, from 1, of which no measurement came in this cycle, as far as that is known."""
        return ()

    def now(self) -> float:
        """Return the time of the clock by which cycles are waited for [s]."""
        return time.monotonic()

    def link_figures(self) -> dict[str, Any]:
        """Return what was counted on the link to a real arm, as JSON values."""
        return {}

    def keep_time(self) -> None:  # a real arm cannot do otherwise
        """Run no faster than real time from now on."""

    @property
    def standing(self) -> bool:
        """Whether the set-point is at rest: the arm holds, or takes no commands yet."""
        return self._contract.standing

    @property
    def setpoint(self) -> FloatArray:
        """The position set-point of this cycle, (n,) [rad]."""
        return self._contract.setpoint

    def close(self) -> None:
        """Brake to rest within the limits, and end the session; a second call does nothing."""
        try:
            with deferred(signal.SIGINT, *interrupts.ENDING):
                self._end()
        finally:  # else an interrupt came before, and a later call closes it
            if not self._open:
                interrupts.release(self)
            if self.interrupted:
                self._heed_signal()

    def _end(self) -> None:
        if not self._open:
            return
        self._open = False
        self._contract.hold("the robot is closed")
        try:
            with suppress(BackendError):  # nobody is reached: the drives' watchdogs stop them
                self._brake()
        finally:
            self._close()

    def _heed_signal(self) -> None:
        number, self.interrupted = self.interrupted, 0
        interrupts.leave(number)

    def _brake(self) -> None:
        """Come to rest within the limits; the arm holds, or nobody is reached for a while."""
        heard = time.monotonic()
        for _ in range(int(BRAKING_TIMEOUT / self.spec.period)):
            if self._contract.standing:
                return
            state = self._next_state(None)
            if self._reached(state):
                heard = time.monotonic()
            elif time.monotonic() > heard + BRAKING_PATIENCE:
                return

    def _next_state(self, timeout: float | None) -> JointState:
        """Answer the last state, if nobody did, and wait for the next."""
        if not self._answered and (command := self._contract.stand_in()) is not None:
            self._send(command)
        measured = self._receive(timeout)
        state = self._contract.observe(self._state_of(measured, timeout))
        if state is None:  # numbers that cannot be true are no measurement
            raise CycleTimeoutError(self.spec.period if timeout is None else timeout)
        self._answered = False
        if self._contract.holding:
            state = replace(state, holding=True)
        self._state = state
        return state

    def _save_session(self) -> object:
        """Return a copy of all that is remembered, for simulated robots that can go back."""
        return self._contract.save(), self._state, self._answered

    def _restore_session(self, saved: Any) -> None:  # noqa: ANN401  # what _save_session returned
        contract, self._state, self._answered = saved
        self._contract.restore(contract)

    def _state_of(self, measured: JointState | None, timeout: float | None) -> JointState:
        """Return what was measured, or else what was known last."""
        if measured is not None:
            return measured
        if self._state is None:
            raise CycleTimeoutError(self.spec.period if timeout is None else timeout)
        temperature, drives = self._condition()
        return replace(
            self._state, stale=True, holding=False, temperature=temperature, drives=drives
        )

    @abstractmethod
    def _receive(self, timeout: float | None) -> JointState | None:
        """Wait for one cycle; return its measurement, or None if it was lost."""

    @abstractmethod
    def _send(self, command: JointCommand) -> JointCommand | None:
        """Put a set-point, within the limits, on the wire; the last one of a cycle counts.

        Returns:
            What the drives will apply, if that is something else.
        """

    @abstractmethod
    def _close(self) -> None:
        """Let go of the robot; called once."""

    def _condition(self) -> tuple[FloatArray | None, tuple[str, ...]]:
        """Return temperatures (n,) [°C] and statuses of drives, where nothing was measured."""
        return None, ()

    def _reached(self, state: JointState) -> bool:
        """Say whether the arm is heard, and hears what it is told."""
        return not state.stale

    def _excuse(self) -> str:
        """Say what this computer has to do with a hold that begins now; empty for nothing."""
        return ""

    def _check(self, command: JointCommand) -> None:  # most take every command
        """Raise if the robot cannot carry out a command; nothing is sent then."""

    def _gravity(self) -> Callable[[], FloatArray] | None:
        """Return what tells the torque that is added to commanded ones; None if drives do that."""
        return None

    def _gains(self) -> tuple[FloatArray, FloatArray] | None:
        """Return the gains by which positions are kept, (n,) each; None if drives do that."""
        return None

    def _stand_at(self, position: FloatArray) -> None:
        """Stand somewhere before the first cycle; a real arm cannot be put there."""

    def _begin(self) -> None:  # most backends have nothing to forget
        """Prepare for a new stream of commands, which starts from the measured pose."""
