"""Motion that identifies arms behind position servos from commands and positions alone.

Each joint, one at a time and in a pose of its own, does what shows one part of its drive:

- slow ramps with reversals: gain, by the sag of a load that changes along them, and dry friction;
- steps: delay, damping, inertia, limits of torque;
- a quick ramp: limits of speed;
- creeping reversals, smaller than what friction holds: play, dead band, stiction.

Its pose is the one of those drawn in which gravity changes most along its ramps, and changes its
sign if it can: play shows only there. Holds on the way show the sag of all joints; then all move
together. The whole is repeated, so that each repetition can be predicted from the others.

Timeline: commands of all joints, one after the other at an even rate.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from math import ceil
from pathlib import Path
from typing import Final

import numpy as np

from limo_driver.errors import InfeasiblePathError
from limo_driver.logs.readers.formats.lerobot import write_actions
from limo_driver.model import RobotModel
from limo_driver.runtime.display import Displayed
from limo_driver.runtime.outputs import whole
from limo_driver.runtime.parameters import Declared, parameter
from limo_driver.trajectory import Segment, Trajectory
from limo_driver.types import FloatArray, readonly
from limopa.feasibility import Condition, Feasibility
from limopa.path import Line
from limopa.request import EVERYWHERE, Surroundings
from limopa.scaffold import ScaffoldSampler


class Timeline:
    """Set-points of n joints, each in force until the next.

    Args:
        start: First pose, (n,) [rad].
        rate: Of the set-points [Hz].
    """

    def __init__(self, start: FloatArray, rate: float) -> None:
        self.rate = rate
        self._parts: list[FloatArray] = [np.array(start)[None, :]]
        self._segments: list[Segment] = []
        self.rows = 1

    @property
    def pose(self) -> FloatArray:
        """Where it ends, (n,) [rad]."""
        return self._parts[-1][-1]

    @property
    def duration(self) -> float:
        """How long it is [s]."""
        return (self.rows - 1) / self.rate

    def follow(self, command: FloatArray, kind: str) -> None:
        """Add set-points, (T, n) [rad]."""
        if len(command):
            self._parts.append(command)
            self._segments.append(Segment(kind, self.rows, self.rows + len(command)))
            self.rows += len(command)

    def hold(self, seconds: float, kind: str = "hold") -> None:
        """Keep the pose."""
        self.follow(np.repeat(self.pose[None, :], self._many(seconds), axis=0), kind)

    def go(self, goal: FloatArray, speed: FloatArray, kind: str) -> None:
        """Lead smoothly to a pose, no joint faster than its speed (n,) [rad/s]."""
        away = goal - self.pose
        many = self._many(1.5 * float(np.max(np.abs(away) / speed)))  # 1.5: peak of a cubic
        s = np.arange(1, many + 1)[:, None] / max(many, 1)
        self.follow(self.pose + (3.0 - 2.0 * s) * s**2 * away, kind)

    def visit(
        self, j: int, away: Sequence[float], speed: float, kind: str, hold: float = 0.0
    ) -> None:
        """Lead a joint at an even speed to places from its pose, and reverse there.

        Args:
            j: Joint, 0-based.
            away: Places, from where it is [rad].
            speed: [rad/s].
            kind: What the motion is for.
            hold: At each place [s].
        """
        base, at = self.pose, 0.0
        parts: list[FloatArray] = []
        for place in away:
            many = self._many(abs(place - at) / speed)
            parts.append(at + (place - at) * np.arange(1, many + 1) / max(many, 1))
            parts.append(np.full(self._many(hold), place))
            at = place
        self._one(base, j, np.concatenate(parts), kind)

    def steps(self, j: int, away: Sequence[float], hold: float, kind: str) -> None:
        """Let a joint jump to places from its pose, and stay there [rad], [s]."""
        self._one(self.pose, j, np.repeat(np.array(away), self._many(hold)), kind)

    def finished(self) -> tuple[FloatArray, FloatArray, tuple[Segment, ...]]:
        """Return times (T,) [s], set-points (T, n) [rad] and what they are for."""
        command = np.concatenate(self._parts)
        return np.arange(len(command)) / self.rate, command, tuple(self._segments)

    def _one(self, base: FloatArray, j: int, away: FloatArray, kind: str) -> None:
        command = np.repeat(base[None, :], away.size, axis=0)
        command[:, j] += away
        self.follow(command, kind)

    def _many(self, seconds: float) -> int:
        return ceil(seconds * self.rate - 1e-9)


_POSES: Final = 160  # drawn
_DRAWS: Final = 20_000  # in vain, before giving up
_REACH: Final = 0.6  # [rad] of a slow ramp to either side, at most
_LEAST: Final = 0.15  # [rad] that a joint has to have to both sides together
_SCANNED: Final = 25  # positions to either side that are checked
_SLOW, _CREEP = 0.3, 0.05  # [rad/s]
_CREEPS: Final = 0.03  # [rad] to either side
_STEP: Final = 0.25  # [rad]
_STEP_HOLD, _HOLD, _REST = 0.7, 0.8, 2.0  # [s] after a step, in a pose, at both ends
_TOGETHER: Final = 20.0  # [s] of all joints at once
_SINES: Final = 3  # of each joint
_SLOWEST, _FASTEST = 0.4, 4.0  # [rad/s] of their phases
_SHARES: Final = (1.0, 0.8, 0.6, 0.4, 0.25, 0.15)  # of the size of the common motion, tried
_PAYLOAD: Final = 0.8  # of a joint's torque limit, that gravity may take of it
_NEAREST: Final = 12  # poses that the way to one may lead through


@dataclass(frozen=True)
class ServoRequest(Declared):
    """Request for the motion of an arm behind position servos.

    Args:
        duration: Of the motion at least [s]; it is made of whole repetitions, two or more.
        rate: Of the commands [Hz].
        speed: Of quick ramps and of the way between poses, where the robot's own limits allow it
            [rad/s].
        surroundings: Margins, clearance [m] and table that every configuration keeps away from.

    Raises:
        ParameterError: Names the parameter, what was given and what is possible.

    Example:
        >>> limo.excite_servos("iiwa14", limo.ServoRequest(rate=30.0), seed=1)
    """

    duration: float = parameter("s", lower=0.0, upper=3600.0, default=0.0)
    rate: float = parameter("Hz", lower=10.0, upper=1000.0, default=50.0)
    speed: float = parameter("rad/s", lower=0.0, above=True, default=1.5)
    surroundings: Surroundings = field(default_factory=Surroundings)


@dataclass(frozen=True, repr=False)
class ServoExcitation(Displayed):
    """Commands for an arm behind position servos: one repetition after the other."""

    robot: str
    joint_names: tuple[str, ...]
    seed: int
    request: ServoRequest
    time: FloatArray  # (T,) [s]
    command: FloatArray  # (T, n) [rad], each in force until the next
    repetitions: tuple[slice, ...]  # rows of each
    segments: tuple[Segment, ...]  # what rows are for
    unchecked_pairs: tuple[tuple[str, str], ...] = ()  # links that always touch
    ranges: tuple[tuple[float, float], ...] = ()  # ends of each joint [rad]

    def __post_init__(self) -> None:
        for name in ("time", "command"):
            object.__setattr__(self, name, readonly(getattr(self, name)))

    @property
    def duration(self) -> float:
        """Of all of it [s]."""
        return float(self.time[-1])

    @property
    def trajectory(self) -> Trajectory:
        """The commands as a motion that can be drawn; steps of them are steep there."""
        velocity = np.gradient(self.command, self.time, axis=0)
        return Trajectory(
            self.time, self.command, velocity, 0.0 * velocity, robot=self.robot,
            segments=self.segments,
        )  # fmt: skip

    def save(self, path: Path | str) -> None:
        """Write CSV: time [s] and command_j [rad], 1-based joints.

        Args:
            path: To be written.

        Raises:
            ConfigError: It cannot be written.
        """
        names = ["time", *(f"command_{j}" for j in range(1, self.command.shape[1] + 1))]
        with whole(path) as draft:
            np.savetxt(
                draft,
                np.column_stack([self.time, self.command]),
                fmt=["%.6f"] + ["%.8f"] * self.command.shape[1],
                delimiter=",",
                header=",".join(names),
                comments="",
            )

    def save_for_lerobot(self, folder: Path | str, motors: Sequence[str] | None = None) -> None:
        """Write a LeRobotDataset whose episodes are the repetitions, actions in degrees.

        A motor named `gripper` is in percent of its range, as LeRobot counts it.

        Args:
            folder: To be made.
            motors: Names of the motors, those of the joints if not given.

        Raises:
            ConfigError: The folder holds something, the rate is no whole number, or a gripper has
                no range.
        """
        write_actions(
            Path(folder), self.command, self.repetitions, motors or self.joint_names,
            self.request.rate, ranges=self.ranges,
        )  # fmt: skip

    def headline(self) -> str:
        """Say how long it is, and for which robot."""
        return (
            f"{self.duration:.0f} s of commands at {self.request.rate:g} Hz for {self.robot}: "
            f"{len(self.repetitions)} repetitions of each joint alone and all together"
        )

    def figures(self) -> Mapping[str, Sequence[object]]:
        """Return the range of each joint."""
        return {
            "joint": self.joint_names,
            "first [rad]": self.command[0].tolist(),
            "from [rad]": self.command.min(axis=0).tolist(),
            "to [rad]": self.command.max(axis=0).tolist(),
        }


def excite_servos(
    model: RobotModel, request: ServoRequest | None = None, seed: int = 0
) -> ServoExcitation:
    """Plan the motion that identifies position servos.

    Args:
        model: The robot.
        request: Duration, rate, speed and surroundings.
        seed: Of every random draw.

    Raises:
        InfeasiblePathError: No pose lets a joint move, or no way leads from pose to pose.
        ConfigError: The collision shapes cannot be read.
    """
    return _Planner(model, request or ServoRequest(), seed).plan()


class _Planner:
    """Poses, and the motion from one to the next."""

    def __init__(self, model: RobotModel, request: ServoRequest, seed: int) -> None:
        self.model, self.request, self.seed = model, request, seed
        self.random = np.random.default_rng(seed)
        self.space = Feasibility(model, request.surroundings, EVERYWHERE)
        self.speed = np.minimum(request.speed, model.limits.velocity)
        drawn = ScaffoldSampler(self.space, self.random, _DRAWS).draw(_POSES)
        load = np.abs(model.gravity_torque(drawn))
        limit = np.where(model.limits.torque > 0, model.limits.torque, np.inf)
        bearable = (load < _PAYLOAD * limit).all(axis=1)
        if not bearable.any():
            j = int(np.argmin((load < _PAYLOAD * limit).mean(axis=0)))
            raise InfeasiblePathError(
                Condition.JOINT_LIMITS,
                f"gravity takes more than {_PAYLOAD:.0%} of the torque limit of joint {j + 1} "
                f"({limit[j]:g} N m) in all of {_POSES} poses",
            )
        self.poses = drawn[bearable]

    def plan(self) -> ServoExcitation:
        """Return the whole motion."""
        home = self.poses[np.argmin(np.linalg.norm(self.poses, axis=1))]
        line = Timeline(home, self.request.rate)
        line.hold(_REST)
        repetitions: list[slice] = []
        while len(repetitions) < 2 or line.duration < self.request.duration:  # noqa: PLR2004
            start = 0 if not repetitions else line.rows
            for j, (pose, low, high) in enumerate(self._own_poses()):
                self._go(line, pose)
                line.hold(_HOLD)
                # Do with one joint all that shows its drive
                line.visit(j, (high, low, 0.0), _SLOW, f"ramp {j + 1}")
                step = [min(_STEP, high), max(-_STEP, low)]
                line.steps(j, (step[0], 0.0, step[1], 0.0), _STEP_HOLD, f"steps {j + 1}")
                line.visit(j, (high, low, 0.0), float(self.speed[j]), f"quick {j + 1}", _STEP_HOLD)
                creep = [min(_CREEPS, high), max(-_CREEPS, low)]
                line.visit(j, (*creep, *creep, 0.0), _CREEP, f"creep {j + 1}")
            self._together(line)
            repetitions.append(slice(start, line.rows))
        self._go(line, home)
        line.hold(_REST)
        repetitions[-1] = slice(repetitions[-1].start, line.rows)
        time, command, segments = line.finished()
        limits = self.model.limits
        ends = zip(limits.position_min.tolist(), limits.position_max.tolist(), strict=True)
        return ServoExcitation(
            self.model.name, self.model.joint_names, self.seed, self.request, time, command,
            tuple(repetitions), segments, self.space.overlapping_pairs, tuple(ends),
        )  # fmt: skip

    def _own_poses(self) -> list[tuple[FloatArray, float, float]]:
        """Return for each joint a pose, and how far the joint can go from it [rad]."""
        found: list[tuple[FloatArray, float, float]] = []
        for j in range(self.model.n):
            tried = self.random.permutation(len(self.poses))[: _POSES // 2]
            rooms = [self._room(self.poses[k], j) for k in tried]
            scores = [
                self._shows(self.poses[k], j, *room) for k, room in zip(tried, rooms, strict=True)
            ]
            best = int(np.argmax(scores))
            low, high = rooms[best]
            if high - low < _LEAST:
                raise InfeasiblePathError(
                    Condition.JOINT_LIMITS,
                    f"joint {j + 1} cannot move by {_LEAST:g} rad in any of {tried.size} poses",
                )
            found.append((self.poses[tried[best]], low, high))
        return found

    def _room(self, pose: FloatArray, j: int) -> tuple[float, float]:
        """Return how far a joint can go down and up from a pose while the others hold [rad]."""
        ends: list[float] = []
        for side in (-1.0, 1.0):
            away = side * np.linspace(0.0, _REACH, _SCANNED)
            position = np.repeat(pose[None, :], _SCANNED, axis=0)
            position[:, j] += away
            blocked = np.flatnonzero(~self.space.check(position).feasible)
            ends.append(float(away[blocked[0] - 1 if blocked.size else -1]))
        return ends[0], ends[1]

    def _shows(self, pose: FloatArray, j: int, low: float, high: float) -> float:
        """Return how much gravity on a joint changes along its ramp; twice where its sign does."""
        position = np.repeat(pose[None, :], _SCANNED, axis=0)
        position[:, j] += np.linspace(low, high, _SCANNED)
        load = self.model.gravity_torque(position)[:, j]
        full = float(np.abs(self.model.gravity_torque(self.poses)[:, j]).max())
        change = float(np.ptp(load)) / full if full > 0.0 else 0.0
        both = load.min() < 0.0 < load.max()
        return (high - low) / (2.0 * _REACH) + change * (2.0 if both else 1.0)

    def _go(self, line: Timeline, goal: FloatArray) -> None:
        """Lead to a pose: straight, or through another."""
        here = line.pose
        ways = [(goal,)]
        near = np.argsort(np.linalg.norm(self.poses - 0.5 * (here + goal), axis=1))[:_NEAREST]
        ways += [(self.poses[k], goal) for k in near]
        for way in ways:
            ends = (here, *way)
            if not any(
                self.space.check_path(Line(a, b)) for a, b in pairwise(ends) if np.any(a != b)
            ):
                for pose in way:
                    line.go(pose, self.speed, "way")
                return
        raise InfeasiblePathError(
            Condition.SELF_COLLISION,
            f"no way was found from {np.round(here, 2)} to {np.round(goal, 2)} rad among "
            f"{len(ways)}",
        )

    def _together(self, line: Timeline) -> None:
        """Move all joints at once, on sines of their own, as far as there is room."""
        pose, n = line.pose, self.model.n
        time = np.arange(0.0, _TOGETHER, 1.0 / self.request.rate)
        for _ in range(_NEAREST):
            pace = np.exp(self.random.uniform(np.log(_SLOWEST), np.log(_FASTEST), (_SINES, n)))
            phase = self.random.uniform(0.0, 2.0 * np.pi, (_SINES, n))
            size = np.minimum(_REACH, self.speed / pace) / _SINES
            waves = (size * np.sin(pace * time[:, None, None] + phase)).sum(axis=1)
            ease = np.minimum(1.0, np.minimum(time, time[-1] - time) / _HOLD)[:, None]
            for share in _SHARES:
                away = share * ease * waves
                if self.space.check(pose + away).feasible.all():
                    line.follow(pose + away, "together")
                    return
        line.hold(_HOLD)  # a pose without room; each joint alone has moved from it
