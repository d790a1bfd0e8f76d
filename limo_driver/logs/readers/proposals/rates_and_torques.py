"""Units of velocities and torques that no name says: what motion and gravity make of them."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Final

import numpy as np

from limo_driver.logs.readers.columns.units import UNITS
from limo_driver.logs.readers.proposals.gravity import WITHIN, Gravity, some_rows, usual
from limo_driver.logs.readers.proposals.motion_units import ALIKE, Reading
from limo_driver.recordings.gate import velocity_factor

if TYPE_CHECKING:
    from collections.abc import Sequence

    from limo_driver.model import RobotModel
    from limo_driver.types import FloatArray

_TORQUE_SCALES: Final = {"N m": 1.0, "N cm": 1e2, "mN m": 1e3}


def velocity_unit(
    time: FloatArray, position: FloatArray, velocity: FloatArray, sliding: Sequence[bool]
) -> Reading:
    """Say in which unit velocities are, from the rate of change of positions.

    Args:
        time: (T,) [s].
        position: (T, n) [rad, m].
        velocity: (T, n) as the log has it.
        sliding: Whether each joint slides, (n,).
    """
    rows = usual(position) & usual(velocity) & usual(time[:, None])
    time, position, velocity = time[rows], position[rows], velocity[rows]
    factors = np.array(
        [
            math.nan if (factor := velocity_factor(time, *own)) is None else abs(factor)
            for own in zip(position.T, velocity.T, strict=True)
        ]
    )
    slides = np.array(sliding)
    turning, turn_why = _velocity_unit(factors[~slides], ("rad/s", "deg/s", "rpm"))
    sliding_unit, slide_why = _velocity_unit(factors[slides], ("m/s", "mm/s"))
    if not slides.any():
        return Reading((turning,), turn_why)
    units = tuple(sliding_unit if slides_ else turning for slides_ in sliding)
    why = (
        slide_why if slides.all() or slide_why == turn_why else f"{turn_why}; {slide_why} (slides)"
    )
    return Reading(units if len(set(units)) > 1 else units[:1], why)


def _velocity_unit(factors: FloatArray, units: Sequence[str]) -> tuple[str, str]:
    """Return the unit in which velocities are about the rate of change of positions, and why.

    Args:
        factors: Of velocities over rates of change in SI units, (k,); NaN of joints that rest.
        units: That are possible; the first is taken where none fits.
    """
    known = factors[np.isfinite(factors)]
    middle = float(np.median(known)) if known.size else math.nan
    for unit in units:
        ratio = middle * UNITS["velocity"][unit]
        if ALIKE[0] < ratio < ALIKE[1]:
            return unit, f"{ratio:.3g} times the rate of change of the positions"
    return units[0], f"{middle:.3g} times the rate of change of the positions; not used"


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
    if slopes.size:
        middle = float(np.median(slopes))
        for unit, scale in _TORQUE_SCALES.items():
            if 1 / WITHIN < middle / scale < WITHIN:
                why = f"{middle / scale:.2g} times the gravity torque of the arm"
                return Reading(_of_joints(unit, model), why)
        return Reading(
            _of_joints("N m", model),
            f"{middle:.2g} times the gravity torque of the arm",
            f"torque: it is {middle:.2g} times the gravity torque of the arm in N m: which unit?",
        )
    return Reading(_of_joints("N m", model), "assumed: gravity makes too little of it to tell")


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
