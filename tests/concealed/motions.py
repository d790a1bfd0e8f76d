"""Motions for the concealed plant: LIMOPA, Fourier, creep, nested reversals, holds, points.

Each segment starts and ends at rest; slow smooth moves join them. Collisions are not looked at,
except in LIMOPA's plans.
"""

from functools import lru_cache
from itertools import pairwise

import numpy as np
from arm import Limits, N
from plant import PERIOD

from limo_driver.model import RobotModel
from limopa import PlanRequest, plan

KINDS = ("limopa", "fourier", "creep", "nested", "points", "hold")
_SHORTEST = 10.0  # [s] of a segment
_SHARE = 0.6  # of the joint's range in which poses are drawn


def recording(kinds: list[str], duration: float, limits: Limits, random: np.random.Generator):
    """Return positions every millisecond, (T, n) [rad], and the name of each segment.

    Args:
        kinds: Segments in their order; each takes an equal part of the time, a plan its own.
        duration: [s] in total.
        limits: Of the arm.
        random: Source of all draws.
    """
    parts = [_limopa(random, duration) if kind == "limopa" else None for kind in kinds]
    taken = sum(len(part) * PERIOD for part in parts if part is not None)
    short = sum(kind == "hold" for kind in kinds)
    free = duration - taken - 3.0 * short - 2.0 * len(kinds)
    each = max(free / max(sum(part is None for part in parts) - short, 1), _SHORTEST)
    pose = _pose(limits, random)
    joined, names = [], []
    for kind, part in zip(kinds, parts, strict=True):
        if part is not None:
            made = part
        else:
            seconds = random.uniform(2.0, 4.0) if kind == "hold" else each
            centre = pose if kind in ("hold", "nested") else _pose(limits, random)
            made = _SEGMENTS[kind](centre, seconds, limits, random)
        if joined:
            joined.append(move(joined[-1][-1], made[0], limits, random.uniform(0.2, 0.5)))
        joined.append(made)
        names.append(kind)
        pose = made[-1]
    return np.concatenate(joined), names


def _limopa(random: np.random.Generator, duration: float) -> np.ndarray:
    scaffolds = 1
    seed = int(random.integers(2**31))
    trajectory = plan(_model(), PlanRequest(scaffolds=scaffolds, rate=250.0), seed).trajectory
    longest = 0.8 * duration
    time = np.arange(0.0, min(trajectory.duration, longest), PERIOD)
    position = trajectory.evaluate(time).position
    if trajectory.duration <= longest:
        return position
    return _brake(position)


def _brake(position: np.ndarray) -> np.ndarray:
    """Bring a motion that is cut off to rest, by slowing its time down over the last second."""
    last = int(1.0 / PERIOD)
    u = np.arange(2 * last) / (2 * last)
    slowed = len(position) - 1 - last + last * (2 * u - u**2)  # from full speed to none
    rows = np.concatenate([np.arange(len(position) - 1 - last), slowed])
    grid = np.arange(len(position))
    stretched = np.stack([np.interp(rows, grid, p) for p in position.T], axis=1)
    return _smooth(stretched, 0.05)


@lru_cache(1)
def _model() -> RobotModel:
    return RobotModel.load("iiwa14")


def _pose(limits: Limits, random: np.random.Generator) -> np.ndarray:
    return random.uniform(-_SHARE, _SHARE, N) * limits.position


def move(start: np.ndarray, end: np.ndarray, limits: Limits, share: float) -> np.ndarray:
    """Go straight with least jerk, at `share` of the speed limits."""
    distance = np.abs(end - start)
    duration = max(1.0, float((1.875 * distance / (share * limits.velocity)).max()))
    u = np.arange(int(duration / PERIOD)) * PERIOD / duration
    return start + (end - start) * (u**3 * (10 - 15 * u + 6 * u**2))[:, None]


def _fourier(centre, duration, limits, random):
    time = np.arange(0.0, duration, PERIOD)
    base = 2 * np.pi * random.uniform(0.04, 0.1)
    k = np.arange(1, 6)
    shape = random.normal(size=(N, 5)) / np.sqrt(k)
    phase = random.uniform(0, 2 * np.pi, (N, 5))
    wave = np.einsum("jk,kjt->tj", shape, np.sin(
        base * k[:, None, None] * time + phase.T[:, :, None]))  # fmt: skip
    speed = np.abs(np.gradient(wave, PERIOD, axis=0)).max(axis=0)
    room = 0.9 * limits.position - np.abs(centre)
    amplitude = np.minimum(
        random.uniform(0.3, 1.0) * room / np.abs(wave).max(axis=0),
        random.uniform(0.15, 0.6) * limits.velocity / speed,
    )
    u = np.minimum(np.minimum(time, time[-1] - time) / 2.0, 1.0)
    ramp = u**3 * (10 - 15 * u + 6 * u**2)
    return centre + ramp[:, None] * amplitude * wave


def _creep(centre, duration, limits, random):
    """Constant slow speeds, each joint its own, with reversals."""
    rows = int(duration / PERIOD)
    velocity = np.zeros((rows, N))
    for j in range(N):
        start, sign, at = 0, random.choice([-1.0, 1.0]), centre[j]
        while start < rows:
            speed = np.exp(random.uniform(np.log(0.003), np.log(0.25)))
            length = int(random.uniform(1.5, 5.0) / PERIOD)
            if abs(at + sign * speed * length * PERIOD) > 0.9 * limits.position[j]:
                sign = -np.sign(at)
            velocity[start : start + length, j] = sign * speed
            at += sign * speed * length * PERIOD
            start, sign = start + length, -sign if random.random() < 0.8 else sign
    velocity[: int(0.3 / PERIOD)] = velocity[-int(0.3 / PERIOD) :] = 0.0
    return centre + np.cumsum(_smooth(velocity, 0.2), axis=0) * PERIOD


def _nested(centre, duration, limits, random):
    """Reversals that shrink, each move a half cosine."""
    count = random.integers(8, 14)
    largest = np.minimum(np.exp(random.uniform(np.log(0.03), np.log(0.3), N)), 0.5)
    largest = np.minimum(largest, 0.9 * limits.position - np.abs(centre) + 1e-3)
    turns = (-1.0) ** np.arange(count) * random.uniform(0.7, 0.85) ** np.arange(count)
    turns = np.concatenate([[0.0], turns, [0.0]])
    rows = int(duration / PERIOD / (len(turns) - 1))
    largest = np.minimum(largest, 0.3 * limits.velocity * rows * PERIOD / np.pi)
    blend = 0.5 - 0.5 * np.cos(np.pi * np.arange(rows) / rows)
    wave = np.concatenate([a + (b - a) * blend for a, b in pairwise(turns)])
    return centre + largest * _smooth(wave[:, None], 0.1)


def _points(centre, duration, limits, random):
    parts, at, rows = [], centre, 0
    while rows < duration / PERIOD:
        goal = _pose(limits, random)
        part = move(at, goal, limits, random.uniform(0.15, 0.6))
        hold = np.tile(goal, (int(random.uniform(0.3, 1.5) / PERIOD), 1))
        parts += [part, hold]
        rows += len(part) + len(hold)
        at = goal
    return np.concatenate(parts)


def _hold(centre, duration, _limits, _random):
    return np.tile(centre, (int(duration / PERIOD), 1))


def _smooth(values: np.ndarray, width: float) -> np.ndarray:
    window = np.hanning(int(width / PERIOD) + 2)[1:-1]
    window /= window.sum()
    half = len(window) // 2
    padded = np.concatenate(
        [np.repeat(values[:1], half, 0), values, np.repeat(values[-1:], half, 0)]
    )
    smooth = np.stack([np.convolve(p, window, "same") for p in padded.T], axis=1)
    return smooth[half : half + len(values)]


_SEGMENTS = {
    "fourier": _fourier,
    "creep": _creep,
    "nested": _nested,
    "points": _points,
    "hold": _hold,
}
