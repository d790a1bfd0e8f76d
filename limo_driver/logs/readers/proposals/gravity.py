"""What gravity says of the unit of torques, and columns that are odd."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Final

import numpy as np

from limo_driver.logs.readers.columns import UNITS
from limo_driver.model import RobotModel
from limo_driver.types import BoolArray, FloatArray

DECISIVE: Final = math.log(4.0)  # by which one reading has to explain the torques better
WITHIN: Final = 6.0  # factor that loads, friction and gains may make; units are 100 apart
_USUAL: Final = 0.99  # quantile of torques that is held against the limits of the drives
_EFFORT: Final = (1e-3, 3.0)  # of these limits, that the torque of some joint comes to
_TORQUE_SCALES: Final = {"N m": 1.0, "N cm": 1e2, "mN m": 1e3}
_ROWS: Final = 1500  # that are looked at
_FAR: Final = 5.0  # of the range of most values, by which corrupt ones lie beyond it
_MOST: Final = 0.5  # of the variance of a current beside its friction
_LEAST: Final = 1e-3  # of the largest deviation of a gravity torque; less is rounding
_OF_TORQUE: Final = 0.3  # of a joint's torque, that gravity has to make to say something of it
_ALL: Final = 0.9  # of it, where a load or friction is no reason for another size
_SURELY: Final = 3.0  # times less than gravity, that no load and no description makes it then
_NARROW: Final = 0.05  # of the usual span, below which a joint hardly moves beside the others
_ALIKE: Final = (0.2, 5.0)  # spans beside the usual one, of joints that move like the others
_JUMP: Final = 0.05  # of the logarithm of 57.3, by which a joint may move within a row
_LEAP: Final = 3.0  # times the longest of usual steps, that another unit makes
_QUANTILES: Final = (0.01, 0.99)
_BEYOND: Final = 1.5  # times what a drive can do, that no torque is
_ALIKE_RATED: Final = 0.3  # of the logarithm, by which parts of a rated torque fit the weight
_UNLIKE: Final = 2.0  # times worse, that N m fit it then
_SCALES: Final = (0.02, 50.0)  # of a unit, that motors and counters make
_SAME: Final = (0.9, 1.11)  # of a unit, within which it is that unit
_FAR_OFF: Final = (0.6, 1.7)  # of a unit, beyond which it is another for sure
_STEPS: Final = 100  # between these
_FEW: Final = 200  # rows by which units are scaled


@dataclass(frozen=True)
class Reading:
    """A unit for each joint, why, and what is open."""

    units: tuple[str, ...]
    why: str
    question: str = ""  # empty where one reading alone fits
    fits_both: bool = False  # all in rad as well as all in deg


class Gravity:
    """How well the gravity of an arm explains measured torques, for any reading of positions."""

    def __init__(
        self, model: RobotModel, torque: FloatArray | None, unit: float | None = None
    ) -> None:
        self.model, self._unit = model, unit
        self.torque = None if model.massless else torque
        # loads may add to what gravity makes of a torque in a known unit, though not tenfold; it
        # may well be less, where it was measured before the gear
        self._most = math.inf if unit is None else WITHIN / unit

    def of_rows(self, rows: slice) -> Gravity:
        """Return the same of some of the rows."""
        torque = None if self.torque is None else self.torque[rows]
        return Gravity(self.model, torque, self._unit)

    def of(self, position: FloatArray, units: tuple[str, ...]) -> float:
        """Return the sum over joints of log(torque that gravity leaves / torque)."""
        if self.torque is None:
            return 0.0
        slides = self.model.sliding
        scale = np.where(slides, 1.0, [UNITS["position"][unit] for unit in units])
        load = self.model.gravity_torque(position * scale)
        left = 0.0
        for own, gravity, angle in zip(self.torque.T, load.T, position.T, strict=True):
            total = float(np.var(own))
            if total > 0 and np.isfinite(own).all():
                rest = own - _fit(own, gravity, angle, self._most)
                left += 0.5 * math.log(max(float(np.var(rest)) / total, 1e-6))
        return left

    def as_mounted(self, position: FloatArray, units: tuple[str, ...]) -> Gravity:
        """Return this, or that of the base on its side, which explains torques decidedly better.

        Descriptions stand upright; the arms of many hang on a wall, or beside a body.
        """
        if self.torque is None:
            return self
        _, *models = mountings(self.model)
        turned = [Gravity(model, self.torque, self._unit) for model in models]
        best = min(turned, key=lambda item: item.of(position, units))
        is_better = best.of(position, units) < self.of(position, units) - DECISIVE
        return best if is_better else self

    def slopes(self, position: FloatArray, least: float = _OF_TORQUE) -> FloatArray:
        """Return torque over gravity of the joints whose torque is gravity, to a part at least."""
        if self.torque is None:
            return np.zeros(0)
        found: list[float] = []
        for own, load in zip(self.torque.T, self.model.gravity_torque(position).T, strict=True):
            energy = float(np.var(load))
            if energy <= 0 or not np.var(own) > 0:
                continue
            slope = float(np.mean((own - own.mean()) * (load - load.mean()))) / energy
            if slope**2 * energy > least**2 * float(np.var(own)):
                found.append(abs(slope))
        return np.array(found)

    def factors(self, position: FloatArray) -> FloatArray:
        """Return how many N m one unit makes at each joint, (n,); NaN where gravity does not say.

        Beside an offset and dry friction, gravity has to make most of what is left.

        Args:
            position: (T, n) [rad, m].
        """
        found = np.full(self.model.n, math.nan)
        if self.torque is None:
            return found
        load = self.model.gravity_torque(position)
        least = _LEAST**2 * float(np.var(load, axis=0).max())
        every = zip(self.torque.T, load.T, position.T, strict=True)
        for j, (own, gravity, angle) in enumerate(every):
            if not np.isfinite(own).all():
                continue
            A = np.column_stack([np.ones(own.size), np.sign(np.gradient(angle))])
            torque, weight = (x - A @ np.linalg.lstsq(A, x)[0] for x in (own, gravity))
            energy, together = float(weight @ weight), float(weight @ torque)
            if energy < least * own.size:
                continue
            if together**2 > _MOST * energy * float(torque @ torque):
                found[j] = energy / together
        return found


def mountings(model: RobotModel) -> Iterator[RobotModel]:
    """Yield a robot as it is described, and with gravity along each axis of its base."""
    yield model
    size = float(np.linalg.norm(model.gravity))
    for axis in np.eye(3):  # the other direction is the same with the other sign, which is fitted
        yield model.with_gravity((size * axis).tolist())


def _fit(
    torque: FloatArray, gravity: FloatArray, position: FloatArray, most: float = math.inf
) -> FloatArray:
    """Return what gravity, an offset and dry friction make of a torque, (T,).

    Args:
        torque: In any unit, (T,).
        gravity: [N m], (T,).
        position: In any unit, (T,).
        most: By which gravity may be scaled.
    """
    A = np.column_stack([np.ones(torque.size), np.sign(np.gradient(position)), gravity])
    x = np.linalg.lstsq(A, torque)[0]
    if abs(x[2]) <= most:
        return A @ x
    own = math.copysign(most, x[2]) * gravity
    return own + A[:, :2] @ np.linalg.lstsq(A[:, :2], torque - own)[0]


def usual(values: FloatArray) -> np.ndarray:
    """Mark rows whose values are numbers, and none far beyond those of the others, (T,).

    Columns without any number say nothing of a row.
    """
    values = np.where(np.isfinite(values), values, np.nan)
    values = values[:, np.isfinite(values).any(axis=0)]
    low, high = np.nanquantile(values, (0.01, 0.99), axis=0)
    reach = _FAR * (high - low) + 1e-9
    return ((values >= low - reach) & (values <= high + reach)).all(axis=1)


def some_rows(position: FloatArray, torque: FloatArray | None) -> np.ndarray:
    """Return some of the usual rows, spread over the log, (k,)."""
    known = usual(position)
    if torque is not None and (known & (whole := usual(torque))).any():
        known &= whole
    rows = np.flatnonzero(known)
    return rows[:: max(1, rows.size // _ROWS)]


def maybe_in_radians(position: FloatArray, turning: BoolArray, fits: BoolArray) -> tuple[int, ...]:
    """Return joints that hardly move in degrees, and move like the others in radians (0-based).

    A joint that turns a tool about its own axis feels no gravity: 2 may be degrees or radians.

    Args:
        position: All in degrees, (T, n).
        turning: Joints that turn, (n,).
        fits: Whether the values of each joint are within its limits in radians, (n,).
    """
    low, high = np.nanquantile(position, _QUANTILES, axis=0)
    span = high - low
    asked = list[int]()
    for j in np.flatnonzero(turning & fits).tolist():
        others = turning & (np.arange(span.size) != j)
        usual = float(np.median(span[others])) if others.any() else 0.0
        in_degrees, in_radians = float(span[j]), math.degrees(float(span[j]))
        if in_degrees < _NARROW * usual and _ALIKE[0] * usual < in_radians < _ALIKE[1] * usual:
            asked.append(j)
    return tuple(asked)


def other_unit_from(position: FloatArray) -> int | None:
    """Return the row from which positions (T, n) go on in degrees or in radians, if they do.

    There, all joints that are away from zero are multiplied or divided by 57.3 at once. Of values
    that jump no farther than they often do, as noise about zero, no ratio says anything.
    """
    steps = np.abs(np.diff(position, axis=0))
    if not len(steps):
        return None
    with np.errstate(divide="ignore", invalid="ignore"):
        ratio = np.abs(np.log(np.abs(position[1:] / position[:-1])))
    jumps = np.abs(ratio - math.log(1 / UNITS["position"]["deg"])) < _JUMP
    jumps &= steps > _LEAP * np.nanquantile(steps, 0.99, axis=0)
    rows = np.flatnonzero(jumps.sum(axis=1) > position.shape[1] / 2)
    return int(rows[0]) + 1 if rows.size else None


def torque_reading(position: FloatArray, torque: FloatArray, model: RobotModel) -> Reading:
    """Say in which unit torques are, and forces of slides, from the gravity of the arm.

    Args:
        position: (T, n) [rad, m].
        torque: (T, n) as the log has it.
        model: The robot.
    """
    rows = some_rows(position, torque)
    cost = Gravity(model, torque[rows])
    slopes = cost.slopes(position[rows])
    if not slopes.size:
        slopes = cost.as_mounted(position[rows], ("rad",) * model.n).slopes(position[rows])
    if not slopes.size:
        return _by_effort(torque[rows], model)
    middle, sure = float(np.median(slopes)), cost.slopes(position[rows], _ALL)
    is_less = sure.size > 1 and float(np.median(sure)) < 1 / _SURELY
    for unit, scale in _TORQUE_SCALES.items():
        if 1 / WITHIN < middle / scale < WITHIN and not is_less:
            why = f"{middle / scale:.2g} times the gravity torque of the arm"
            question = (
                f"torque: no name says {unit}, and in N m it is {middle:.2g} times the gravity "
                f"torque of the arm: is it in {unit}, or a current?"
            )
            if unit == "N m":
                question = _of_rated(cost.factors(position[rows]), torque[rows], model)
            return Reading(_of_joints(unit, model), why, question)
    return Reading(
        _of_joints("N m", model),
        f"{middle:.2g} times the gravity torque of the arm",
        f"torque: it is {middle:.2g} times the gravity torque of the arm in N m: which "
        "unit, or a current (`unit: A`)?",
    )


def _of_rated(factors: FloatArray, torque: FloatArray, model: RobotModel) -> str:
    """Return a question where torques (T, n) may be parts of what each drive is rated for.

    Args:
        factors: How many N m one unit makes by the weight of the bodies, (n,); NaN where unknown.
        torque: As the log has it.
        model: The robot.
    """
    limit = model.limits.torque
    rated = np.where(np.isfinite(limit) & (limit > 0) & ~np.array(model.sliding), limit, math.nan)
    known = np.isfinite(factors) & np.isfinite(rated) & (factors != 0)
    weight = np.log(np.abs(factors[known]))
    spread = float(np.std(weight - np.log(rated[known]))) if known.sum() > 1 else math.inf
    columns = [np.abs(own[np.isfinite(own)]) for own in torque.T]
    part = np.array([np.quantile(own, _USUAL) if own.size else 0.0 for own in columns]) / rated
    most = float(np.max(part, where=np.isfinite(part), initial=0.0))
    if spread < _ALIKE_RATED and float(np.std(weight)) > _UNLIKE * _ALIKE_RATED:
        why = "the weight of its bodies makes the same part of what each drive can do, and no N m"
    elif most > _BEYOND:
        why = f"joint {int(np.nanargmax(part)) + 1} would have {most:.2g} times what its drive can"
    else:
        return ""
    return (
        f"torque: no name says N m, and {why}: is it in N m, a current (`unit: A`), or in % or ‰ "
        "of the rated torque (`unit: '%'`, with `factor:` in N m for each of them)?"
    )


def gear_question(position: FloatArray, units: tuple[str, ...], cost: Gravity) -> str:
    """Return a question where another scale of positions explains the torques far better.

    Motors turn as often as their gears say, and encoders count: degrees and radians fit then, but
    fit badly.

    Args:
        position: As the log has them, (T, n).
        units: In which they are read.
        cost: Of the torques in these rows.
    """
    scales, more = _scaled(position, units, cost.as_mounted(position, units))
    best = int(np.argmin(more))
    if more[best] > -DECISIVE or _SAME[0] < scales[best] < _SAME[1]:
        return ""
    return (
        f"position: {scales[best]:.3g} times as far, the torques would be far more those of the "
        "weight: are these turns or degrees of motors, or counts (`factor:`, one over the gear's "
        "ratio), and from which zero (`zero:`)?"
    )


def is_singled_out(position: FloatArray, units: tuple[str, ...], cost: Gravity) -> bool:
    """Say whether positions in units explain the torques better than any other scale.

    From a wrong zero, no scale does. Arguments as of `gear_question`.
    """
    scales, more = _scaled(position, units, cost.as_mounted(position, units))
    far = (scales < _FAR_OFF[0]) | (scales > _FAR_OFF[1])
    is_best = _SAME[0] < scales[int(np.argmin(more))] < _SAME[1]
    return is_best and bool(more[far].min() > DECISIVE)


def _scaled(
    position: FloatArray, units: tuple[str, ...], cost: Gravity
) -> tuple[FloatArray, FloatArray]:
    """Return scales of positions, and how much more than as read gravity leaves of the torques."""
    every = slice(None, None, max(1, len(position) // _FEW))
    few, position = cost.of_rows(every), position[every]
    scales = np.geomspace(*_SCALES, _STEPS)
    turns = ~np.array(cost.model.sliding)
    left = [few.of(position * np.where(turns, scale, 1.0), units) for scale in scales.tolist()]
    return scales, np.array(left) - few.of(position, units)


def _by_effort(torque: FloatArray, model: RobotModel) -> Reading:
    """Return N m for torques (T, n) that the drives can make; with a question for others."""
    units, limit = _of_joints("N m", model), model.limits.torque
    part = np.nanquantile(np.abs(torque), _USUAL, axis=0) / np.where(
        (limit > 0) & np.isfinite(limit), limit, math.nan
    )
    known = part[np.isfinite(part)]
    if known.size and not _EFFORT[0] < known.max() < _EFFORT[1]:
        return Reading(
            units,
            f"{known.max():.2g} times the largest torque of the drives",
            f"torque: no name says its unit, and in N m it is {known.max():.2g} times what the "
            "drives of the description can do: which unit?",
        )
    why = "assumed: gravity makes too little of it to tell"
    return Reading(units, f"{why}, and the drives can do it" if known.size else why)


def current_factors(position: FloatArray, current: FloatArray, model: RobotModel) -> FloatArray:
    """Return the N m that one unit of current makes at each joint, (n,); NaN where none shows.

    Args:
        position: (T, n) [rad, m].
        current: (T, n) as the log has it.
        model: The robot, whose bodies set the scale.
    """
    rows = some_rows(position, current)
    return Gravity(model, current[rows]).factors(position[rows])


def _of_joints(unit: str, model: RobotModel) -> tuple[str, ...]:
    """Return the unit of each joint, or the one that all have: a torque of a slide is a force."""
    units = tuple("N" if slides and unit == "N m" else unit for slides in model.sliding)
    return units if len(set(units)) > 1 else units[:1]
