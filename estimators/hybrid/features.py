"""Input features of the hybrid's network: joint motion, rotational history, rigid-body torque.

The history is a scan over the positions, the same code for a whole recording and for one sample.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Final

import numpy as np

from limo_driver.errors import ConfigError
from limo_driver.model import RobotModel
from limo_driver.runtime.compiled import compiled
from limo_driver.types import FloatArray, IntArray, Motion

REVERSAL: Final = 2e-4  # [rad]; above the jitter of a filtered encoder, far below any LIMO motion
SATURATION: Final = float(np.deg2rad(10.0))  # [rad], of the rotational history, as in the paper
_NOTHING: FloatArray = np.zeros((0, 0))
_TURN, _EXTREME, _DIRECTION, _LAST, _STOPS = 0, 1, 2, 3, 4  # columns of a joint's memory


@dataclass(frozen=True)
class Feature:
    """A number with a unit that the network sees."""

    name: str
    unit: str


@dataclass(frozen=True)
class Features:
    """The inputs of a network for n joints, and which of them it may use for each joint.

    x = (q, dq, ddq, r, tau_RBD) of all joints, with the rotational history r: the signed rotation
    since the last reversal, clipped to `saturation`. A joint has reversed when it has come back by
    `reversal` from the farthest point it reached; r is then counted from that point. At the start,
    r is counted from the first position.

    Stop operators z ← clip(z + Δq, -w, w) remember more than the last reversal: one for each width
    w gives the state of any presliding friction that is a sum of Maxwell-slip elements.

    Directions tanh(dq / v) resolve the neighbourhood of a reversal, where dry friction changes
    sign, at several speeds v: normalised velocity does not, since fast reaches set its scale.

    The deflection torque ID(q - compliance tau_RBD, dq, ddq) - ID(q, dq, ddq) is what the rigid
    body needs more when all joints give way to their load, as elastic drives do. It depends on the
    whole pose, which a network could only learn from more poses than a recording visits.

    Args:
        n: Number of joints.
        own_joint: Show the network of a joint its own joint only.
        stop_widths: Widths w of the stop operators [rad].
        direction_speeds: Speeds v of the directions [rad/s].
        compliance: Of every joint, for the deflection torque [rad/(N m)]; 0 leaves it out.
        without: Quantities that are left out, by name.
        reversal: Rotation back that counts as a reversal [rad].
        saturation: Largest rotational history [rad].

    Source: Çallar and Böttger, "Hybrid Learning of Time-Series Inverse Dynamics Models for Locally
    Isotropic Robot Motion", RA-L 2022, sec. III-B.1; stop operators: Visintin, "Differential Models
    of Hysteresis", 1994.
    """

    n: int
    own_joint: bool = False
    stop_widths: tuple[float, ...] = ()
    direction_speeds: tuple[float, ...] = ()
    compliance: float = 0.0
    reversal: float = REVERSAL
    saturation: float = SATURATION
    without: tuple[str, ...] = ()

    @cached_property
    def _constants(self) -> FloatArray:
        """Constants of the compiled scan."""
        limits = (self.reversal, self.saturation)
        return np.array([*limits, *self.stop_widths, *self.direction_speeds], dtype=np.float64)

    @cached_property
    def places(self) -> IntArray:
        """Which block of n inputs each quantity becomes; -1 where it is left out."""
        places = np.full(len(self._every), -1)
        places[self._kept] = np.arange(len(self._kept))
        return places

    @property
    def _every(self) -> tuple[Feature, ...]:
        """The quantities of a joint, in order, those left out among them."""
        every = (
            ("position", "rad"),
            ("velocity", "rad/s"),
            ("acceleration", "rad/s^2"),
            ("rotation_since_reversal", "rad"),
            ("rigid_body_torque", "N m"),
            *((f"stop_{width:.3g}rad", "rad") for width in self.stop_widths),
            *((f"direction_{speed:.3g}rad/s", "1") for speed in self.direction_speeds),
            *([("deflection_torque", "N m")] if self.compliance else []),
        )
        return tuple(Feature(name, unit) for name, unit in every)

    @property
    def _kept(self) -> list[int]:
        """Where the quantities stand that are not left out."""
        return [i for i, quantity in enumerate(self._every) if quantity.name not in self.without]

    @property
    def quantities(self) -> tuple[str, ...]:
        """Names of the quantities of a joint that the network sees, in order."""
        return tuple(self._every[i].name for i in self._kept)

    @property
    def inputs(self) -> tuple[Feature, ...]:
        """All inputs, in order: each quantity of all joints, 1-based."""
        return tuple(
            Feature(f"{self._every[i].name}_{j + 1}", self._every[i].unit)
            for i in self._kept
            for j in range(self.n)
        )

    @property
    def columns(self) -> np.ndarray[tuple[int, ...], np.dtype[np.int64]]:
        """Inputs that the network of each joint may use, (n, f)."""
        every = np.arange(len(self.inputs)).reshape(-1, self.n)
        if self.own_joint:
            return np.ascontiguousarray(every.T)
        return np.tile(every.ravel(), (self.n, 1))

    def init(self) -> FloatArray:
        """Return the memory before the first sample."""
        memory = np.zeros((self.n, _STOPS + len(self.stop_widths)))
        memory[:, _LAST] = np.nan
        return memory

    def advance(
        self,
        memory: FloatArray,
        motion: Motion,
        rigid_body_torque: FloatArray,
        model: RobotModel,
    ) -> tuple[FloatArray, FloatArray]:
        """Compute the inputs of T samples that follow `memory`.

        Args:
            memory: Memory after the sample before.
            motion: T samples of n joints.
            rigid_body_torque: (T, n) [N m].
            model: The rigid body.

        Returns:
            The inputs, (T, number of inputs), and the memory after the last sample.
        """
        after = memory.copy()
        deflection = _NOTHING
        if self.compliance:
            deflection = _deflection(model, motion, self.compliance * rigid_body_torque)
        inputs = _inputs(
            after,
            np.ascontiguousarray(motion.position),
            np.ascontiguousarray(motion.velocity),
            np.ascontiguousarray(motion.acceleration),
            np.ascontiguousarray(rigid_body_torque),
            np.ascontiguousarray(deflection),
            self._constants,
            self.places,
            len(self.stop_widths),
        )
        return inputs, after


# Widths of the stop operators: half a reversal threshold of LIMO motion up to the paper's 10°.
_WIDTHS: Final = tuple(float(f"{w:.3g}") for w in np.geomspace(3e-4, SATURATION, 9))

_SPEEDS: Final = (0.003, 0.01, 0.03, 0.1)  # [rad/s], from creep to the slower half of LIMO motion

_COMPLIANCE: Final = 1e-4  # [rad/(N m)], a common size of harmonic drives; the network scales it

FEATURE_SETS: Final[dict[str, Callable[[int], Features]]] = {
    "all-joints": Features,  # the paper's: every network sees every joint
    "own-joint": lambda n: Features(n, own_joint=True),  # the paper's five, of one joint each
    # What friction and elasticity of a drive depend on: neither position nor acceleration, from
    # which a network would learn the poses of a recording by heart.
    "drive": lambda n: Features(
        n,
        own_joint=True,
        stop_widths=_WIDTHS,
        direction_speeds=_SPEEDS,
        compliance=_COMPLIANCE,
        without=("position", "acceleration"),
    ),
}


def feature_set(name: str, n: int) -> Features:
    """Return the features of a named set for n joints.

    Raises:
        ConfigError: No such set; the message lists the known ones.
    """
    if name not in FEATURE_SETS:
        raise ConfigError(f"no feature set is called {name!r}; known: {', '.join(FEATURE_SETS)}")
    return FEATURE_SETS[name](n)


def _deflection(model: RobotModel, motion: Motion, angle: FloatArray) -> FloatArray:
    """Return the torque added by joints that give way by `angle` (T, n) [rad]; (T, n) [N m]."""
    v, a = motion.velocity, motion.acceleration
    straight = model.inverse_dynamics(motion.position, v, a)
    return model.inverse_dynamics(motion.position - angle, v, a) - straight


@compiled(
    reads=("position", "velocity", "acceleration", "rigid_body_torque", "deflection"), nogil=True
)
def _inputs(
    memory: FloatArray,
    position: FloatArray,
    velocity: FloatArray,
    acceleration: FloatArray,
    rigid_body_torque: FloatArray,
    deflection: FloatArray,
    constants: FloatArray,
    places: IntArray,
    stops: int,
) -> FloatArray:
    """Advance `memory` (n, ...) in place over T samples; return the inputs, (T, inputs).

    `constants` are the reversal, the saturation, the widths of the stops and the speeds of the
    directions; `places` says which block of n inputs each quantity becomes, -1 where it is left
    out. `deflection` is (T, n), or empty.
    """
    T, n = position.shape
    widths, speeds = constants[2 : 2 + stops], constants[2 + stops :]
    inputs = np.empty((T, (places.max() + 1) * n))
    quantities = np.empty(places.size)
    for t in range(T):
        for j in range(n):
            quantities[0] = position[t, j]
            quantities[1] = velocity[t, j]
            quantities[2] = acceleration[t, j]
            step = _turn(memory[j], position[t, j], constants[0])
            rotation = position[t, j] - memory[j, _TURN]
            quantities[3] = min(max(rotation, -constants[1]), constants[1])
            quantities[4] = rigid_body_torque[t, j]
            for i in range(stops):
                z = min(max(memory[j, _STOPS + i] + step, -widths[i]), widths[i])
                quantities[5 + i] = memory[j, _STOPS + i] = z
            for i in range(speeds.size):
                quantities[5 + stops + i] = math.tanh(velocity[t, j] / speeds[i])
            if deflection.size:
                quantities[-1] = deflection[t, j]
            for i in range(places.size):
                if places[i] >= 0:
                    inputs[t, places[i] * n + j] = quantities[i]
    return inputs


@compiled(nogil=True)
def _turn(own: FloatArray, q: float, reversal: float) -> float:
    """Advance the extremes of a joint in place to the position q; return the step to it [rad]."""
    if np.isnan(own[_LAST]):
        own[_TURN] = own[_EXTREME] = own[_LAST] = q
    step = q - own[_LAST]
    own[_LAST] = q
    if own[_DIRECTION] == 0.0:
        if abs(q - own[_TURN]) > reversal:
            own[_DIRECTION] = np.sign(q - own[_TURN])
            own[_EXTREME] = q
    elif (q - own[_EXTREME]) * own[_DIRECTION] >= 0.0:
        own[_EXTREME] = q
    elif abs(q - own[_EXTREME]) > reversal:
        own[_TURN] = own[_EXTREME]
        own[_EXTREME] = q
        own[_DIRECTION] = -own[_DIRECTION]
    return step
