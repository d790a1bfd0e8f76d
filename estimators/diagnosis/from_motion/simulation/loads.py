"""What loads each joint along recorded motion, for an arm that may differ from its description.

Differences that all joints feel: zeros and signs of encoders, and a body at one of the last links.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from itertools import pairwise
from typing import TYPE_CHECKING, Any, Final, NamedTuple

import numpy as np

from estimators.diagnosis.from_motion.simulation.constants import DELAY, GAIN, KV
from estimators.diagnosis.from_motion.simulation.free_run import commands_of
from estimators.diagnosis.from_motion.simulation.joint_step import draws
from estimators.diagnosis.from_motion.simulation.one_joint import LoadedJoint
from estimators.diagnosis.from_motion.simulation.plant import most_torque
from estimators.rigid_body.regressor import PER_LINK, RegressorChain
from limo_driver.recordings.bandwidth import bandwidth_for
from limo_driver.types import Motion

if TYPE_CHECKING:
    from collections.abc import Sequence

    from limo_driver.model import RobotModel
    from limo_driver.recordings.recording import Recording
    from limo_driver.types import FloatArray

_KEPT: Final = 6  # sets of zeros and signs
_FASTEST: Final = 200.0  # [Hz], which tells all that a fit asks for


@dataclass(frozen=True)
class ArmChange:
    """How an arm of n joints differs from its description."""

    zero: tuple[float, ...]  # (n,) [rad], encoder minus link
    sign: tuple[int, ...]  # (n,), of each encoder
    mass: float = 0.0  # [kg], at one link
    com: tuple[float, float, float] = (0.0, 0.0, 0.0)  # [m], of that mass, in the link's frame
    order: tuple[int, ...] = ()  # column of each link's recorded joint, 0-based; as told, if empty
    carrier: int | None = None  # link that carries that mass, 0-based; the last, if not given
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


class _Recorded(NamedTuple):
    """Rows of all recordings, one after the other, in an order of joints."""

    time: FloatArray  # (T,) [s]
    command: FloatArray  # (n, T) [rad]
    position: FloatArray  # (n, T) [rad]
    velocity: FloatArray  # (n, T) [rad/s]


class _Loaded(NamedTuple):
    """Loads of these rows at given zeros and signs."""

    load: FloatArray  # (n, T) [N m], without the joint's own acceleration
    inertia: FloatArray  # (n, T) [kg m²], about each joint, at zeros as described


class _Lever(NamedTuple):
    """What a body at a link adds to them, for each of its inertial parameters."""

    load: FloatArray  # (n, 10, T)
    inertia: FloatArray  # (n, 10, T)


_Order = tuple[int, ...]
_Key = tuple[tuple[float, ...], tuple[int, ...], _Order]  # zeros, signs and order
_Carried = tuple[tuple[float, ...], tuple[int, ...], _Order, int | None]  # and what carries a body


@dataclass
class ArmLoads:
    """The loads of an arm along recordings.

    With the stated constants of its drives, (n, columns), it has those of its supply, too.
    """

    body: RobotModel
    recordings: Sequence[Recording]
    stated: FloatArray | None = None
    fastest: float = _FASTEST  # [Hz]; every second row or fewer of faster recordings
    _recorded: dict[_Order, _Recorded] = field(init=False, default_factory=dict)
    _loaded: dict[_Key, _Loaded] = field(init=False, default_factory=dict)
    _levers: dict[_Carried, _Lever] = field(init=False, default_factory=dict)
    _drawn: dict[_Order, FloatArray] = field(init=False, default_factory=dict)

    def __post_init__(self) -> None:
        self._chain = RegressorChain.of(self.body)
        self._weightless = RegressorChain.of(self.body.with_gravity((0.0, 0.0, 0.0)))
        thinned = [max(1, round(r.rate / self.fastest)) for r in self.recordings]
        self._rows = [slice(None, None, every) for every in thinned]
        self._motions = [
            r.motion(bandwidth_for([r]))[rows]
            for r, rows in zip(self.recordings, self._rows, strict=True)
        ]
        ends = np.cumsum([motion.time.size for motion in self._motions]).tolist()
        self._each = [slice(*own) for own in pairwise([0, *ends])]  # rows of each recording
        self._stretches = [
            slice(own.start + first, own.start + stop)
            for recording, every, own in zip(self.recordings, thinned, self._each, strict=True)
            for part in recording.segments
            for first, stop in [(-(-(part.start or 0) // every), -(-part.stop // every))]
            if stop - first > 1
        ]

    @property
    def n(self) -> int:
        """Number of joints."""
        return self.body.n

    def parts(self, change: ArmChange) -> list[list[LoadedJoint]]:
        """Return the stretches of each joint of an arm that differs so."""
        recorded = self._in_order(change.order)
        load, inertia = self._loads(change)
        if change.mass != 0.0:
            more = [change.moments @ own for own in self._lever(change)]
            load, inertia = load + more[0], inertia + more[1]
        if any(sign < 0 for sign in change.sign):
            load = load * np.array(change.sign)[:, None]
        supply = self._supply(change)
        return [
            [
                LoadedJoint(
                    recorded.time[rows],
                    recorded.command[j, rows],
                    recorded.position[j, rows],
                    recorded.velocity[j, rows],
                    load[j, rows],
                    inertia[j, rows],
                    supply[rows],
                )
                for rows in self._stretches
            ]
            for j in range(self.n)
        ]

    def _in_order(self, order: _Order) -> _Recorded:
        """Return the rows of all recordings, whose joints are in an order."""
        if order not in self._recorded:
            columns = list(order or range(self.n))
            own = [
                (
                    motion.time,
                    commands_of(recording)[rows][:, columns].T,
                    recording.position[rows][:, columns].T,
                    motion.velocity[:, columns].T,
                )
                for recording, rows, motion in zip(
                    self.recordings, self._rows, self._motions, strict=True
                )
            ]
            self._recorded[order] = _Recorded(*(_in_a_row(x) for x in zip(*own, strict=True)))
        return self._recorded[order]

    def _loads(self, change: ArmChange) -> _Loaded:
        """Return the loads of all rows at the zeros and signs of an arm."""
        key = (change.zero, change.sign, change.order)
        if key not in self._loaded:
            _forget(self._loaded)
            known = None
            if any(change.zero):  # of the inertia, which depends little on zeros
                described = ArmChange((0.0,) * self.n, change.sign, order=change.order)
                known = self._loads(described).inertia
            own = [
                self._load(_linked(motion, change), None if known is None else known[:, rows].T)
                for motion, rows in zip(self._motions, self._each, strict=True)
            ]
            self._loaded[key] = _Loaded(*(_in_a_row(x) for x in zip(*own, strict=True)))
        return self._loaded[key]

    def _lever(self, change: ArmChange) -> _Lever:
        """Return what a body at a link adds, at the zeros and signs of an arm."""
        key = (change.zero, change.sign, change.order, change.carrier)
        if key not in self._levers:
            _forget(self._levers)
            link = change.carrier
            own = [self._lifted(_linked(motion, change), link) for motion in self._motions]
            self._levers[key] = _Lever(*(_in_a_row(x) for x in zip(*own, strict=True)))
        return self._levers[key]

    @property
    def shows_supply(self) -> bool:
        """Whether the stated drives say how far they are driven."""
        if self.stated is None:
            return False
        known = np.isfinite(most_torque(self.stated))
        known &= (self.stated[:, [KV, GAIN]] == 0.0).all(axis=1)
        return bool(known.all())

    def _supply(self, change: ArmChange) -> FloatArray:
        """Return the voltage over that without load, of all rows (T,), of one supply.

        What servos draw is that of the stated drives where the recorded joints were.
        """
        stated, order = self.stated, change.order
        if change.sag == 0.0 or stated is None:
            return np.ones(self._each[-1].stop)
        if order not in self._drawn:
            columns = list(order or range(self.n))
            own = [
                _drawn(motion, stated, r, rows, columns)
                for motion, r, rows in zip(self._motions, self.recordings, self._rows, strict=True)
            ]
            self._drawn[order] = _in_a_row(own)
        drawn, returned = self._drawn[order]
        return np.minimum((1 + change.sag * returned) / (1 + change.sag * drawn), 1.0)

    def _load(self, motion: Motion, inertia: FloatArray | None) -> tuple[FloatArray, FloatArray]:
        """Return loads and inertias of a motion, (n, T) each, by its inertia (T, n) if known."""
        position = motion.position
        load = self.body.inverse_dynamics(position, motion.velocity, motion.acceleration)
        if inertia is None:
            columns = [self.body.inertia_of(position, j)[:, j] for j in range(self.n)]
            inertia = np.stack(columns, axis=1)
        return (load - inertia * motion.acceleration).T, inertia.T

    def _lifted(self, motion: Motion, link: int | None) -> tuple[FloatArray, FloatArray]:
        """Return loads and inertias of each inertial parameter at a link, (n, 10, T)."""
        load, still = self._carried(self._chain, motion, link), np.zeros_like(motion.position)
        inertia = np.empty_like(load)
        for j in range(self.n):
            unit = still.copy()
            unit[:, j] = 1.0
            alone = Motion(motion.time, motion.position, still, unit)
            inertia[j] = self._carried(self._weightless, alone, link)[j]
        return load - inertia * motion.acceleration.T[:, None], inertia

    @staticmethod
    def _carried(chain: RegressorChain, motion: Motion, link: int | None) -> FloatArray:
        """Return the columns of a link, the last if none is given, (n, 10, T)."""
        first = PER_LINK * (chain.links - 1 if link is None else link)
        return np.moveaxis(chain.regressor(motion)[:, :, first : first + PER_LINK], 1, 2).copy()

    @property
    def carriers(self) -> tuple[int | None, ...]:
        """Links that may carry a body: the last, and that which it moves on, as jaws on a hand."""
        above = int(self.body.pin_tree.parents[self._chain.links]) - 1
        return (None,) if above < 0 else (None, above)


def loaded_joints(body: RobotModel, recordings: Sequence[Recording]) -> list[list[LoadedJoint]]:
    """Return the stretches of each joint of an arm as it is described, with all of their rows.

    Args:
        body: The rigid body.
        recordings: With commands.

    Returns:
        For each joint (0-based), its stretches without a gap.
    """
    return ArmLoads(body, recordings, fastest=np.inf).parts(ArmChange.none(body.n))


def as_described(recording: Recording, change: ArmChange) -> Recording:
    """Return a recording whose joints have the order and the signs of the description.

    Args:
        recording: With commands.
        change: How the arm that was recorded differs.
    """
    order, sign = list(change.order or range(recording.n)), np.array(change.sign)
    channels = tuple(recording.channels[j] for j in order)
    position, command = (
        values[:, order] * sign for values in (recording.position, commands_of(recording))
    )
    return replace(
        recording,
        position=position,
        command=command,
        channels=channels,
        velocity=None,
        extras={},
    )


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


def _in_a_row(parts: Sequence[FloatArray]) -> FloatArray:
    """Return the rows of all recordings, which are the last axis, one after the other."""
    return np.ascontiguousarray(np.concatenate(parts, axis=-1))


def _forget(known: dict[Any, Any]) -> None:
    """Make room for one more; loads as described stay."""
    if len(known) >= _KEPT:
        known.pop(next((key for key in known if any(key[0])), next(iter(known))))
