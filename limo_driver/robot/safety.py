"""The safety contract, the same for every backend.

Idle until the first command, which has to start from the measured pose; active while valid
commands come; holding after anything else: an expired command, a fault, a request. A hold slows
down within the limits, then keeps the pose, and ends only by `resume`; braking that was begun is
finished after it, too. Another control mode starts from the measured pose, like a new stream.

Every cycle has exactly one set-point, and every set-point keeps the limits of position, velocity,
acceleration, torque and torque rate, whatever was commanded; with one exception: under impedance
control the torque limits hold for the feed-forward alone, so a step of stiffness or damping away
from the set-point is met by the drives' saturation only. A command that cannot be read (not
finite, wrong length) or that the backend cannot carry out is refused before anything is sent.
"""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from enum import Enum
from functools import cache
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from limo_driver.errors import BackendError, ConfigError, HoldingError, JointLimitError, ShapeError
from limo_driver.robot.setpoints import (
    TORQUE,
    WRENCH,
    EffortLimits,
    PositionLimits,
    first_runaway,
    first_unreadable,
    names_of,
    slow_down,
)
from limo_driver.types import (
    ImpedanceCommand,
    JointState,
    PositionCommand,
    TorqueCommand,
    WrenchCommand,
    WrenchLimits,
)

if TYPE_CHECKING:
    from collections.abc import Callable

    from limo_driver.types import FloatArray, JointCommand, RobotSpec

START_TOLERANCE = 0.02  # [rad], distance of the first command from the measured pose
RANGE_TOLERANCE = 0.01  # [rad], how far outside its range a joint may be carried
VELOCITY_TOLERANCE = 1.2  # times the velocity limit that a measured velocity may reach
LONGEST_VALIDITY = 1.0  # [s], of a command; an arm whose sender is gone holds by then
STALE_TIMEOUT = 0.1  # [s] without a measurement after which the arm holds
_NO_WRENCH = np.zeros(6)
_TAKES_NO_WRENCH = WrenchLimits(wrench=_NO_WRENCH, rate=_NO_WRENCH)


class Phase(Enum):
    """State of the safety contract."""

    IDLE = "idle"
    ACTIVE = "active"
    HOLDING = "holding"


_IDLE, _ACTIVE, _HOLDING = Phase  # quicker than by their class, and asked for in every cycle


class _Setpoint(NamedTuple):
    """Set-point of one cycle; each array has shape (n,)."""

    position: FloatArray  # [rad]
    velocity: FloatArray  # [rad/s]
    torque: FloatArray  # [N m]
    goal: FloatArray  # the position that was commanded [rad]
    wrench: FloatArray = _NO_WRENCH  # (6,) [N, N m]


@dataclass
class _Memory:
    """All that the contract remembers from one cycle to the next."""

    now: _Setpoint
    after: _Setpoint | None = None  # of the next cycle, once it was sent
    phase: Phase = _IDLE
    reason: str = ""
    state: JointState | None = None
    time: float = 0.0  # robot time, also while measurements are lost [s]
    command: JointCommand | None = None  # in force
    command_time: float = 0.0
    led: bool = False  # another one says where the set-point is while the arm is not commanded


class SafetyContract:
    """Chooses the set-point of each cycle, within the limits.

    Args:
        spec: The robot and its limits.
        start_tolerance: How far the first position may be from the measured pose [rad].
        check: Raises for a readable command that this robot cannot carry out.
    """

    def __init__(
        self,
        spec: RobotSpec,
        start_tolerance: float = START_TOLERANCE,
        check: Callable[[JointCommand], None] | None = None,
    ) -> None:
        self.spec = spec
        self._check = check
        self.start_tolerance = start_tolerance
        zero = np.zeros(spec.n)
        self._memory = _Memory(_Setpoint(zero, zero, zero, zero))
        limits, wrench = spec.limits, spec.wrench_limits or _TAKES_NO_WRENCH
        self._positions = PositionLimits(limits, spec.period)
        self._torques = EffortLimits(limits.torque, limits.torque_rate, spec.period, TORQUE)
        self._wrenches = EffortLimits(wrench.wrench, wrench.rate, spec.period, WRENCH)
        lower, upper = limits.position_min - RANGE_TOLERANCE, limits.position_max + RANGE_TOLERANCE
        self._runaway = np.array([lower, upper, VELOCITY_TOLERANCE * limits.velocity])

    @property
    def holding(self) -> bool:
        """Whether commands are refused until `resume`."""
        return self._memory.phase is _HOLDING

    @property
    def at_rest(self) -> bool:
        """Whether the next command starts a stream, from the measured pose at rest."""
        return self._memory.phase is _IDLE and self.standing

    @property
    def standing(self) -> bool:
        """Whether the set-point is at rest."""
        memory = self._memory
        return memory.phase is not _ACTIVE and not memory.now.velocity.any()

    @property
    def setpoint(self) -> FloatArray:
        """Position set-point of this cycle, (n,) [rad]."""
        return self._memory.now.position

    def observe(self, state: JointState) -> None:
        """Take note of the state that opens a cycle; expired commands and faults lead to hold."""
        memory = self._memory
        if memory.state is None and not memory.led:
            zero = np.zeros(self.spec.n)
            memory.now = _Setpoint(state.position, zero, zero, state.position)
        memory.state = state
        memory.time = memory.time + self.spec.period if state.stale else state.time
        if memory.after is not None:
            memory.now, memory.after = memory.after, None
        if memory.phase is _ACTIVE and (reason := self._fault(state)):
            self.hold(reason)

    def admit(self, command: JointCommand) -> JointCommand:
        """Return what may be sent instead of `command` in this cycle.

        Raises:
            HoldingError: The arm holds.
            JointLimitError: Not finite, or the first position is far from the measured pose.
            ShapeError: Another number of joints.
            ConfigError: `valid_for` is not positive or above 1 s.
        """
        self._take(command)
        return self._limited(command)

    def admit_path(self, targets: FloatArray) -> tuple[FloatArray, tuple[str, ...]]:
        """Return the set-points of T coming cycles, one position each, and the limits they met.

        The same as to `admit` each row in its cycle, in one go, for robots that simulate ahead.

        Args:
            targets: Commanded positions, (T, n) [rad].
        """
        unreadable = int(np.argmin(np.isfinite(targets).all(axis=1)))
        check_readable(PositionCommand(position=targets[unreadable]), self.spec.n)
        self._take(PositionCommand(position=targets[0]))
        memory, now = self._memory, self._memory.now
        path, speed, hit = self._positions.follow_path(
            targets, now.goal, now.position, now.velocity
        )
        memory.command = PositionCommand(position=targets[-1])
        after = path[-1].copy(), speed[-1].copy()  # the path is the caller's
        memory.after = _Setpoint(*after, now.torque, memory.command.position)
        memory.command_time += (len(targets) - 1) * self.spec.period
        return path, names_of(hit)

    def stand_in(self) -> JointCommand | None:
        """Return what to send in a cycle for which no command came; None if nothing changes."""
        memory, now = self._memory, self._memory.now
        if memory.phase is _ACTIVE and memory.command is not None:
            return self._limited(memory.command)
        holds = memory.phase is _HOLDING and memory.state is not None
        if holds or now.velocity.any():  # also a hold that was ended finishes braking
            position, velocity = slow_down(
                now.position, now.velocity, self.spec.limits.acceleration, self.spec.period
            )
            memory.after = _Setpoint(position, velocity, np.zeros(self.spec.n), position)
            return PositionCommand(position=position)
        return None

    def hold(self, reason: str) -> None:
        """Slow down, keep the pose and refuse commands; a hold keeps its first reason."""
        memory = self._memory
        if memory.phase is _HOLDING:
            return
        if memory.phase is _ACTIVE and not isinstance(memory.command, PositionCommand):
            self._anchor()
            memory.after = None
        # A position that was sent already is the set-point of the next cycle: braking begins there.
        memory.phase, memory.reason, memory.command = _HOLDING, reason, None

    def resume(self) -> None:
        """End a hold: the next command starts again from the measured pose."""
        if self._memory.phase is _HOLDING:
            self._memory.phase, self._memory.reason = _IDLE, ""

    def lead(self, position: FloatArray) -> None:
        """Let the set-point rest where another one, such as the arm's own controller, has it.

        For arms whose controller keeps a set-point of its own: called while nothing is commanded,
        and streams of commands start from there, not from where the arm happens to be.
        """
        memory, zero = self._memory, np.zeros(self.spec.n)
        memory.now, memory.after, memory.led = _Setpoint(position, zero, zero, position), None, True

    def withhold(self) -> None:
        """Forget the set-point of the next cycle, since it could not be sent."""
        self._memory.after = None

    def save(self) -> object:
        """Return a copy of all that the contract remembers."""
        return replace(self._memory)  # what it holds is replaced, never written into

    def restore(self, saved: object) -> None:
        """Go back to what `save` returned."""
        if not isinstance(saved, _Memory):
            raise TypeError(f"expected what save() returned, given {type(saved).__name__}")
        self._memory = replace(saved)

    def _anchor(self) -> None:
        """Move the set-point to where a compliant arm is and to how it moves."""
        memory = self._memory
        if (state := memory.state) is not None:
            # A lost measurement is carried on by its velocity; nothing is added to a fresh one.
            position = state.position + (memory.time - state.time) * state.velocity
            # What moves faster than it may is not followed faster, nor is a measurement that errs.
            fastest = self.spec.limits.velocity
            velocity = np.clip(state.velocity, -fastest, fastest)
            memory.now = memory.now._replace(position=position, velocity=velocity)

    def _fault(self, state: JointState) -> str:
        """Say why the arm has to hold; empty if it need not."""
        memory, command = self._memory, self._memory.command
        if state.stale:
            lost = memory.time - state.time
            if lost > STALE_TIMEOUT:
                return f"no measurement for {lost:.3g} s"
        elif j := first_runaway(state.position, state.velocity, self._runaway):
            return f"joint {j} leaves its range or its velocity limit"
        if command is not None and memory.time > memory.command_time + command.valid_for + 1e-9:
            return f"the last command expired after {command.valid_for:.3g} s"
        return ""

    def _take(self, command: JointCommand) -> None:
        """Refuse a command, or let it be the one in force."""
        memory = self._memory
        if memory.phase is _HOLDING:
            raise HoldingError(memory.reason)
        if memory.state is None:
            raise BackendError("a command answers a state; call receive() before the first send()")
        check_readable(command, self.spec.n)
        if isinstance(command, WrenchCommand) and self.spec.wrench_limits is None:
            raise BackendError(f"{self.spec.name} takes no wrench")
        if self._check is not None:
            self._check(command)
        if memory.phase is _IDLE or type(command) is not type(memory.command):
            self._start(command, memory.state)
        memory.phase, memory.command, memory.command_time = _ACTIVE, command, memory.time

    def _start(self, command: JointCommand, state: JointState) -> None:
        """Begin a stream of commands at the measured pose."""
        if state.stale:
            raise BackendError("a stream starts from a measured pose; the measurement is lost")
        goal, zero = state.position, np.zeros(self.spec.n)
        if isinstance(command, (PositionCommand, ImpedanceCommand)):
            self.check_start(command.position, state.position)
            goal = command.position
        now = self._memory.now
        if self._memory.phase is _ACTIVE:  # another control mode takes over
            self._memory.now = _Setpoint(state.position, state.velocity, zero, goal)
        elif (
            now.velocity.any() or self._memory.led
        ):  # still braking: go on from the set-point, which the arm follows
            self._memory.now = now._replace(torque=zero, goal=goal, wrench=_NO_WRENCH)
        else:
            self._memory.now = _Setpoint(state.position, zero, zero, goal)

    def check_start(self, position: FloatArray, measured: FloatArray) -> None:
        """Check that a stream of positions begins where the arm is.

        Args:
            position: The first one, (n,) [rad].
            measured: Where the arm is, (n,) [rad].

        Raises:
            JointLimitError: Further away than `start_tolerance`.
        """
        off = np.abs(position - measured)
        if np.any(off > self.start_tolerance):
            j, tolerance = int(np.argmax(off)), self.start_tolerance
            raise JointLimitError(
                j + 1,
                "first position",
                float(position[j]),
                (float(measured[j]) - tolerance, float(measured[j]) + tolerance),
                "rad",
                "start from the measured pose, or move there first",
            )

    def _limited(self, command: JointCommand) -> JointCommand:
        """Limit a command against the set-point of this cycle and note the next one."""
        now = self._memory.now
        position, velocity, torque, goal, wrench = now
        changed: dict[str, FloatArray] = {}
        hit = 0
        if isinstance(command, (PositionCommand, ImpedanceCommand)):
            goal = command.position
            position, velocity, hit = self._positions.follow(goal, now.goal, position, velocity)
            changed["position"] = position
        if isinstance(command, (TorqueCommand, ImpedanceCommand)):
            torque, met = self._torques.follow(command.torque, torque)
            hit |= met
            changed["torque"] = torque
        if isinstance(command, WrenchCommand):
            wrench, hit = self._wrenches.follow(command.wrench, wrench)
            changed["wrench"] = wrench
        self._memory.after = _Setpoint(position, velocity, torque, goal, wrench)
        return replace(command, limited_by=names_of(hit), **changed) if hit else command


def warm_up(spec: RobotSpec) -> None:
    """Compile the arithmetic of the contract, before an arm waits for it."""
    zero = np.zeros(spec.n)
    position, torque = PositionCommand(position=zero), TorqueCommand(torque=zero)
    contract = SafetyContract(spec)
    # From a measurement at rest, from set-points, and from a measurement in motion.
    for cycle, command in enumerate((position, position, torque, torque, position)):
        contract.observe(JointState(cycle * spec.period, zero, zero, zero, cycle))
        contract.admit(command)


def check_readable(command: JointCommand, n: int) -> None:
    """Refuse a command that is not finite or not for n joints.

    Raises:
        ShapeError: Another number of joints.
        JointLimitError: Not finite, or a negative stiffness or damping.
        ConfigError: `valid_for` is not positive or above 1 s.
    """
    if not 0 < command.valid_for <= LONGEST_VALIDITY:
        raise ConfigError(
            f"valid_for = {command.valid_for} s has to be positive, at most {LONGEST_VALIDITY:g} s"
        )
    for name, unit, lowest in _read_of(type(command)):
        values: FloatArray = getattr(command, name)
        length = _NO_WRENCH.size if name == "wrench" else n
        if values.shape != (length,):
            raise ShapeError(name, values.shape, f"({length},)")
        if j := first_unreadable(values, lowest):
            given = float(values[j - 1])
            raise JointLimitError(j, name, given, (lowest, np.inf), unit, "nothing was sent")


@cache
def _read_of(kind: type[JointCommand]) -> tuple[tuple[str, str, float], ...]:
    """Return what is to be read of a kind of command: name, unit, lowest value."""
    names = {item.name for item in fields(kind)}
    return tuple(row for row in _READ if row[0] in names)


_READ = (
    ("position", "rad", -np.inf),
    ("torque", "N m", -np.inf),
    ("wrench", "N or N m", -np.inf),
    ("stiffness", "N m/rad", 0.0),
    ("damping", "N m s/rad", 0.0),
)
