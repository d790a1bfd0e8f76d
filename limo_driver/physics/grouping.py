"""Effects of one kind, which are evaluated together: a call costs more than its arithmetic."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from limo_driver.physics.effect import BodyEffect, SensorEffect
from limo_driver.physics.effects.friction import Frictions, VelocityFriction
from limo_driver.physics.effects.hysteresis import MAXWELL_SLIP, MaxwellSlips, PreslidingHysteresis
from limo_driver.physics.effects.sensing import TorqueOffset
from limo_driver.physics.effects.transmission import JointElasticity, wind_up

if TYPE_CHECKING:
    from collections.abc import Sequence

    from limo_driver.physics.effect import Effect, State
    from limo_driver.types import FloatArray, Motion


class EffectGroups:
    """The effects of a simulation of n joints by how they are evaluated.

    Args:
        effects: In the order of their memories.
        n: Number of joints.
    """

    def __init__(self, effects: Sequence[Effect], n: int) -> None:
        numbered = tuple(enumerate(effects))
        slipping = [
            (i, item)
            for i, item in numbered
            if isinstance(item, PreslidingHysteresis) and item.law == MAXWELL_SLIP
        ]
        elastic = [item for item in effects if isinstance(item, JointElasticity)]
        self.sensing = tuple((i, item) for i, item in numbered if isinstance(item, SensorEffect))
        self._frictions = Frictions.of([e for e in effects if isinstance(e, VelocityFriction)])
        self._slips = MaxwellSlips([item for _, item in slipping])
        self._slip_places = tuple(i for i, _ in slipping)
        self._compliances = np.zeros((2, n))  # [rad/(N m)], and cubic [rad/(N m)³]
        for item in elastic:
            self._compliances[:, item.joint - 1] += 1.0 / item.stiffness, item.cubic
        self.is_elastic = bool(elastic)
        self._offsets = np.zeros(n)  # [N m]
        for item in effects:
            if isinstance(item, TorqueOffset):
                self._offsets[item.joint - 1] += item.offset
        together = (BodyEffect, VelocityFriction, JointElasticity, SensorEffect, TorqueOffset)
        self.single = tuple(
            (i, item)
            for i, item in numbered
            if not isinstance(item, together) and i not in self._slip_places
        )

    def write_torques(self, torque: FloatArray, motion: Motion, memories: list[State]) -> None:
        """Write what acts together to `torque` (T, n) [N m], its new memories to the list."""
        torque[:] = self._offsets
        self._frictions.add(torque, motion.velocity)
        if places := self._slip_places:
            after = self._slips.add(torque, motion, [memories[i] for i in places])
            for i, memory in zip(places, after, strict=True):
                memories[i] = memory

    def wind_up(self, load: FloatArray) -> FloatArray:
        """Return how far the elastic joints wind up under a load (T, n) [N m], (T, n) [rad]."""
        return wind_up(load, self._compliances[0], self._compliances[1])
