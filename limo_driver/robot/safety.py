"""The safety contract, the same for every backend.

Idle until the first command, which has to start near the measured pose; active while valid
commands come; holding after anything else: an expired command, a fault, a request. A hold slows
down within the limits, then keeps the pose, and ends only by `resume`; braking that was begun is
finished after it, too.

Every cycle has exactly one set-point, a step of the output stage (`output.py`) from the one that
really had effect in the cycle before, so that the limits of position, velocity, acceleration,
torque, torque rate and gains hold whatever was commanded, and through every change of mode, hold
and resume. A command that cannot be read (not finite, wrong length) or that the backend cannot
carry out is refused before anything is sent. Measurements are believed only if they can be true.
"""

from __future__ import annotations

from dataclasses import dataclass, field, fields, replace
from enum import Enum
from functools import cache
from typing import TYPE_CHECKING

import numpy as np

from limo_driver.errors import BackendError, ConfigError, HoldingError, JointLimitError, ShapeError
from limo_driver.robot.measured import Belief, Measured, Pose
from limo_driver.robot.output import OutputStage, Setpoint, applied_command
from limo_driver.robot.setpoints import first_unreadable, names_of
from limo_driver.types import (
    ImpedanceCommand,
    JointState,
    PositionCommand,
    TorqueCommand,
    WrenchCommand,
)

if TYPE_CHECKING:
    from collections.abc import Callable

    from limo_driver.types import FloatArray, JointCommand, RobotSpec

START_TOLERANCE = 0.02  # [rad], distance of the first command from the measured pose
LONGEST_VALIDITY = 1.0  # [s], of a command; an arm whose sender is gone holds by then
STALE_TIMEOUT = 0.1  # [s] without a measurement after which the arm holds
COMPLIANT_TIMEOUT = 0.01  # [s] of the same, by which an arm that gives way is told to hold
COMMANDS = (PositionCommand, ImpedanceCommand, TorqueCommand, WrenchCommand)
_WRENCH_LENGTH = 6


class Phase(Enum):
    """State of the safety contract."""

    IDLE = "idle"
    ACTIVE = "active"
    HOLDING = "holding"


_IDLE, _ACTIVE, _HOLDING = Phase  # quicker than by their class, and asked for in every cycle


@dataclass
class _Memory:
    """All that the contract remembers from one cycle to the next."""

    now: Setpoint  # what the drives have in this cycle
    after: Setpoint | None = None  # of the next cycle, once it was sent
    phase: Phase = _IDLE
    reason: str = ""
    asked: str = ""  # for a hold, by any thread, and not resumed since
    state: JointState | None = None
    belief: Belief = field(default_factory=Belief)
    command: JointCommand | None = None  # in force
    command_time: float = 0.0
    commanded: bool = False  # at any time; or another one says where the set-point is
    floats: bool = False  # it holds, and gives way until it is measured again


class SafetyContract:
    """Chooses the set-point of each cycle, within the limits.

    Args:
        spec: The robot and its limits.
        start_tolerance: How far the first position may be from the measured pose [rad].
        check: Raises for a readable command that this robot cannot carry out.
        gravity: Torque that the backend adds to commanded ones, (n,) [N m]; see `OutputStage`.
        gains: Stiffness and damping by which drives keep positions; see `OutputStage`.
        excuse: Says what this computer itself may have to do with a fault; empty for nothing.
    """

    def __init__(
        self,
        spec: RobotSpec,
        start_tolerance: float = START_TOLERANCE,
        check: Callable[[JointCommand], None] | None = None,
        gravity: Callable[[], FloatArray] | None = None,
        gains: tuple[FloatArray, FloatArray] | None = None,
        excuse: Callable[[], str] = str,
    ) -> None:
        self.spec = spec
        self._check, self._excuse = check, excuse
        self.start_tolerance = start_tolerance
        self._stage = OutputStage(spec, gravity, gains)
        self._measured = Measured(spec.limits, spec.period)
        self._memory = _Memory(self._stage.at_rest(np.zeros(spec.n)))

    @property
    def holding(self) -> bool:
        """Whether commands are refused until `resume`."""
        return self._memory.phase is _HOLDING

    @property
    def at_rest(self) -> bool:
        """Whether the next command starts a stream, from a set-point at rest."""
        return self._memory.phase is _IDLE and self.standing

    @property
    def standing(self) -> bool:
        """Whether the set-point is at rest."""
        memory = self._memory
        return memory.phase is not _ACTIVE and self._stage.rests(memory.now)

    @property
    def setpoint(self) -> FloatArray:
        """Position set-point of this cycle, (n,) [rad]."""
        memory = self._memory
        if memory.phase is _ACTIVE or memory.now.rigid or (pose := self._pose()) is None:
            return memory.now.position
        return pose.position  # from where it will brake

    @property
    def believed(self) -> FloatArray | None:
        """Where the arm is in this cycle, as far as measurements can be believed, (n,) [rad]."""
        pose = self._pose()
        return None if pose is None else pose.position

    @property
    def present(self) -> Setpoint:
        """All that the drives have in this cycle."""
        return self._memory.now

    @property
    def following(self) -> Setpoint:
        """All that the drives are to have in the next cycle."""
        memory = self._memory
        return memory.now if memory.after is None else memory.after

    def observe(self, state: JointState) -> JointState | None:
        """Take note of the state that opens a cycle; expired commands and faults lead to hold.

        Returns:
            The state; or the last one, flagged as stale, where this one cannot be true; or None
            where there is none yet.
        """
        memory, before = self._memory, self._memory.state
        believed = self._measured.take(state, memory.belief)
        if memory.after is not None:
            memory.now, memory.after = memory.after, None
        if not believed and not state.stale:
            if before is None:
                return None
            state = replace(before, stale=True)
        memory.state = state
        if believed and not memory.commanded:
            memory.now = self._stage.at_rest(state.position, memory.now.gravity)
            memory.commanded = memory.phase is _HOLDING
        memory.floats = memory.floats and not believed
        if memory.phase is _ACTIVE and (reason := self._fault(stale=state.stale)):
            self.hold(reason + self._excuse())
        return state

    def admit(self, command: JointCommand) -> JointCommand:
        """Return what may be sent instead of `command` in this cycle.

        Raises:
            HoldingError: The arm holds, or has to: it would give way where it could not stop.
            JointLimitError: Not finite, or the first position is far from the measured pose.
            ShapeError: Another number of joints.
            ConfigError: `valid_for` is not positive or above 1 s.
        """
        pose = self._take(command)
        return self._limited(command, pose)

    def admit_path(self, targets: FloatArray) -> tuple[FloatArray, tuple[str, ...]]:
        """Return the set-points of T coming cycles, one position each, and the limits they met.

        The same as to `admit` each row in its cycle, in one go, for robots that simulate ahead.

        Args:
            targets: Commanded positions, (T, n) [rad].
        """
        unreadable = int(np.argmin(np.isfinite(targets).all(axis=1)))
        check_readable(PositionCommand(position=targets[unreadable]), self.spec.n)
        pose = self._take(PositionCommand(position=targets[0]))
        memory = self._memory
        path, memory.after, hit = self._stage.path(targets, memory.now, pose)
        memory.command = PositionCommand(position=targets[-1])
        memory.command_time += (len(targets) - 1) * self.spec.period
        return path, names_of(hit)

    def finds_nothing_in(
        self, position: FloatArray, velocity: FloatArray, torque: FloatArray
    ) -> bool:
        """Say whether `observe` would take each of T states in a row, (T, n), without a fault.

        For robots that simulate ahead by `admit_path`, asked before any of them is observed.
        """
        return self._measured.all_fine(position, velocity, torque, self._memory.belief)

    def pass_by(self, state: JointState) -> None:
        """Believe the state before the one that is observed next, after `finds_nothing_in`."""
        self._measured.take(state, self._memory.belief)

    def stand_in(self) -> JointCommand | None:
        """Return what to send in a cycle for which no command came; None if nothing changes."""
        memory, pose = self._memory, self._pose()
        if pose is None:
            return None
        if memory.phase is _ACTIVE and memory.command is not None:
            return self._limited(memory.command, pose)
        if memory.floats:
            return self._limited(TorqueCommand(torque=np.zeros(self.spec.n)), pose)
        rests = memory.now.rests and not self._stage.carries
        if memory.phase is _HOLDING or not rests:  # one that was ended brakes on, too
            memory.after = self._stage.brake(memory.now, pose)
            return PositionCommand(position=memory.after.position)
        return None

    def hold(self, reason: str) -> None:
        """Slow down, keep the pose and refuse commands; a hold keeps its first reason."""
        memory = self._memory
        memory.asked = (
            memory.asked or reason or "asked"
        )  # first: a command that is being taken looks there
        if memory.phase is not _HOLDING:
            # What was sent already has its effect: braking begins in the cycle after that.
            memory.phase, memory.reason, memory.command = _HOLDING, reason, None
            memory.commanded = memory.commanded or memory.state is not None

    def resume(self) -> None:
        """End a hold: the next command starts again from the measured pose.

        Raises:
            BackendError: The pose jumped, and drives keep positions by stiffness.
        """
        self._require_one_place(self._pose())
        if self._memory.phase is _HOLDING:
            self._memory.asked = ""
            self._memory.phase, self._memory.reason = _IDLE, ""

    def lead(self, position: FloatArray, gravity: FloatArray | None = None) -> None:
        """Let the set-point rest where another one, such as the arm's own controller, has it.

        For arms whose controller keeps a set-point of its own: called while nothing is commanded,
        and streams of commands start from there, not from where the arm happens to be. Wherever
        that is, the next measurement is believed.

        Args:
            position: Of the set-point, (n,) [rad].
            gravity: That is added to what the drives are told, (n,) [N m]; None for none.
        """
        memory = self._memory
        memory.belief.anywhere = True
        memory.now, memory.after = self._stage.at_rest(position, gravity), None
        memory.commanded = True

    def withhold(self, sent: Setpoint | None = None) -> None:
        """Forget the set-point of the next cycle: it could not be sent.

        Args:
            sent: What had been sent already in its stead, if anything.
        """
        self._memory.after = sent

    def take_back(self, effective: Setpoint) -> None:
        """Forget what followed a set-point: it had no effect, so that the next comes after this."""
        self._memory.now, self._memory.after = effective, None

    def save(self) -> object:
        """Return a copy of all that the contract remembers."""
        memory = (
            self._memory
        )  # apart from the belief, what it holds is replaced, never written into
        return replace(memory, belief=replace(memory.belief))

    def restore(self, saved: object) -> None:
        """Go back to what `save` returned."""
        if not isinstance(saved, _Memory):
            raise TypeError(f"expected what save() returned, given {type(saved).__name__}")
        self._memory = replace(saved, belief=replace(saved.belief))

    def _pose(self) -> Pose | None:
        return self._measured.now(self._memory.belief)

    def _require_one_place(self, pose: Pose | None) -> None:
        """Refuse to leave a hold while an arm may be in two places, if stiffness keeps it there.

        What torque its drives have, and lead on from, depends on where it is.
        """
        if self._stage.carries and pose is not None and pose.apart is not None:
            j = int(np.argmax(np.abs(pose.apart)))
            raise BackendError(
                f"joint {j + 1} is measured {abs(pose.apart[j]):.3g} rad from where it can be; "
                "resume once it is measured there, or open the robot anew"
            )

    def _fault(self, *, stale: bool) -> str:
        """Say why the arm has to hold; empty if it need not."""
        memory, command, pose = self._memory, self._memory.command, self._pose()
        rigid, belief, reason = memory.now.rigid, memory.belief, ""
        if pose is None or belief.pose is None:
            return ""
        if away := self._runaway():
            reason = away
        elif belief.jumped:
            reason = "the measured pose jumped"
        elif stale and (loss := self._loss(belief.time - belief.pose.time, pose, rigid=rigid)):
            reason = loss
        elif not rigid and (late := self._late(pose)):
            reason = late
        elif command is not None and belief.time > memory.command_time + command.valid_for + 1e-9:
            reason = f"the last command expired after {command.valid_for:.3g} s"
        return reason

    def _runaway(self) -> str:
        """Say which joint was measured where it has to be braked, in any mode; empty if none."""
        j = self._memory.belief.runaway
        return f"joint {j} leaves its range or its velocity limit" if j else ""

    def _late(self, pose: Pose) -> str:
        """Say which joint, in an arm that gives way, has to be braked now; empty if none."""
        j = self._stage.first_beyond(pose)
        return f"joint {j} could not have stopped inside its range a moment later" if j else ""

    def _loss(self, lost: float, pose: Pose, *, rigid: bool) -> str:
        """Say why an arm that is not measured for a time [s] has to hold; empty if not yet."""
        if rigid and lost <= STALE_TIMEOUT:
            return ""
        # What gives way goes where torques take it: told in time, and sooner if it may be fast.
        late = lost + self.spec.period >= COMPLIANT_TIMEOUT - 1e-9
        if not rigid and not late and not self._measured.runaway(pose):
            return ""
        self._memory.floats = not rigid and self.spec.on_loss == "float"
        return f"no measurement for {lost:.3g} s"

    def _take(self, command: JointCommand) -> Pose:
        """Refuse a command, or let it be the one in force; return where the arm is."""
        memory, pose = self._memory, self._pose()
        if memory.phase is _HOLDING:
            raise HoldingError(memory.reason)
        if memory.state is None or pose is None:
            raise BackendError("a command answers a state; call receive() before the first send()")
        check_readable(command, self.spec.n)
        if isinstance(command, WrenchCommand) and self.spec.wrench_limits is None:
            raise BackendError(f"{self.spec.name} takes no wrench")
        if self._check is not None:
            self._check(command)
        if memory.phase is _IDLE or type(command) is not type(memory.command):
            if memory.state.stale:
                raise BackendError("a stream starts from a measured pose; the measurement is lost")
            self._require_one_place(pose)
            if isinstance(command, (PositionCommand, ImpedanceCommand)):
                self.check_start(command.position, memory.state.position)
            # An arm that was resumed while it braked may give way again only where it could stop.
            if not isinstance(command, PositionCommand):
                self._check_stoppable(command, pose)
        memory.phase, memory.command, memory.commanded = _ACTIVE, command, True
        memory.command_time = memory.belief.time
        if memory.asked:  # meanwhile, by another thread
            self.hold(memory.asked)
            raise HoldingError(memory.reason)
        return pose

    def _check_stoppable(self, command: JointCommand, pose: Pose) -> None:
        reason = self._runaway() or self._late(pose)
        if not reason and isinstance(command, (TorqueCommand, ImpedanceCommand)):
            push = command.torque
            if isinstance(command, ImpedanceCommand):
                push = push + command.stiffness * (command.position - pose.position)
            if j := self._measured.first_outward(pose, push):
                reason = f"joint {j} is outside its range, and would be pushed further"
        if reason:
            self.hold(reason)
            raise HoldingError(reason)

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

    def _limited(self, command: JointCommand, pose: Pose) -> JointCommand:
        """Limit a command against the set-point of this cycle and note the next one."""
        memory = self._memory
        memory.after, hit = self._stage.step(command, memory.now, pose)
        return applied_command(command, memory.after, hit)


def warm_up(spec: RobotSpec) -> None:
    """Compile the arithmetic of the contract, before an arm waits for it."""
    zero = np.zeros(spec.n)
    inside = np.clip(zero, spec.limits.position_min, spec.limits.position_max)
    position, torque = PositionCommand(position=inside), TorqueCommand(torque=zero)
    impedance = ImpedanceCommand(position=inside, stiffness=zero, damping=zero, torque=zero)
    contract = SafetyContract(spec, gravity=lambda: zero)
    # From a measurement at rest, from set-points, and from a measurement in motion.
    commands = (position, position, torque, torque, position, impedance, torque, None)
    for cycle, command in enumerate(commands):
        contract.observe(JointState(cycle * spec.period, inside, zero, zero, cycle))
        if command is not None and not contract.holding:
            contract.admit(command)
    contract.hold("warm")
    contract.stand_in()


def check_readable(command: JointCommand, n: int) -> None:
    """Refuse a command that is not finite or not for n joints.

    Raises:
        ShapeError: Another number of joints.
        JointLimitError: Not finite, or a negative stiffness or damping.
        ConfigError: It is none of limo's commands, or `valid_for` is not positive or above 1 s.
    """
    if type(command) not in COMMANDS:
        known = ", ".join(kind.__name__ for kind in COMMANDS)
        raise ConfigError(f"a command is one of {known}, not {type(command).__name__}")
    try:
        valid = 0 < command.valid_for <= LONGEST_VALIDITY
    except (TypeError, ValueError):  # no number
        valid = False
    if not valid:
        raise ConfigError(
            f"valid_for = {command.valid_for} s has to be positive, at most {LONGEST_VALIDITY:g} s"
        )
    for name, unit, lowest in _read_of(type(command)):
        values: FloatArray = getattr(command, name)
        length = _WRENCH_LENGTH if name == "wrench" else n
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
