"""Motions that make one kind of joint physics show: creep, nested reversals, holds, sweeps.

Each is a chain of straight moves, sinusoids and holds in joint space around a start pose, every
part from rest to rest, checked for joint limits, table and self-collision, and timed within the
limits of velocity, acceleration and jerk. Where the full amplitude is not feasible, the other
direction and smaller amplitudes are tried.

All of them take the robot, the pose around which to move, (n,) [rad], and the joints that are to
show something, 1-based: they move together, unless the motion says one after the other, which it
does with the first three. All raise `ConfigError` if one of the joints does not exist, and
`InfeasiblePathError` if no amplitude is feasible from that pose.

Source: the exciting motions are those of the friction literature: creep at steady speeds
(Armstrong-Hélouvry 1991), nested reversals (Swevers et al. 2000), the same path at several loads
(Bittencourt and Gunnarsson 2012), holds approached from both sides.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from limo_driver.errors import ConfigError, InfeasiblePathError
from limo_driver.model import RobotModel
from limo_driver.trajectory import Trajectory
from limo_driver.types import FloatArray
from limopa.path import Line
from limopa.separation.chain import MotionChain, first_feasible

CREEP = (0.004, 0.01, 0.025, 0.06, 0.15)  # [rad/s]
FAST = (0.05, 0.15, 0.35, 0.6, 0.8)  # shares of the slowest joint's velocity limit
SCALES = (1.0, -1.0, 0.6, -0.6, 0.35, -0.35, 0.2, -0.2)  # of an amplitude, in the order tried
AT_ONCE = 3  # joints that are swept one after the other; more would last too long
_SHRINKING = 0.72  # of one reversal to the next
_LEAST_RANGE = 0.15  # [rad] that a sweep has to span
_RANGE = 1.25  # [rad] to either side, of a wide sweep
_POSES = 64  # random poses that are looked at
_NEAR, _FAR = 0.7, 1.5  # [rad] of each joint around the start
_LEAST_LOAD = 0.01  # of the torque limit, to either side of a reversal of the load


def creep(
    model: RobotModel, start: FloatArray, joints: Sequence[int], speeds: Sequence[float] = CREEP
) -> Trajectory:
    """Move joints at steady speeds [rad/s], forth and back at each."""
    direction = _direction(model, joints)

    def build(chain: MotionChain, scale: float) -> None:
        for speed in speeds:
            distance = scale * float(np.clip(8.0 * speed, 0.05, 0.6))
            for to in (start + distance * direction, start):
                chain.move(to, speed, "creep")
                chain.hold(0.3)

    return _scaled(model, start, build)


def speed_ladder(model: RobotModel, start: FloatArray, joints: Sequence[int]) -> Trajectory:
    """Move joints forth and back at five steady speeds up to 80 % of the slowest one's limit."""
    return creep(model, start, joints, [share * _slowest(model, joints) for share in FAST])


def nested_reversals(
    model: RobotModel,
    start: FloatArray,
    joints: Sequence[int],
    amplitude: float = 0.08,
    speeds: Sequence[float] = (0.02, 0.06),
) -> Trajectory:
    """Reverse joints inside ever smaller loops, down to a milliradian, at two speeds.

    Args:
        model: The robot.
        start: Pose around which to move, (n,) [rad].
        joints: Joints that move, together, 1-based.
        amplitude: Of the outermost loop [rad].
        speeds: Of the whole motion, repeated at each [rad/s].
    """
    direction = _direction(model, joints)

    def build(chain: MotionChain, scale: float) -> None:
        for speed in speeds:
            reach = scale * amplitude
            while abs(reach) > 1e-3:  # noqa: PLR2004  # [rad]
                chain.move(start + reach * direction, speed, "nested reversal")
                reach *= -_SHRINKING
            chain.move(start, speed, "nested reversal")

    return _scaled(model, start, build)


def rest_holds(
    model: RobotModel,
    start: FloatArray,
    joints: Sequence[int],
    span: float = 0.6,
    seconds: float = 1.5,
) -> Trajectory:
    """Rest at seven poses, each approached from either side.

    Args:
        model: The robot.
        start: The first pose, (n,) [rad].
        joints: Joints that move, together, 1-based.
        span: From the first to the last pose [rad].
        seconds: How long to rest at each.
    """
    direction = _direction(model, joints)

    def build(chain: MotionChain, scale: float) -> None:
        stairs = np.linspace(0.0, scale * span, 7)
        beyond = stairs[-1] + scale * span / 6
        for step in (*stairs, beyond, *stairs[::-1]):
            chain.move(start + step * direction, 0.1, "approach")
            chain.hold(seconds)

    return _scaled(model, start, build)


def wide_sweep(
    model: RobotModel,
    start: FloatArray,
    joints: Sequence[int],
    speeds: Sequence[float] = (0.15, 0.45),
) -> Trajectory:
    """Sweep one joint after the other wide both ways [rad/s], in poses of low and of high load."""
    chain = _chain(model, start, joints)
    for joint in joints[:AT_ONCE]:
        for pose in heavy_and_light(chain, start, joint - 1) or [start]:
            low, high = range_of(chain, pose, joint - 1)
            if np.abs(high - low).max() < _LEAST_RANGE or chain.broken_by(Line(chain.here, pose)):
                continue
            chain.move(pose)
            for speed in speeds:
                chain.visit((high, low, pose), speed, "sweep")
            if not chain.broken_by(Line(chain.here, start)):
                chain.move(start)
    return chain.trajectory()


def load_reversal(
    model: RobotModel,
    start: FloatArray,
    joints: Sequence[int],
    speeds: Sequence[float] = (0.1, 0.3),
) -> Trajectory:
    """Sweep one joint after the other [rad/s], there and back where its gravity torque is zero.

    Raises:
        InfeasiblePathError: Gravity loads none of the joints from either side in reach.
    """
    chain = _chain(model, start, joints)
    for joint in joints[:AT_ONCE]:
        ends = reversing(chain, joint - 1)
        if ends is None:
            continue
        chain.move(ends[0])
        for speed in speeds:
            chain.visit((ends[1], ends[0]) * 2, speed, "sweep")
    if "sweep" not in chain.kinds:
        raise InfeasiblePathError(
            "gravity", f"it loads none of the joints {list(joints)} from either side in reach"
        )
    return chain.trajectory()


def two_frequencies(
    model: RobotModel,
    start: FloatArray,
    joints: Sequence[int],
    frequencies: Sequence[float] = (0.3, 1.5),
) -> Trajectory:
    """Swing one joint after the other at a low and at a high frequency [Hz]."""
    _check(model, joints)

    def build(chain: MotionChain, scale: float) -> None:
        for joint in joints[:AT_ONCE]:
            for frequency in frequencies:
                amplitude = np.zeros(model.n)
                strongest = 0.3 * model.limits.acceleration[joint - 1]
                amplitude[joint - 1] = scale * min(0.25, strongest / (2 * np.pi * frequency) ** 2)
                chain.swing(amplitude, frequency, max(3, round(8 * frequency)), "swing")
                chain.hold(0.5)

    return _scaled(model, start, build)


def apart(model: RobotModel, start: FloatArray, joints: Sequence[int]) -> Trajectory:
    """Move two joints apart, together, and each alone, at two speeds.

    Args:
        model: The robot.
        start: Pose around which to move, (n,) [rad].
        joints: The two joints, 1-based; of one joint, its neighbour is the other.

    Raises:
        ConfigError: A joint does not exist, or the robot has one only.
        InfeasiblePathError: No amplitude is feasible from this pose.
    """
    first, second = _pair(model, joints)

    def build(chain: MotionChain, scale: float) -> None:
        for speed in (0.06, 0.2):
            for ways in ((1.0, -1.0), (1.0, 1.0), (1.0, 0.0), (0.0, 1.0)):
                step = np.zeros(model.n)
                step[[first - 1, second - 1]] = np.multiply(0.3 * scale, ways)
                chain.visit((start + step, start - step, start), speed, "apart")

    return _scaled(model, start, build)


def revisit(
    model: RobotModel, start: FloatArray, joints: Sequence[int], minutes: float = 1.5
) -> Trajectory:
    """Sweep joints slowly both ways, exercise them for minutes, and sweep the same way again."""
    direction = _direction(model, joints)
    fast = 0.7 * _slowest(model, joints)

    def build(chain: MotionChain, scale: float) -> None:
        far = start + 0.8 * scale * direction
        lap = 2 * float(np.abs(far - start).max()) / fast + 1.0  # [s], about
        laps = max(1, round(60 * minutes / lap))
        chain.visit((far, start), 0.08, "before")
        chain.visit((far, start) * laps, fast, "exercise")
        chain.visit((far, start), 0.08, "after")

    return _scaled(model, start, build)


def _scaled(
    model: RobotModel, start: FloatArray, build: Callable[[MotionChain, float], None]
) -> Trajectory:
    """Return the motion of the first scale that is feasible."""

    def attempt(scale: float) -> Trajectory:
        chain = MotionChain(model, start)
        build(chain, scale)
        return chain.trajectory()

    return first_feasible(attempt, SCALES)


def _chain(model: RobotModel, start: FloatArray, joints: Sequence[int]) -> MotionChain:
    _check(model, joints)
    return MotionChain(model, start)


def _check(model: RobotModel, joints: Sequence[int]) -> None:
    if not joints or not all(1 <= j <= model.n for j in joints):
        raise ConfigError(f"joints are {list(joints)}, expected some of 1 to {model.n}")


def _direction(model: RobotModel, joints: Sequence[int]) -> FloatArray:
    """Return 1 for the joints that move, (n,)."""
    _check(model, joints)
    direction = np.zeros(model.n)
    direction[np.array(joints) - 1] = 1.0
    return direction


def _slowest(model: RobotModel, joints: Sequence[int]) -> float:
    """Return the least velocity limit of the joints [rad/s]."""
    _check(model, joints)
    return float(min(model.limits.velocity[j - 1] for j in joints))


def _pair(model: RobotModel, joints: Sequence[int]) -> tuple[int, int]:
    _check(model, joints)
    if model.n == 1:
        raise ConfigError("the robot has one joint; two are needed to move apart")
    first = joints[0]
    neighbour = first + 1 if first < model.n else first - 1
    return first, joints[1] if len(joints) > 1 else neighbour


def range_of(chain: MotionChain, pose: FloatArray, j: int) -> tuple[FloatArray, FloatArray]:
    """Return how far joint j (0-based) can go from a pose to either side, both (n,) [rad]."""
    step = np.eye(len(pose))[j]
    ends: list[FloatArray] = []
    for sign in (-1.0, 1.0):
        reaches = (sign * _RANGE * share for share in np.linspace(1.0, 1.0 / 16, 16))
        free = (r for r in reaches if not chain.broken_by(Line(pose, pose + r * step)))
        ends.append(pose + next(free, 0.0) * step)
    return ends[0], ends[1]


def heavy_and_light(chain: MotionChain, start: FloatArray, j: int) -> list[FloatArray]:
    """Return poses nearby of the lowest and the highest gravity torque at joint j; or none."""
    reachable = _reachable(chain, start, j, _NEAR)
    if not reachable:
        return []
    load = chain.model.gravity_torque(np.array(reachable))[:, j]
    return [reachable[int(load.argmin())], reachable[int(load.argmax())]]


def reversing(chain: MotionChain, j: int) -> tuple[FloatArray, FloatArray] | None:
    """Return the ends of a sweep of joint j that gravity loads from either side; or None.

    Of the sweeps in random poses it is the one whose smaller load is the largest.
    """
    best, found = _LEAST_LOAD * float(chain.model.limits.torque[j]), None
    for spread in (_NEAR, _FAR):
        for pose in _reachable(chain, chain.here, j, spread):
            low, high = range_of(chain, pose, j)
            first, last = chain.model.gravity_torque(np.array([low, high]))[:, j]
            way = Line(chain.here, low)
            if first * last < 0 and min(abs(first), abs(last)) > best and not chain.broken_by(way):
                best, found = min(abs(first), abs(last)), (low, high)
        if found is not None:
            break
    return found


def _reachable(chain: MotionChain, start: FloatArray, j: int, spread: float) -> list[FloatArray]:
    """Return random poses around `start`, with joint j as there, that a straight move reaches."""
    random = np.random.default_rng(0)
    poses = start + random.uniform(-spread, spread, (_POSES, len(start)))
    poses[:, j] = start[j]
    return [pose for pose in poses if not chain.broken_by(Line(start, pose))]
