"""What loads each joint along recorded motion, for an arm that may differ from its description.

Differences that all joints feel: zeros and signs of encoders, and a body at the last link.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from estimators.drives.simulation.columns import DELAY
from estimators.drives.simulation.free_run import commands_of
from estimators.drives.simulation.joint_step import draws
from estimators.drives.simulation.one_joint import LoadedJoint
from estimators.drives.simulation.plant import most_torque
from estimators.rigid_body.regressor import PER_LINK, RegressorChain
from limo_driver.recordings.bandwidth import bandwidth_for
from limo_driver.types import Motion

if TYPE_CHECKING:
    from collections.abc import Sequence

    from limo_driver.model import RobotModel
    from limo_driver.recordings.recording import Recording
    from limo_driver.types import FloatArray

_KEPT: Final = 6  # sets of zeros and signs
_FASTEST: Final = 200.0  # [Hz]; every second row or fewer of faster recordings


@dataclass(frozen=True)
class ArmChange:
    """How an arm of n joints differs from its description."""

    zero: tuple[float, ...]  # (n,) [rad], encoder minus link
    sign: tuple[int, ...]  # (n,), of each encoder
    mass: float = 0.0  # [kg], at the last link
    com: tuple[float, float, float] = (0.0, 0.0, 0.0)  # [m], of that mass, in the link's frame
    order: tuple[int, ...] = ()  # column of each link's recorded joint, 0-based; as told, if empty
    sag: float = 0.0  # resistance of the supply over that of a motor's winding

    @classmethod
    def none(cls, n: int) -> ArmChange:
        """Return an arm as it is described."""
        return cls((0.0,) * n, (1,) * n)

    def value(self, name: str) -> float:
        """Return one of `zero_1` to `zero_n`, `mass`, `com_x`, `com_y`, `com_z` and `sag`."""
        if name in {"mass", "sag"}:
            return getattr(self, name)
        kind, _, which = name.partition("_")
        return self.com["xyz".index(which)] if kind == "com" else self.zero[int(which) - 1]

    def with_value(self, name: str, value: float) -> ArmChange:
        """Return the same with another value of one of them."""
        if name in {"mass", "sag"}:
            return replace(self, **{name: value})
        kind, _, which = name.partition("_")
        if kind == "com":
            x, y, z = (
                value if axis == which else old for axis, old in zip("xyz", self.com, strict=True)
            )
            return replace(self, com=(x, y, z))
        k = int(which) - 1
        return replace(self, zero=(*self.zero[:k], value, *self.zero[k + 1 :]))

    @property
    def moments(self) -> FloatArray:
        """Inertial parameters of the mass, as a point, (10,)."""
        c = np.array(self.com)
        xx, xy, yy, xz, yz, zz = (c @ c * np.eye(3) - np.outer(c, c))[
            (0, 0, 1, 0, 1, 2), (0, 1, 1, 2, 2, 2)
        ]
        return self.mass * np.array([1.0, *c, xx, xy, yy, xz, yz, zz])


@dataclass(frozen=True)
class _Loaded:
    """Loads of one recording at given zeros and signs."""

    load: FloatArray  # (T, n) [N m], without the joint's own acceleration
    inertia: FloatArray  # (T, n) [kg m²], about each joint, at zeros as described


@dataclass(frozen=True)
class _Lever:
    """What a body at the last link adds to them, for each of its inertial parameters."""

    load: FloatArray  # (T, n, 10)
    inertia: FloatArray  # (T, n, 10)


_Key = tuple[tuple[float, ...], tuple[int, ...], tuple[int, ...]]  # zeros, signs and order


@dataclass
class ArmLoads:
    """The loads of an arm along recordings.

    With the stated constants of its drives, (n, columns), it has those of its supply, too.
    """

    body: RobotModel
    recordings: Sequence[Recording]
    stated: FloatArray | None = None
    _loaded: dict[_Key, list[_Loaded]] = field(init=False, default_factory=dict)
    _levers: dict[_Key, list[_Lever]] = field(init=False, default_factory=dict)
    _drawn: dict[tuple[int, ...], list[FloatArray]] = field(init=False, default_factory=dict)

    def __post_init__(self) -> None:
        self._chain = RegressorChain.of(self.body)
        self._weightless = RegressorChain.of(self.body.with_gravity((0.0, 0.0, 0.0)))
        thinned = [max(1, round(r.rate / _FASTEST)) for r in self.recordings]
        self._rows = [slice(None, None, every) for every in thinned]
        self._motions = [
            _thinned(r.motion(bandwidth_for([r])), rows)
            for r, rows in zip(self.recordings, self._rows, strict=True)
        ]

    @property
    def n(self) -> int:
        """Number of joints."""
        return self.body.n

    def parts(self, change: ArmChange) -> list[list[LoadedJoint]]:
        """Return the stretches of each joint of an arm that differs so."""
        key = (change.zero, change.sign, change.order)
        linked = [_linked(motion, change) for motion in self._motions]
        if key not in self._loaded:
            _forget(self._loaded)
            described = ArmChange((0.0,) * self.n, change.sign, order=change.order)
            if any(change.zero):
                self.parts(described)  # for the inertia, which depends little on zeros
            known = self._loaded.get((described.zero, described.sign, change.order))
            self._loaded[key] = [
                self._load(motion, None if known is None else known[k].inertia)
                for k, motion in enumerate(linked)
            ]
        if change.mass != 0.0 and key not in self._levers:
            _forget(self._levers)
            self._levers[key] = [self._lever(motion) for motion in linked]
        found: list[list[LoadedJoint]] = [[] for _ in range(self.n)]
        order = list(change.order or range(self.n))
        for k, (recording, rows) in enumerate(zip(self.recordings, self._rows, strict=True)):
            load, inertia = self._loaded[key][k].load, self._loaded[key][k].inertia
            if change.mass != 0.0:
                load = load + self._levers[key][k].load @ change.moments
                inertia = inertia + self._levers[key][k].inertia @ change.moments
            load = load * np.array(change.sign)
            arrays = (
                commands_of(recording)[rows][:, order],
                recording.position[rows][:, order],
                self._motions[k].velocity[:, order],
                load,
                inertia,
                self._supply(k, change),
            )
            time, step = recording.time[rows], int(rows.step or 1)
            for part in recording.segments:
                own = slice(-(-(part.start or 0) // step), -(-part.stop // step))
                if own.stop - own.start > 1:
                    for j in range(self.n):
                        columns = (np.ascontiguousarray(x[own, j]) for x in arrays)
                        found[j].append(LoadedJoint(time[own], *columns))
        return found

    @property
    def shows_supply(self) -> bool:
        """Whether the stated drives say how far they are driven."""
        return self.stated is not None and bool(np.isfinite(most_torque(self.stated)).all())

    def _supply(self, k: int, change: ArmChange) -> FloatArray:
        """Return the voltage of a recording over that without load, (T, n), of one supply.

        What servos draw is that of the stated drives where the recorded joints were.
        """
        motion, stated = self._motions[k], self.stated
        if change.sag == 0.0 or stated is None:
            return np.ones_like(motion.position)
        if change.order not in self._drawn:
            self._drawn[change.order] = [
                _drawn(own, stated, r, rows, list(change.order or range(self.n)))
                for own, r, rows in zip(self._motions, self.recordings, self._rows, strict=True)
            ]
        drawn, returned = self._drawn[change.order][k]
        supply = np.minimum((1 + change.sag * returned) / (1 + change.sag * drawn), 1.0)
        return np.tile(supply[:, None], self.n)

    def _load(self, motion: Motion, inertia: FloatArray | None) -> _Loaded:
        position = motion.position
        load = self.body.inverse_dynamics(position, motion.velocity, motion.acceleration)
        if inertia is None:
            columns = [self.body.inertia_of(position, j)[:, j] for j in range(self.n)]
            inertia = np.stack(columns, axis=1)
        return _Loaded(load - inertia * motion.acceleration, inertia)

    def _lever(self, motion: Motion) -> _Lever:
        load, still = self._last(self._chain, motion), np.zeros_like(motion.position)
        inertia = np.empty_like(load)
        for j in range(self.n):
            unit = still.copy()
            unit[:, j] = 1.0
            alone = Motion(motion.time, motion.position, still, unit)
            inertia[:, j] = self._last(self._weightless, alone)[:, j]
        return _Lever(load - inertia * motion.acceleration[:, :, None], inertia)

    @staticmethod
    def _last(chain: RegressorChain, motion: Motion) -> FloatArray:
        """Return the columns of the last link, (T, n, 10)."""
        return np.swapaxes(chain.regressor(motion)[:, :, -PER_LINK:], 0, 1).copy()


def as_described(recording: Recording, change: ArmChange) -> Recording:
    """Return a recording whose joints have the order and the signs of the description.

    Args:
        recording: With commands.
        change: How the arm that was recorded differs.
    """
    order, sign = list(change.order or range(recording.n)), np.array(change.sign)
    position, command = (
        values[:, order] * sign for values in (recording.position, commands_of(recording))
    )
    return replace(recording, position=position, command=command, velocity=None, extras={})


def _linked(motion: Motion, change: ArmChange) -> Motion:
    """Return how the links moved."""
    sign, order = np.array(change.sign, dtype=float), list(change.order or range(len(change.sign)))
    return Motion(
        motion.time,
        (motion.position[:, order] - np.array(change.zero)) * sign,
        motion.velocity[:, order] * sign,
        motion.acceleration[:, order] * sign,
    )


def _drawn(
    motion: Motion, stated: FloatArray, recording: Recording, rows: slice, order: list[int]
) -> FloatArray:
    """Return what all servos draw by voltage, and what their back-EMF saves, (2, T)."""
    command = np.stack(
        [
            commands_of(recording)[
                np.maximum(
                    np.searchsorted(recording.time, motion.time - row[DELAY], "right") - 1, 0
                ),
                column,
            ]
            for row, column in zip(stated, order, strict=True)
        ],
        axis=1,
    )
    error = command - recording.position[rows][:, order]
    total = np.zeros((2, motion.time.size))
    for j, row in enumerate(stated):
        total += draws(row, error[:, j], np.ascontiguousarray(motion.velocity[:, order[j]]))
    return np.stack([total[0], np.maximum(total[1], 0.0)])


def _forget(known: dict[_Key, Any]) -> None:
    """Make room for one more; loads as described stay."""
    if len(known) >= _KEPT:
        known.pop(next((key for key in known if any(key[0])), next(iter(known))))


def _thinned(motion: Motion, rows: slice) -> Motion:
    return Motion(
        motion.time[rows], motion.position[rows], motion.velocity[rows], motion.acceleration[rows]
    )
