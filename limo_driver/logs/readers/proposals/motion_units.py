"""Units that no name says: what limits, gravity and velocities of an arm make of each reading."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from limo_driver.logs.readers.columns import UNITS
from limo_driver.logs.readers.proposals.gravity import (
    DECISIVE,
    Gravity,
    Reading,
    gear_question,
    is_singled_out,
    maybe_in_radians,
    some_rows,
    usual,
)
from limo_driver.logs.readers.proposals.slides import slide_units
from limo_driver.model import RobotModel
from limo_driver.recordings.gate.held_values import factors_by_joint, one_factor
from limo_driver.types import FloatArray

MARGIN: Final = 0.5  # [rad] beyond the limits of a description that a joint may well go
_REST: Final = 0.1  # [rad], beyond which no noise of an encoder goes
_FEWEST_ROWS: Final = 10
ALIKE: Final = (0.6, 1.6)  # velocity over rate of change of position, in the right unit
_SAME: Final = 0.1  # by which a velocity differs from the rate of change, on the right clock
_RESTS: Final = 0.01  # of the widest range of all joints, below which one rests beside it
_SWEEP: Final = 0.1  # [s], over which a speed is the mean: of close samples it is all noise
_SHARED: Final = 0.25  # of a step, that one next to it makes where it is part of a motion
_FASTER: Final = 2.0  # times the velocity limit of a description that no joint goes


class _BySpeed(NamedTuple):
    """The unit that a speed leaves for positions, and why."""

    unit: str
    why: str
    is_rate: bool = False  # whether velocities are these positions' own rate of change


@dataclass(frozen=True)
class Beside:
    """What a log has beside positions of which it does not say the unit.

    Args:
        torque: (T, n), where it is measured.
        torque_unit: In N m; None where that is not known.
        time: (T,) [s], where its unit is known.
        velocity: (T, n) [rad/s], where their unit is stated.
    """

    torque: FloatArray | None = None
    torque_unit: float | None = None
    time: FloatArray | None = None
    velocity: FloatArray | None = None


def position_reading(position: FloatArray, more: Beside, model: RobotModel) -> Reading:
    """Say whether positions are in radians or degrees, joint by joint; or in m or mm, of slides.

    Args:
        position: (T, n) as the log has them, each with sign and zero of the robot.
        more: What else the log has.
        model: The robot.
    """
    by_speed, torque = _unit_by_speed(position, more, model), more.torque
    slides = slide_units(position, more.time, more.velocity, model)
    rests_at_zero = _is_noise_about_zero(position[:, ~np.array(model.sliding)])
    rows = some_rows(position, torque)
    position = position[rows]
    torque = None if torque is None else torque[rows]
    if all(slides.units):
        return Reading(slides.units, "within the limits of all slides", slides.question)
    # as if in rad: nothing else is open of joints that slide
    position = position * [UNITS["position"].get(unit, 1.0) for unit in slides.units]
    cost = Gravity(model, torque, more.torque_unit)
    found = _turns(position, cost, by_speed)
    if found.fits_both and (mounted := cost.as_mounted(position, found.units)) is not cost:
        found = _turns(position, mounted, by_speed)
    if found.question and rests_at_zero:  # the same pose in either unit
        found = Reading(("rad",) * model.n, "taken for rad: noise about zero says nothing of it")
    elif not found.question and not (by_speed and by_speed.is_rate):
        found = replace(found, question=gear_question(position, found.units, cost))
    units = tuple(own or unit for own, unit in zip(slides.units, found.units, strict=True))
    asked = "; ".join(filter(None, (found.question, slides.question)))
    return replace(
        found, units=units, question=asked, fits_both=found.fits_both and not slides.question
    )


def _is_noise_about_zero(position: FloatArray) -> bool:
    """Say whether positions (T, k) stay at zero, but for noise from one row to the next."""
    known = position[np.isfinite(position).all(axis=1)]
    if len(known) < _FEWEST_ROWS or np.abs(known).max(initial=0.0) > _REST:
        return False
    spread = known.std(axis=0)
    noise = np.diff(known, axis=0).std(axis=0) / math.sqrt(2.0)
    return bool((spread <= 2.0 * noise).all() and (np.abs(known.mean(axis=0)) <= spread).all())


def _unit_by_speed(position: FloatArray, beside: Beside, model: RobotModel) -> _BySpeed | None:
    """Return the unit that velocities, or limits of them, leave for positions (T, n), and why.

    A joint whose velocity limit would be far exceeded in rad is in deg. No slow motion says the
    opposite: the speed of a joint has no lower limit.
    """
    turns = np.flatnonzero(~np.array(model.sliding))
    if beside.time is None or not turns.size:
        return None
    rows = np.append(True, np.diff(beside.time) > 0) & usual(position) & np.isfinite(beside.time)
    time, position = beside.time[rows], position[rows][:, turns]
    if time.size < _FEWEST_ROWS:
        return None
    found = None
    if beside.velocity is not None:
        found = _unit_of_velocities(time, position, beside.velocity[rows][:, turns])
    if found is None and model.description.kind != "MJCF":  # which has no limits of velocity
        found = _too_fast_in_rad(time, position, turns, model)
    return found


def _unit_of_velocities(
    time: FloatArray, position: FloatArray, velocity: FloatArray
) -> _BySpeed | None:
    """Return the unit of positions (T, k) whose rate of change velocities [rad/s] are."""
    factors = _factors(time, position, velocity)
    middle = _middle(factors[factors > 0])
    for unit in ("rad", "deg"):
        ratio = middle / UNITS["position"][unit]
        if ALIKE[0] < ratio < ALIKE[1]:
            why = f"the velocities are {ratio:.3g} times their rate of change in {unit}"
            return _BySpeed(unit, why, is_rate=True)
    return None


def _too_fast_in_rad(
    time: FloatArray, position: FloatArray, turns: NDArray[np.intp], model: RobotModel
) -> _BySpeed | None:
    """Return degrees where positions (T, k) of joints `turns` move too fast for radians."""
    every = max(1, round(_SWEEP / float(np.median(np.diff(time)))))
    time, position = time[::every], _without_jumps(position)[::every]
    if time.size < _FEWEST_ROWS:
        return None
    speeds = np.abs(np.diff(position, axis=0)) / np.diff(time)[:, None]
    for j, speed in zip(turns.tolist(), np.quantile(speeds, 0.98, axis=0).tolist(), strict=True):
        limit = float(model.limits.velocity[j])
        if 0 < _FASTER * limit < speed:
            why = f"in rad, joint {j + 1} would move at {speed:.3g} of {limit:.3g} rad/s"
            return _BySpeed("deg", why)
    return None


def _without_jumps(position: FloatArray) -> FloatArray:
    """Return positions (T, k) without steps that none next to them shares: no speed makes these."""
    steps = np.diff(position, axis=0)
    size, way = np.abs(steps), np.sign(steps)
    none = np.zeros_like(steps[:1])
    before, after = np.vstack([none, steps[:-1]]), np.vstack([steps[1:], none])
    shared = np.maximum(before * way, after * way) > _SHARED * size
    return np.vstack([position[:1], position[:1] + np.cumsum(np.where(shared, steps, 0.0), axis=0)])


def _turns(position: FloatArray, cost: Gravity, by_speed: _BySpeed | None) -> Reading:
    """Say whether positions (T, n) of the joints that turn are in radians or degrees."""
    model = cost.model
    n, slides = model.n, np.array(model.sliding)
    possible = {
        unit: _possible(position * UNITS["position"][unit], model) | slides
        for unit in ("rad", "deg")
    }
    uniform = [unit for unit, fits in possible.items() if fits.all()]
    if len(uniform) == 1:
        unit = uniform[0]
        other = "deg" if unit == "rad" else "rad"
        j = int(np.flatnonzero(~possible[other])[0])
        why = f"beyond the limits of joint {j + 1} in {other}, within all limits in {unit}"
        found = _unless_mixed(position, (unit,) * n, why, possible, cost)
        if unit == "deg" and not found.question and not _says_deg(position, cost, by_speed):
            found = replace(
                found,
                question=f"position: are the columns in rad or deg? limits alone say deg ({why}), "
                "which a description may have wrong, and motors turn as far (`factor:`)",
            )
        return found
    if len(uniform) > 1:
        rad, deg = (cost.of(position, (unit,) * n) for unit in ("rad", "deg"))
        decided = abs(rad - deg) >= DECISIVE
        unit, other = ("rad", "deg") if rad < deg else ("deg", "rad")
        if by_speed is not None and not (decided and by_speed.unit == other):
            return _unless_mixed(position, (by_speed.unit,) * n, by_speed.why, possible, cost)
        if by_speed is not None:
            why = f"the torques are those of positions in {unit}"
            asked = f"the torques fit {unit}, but {by_speed.why}"
            return Reading((unit,) * n, why, f"position: are the columns in rad or deg? {asked}")
        if not decided:
            told, fitted = "the torques fit both", "limits and torques"
            if cost.torque is None:
                told, fitted = "no torque says which", "the limits, and no torque says which"
            return Reading(
                ("rad",) * n,
                f"in rad and in deg within the limits, and {told}",
                f"position: are the columns in rad or deg? both fit {fitted}",
                fits_both=True,
            )
        return _unless_mixed(
            position, (unit,) * n, f"the torques are those of positions in {unit}", possible, cost
        )
    return _one_by_one(position, possible, cost)


def _one_by_one(position: FloatArray, possible: dict[str, np.ndarray], cost: Gravity) -> Reading:
    """Return the unit of each joint where no unit fits all; with a question where none fits one."""
    units = tuple("rad" if fits else "deg" for fits in possible["rad"])
    why = "within the limits one by one only"
    if beyond := (np.flatnonzero(~(possible["rad"] | possible["deg"])) + 1).tolist():
        asked = (
            f"position: in deg, too, the columns of joints {', '.join(map(str, beyond))} go beyond "
            "the limits: of which unit or motor are they (`unit:`, `factor:`, `zero:`)?"
        )
        return Reading(units, why, asked)
    return _unless_mixed(position, units, why, possible, cost)


def _says_deg(position: FloatArray, cost: Gravity, by_speed: _BySpeed | None) -> bool:
    """Say whether more than limits says that positions (T, n) are in degrees."""
    if by_speed is not None and by_speed.is_rate:
        return by_speed.unit == "deg"
    if cost.torque is not None:
        return is_singled_out(position, ("deg",) * cost.model.n, cost)
    return by_speed is not None and by_speed.unit == "deg"


def _unless_mixed(
    position: FloatArray,
    units: tuple[str, ...],
    why: str,
    possible: dict[str, np.ndarray],
    cost: Gravity,
) -> Reading:
    """Return a reading; with a question where single joints decidedly fit other units."""
    apart = tuple("rad" if fits else "deg" for fits in possible["rad"])
    best, least = _flipped(position, units, possible, cost)
    other, its = _flipped(position, apart, possible, cost)
    mixed = _differ(best, cost.model)  # then those of which nothing tells are as likely in rad
    if its < least + (DECISIVE if mixed else -DECISIVE):
        best = other
    if not _differ(best, cost.model):
        return Reading(best, why, _about_narrow(position, best, possible["rad"], cost))
    slides = cost.model.sliding
    in_degrees = [j + 1 for j, unit in enumerate(best) if unit == "deg" and not slides[j]]
    listed = ", ".join(map(str, in_degrees))
    return Reading(
        best,
        f"joints {listed} read as degrees, the others as radians",
        f"position: the columns of joints {listed} fit degrees only, others radians: is that so?",
    )


def _about_narrow(
    position: FloatArray, units: tuple[str, ...], fits: np.ndarray, cost: Gravity
) -> str:
    """Return a question about joints that may be in radians where all others are in degrees."""
    if "deg" not in units:
        return ""
    narrow = maybe_in_radians(position, ~np.array(cost.model.sliding), fits)
    least = cost.of(position, units)
    open_still = [
        j + 1
        for j in narrow
        if cost.of(position, (*units[:j], "rad", *units[j + 1 :])) < least + DECISIVE
    ]
    if not open_still:
        return ""
    listed = ", ".join(map(str, open_still))
    return (
        f"position: the columns of joints {listed} hardly move in degrees, and move like the "
        "others in radians: which is it (`unit:`, a list)?"
    )


def _differ(units: tuple[str, ...], model: RobotModel) -> bool:
    """Say whether the joints that turn are read in more than one unit."""
    return len({unit for unit, slides in zip(units, model.sliding, strict=True) if not slides}) > 1


def _flipped(
    position: FloatArray, units: tuple[str, ...], possible: dict[str, np.ndarray], cost: Gravity
) -> tuple[tuple[str, ...], float]:
    """Return units with single joints changed where that explains the torques decidedly better."""
    least = cost.of(position, units)
    for j, unit in enumerate(units):
        other = "deg" if unit == "rad" else "rad"
        flipped = (*units[:j], other, *units[j + 1 :])
        if cost.model.sliding[j] or not possible[other][j]:
            continue
        if (left := cost.of(position, flipped)) < least - DECISIVE:
            units, least = flipped, left
    return units, least


def _possible(position: FloatArray, model: RobotModel) -> np.ndarray:
    """Say of each joint whether positions (T, n) [rad] are within its limits."""
    limits = model.limits
    low, high = np.nanquantile(position, (0.002, 0.998), axis=0)
    fits = (low > limits.position_min - MARGIN) & (high < limits.position_max + MARGIN)
    return fits | np.array(model.turning)


def velocity_unit(
    time: FloatArray,
    position: FloatArray,
    velocity: FloatArray,
    sliding: Sequence[bool],
    stated: tuple[str, ...] = (),
) -> Reading:
    """Say in which unit velocities are, from the rate of change of positions.

    Args:
        time: (T,) [s].
        position: (T, n) [rad, m].
        velocity: (T, n) as the log has it.
        sliding: Whether each joint slides, (n,).
        stated: The unit that names state, if they do.
    """
    rows = usual(position) & usual(velocity) & usual(time[:, None])
    time, position, velocity = time[rows], position[rows], velocity[rows]
    factors = _factors(time, position, velocity)
    slides = np.array(sliding)
    turning, turn_why = _velocity_unit(factors[~slides], stated or ("rad/s", "deg/s", "rpm"))
    sliding_unit, slide_why = _velocity_unit(factors[slides], stated or ("m/s", "mm/s"))
    scales = [UNITS["velocity"][sliding_unit if slide else turning] for slide in sliding]
    question = _about_time(factors * scales)
    if not slides.any():
        return Reading((turning,), turn_why, question)
    units = tuple(sliding_unit if slides_ else turning for slides_ in sliding)
    why = (
        slide_why if slides.all() or slide_why == turn_why else f"{turn_why}; {slide_why} (slides)"
    )
    return Reading(units if len(set(units)) > 1 else units[:1], why, question)


def _factors(time: FloatArray, position: FloatArray, velocity: FloatArray) -> FloatArray:
    """Return `factors_by_joint` without signs, (n,); NaN of joints that rest beside others."""
    ranges = np.ptp(position, axis=0)
    return np.abs(factors_by_joint(time, position, velocity, ranges > _RESTS * ranges.max()))


def _middle(factors: FloatArray) -> float:
    """Return the median of those that are known; NaN where none is."""
    known = factors[np.isfinite(factors)]
    return float(np.median(known)) if known.size else math.nan


def are_rates(time: FloatArray, position: FloatArray, velocity: FloatArray) -> bool:
    """Say whether velocities (T, n) are, within 10 %, what positions (T, n) change by a second."""
    factors = _factors(time, position, velocity)
    known = factors[np.isfinite(factors)]
    return known.size > 0 and float(np.abs(known - 1.0).max()) < _SAME


def _about_time(factors: FloatArray) -> str:
    """Return a question where velocities are off by one factor at all joints; else nothing.

    Args:
        factors: Of velocities over rates of change in the same unit, (n,); NaN of joints that rest.
    """
    if (factor := one_factor(factors)) is None:
        return ""
    return (
        f"time: at all joints the velocities are {factor:.3g} times the rate of change of the "
        f"positions: do {1 / factor:.3g} s pass in one of the log (`factor: {1 / factor:.3g}` "
        "under `time:`), or are the velocities none (delete `velocity:`)?"
    )


def _velocity_unit(factors: FloatArray, units: Sequence[str]) -> tuple[str, str]:
    """Return the unit in which velocities are about the rate of change of positions, and why.

    Args:
        factors: Of velocities over rates of change in SI units, (k,); NaN of joints that rest.
        units: That are possible; the first is taken where none fits.
    """
    known, middle = factors[np.isfinite(factors)], _middle(factors)
    for unit in units:
        ratio = middle * UNITS["velocity"][unit]
        if ALIKE[0] < ratio < ALIKE[1]:
            return unit, f"{ratio:.3g} times the rate of change of the positions"
    for unit in sorted(units, key=lambda unit: abs(np.log(middle * UNITS["velocity"][unit]))):
        if (factor := one_factor(known * UNITS["velocity"][unit])) is not None:
            return unit, f"{factor:.3g} times the rate of change of the positions at all joints"
    return units[0], f"{middle:.3g} times the rate of change of the positions; not used"
