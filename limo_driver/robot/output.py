"""The output stage: every number that goes to the drives follows from the last that had effect.

Modes, holds and resumes change where a set-point is led to, never where it comes from. Where the
drives kept a position, that is the last set-point; where they were compliant, it is where the arm
is and how it moves. The torque that a mode leaves behind fades at its rate, however many modes are
asked for meanwhile. Nothing here knows phases or commands in force: one cycle, one step.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any, NamedTuple, TypeAlias

import numpy as np

from limo_driver.robot.efforts import EffortLimits, GainLimits
from limo_driver.robot.jerk import JerkLimits
from limo_driver.robot.measured import farthest_false
from limo_driver.robot.setpoints import TORQUE, WRENCH, PositionLimits, names_of
from limo_driver.types import (
    ImpedanceCommand,
    PositionCommand,
    TorqueCommand,
    WrenchCommand,
    WrenchLimits,
)

if TYPE_CHECKING:
    from collections.abc import Callable

    from limo_driver.robot.measured import Pose
    from limo_driver.types import FloatArray, JointCommand, RobotSpec

    # Where positions are led from: goal of the cycle before [rad], set-point [rad], its velocity
    # [rad/s], and the last change of that, where jerk has a limit and there was one.
    _Begun: TypeAlias = tuple[FloatArray, FloatArray, FloatArray, FloatArray | None]

_STIFF = 1e-6  # relative, of a stiffness that was reached
_NO_WRENCH = np.zeros(6)
_TAKES_NO_WRENCH = WrenchLimits(wrench=_NO_WRENCH, rate=_NO_WRENCH)


class Setpoint(NamedTuple):
    """All that the drives are told in one cycle; each array has shape (n,)."""

    mode: type[JointCommand]  # which of the numbers have an effect
    position: FloatArray  # [rad]
    velocity: FloatArray  # of the position [rad/s]
    torque: FloatArray  # feed-forward [N m]; what is left of it, in modes without any
    stiffness: FloatArray  # [N m/rad]
    damping: FloatArray  # [N m s/rad]
    wrench: FloatArray  # (6,) [N, N m]
    gravity: FloatArray | None  # that is added to the torque on its way [N m]; None where none is
    goal: FloatArray | None = None  # the position that was commanded [rad], in a stream of them
    change: FloatArray | None = None  # of the velocity, in the last cycle, where jerk has a limit

    @property
    def rigid(self) -> bool:
        """Whether the drives keep the position, instead of giving way."""
        return self.mode is PositionCommand

    @property
    def rests(self) -> bool:
        """Whether it is a position that stands, and no torque is left of what was before."""
        moves = self.velocity.any() or self.torque.any() or self.wrench.any()
        moves = moves or (self.change is not None and self.change.any())
        return self.mode is PositionCommand and not moves


class OutputStage:
    """Takes one step, within the limits, from what the drives had to what they are to have.

    Args:
        spec: The robot and its limits.
        gravity: Torque that is added to commanded ones on their way to the drives, (n,) [N m];
            None where drives do that by themselves.
        gains: Stiffness and damping by which drives keep positions, (n,) each; None where they do
            that by themselves.
    """

    def __init__(
        self,
        spec: RobotSpec,
        gravity: Callable[[], FloatArray] | None = None,
        gains: tuple[FloatArray, FloatArray] | None = None,
    ) -> None:
        limits, wrench = spec.limits, spec.wrench_limits or _TAKES_NO_WRENCH
        self._gravity, self._gains = gravity, gains
        self._zero = np.zeros(spec.n)
        self._smooth = spec.jerk is not None
        self._positions = (
            PositionLimits(limits, spec.period)
            if spec.jerk is None
            else JerkLimits(limits, spec.period, spec.jerk)
        )
        self._torques = EffortLimits(limits.torque, limits.torque_rate, spec.period, TORQUE)
        self._wrenches = EffortLimits(wrench.wrench, wrench.rate, spec.period, WRENCH)
        unseen = None if gains is None else farthest_false(limits, spec.period)
        self._impedances = GainLimits(limits, spec.period, unseen)

    @property
    def carries(self) -> bool:
        """Whether there is a torque of gravity to be told anew in each cycle, also at rest."""
        return self._gravity is not None and self._gains is not None

    def at_rest(self, position: FloatArray, gravity: FloatArray | None = None) -> Setpoint:
        """Return the set-point of an arm that stands and that nobody has commanded yet.

        Args:
            position: Of the arm, (n,) [rad].
            gravity: That was added last to what the drives are told, (n,) [N m]; None for none.
        """
        zero, gains = self._zero, self._gains or (self._zero, self._zero)
        return Setpoint(PositionCommand, position, zero, zero, *gains, _NO_WRENCH, gravity)

    def rests(self, now: Setpoint) -> bool:
        """Say whether an arm stands, as stiff as positions are kept, and nothing else is left."""
        if self._gains is None or not now.rests:
            return now.rests
        return bool(np.abs(now.stiffness - self._gains[0]).max() <= _STIFF * self._gains[0].max())

    def where(self, last: Setpoint, pose: Pose) -> FloatArray:
        """Return the position from which a position would be led, (n,) [rad]."""
        return last.position if last.rigid else pose.position

    def first_beyond(self, pose: Pose) -> int:
        """Return the first joint, from 1, that has to brake now to stop in its range; 0 if none."""
        return self._positions.first_beyond(pose.position, pose.velocity, pose.acceleration)

    def step(self, command: JointCommand, last: Setpoint, pose: Pose) -> tuple[Setpoint, int]:
        """Return the set-point after `last` on the way to `command`, and the limits met, as bits.

        Args:
            command: Readable, for n joints.
            last: What the drives have in this cycle.
            pose: Where the arm is and how it moves.
        """
        if isinstance(command, PositionCommand):
            goal = command.position
            begun = (
                (last.goal, last.position, last.velocity, last.change)  # most often, at once
                if last.mode is PositionCommand and last.goal is not None
                else self._begun(goal, last, pose, PositionCommand)
            )
            position, velocity, hit = self._positions.follow(goal, *begun)
            return self._rigid(last, pose, position, velocity, goal, begun), hit
        if isinstance(command, ImpedanceCommand):
            return self._compliant(command, last, pose)
        gravity = self._carried(last)
        effort, wrench, hit = self._shifted(self._effort(last, pose), last, gravity), last.wrench, 0
        if isinstance(command, TorqueCommand):
            torque, hit = self._torques.follow(command.torque, effort, gravity)
        else:
            torque = self._torques.fade(effort)
        if isinstance(command, WrenchCommand):
            wrench, hit = self._wrenches.follow(command.wrench, last.wrench)
        elif wrench is not _NO_WRENCH:
            wrench = self._wrenches.fade(wrench)
        zero = self._zero
        return Setpoint(
            type(command), pose.position, zero, torque, zero, zero, wrench, gravity
        ), hit  # fmt: skip

    def brake(self, last: Setpoint, pose: Pose) -> Setpoint:
        """Return the set-point after `last` on the way to rest, inside the range."""
        begun = self._begun(last.position, last, pose, PositionCommand)
        position, velocity = self._positions.brake(*begun[1:])
        return self._rigid(last, pose, position, velocity, None, begun)

    def path(
        self, targets: FloatArray, last: Setpoint, pose: Pose
    ) -> tuple[FloatArray, Setpoint, int]:
        """Take as many steps as there are positions (T, n) [rad]; return their set-points.

        Returns:
            Set-points (T, n) [rad], the last one of them, and the limits met, as bits.
        """
        begun = self._begun(targets[0], last, pose, PositionCommand)
        path, speed, hit = self._positions.follow_path(targets, *begun)
        if len(targets) > 1:
            begun = targets[-2], path[-2], speed[-2], None
        after = self._rigid(last, pose, path[-1].copy(), speed[-1].copy(), targets[-1], begun)
        if after.torque is not self._zero:
            after = after._replace(torque=self._torques.fade(after.torque, len(targets) - 1))
        return path, after, hit

    def _begun(
        self, goal: FloatArray, last: Setpoint, pose: Pose, mode: type[JointCommand]
    ) -> _Begun:
        """Return where positions are led from."""
        if last.rigid or last.mode is mode:
            before = goal if last.goal is None or last.mode is not mode else last.goal
            return before, last.position, last.velocity, last.change
        # What moves faster than it may, or than it can stop, is not followed in that. Stiffness
        # keeps an arm whose pose jumped where it was: if it is there, nothing pulls at it.
        position = pose.position
        if pose.apart is not None and self._gains is not None:
            position = position + pose.apart
        return goal, position, self._positions.stoppable(position, pose.velocity), None

    def _rigid(
        self,
        last: Setpoint,
        pose: Pose,
        position: FloatArray,
        velocity: FloatArray,
        goal: FloatArray | None,
        begun: _Begun,
    ) -> Setpoint:
        """Return a set-point of position; torques that were there fade."""
        zero, wrench = self._zero, last.wrench
        change = velocity - begun[2] if self._smooth else None
        if wrench is not _NO_WRENCH:
            wrench = self._wrenches.fade(wrench) if wrench.any() else _NO_WRENCH
        if self._gains is not None:
            gravity = self._carried(last)
            wanted, before = (*self._gains, zero), self._impedance(last, pose, gravity)
            away, speed = position - pose.position, pose.velocity - velocity
            if not last.rigid:  # the spring begins anew where the arm is; its torque does not
                kept = before[0] * away - before[1] * speed
                effort = self._shifted(self._effort(last, pose), last, gravity)
                before = before[0], before[1], effort - kept
            (stiffness, damping, torque), _ = self._impedances.follow(
                wanted, before, away, speed, gravity, pose.apart
            )
            return Setpoint(
                PositionCommand, position, velocity, torque, stiffness, damping, wrench, gravity,
                goal, change,
            )  # fmt: skip
        torque = zero
        if last.torque is not zero or last.mode is ImpedanceCommand:
            torque = self._torques.fade(self._effort(last, pose))
            torque = torque if torque.any() else zero
        return Setpoint(
            PositionCommand, position, velocity, torque, zero, zero, wrench, None, goal, change
        )

    def _compliant(
        self, command: ImpedanceCommand, last: Setpoint, pose: Pose
    ) -> tuple[Setpoint, int]:
        """Return a set-point of position, stiffness, damping and feed-forward."""
        begun = self._begun(command.position, last, pose, ImpedanceCommand)
        position, velocity, hit = self._positions.follow(command.position, *begun)
        gravity = self._carried(last)
        before = self._impedance(last, pose, gravity)
        if last.rigid and self._gains is not None:  # what it was damped towards stands from now on
            before = before[0], before[1], before[2] + before[1] * last.velocity
        gains, met = self._impedances.follow(
            (command.stiffness, command.damping, command.torque),
            before,
            position - pose.position,
            pose.velocity,
            gravity,
            pose.apart,
        )
        stiffness, damping, torque = gains
        after = Setpoint(
            ImpedanceCommand, position, velocity, torque, stiffness, damping, _NO_WRENCH, gravity,
            command.position, velocity - begun[2] if self._smooth else None,
        )  # fmt: skip
        return after, hit | met

    def _impedance(
        self, last: Setpoint, pose: Pose, gravity: FloatArray | None
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return the impedance that drives have: none, apart from a torque, if they are rigid."""
        if last.mode is ImpedanceCommand or (last.rigid and self._gains is not None):
            return last.stiffness, last.damping, self._shifted(last.torque, last, gravity)
        return self._zero, self._zero, self._shifted(self._effort(last, pose), last, gravity)

    def _effort(self, last: Setpoint, pose: Pose) -> FloatArray:
        """Return the torque that drives have, or what is left of it, (n,) [N m]."""
        if last.mode is ImpedanceCommand or (last.rigid and self._gains is not None):
            gains = last.stiffness, last.damping, last.torque
            slip = pose.velocity - last.velocity if last.rigid else pose.velocity
            return self._impedances.effort(gains, last.position - pose.position, slip)
        return last.torque

    def _shifted(
        self, effort: FloatArray, last: Setpoint, gravity: FloatArray | None
    ) -> FloatArray:
        """Return an effort as it counts beside another gravity.

        What the drive gets is the sum, so its rate counts: gravity moves on with the arm.
        """
        if gravity is None or last.gravity is None:
            return effort
        return effort + (last.gravity - gravity)

    def _carried(self, last: Setpoint) -> FloatArray | None:
        """Return the gravity of the next cycle, which keeps the rate of torques as they do."""
        if self._gravity is None:
            return None
        gravity = self._gravity()
        return gravity if last.gravity is None else self._torques.near(gravity, last.gravity)


def applied_command(command: JointCommand, after: Setpoint, hit: int) -> JointCommand:
    """Return a command as the drives will apply it, with the limits that changed it."""
    if not hit:
        return replace(command, limited_by=()) if command.limited_by else command
    values: dict[str, Any] = {"limited_by": names_of(hit)}
    for name in _TOLD[type(command)]:
        values[name] = getattr(after, name)
    return replace(command, **values)


def instead(command: JointCommand, setpoint: Setpoint) -> JointCommand:
    """Return a command as the drives will have it where another set-point goes out instead."""
    values = {name: getattr(setpoint, name) for name in _TOLD[type(command)]}
    return replace(command, limited_by=(*command.limited_by, "link"), **values)


_TOLD: dict[type[JointCommand], tuple[str, ...]] = {
    PositionCommand: ("position",),
    ImpedanceCommand: ("position", "stiffness", "damping", "torque"),
    TorqueCommand: ("torque",),
    WrenchCommand: ("wrench",),
}
