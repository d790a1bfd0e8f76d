"""Strangers: arms of which only a bare description is at hand, with something unusual, or nothing.

All joints rub, each as it likes, and bodies are off the description by 2 %. One recording is all
that there is of such an arm.
"""

from dataclasses import dataclass, replace

import arm as arm_
import motions
import numpy as np
import presliding
from acquisition import CLASS, Instruments, Recorded
from arm import N, add_body
from plant import PERIOD
from world import World, off_within

KINDS = (
    "null", "payload", "drag", "spring", "payload_and_drag", "null_presliding", "presliding",
    "dry",
)  # fmt: skip
FLOOR = 0.03 * CLASS  # [N m] of the noise below 10 Hz, about
_MOVING = 0.01  # [rad/s]
_SHORT = 40.0  # [s], below which there are two kinds of motion instead of four


@dataclass(frozen=True)
class Unusual:
    """One thing that such a joint, or the flange, seldom has."""

    effect: str
    joint: int  # 1-based
    size: float = np.nan  # [noise floors] RMS where the joint moves, beyond plain friction
    mass: float = np.nan  # [kg]
    equivalent: tuple[str, ...] = ()


@dataclass(frozen=True)
class Stranger:
    """An arm, how it is to move, and what is unusual in it."""

    seed: int
    world: World
    motion: np.ndarray  # (T, n) [rad] every millisecond
    unusual: tuple[Unusual, ...]

    def record(self) -> Recorded:
        """Return what the sensors say of the motion."""
        random = np.random.default_rng([self.seed, 4022])
        response = self.world.respond(self.motion, 0, random)
        return Instruments.draw(random).record(response, self.world.sensing, 0)


def draw(kind: str, seed: int, seconds: float) -> Stranger:
    """Draw an arm; the same arguments give the same one.

    Args:
        kind: One of `KINDS`; `null_presliding` has presliding at all joints, which is how it is
            made, and `dry` eight times the usual dry friction at one.
        seed: Of all draws.
        seconds: Length of the recording, about.
    """
    random = np.random.default_rng([seed, 4021])
    world = World.draw(random)
    world = replace(world, arm=off_within(world.arm, random))
    _, limits = arm_.load()
    kinds = ["fourier", "points"] if seconds < _SHORT else ["fourier", "points", "creep", "nested"]
    motion, _ = motions.recording(list(random.permutation(kinds)), seconds, limits, random)
    unusual: list[Unusual] = []
    if kind == "null_presliding":
        for j in range(N):
            world = _presliding(world, j, 0.6, random)
    if kind.startswith("payload"):
        mass = float(random.uniform(0.5, 3.0))
        com = np.array([*random.uniform(-0.03, 0.03, 2), random.uniform(0.06, 0.15)])
        world = replace(world, arm=add_body(world.arm, N - 1, mass, com, mass * 9e-4 * np.eye(3)))
        unusual.append(Unusual("payload", N, mass=mass, equivalent=("link_inertia",)))
    j = int(random.integers(N))
    v = np.gradient(motion[:, j], PERIOD)
    if kind.endswith("drag"):
        wanted = random.uniform(3.0, 10.0)
        amplitude = wanted * FLOOR[j] / _beyond_friction(v * np.abs(v), v)
        world = world.with_drive(j, drag=amplitude, power=2.0)
        unusual.append(Unusual("quadratic_drag", j + 1, wanted))
    if kind == "spring":
        rest, wanted = random.uniform(-0.8, 0.8), random.uniform(3.0, 10.0)
        amplitude = wanted * FLOOR[j] / _beyond_friction(motion[:, j], v)
        world = world.with_drive(j, spring=amplitude, spring_rest=rest, spring_width=1e3)
        unusual.append(Unusual("spring_load", j + 1, wanted))
    if kind == "presliding":
        world = _presliding(world, j, 0.9, random)
        unusual.append(Unusual("presliding_hysteresis", j + 1))
    if kind == "dry":
        world = world.with_drive(j, coulomb=8.0 * world.drive["coulomb"][j])
        unusual.append(Unusual("coulomb_friction", j + 1))
    return Stranger(seed, world, motion, tuple(unusual))


def _presliding(world: World, j: int, part: float, random: np.random.Generator) -> World:
    """Return a world in which a part of a joint's dry friction builds up over a way."""
    dry = float(world.drive["coulomb"][j])
    width = float(np.exp(random.uniform(np.log(8e-3), np.log(2e-2))))  # [rad]
    fields = presliding.draw("bouc_wen", part * dry, width, random)
    return world.with_drive(j, coulomb=(1.0 - part) * dry, **fields)


def _beyond_friction(torque: np.ndarray, velocity: np.ndarray) -> float:
    """Return the RMS of the part of a torque (T,) that offset and plain friction cannot imitate."""
    rows = np.abs(velocity) > _MOVING
    plain = np.stack([np.sign(velocity), velocity, np.ones_like(velocity)], axis=1)[rows]
    left = torque[rows] - plain @ np.linalg.lstsq(plain, torque[rows], rcond=None)[0]
    return float(np.sqrt(np.mean(left**2)))
