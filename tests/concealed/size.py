"""How large an effect is: what tolerances cannot imitate of it, over the noise floor.

Size = RMS, at the most affected joint and over the rows in which that joint moves, of the part of
the torque change that inertia (2 %) and friction (15 %) inside their tolerances cannot imitate,
divided by the noise floor, all in the band below 10 Hz. What they can imitate is the best fit
of the torques of their deviations with each deviation inside two of its standard deviations. A
ridge of one standard deviation would not do: over thousands of rows, data outvote any prior.
"""

from dataclasses import dataclass

import arm as arm_
import numpy as np
from acquisition import in_band
from arm import N
from drive import slope
from plant import PERIOD, Response
from scipy.optimize import lsq_linear
from world import FRICTION, INERTIA, World

_STRIDE = 40  # milliseconds between the rows that are looked at
_INSIDE = 2.0  # standard deviations
MOVING = 0.003  # [rad/s]


@dataclass(frozen=True)
class Yardstick:
    """What a size is measured with: rows, tolerances, noise floor."""

    columns: np.ndarray  # (rows n, p) of one standard deviation each, over the floor
    triangle: np.ndarray  # (p, p), R of their QR decomposition
    moving: np.ndarray  # (rows, n)
    floor: np.ndarray  # (n,) [N m]
    friction: np.ndarray  # (2 n,) dry and viscous, of which a standard deviation is a share

    @classmethod
    def of(
        cls, world: World, responses: list[Response], motions: list[np.ndarray], floor: np.ndarray
    ) -> "Yardstick":
        columns = np.concatenate(
            [_columns(world, r, m) for r, m in zip(responses, motions, strict=True)]
        )
        moving = np.concatenate(
            [np.abs(in_band(r.velocity, 1 / PERIOD))[::_STRIDE] > MOVING for r in responses]
        )
        scaled = (columns / floor[:, None]).reshape(-1, columns.shape[2])
        # deviations that the motion does not show stay where they are
        normal = scaled.T @ scaled + 1e-3 * np.eye(columns.shape[2])
        friction = np.concatenate([world.nominal.coulomb, world.nominal.viscous])
        return cls(scaled, np.linalg.cholesky(normal).T, moving, floor, friction)

    def sizes(self, change: np.ndarray, world: World) -> np.ndarray:
        """Return the size at each joint of a torque change.

        Args:
            change: (rows, n) [N m].
            world: Where it came about; friction that its nominal model lacks has no tolerance.
        """
        y = (change / self.floor).reshape(-1)
        seen = np.linalg.solve(self.triangle.T, self.columns.T @ y)
        known = np.concatenate([world.nominal.coulomb, world.nominal.viscous]) / self.friction
        inside = np.full(len(seen), _INSIDE)
        inside[-len(known) :] = _INSIDE * np.maximum(known, 1e-9)
        deviations = lsq_linear(self.triangle, seen, (-inside, inside), method="bvls").x
        left = (y - self.columns @ deviations).reshape(change.shape)
        return np.array([_rms(left[self.moving[:, j], j]) for j in range(N)])


def change(world: World, responses: list[Response]) -> np.ndarray:
    """Return what the recorded torque differs by from what the nominal structure says."""
    parts = []
    for k, response in enumerate(responses):
        said = world.sensing.torque(response.torque, k)
        seen = response._replace(position=response.position + world.sensing.encoder_offset)
        nominal = world.nominal.torque(seen, float(world.drive["sharpness"][0]))
        parts.append(in_band(said - nominal, 1 / PERIOD)[::_STRIDE])
    return np.concatenate(parts)


def noise_floor(time: np.ndarray, noise: np.ndarray, moving: np.ndarray, rate: float) -> np.ndarray:
    """Return the RMS of noise below 10 Hz over moving rows, (n,) [N m]."""
    even = np.arange(0.0, time[-1], 1 / rate)
    low = in_band(np.stack([np.interp(even, time, x) for x in noise.T], axis=1), rate)
    rows = moving[np.searchsorted(time, even).clip(0, len(time) - 1)]
    rows |= ~rows.any(axis=0)  # of a joint that never moves, all
    return np.array([_rms(low[rows[:, j], j]) for j in range(N)])


def _columns(world: World, response: Response, motion: np.ndarray) -> np.ndarray:
    """Return the torque of one standard deviation of each nominal value, (rows, n, p)."""
    velocity = np.gradient(motion, PERIOD, axis=0)
    acceleration = np.gradient(velocity, PERIOD, axis=0)
    rows = [x[::_STRIDE].copy() for x in (motion, velocity, acceleration)]
    base, w = world.nominal.arm, arm_.work()
    nominal = arm_.along(base, w, *rows)
    columns = [
        arm_.along(made, w, *rows) - nominal for i in range(N) for made in _deviations(base, i)
    ]
    v = response.velocity
    sign = v * slope(v, float(world.drive["sharpness"][0]))
    dry = in_band(world.nominal.coulomb * sign, 1 / PERIOD)[::_STRIDE]
    viscous = in_band(world.nominal.viscous * v, 1 / PERIOD)[::_STRIDE]
    joints = np.eye(N)
    columns += [FRICTION * torque * joints[j] for torque in (dry, viscous) for j in range(N)]
    return np.stack(columns, axis=2)


def _deviations(arm: arm_.Arm, i: int):
    mass = arm.mass.copy()
    mass[i] *= 1 + INERTIA
    yield arm._replace(mass=mass)
    for a in range(3):
        com, inertia = arm.com.copy(), arm.inertia.copy()
        com[i, a] += INERTIA * np.linalg.norm(arm.com[i])
        yield arm._replace(com=com)
        e = INERTIA * np.eye(3)[a]
        inertia[i] *= 1 + (e[:, None] + e[None, :]) / 2
        yield arm._replace(inertia=inertia)


def _rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(values**2))) if values.size else 0.0
