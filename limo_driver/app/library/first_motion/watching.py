"""Watch an arm that nobody commands: what is lost, how evenly it comes, whether it can be true.

Poses at rest are kept for the comparison with gravity.

`ShadowRobot` is a robot whose commands are computed, within its limits, and go nowhere.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final, TypeVar

import numpy as np

from limo_driver.app.library.first_motion.gravity import StillPose
from limo_driver.errors import BackendError, CycleTimeoutError
from limo_driver.robot.realtime import LatencyHistogram
from limo_driver.robot.robot import READY_TIMEOUT, Robot
from limo_driver.robot.safety import COMPLIANT_TIMEOUT, LONGEST_VALIDITY, STALE_TIMEOUT
from limo_driver.robot.setpoints import VELOCITY_TOLERANCE
from limo_driver.runtime.parameters import Declared, parameter
from limo_driver.types import FloatArray, JointCommand, JointState, PositionCommand

if TYPE_CHECKING:
    from limo_driver.robot.registry import Examination


REST: Final = 2e-3  # [rad] by which a joint at rest may be measured elsewhere meanwhile
BEYOND: Final = 0.01  # [rad] beyond a limit that a joint may be measured, by its encoder's zero
HELD: Final = 1.0  # [s] for which an arm is held; the second half counts
STILL: Final = ("position", "torque")
_Judged = TypeVar("_Judged")
GAP_CYCLES: Final = 3  # lost in a row, from which on it is an interruption, if it takes 10 ms


@dataclass(frozen=True)
class WatchSettings(Declared):
    """What is looked for.

    Args:
        duration: For which the arm is watched.
        poses: That somebody has to guide the arm to, at least.
        still: For which it has to rest in each.
        apart: By which at least one joint differs from pose to pose.
        most_lost: Of the cycles, without measurement.
        most_late: Of the cycles, that came more than 10 ms late.
    """

    duration: float = parameter("s", lower=0.0, above=True, default=3600.0)
    poses: int = parameter("", lower=0, upper=100, default=3)
    still: float = parameter("s", lower=0.0, above=True, default=1.0)
    apart: float = parameter("rad", lower=0.0, above=True, default=0.3)
    most_lost: float = parameter("1", lower=0.0, upper=1.0, default=1e-3)
    most_late: float = parameter("1", lower=0.0, upper=1.0, default=1e-3)


@dataclass(frozen=True)
class Interruption:
    """A time without measurements."""

    at: float  # [s] since the start
    length: float  # [s]
    joints: tuple[int, ...]  # that were silent, where that is known


class Watch:
    """What was seen of an arm so far.

    Args:
        robot: Open to listen only.
        settings: What is looked for.
        tolerance: Of each joint's torque, (n,) [N m].
    """

    def __init__(self, robot: Robot, settings: WatchSettings, tolerance: FloatArray) -> None:
        self._robot, self._settings, self._tolerance = robot, settings, tolerance
        self.jitter = LatencyHistogram()  # by which measurements came too late or too early
        self.cycles = self.late = 0
        self.lost = 0
        self.interruptions: list[Interruption] = []
        self.odd: dict[tuple[str, int], str] = {}  # what cannot be, by kind and joint
        n = robot.spec.n
        self.lowest, self.highest = np.full(n, np.inf), np.full(n, -np.inf)  # [rad]
        self._rests = _Rests(settings.still, settings.apart, tolerance)
        self._heard = robot.now()
        self._silent = Counter[int]()
        self._before = 0

    @property
    def poses(self) -> tuple[StillPose, ...]:
        """Poses in which the arm was at rest."""
        return self._rests.poses()

    def run(self, progress: Callable[[float, int], None]) -> None:
        """Watch for as long as the settings say.

        Args:
            progress: Told now and then the time that has passed [s], and the poses found.
        """
        robot = self._robot
        began = self._heard = robot.now()
        self._before, shown = robot.lost, began
        while (now := robot.now()) < began + self._settings.duration:
            with suppress(CycleTimeoutError):  # nothing came since it was opened
                self._take(robot.receive(), robot.now() - began)
            if now > shown + 1.0:
                shown = now
                progress(now - began, len(self.poses))
        if (silent := robot.now() - self._heard) > STALE_TIMEOUT + robot.spec.period:
            self._interrupt(robot.now() - began, silent)

    def _take(self, state: JointState, at: float) -> None:
        robot, period = self._robot, self._robot.spec.period
        if state.stale:
            self._silent.update(robot.silent_joints)
            return
        self.cycles += 1
        lost, self._before = robot.lost - self._before, robot.lost
        self.lost += lost
        if lost >= GAP_CYCLES and lost * period >= COMPLIANT_TIMEOUT:
            self._interrupt(at, lost * period)
        now = robot.now()
        if not lost and self.cycles > 1:
            late = now - self._heard - period
            self.jitter.add(abs(late))
            self.late += late > COMPLIANT_TIMEOUT
        self._heard = now
        self._silent.clear()
        self._note_odd(state)
        self._rests.take(state)

    def _interrupt(self, ended: float, length: float) -> None:
        """Note a time without measurements."""
        joints = tuple(sorted(self._silent))
        self.interruptions.append(Interruption(ended - length, length, joints))

    def _note_odd(self, state: JointState) -> None:
        """Note what no arm of this description can be measured at."""
        limits = self._robot.spec.limits
        np.minimum(self.lowest, state.position, out=self.lowest)
        np.maximum(self.highest, state.position, out=self.highest)
        low, high = limits.position_min - BEYOND, limits.position_max + BEYOND
        beyond = (state.position < low) | (state.position > high)
        fast = np.abs(state.velocity) > VELOCITY_TOLERANCE * limits.velocity
        strong = np.abs(state.torque) > limits.torque + self._tolerance
        if not (beyond.any() or fast.any() or strong.any()):
            return
        for j in np.flatnonzero(beyond).tolist():
            self.odd.setdefault(
                ("range", j + 1),
                f"joint {j + 1} was measured at {state.position[j]:.3g} rad, outside its range of "
                f"{limits.position_min[j]:.3g} to {limits.position_max[j]:.3g} rad: another arm "
                "than described, joints that are exchanged, or an encoder of another zero",
            )
        for j in np.flatnonzero(fast).tolist():
            self.odd.setdefault(
                ("speed", j + 1),
                f"joint {j + 1} was measured at {state.velocity[j]:.3g} rad/s, above its limit of "
                f"{limits.velocity[j]:.3g} rad/s, while nobody commanded it: a quick hand, an "
                "encoder that jumps, or another unit",
            )
        for j in np.flatnonzero(strong).tolist():
            self.odd.setdefault(
                ("torque", j + 1),
                f"joint {j + 1} was measured at {state.torque[j]:.3g} N m, above its limit of "
                f"{limits.torque[j]:.3g} N m: another unit, joints that are exchanged, "
                "or a sensor that is broken",
            )

    def judge(self, found: Examination) -> None:
        """Add what was seen of the link and of poses to an examination."""
        settings, all_ = self._settings, self.cycles + self.lost
        found.figures |= {
            "cycles": self.cycles,
            "lost": self.lost,
            "late": self.late,
            "jitter": self.jitter.as_json(),
            "interruptions": [vars(each) for each in self.interruptions],
            "lowest": _finite(self.lowest),
            "highest": _finite(self.highest),
        }
        if self.interruptions:
            found.add("loose-cable", self._interrupted(all_))
        elif self.lost > settings.most_lost * all_:
            found.add(
                "loss",
                f"{self.lost} of {all_} measurements were lost, one at a time: use a cable of its "
                "own, no wireless network and no shared switch",
            )
        if self.late > settings.most_late * max(self.cycles, 1):
            found.add(
                "jitter",
                f"{self.late} of {self.cycles} measurements came more than "
                f"{1e3 * COMPLIANT_TIMEOUT:.0f} ms late ({self.jitter.summary()}): end what else "
                "computes here, and give limo real-time priority",
            )
        for (kind, _), text in self.odd.items():
            found.add(kind, text, problem=kind != "speed")  # hands may be quick
        if (seen := len(self.poses)) < settings.poses:
            found.add(
                "poses",
                f"{seen} of {settings.poses} poses at rest were seen: guide the arm by hand to as "
                f"many that differ by {np.degrees(settings.apart):.0f}° or more in a joint, let "
                f"go, and wait {2 * settings.still:g} s in each",
            )

    def _interrupted(self, all_: int) -> str:
        longest = max(self.interruptions, key=lambda each: each.length)
        joints = sorted({j for each in self.interruptions for j in each.joints})
        whose = f" of joint{'s' * (len(joints) > 1)} {', '.join(map(str, joints))}"
        times = len(self.interruptions)
        return (
            f"measurements{whose if joints else ''} stayed away {times} time{'s' * (times > 1)}, "
            f"for up to {1e3 * longest.length:.0f} ms ({self.lost} of {all_} lost): a loose cable "
            "or plug, seat it and relieve its strain"
        )


def hold_judged(
    robot: Robot, position: FloatArray, judge: Callable[[StillPose], _Judged]
) -> _Judged:
    """Hold an arm still, and go on while a thread judges what that takes; return its judgement.

    Drives that hear nothing meanwhile would stop, and a motion that follows were refused.

    Raises:
        JointLimitError: As `hold_still`.
        BackendError: Likewise.
    """
    pose, hold = (
        hold_still(robot, position),
        PositionCommand(position=position, valid_for=LONGEST_VALIDITY),
    )
    with ThreadPoolExecutor(1) as apart:
        judged = apart.submit(judge, pose)
        while not judged.done():
            robot.send(hold)
            robot.receive()
    return judged.result()


def hold_still(robot: Robot, position: FloatArray) -> StillPose:
    """Hold an arm where it stands, and return the pose and the torque that this takes.

    Args:
        robot: Open to be commanded.
        position: From which it is to move on, (n,) [rad].

    Raises:
        JointLimitError: It stands elsewhere.
        BackendError: It was not measured meanwhile.
    """
    robot.wait_until_ready()
    robot.receive()
    hold, rows = PositionCommand(position=position), list[JointState]()
    for _ in range(round(HELD / robot.spec.period)):
        robot.send(hold)
        rows.append(robot.receive())
    still = [row for row in rows[len(rows) // 2 :] if not row.stale]
    if not still:
        raise BackendError("no measurements came while the arm was held")
    position, torque = (np.mean([getattr(row, x) for row in still], axis=0) for x in STILL)
    return StillPose(position, torque)


class _Rests:
    """Poses at rest, out of stretches of a given time, in which nothing moves.

    Args:
        still: Length of a stretch [s].
        apart: Least difference of two poses in some joint [rad].
        tolerance: By which torque may change meanwhile, (n,) [N m].
    """

    def __init__(self, still: float, apart: float, tolerance: FloatArray) -> None:
        self._still, self._apart, self._tolerance = still, apart, tolerance
        self._found: list[tuple[FloatArray, list[FloatArray]]] = []  # pose, torques of stretches
        self._begin()

    def _begin(self) -> None:
        self._rows: list[tuple[FloatArray, FloatArray]] = []
        self._from = np.nan

    def take(self, state: JointState) -> None:
        """Take a measurement."""
        if not self._rows:
            self._from = state.time
        self._rows.append((state.position, state.torque))
        if np.abs(state.position - self._rows[0][0]).max() > REST:
            self._begin()
        elif state.time - self._from >= self._still:
            self._keep()
            self._begin()

    def _keep(self) -> None:
        position, torque = (np.array(rows) for rows in zip(*self._rows, strict=True))
        if (torque.std(axis=0) > self._tolerance).any():  # a hand leans on it
            return
        here, load = position.mean(axis=0), torque.mean(axis=0)
        for pose, torques in self._found:
            if np.abs(pose - here).max() < self._apart:
                torques.append(load)
                return
        self._found.append((here, [load]))

    def poses(self) -> tuple[StillPose, ...]:
        """Return each pose, with the median of its torques: a hand may have been there for long."""
        return tuple(
            StillPose(pose, np.median(np.array(torques), axis=0)) for pose, torques in self._found
        )


def _finite(values: FloatArray) -> list[float | None]:
    return [float(v) if np.isfinite(v) else None for v in values]


def first_state(robot: Robot, timeout: float) -> JointState:
    """Return the first measurement of an arm that was opened just now.

    Args:
        robot: That listens.
        timeout: Longest wait [s].

    Raises:
        BackendError: None came in time.
    """
    ends = robot.now() + timeout
    while robot.now() < ends:
        with suppress(CycleTimeoutError):
            if not (state := robot.receive()).stale:
                return state
    raise BackendError(f"no measurement came within {timeout:g} s")


class ShadowRobot(Robot):
    """The states of a robot that was opened to listen only, and the safety contract of its own.

    What `send` returns is what the drives would have been sent; nothing leaves for them.

    Args:
        robot: Open to listen only; closed with the shadow.
    """

    def __init__(self, robot: Robot) -> None:
        self._listener = robot
        super().__init__(robot.spec)

    @property
    def lost(self) -> int:
        """Measurements that did not come over the link."""
        return self._listener.lost

    def now(self) -> float:
        """Return the time of the clock by which cycles are waited for [s]."""
        return self._listener.now()

    def wait_until_ready(self, timeout: float = READY_TIMEOUT) -> None:
        """Wait for a first measurement.

        Args:
            timeout: Longest wait [s].

        Raises:
            BackendError: None came in time.
        """
        first_state(self, timeout)

    def link_figures(self) -> dict[str, Any]:
        """Return what was counted on the link."""
        return self._listener.link_figures()

    def _receive(self, timeout: float | None) -> JointState | None:
        state = self._listener.receive(timeout)
        return None if state.stale else state

    def _send(self, command: JointCommand) -> JointCommand | None:
        """Send nothing."""

    def _gravity(self) -> Callable[[], FloatArray] | None:
        return self._listener._gravity()  # the contract is the listener's, too

    def _gains(self) -> tuple[FloatArray, FloatArray] | None:
        return self._listener._gains()

    def _close(self) -> None:
        self._listener.close()
