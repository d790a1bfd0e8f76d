"""The first motions of an arm: one joint by two degrees, then locally isotropic motion, slowly."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Final

import numpy as np

from limo_driver.errors import BackendError, ConfigError, PathError
from limo_driver.trajectory import Segment, Trajectory
from limopa import Exploring, PlanRequest, Reaching, Surroundings, plan
from limopa.feasibility import Feasibility
from limopa.path import JointBounds, Line, joined, retime
from limopa.request import EVERYWHERE

if TYPE_CHECKING:
    from collections.abc import Callable

    from limo_driver.model import RobotModel
    from limo_driver.robot.registry import Examination
    from limo_driver.types import BoolArray, FloatArray, JointState

ANGLE: Final = math.radians(2.0)
JOINT_SPEED: Final = 0.05  # of the limit of velocity
LIMOPA_SPEED: Final = 0.10  # of the limit of velocity
SLOW: Final = (0.5 * LIMOPA_SPEED, LIMOPA_SPEED)  # shares of the limit, that are drawn
RATE: Final = 250.0  # [Hz], of the samples
_FULL: Final = 0.9  # of the two degrees, that the joint has to be measured to have gone
_WAYS: Final = 20  # plans of which one has to begin where a straight way leads
# While one joint moves, or all do.
MOST_ASIDE: Final = math.radians(0.5)  # [rad] by which a joint that is not commanded may move
MOST_BEHIND: Final = math.radians(3.0)  # [rad] by which one may be off its set-point
JOINT_BEHIND: Final = ANGLE / 2  # [rad], likewise, while one joint moves alone
MOST_TORQUE: Final = 0.1  # of the torque limit, by which a torque may differ from gravity


def one_joint(model: RobotModel, start: FloatArray, joint: int) -> Trajectory:
    """Plan the motion of one joint by two degrees towards the middle of its range, and back.

    Args:
        model: The arm.
        start: Where it stands, (n,) [rad].
        joint: Which one moves, from 1.

    Raises:
        ConfigError: There is no such joint.
        PathError: The joint stands beyond its range.
    """
    if not 1 <= joint <= model.n:
        raise ConfigError(f"`joint` is {joint}, expected 1 to {model.n}")
    j, limits = joint - 1, model.limits
    middle = (limits.position_min[j] + limits.position_max[j]) / 2
    goal = start.copy()
    goal[j] += math.copysign(ANGLE, middle - start[j])
    if not limits.position_min[j] <= goal[j] <= limits.position_max[j]:
        raise PathError(
            f"joint {joint} stands at {start[j]:.3g} rad, beyond its range of "
            f"{limits.position_min[j]:.3g} to {limits.position_max[j]:.3g} rad; guide it inside"
        )
    bounds = JointBounds.of(limits, 1 / RATE, JOINT_SPEED, JOINT_SPEED)
    there, back = Line(start, goal), Line(goal, start)
    parts = [("there", retime(there, bounds, 1 / RATE)), ("back", retime(back, bounds, 1 / RATE))]
    return _within(joined(parts, 1 / RATE, model.name), model, JOINT_SPEED)


def slow_limopa(
    model: RobotModel,
    start: FloatArray,
    scaffolds: int,
    seed: int,
    surroundings: Surroundings,
    exploring: Exploring,
) -> Trajectory:
    """Plan locally isotropic motion from where an arm stands, at a tenth of its speed.

    Args:
        model: The arm.
        start: Where it stands, (n,) [rad].
        scaffolds: Poses to reach and explore.
        seed: Of the plan; the next ones are tried where no straight way leads to its start.
        surroundings: What is kept away from.
        exploring: How each pose is explored; no faster than at a tenth.

    Raises:
        InfeasiblePathError: There is no such motion.
        PathError: No straight way leads to one from where the arm stands.
    """
    request = PlanRequest(
        scaffolds=scaffolds,
        rate=RATE,
        surroundings=surroundings,
        reaching=Reaching(velocity=SLOW, acceleration=SLOW),
        exploring=exploring,
    )
    feasibility = Feasibility(model, surroundings, EVERYWHERE)
    if broken := feasibility.check(start[None]).conditions():
        raise PathError(
            f"where the arm stands, it breaks a condition of the plan: {_listed(broken)}; guide it "
            "elsewhere, or state what is around it"
        )
    bounds = JointBounds.of(model.limits, 1 / RATE, LIMOPA_SPEED, LIMOPA_SPEED)
    broken: tuple[object, ...] = ()
    for k in range(_WAYS):
        motion = plan(model, request, seed + k).trajectory
        way = Line(start, motion.position[0])
        if not (broken := feasibility.check_path(way)):
            first = joined([("approach", retime(way, bounds, 1 / RATE))], 1 / RATE, model.name)
            return _within(_one_after_other(first, motion), model, LIMOPA_SPEED)
    raise PathError(
        f"no straight way leads from where the arm stands to the first pose of {_WAYS} plans, the "
        f"last for: {_listed(broken)}; guide it to the middle of its workspace"
    )


def _listed(conditions: tuple[object, ...]) -> str:
    return ", ".join(map(str, conditions))


def _one_after_other(first: Trajectory, second: Trajectory) -> Trajectory:
    """Return two motions as one; the second begins at rest where the first ends."""
    rows = len(first) - 1
    return Trajectory(
        np.concatenate([first.time[:-1], second.time + first.time[-1]]),
        *(
            np.concatenate([getattr(first, name)[:-1], getattr(second, name)])
            for name in ("position", "velocity", "acceleration")
        ),
        robot=second.robot,
        segments=(
            Segment("approach", 0, rows),
            *(Segment(each.kind, each.start + rows, each.stop + rows) for each in second.segments),
        ),
    )


def _within(motion: Trajectory, model: RobotModel, share: float) -> Trajectory:
    """Return a motion that is no faster than a share of the limits of velocity.

    Raises:
        PathError: It is faster.
    """
    fastest = float(motion.peaks().over(model.limits).velocity.max())
    if fastest > share * (1 + 1e-3):
        raise PathError(f"a motion at {fastest:.1%} of the speed, expected at most {share:.0%}")
    return motion


class Watchman:
    """Looks at each state of a first motion, and ends it where the arm does something else.

    Args:
        model: The arm, with its tool and mounting.
        start: Where the motion begins, (n,) [rad].
        moving: Joints that are commanded to move, (n,).
        setpoint: Says where joints are commanded to be, (n,) [rad].
        behind: By which they may be elsewhere [rad].
    """

    def __init__(
        self,
        model: RobotModel,
        start: FloatArray,
        moving: BoolArray,
        setpoint: Callable[[], FloatArray],
        behind: float,
    ) -> None:
        self._model, self._start, self._moving = model, start, moving
        self._setpoint, self._behind = setpoint, behind
        self._most = MOST_TORQUE * model.limits.torque
        self.aside = np.zeros(model.n)  # largest way of each joint from the start [rad]
        self.torque = np.zeros(model.n)  # largest difference from gravity [N m]
        self.travel = np.zeros((2, model.n))  # lowest and highest of the way from the start [rad]

    def look(self, state: JointState) -> None:
        """Take a state.

        Raises:
            UnexpectedMotionError: Names the joint and what it does.
        """
        way = state.position - self._start
        np.minimum(self.travel[0], way, out=self.travel[0])
        np.maximum(self.travel[1], way, out=self.travel[1])
        np.maximum(self.aside, np.abs(way), out=self.aside)
        rest = np.abs(state.torque - self._model.gravity_torque(state.position[None])[0])
        np.maximum(self.torque, rest, out=self.torque)
        strays = (np.abs(way) > MOST_ASIDE) & ~self._moving
        if strays.any():
            j = int(np.argmax(np.where(strays, np.abs(way), 0.0)))
            raise UnexpectedMotionError(
                "wrong-joint",
                f"joint {j + 1} moved by {math.degrees(way[j]):+.2f}°, although it was not "
                "commanded to: joints that are exchanged, or an arm that sags",
            )
        behind = self._setpoint() - state.position
        if (np.abs(behind) > self._behind).any():
            j = int(np.argmax(np.abs(behind)))
            raise UnexpectedMotionError(
                "not-following",
                f"joint {j + 1} is {math.degrees(behind[j]):+.2f}° off its set-point: a brake that "
                "is closed, joints that are exchanged, or another direction",
            )
        if (rest > self._most).any():
            j = int(np.argmax(rest / self._most))
            raise UnexpectedMotionError(
                "contact",
                f"the torque of joint {j + 1} is {rest[j]:.3g} N m away from gravity, more than "
                f"{self._most[j]:.3g} N m: the arm touches something, or is not the one described",
            )

    def judge_travel(self, found: Examination, motion: Trajectory) -> None:
        """Say, after all, whether one joint was measured to go where it was commanded to."""
        way = motion.position - motion.position[0]
        j = int(np.argmax(np.abs(way).max(axis=0)))
        wanted = float(way[np.argmax(np.abs(way[:, j])), j])
        went = float(self.travel[1 if wanted > 0 else 0, j])
        if abs(went) < _FULL * ANGLE:
            found.add(
                "not-following",
                f"joint {j + 1} went {math.degrees(went):+.2f}° of {math.degrees(wanted):+.2f}°",
            )


class UnexpectedMotionError(BackendError):
    """An arm did something else than it was commanded.

    Args:
        kind: A word for programs.
        text: What it did.
    """

    def __init__(self, kind: str, text: str) -> None:
        self.kind = kind
        super().__init__(text)
