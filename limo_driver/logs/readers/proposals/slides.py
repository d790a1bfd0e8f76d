"""In which unit the positions of joints that slide are: metres, unless they say otherwise."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from limo_driver.logs.readers.columns import UNITS
from limo_driver.model import RobotModel
from limo_driver.recordings.gate.held_values import velocity_factor
from limo_driver.types import FloatArray

_ROOM: Final = 0.1  # [m] beyond the limits of a description
_UNITS: Final = ("m", "cm", "mm")
_LONGEST: Final = 3.0  # [m], that a slide without limits may be expected to move
_UNLIMITED: Final = 20.0  # [m], from where a limit is none
_FASTEST: Final = 3.0  # [m/s], where a description does not say it
_FASTER: Final = 1.5  # times the limit of the drive, that no motion is
_USUAL: Final = 0.95  # of the speeds, in which no jump counts
_SWEEP: Final = 0.1  # [s] over which a speed is the mean
_ALIKE: Final = (0.6, 1.6)  # velocity over rate of change of position, in the right unit
_MOST: Final = 0.998  # of the positions, in which none is damaged


@dataclass(frozen=True)
class SlideUnits:
    """The unit of each joint that slides, nothing for the others, and what is open."""

    units: tuple[str, ...]
    question: str = ""


def slide_units(
    position: FloatArray, time: FloatArray | None, velocity: FloatArray | None, model: RobotModel
) -> SlideUnits:
    """Return the units of slides: by velocities, else by limits and speed, which leave a question.

    Metres are what formats have. Values too large or too fast for them are in another unit, of
    which the same limits do not tell centimetres from millimetres.

    Args:
        position: (T, n) as the log has them.
        time: (T,) [s], where its unit is known.
        velocity: (T, n) [m/s], where their unit is stated.
        model: The robot.
    """
    units, asked = list[str](), list[str]()
    for j, slides in enumerate(model.sliding):
        if not slides:
            units.append("")
            continue
        own = position[:, j]
        by_rate = ""
        if time is not None and velocity is not None:
            by_rate = _by_rate(time, own, velocity[:, j])
        fits = [unit for unit in _UNITS if _fits(own * UNITS["position"][unit], time, j, model)]
        units.append(by_rate or (fits[0] if fits else "m"))
        if by_rate in fits or (not by_rate and units[-1:] == fits[:1] == ["m"]):
            continue
        known = ", ".join(fits) or "none of m, cm and mm"
        more = f", its velocities {by_rate}" if by_rate else ""
        asked.append(f"{model.joint_names[j]} (limits and speed allow {known}{more})")
    question = f"position: are slides in m, cm or mm? {'; '.join(asked)}" if asked else ""
    return SlideUnits(tuple(units), question)


def _fits(position: FloatArray, time: FloatArray | None, j: int, model: RobotModel) -> bool:
    """Say whether positions (T,) [m] are where a slide goes, and change as fast as it moves."""
    low, high = model.limits.position_min[j], model.limits.position_max[j]
    furthest = max(abs(low), abs(high)) + _ROOM
    reach = furthest if furthest < _UNLIMITED else _LONGEST
    if not np.nanquantile(np.abs(position), _MOST) < reach:
        return False
    limit = float(model.limits.velocity[j])
    usual = _FASTEST if model.unlimited_speed[j] or not limit > 0 else limit
    return time is None or _speed(time, position) < _FASTER * usual


def _speed(time: FloatArray, position: FloatArray) -> float:
    """Return how fast positions (T,) change, but for a few jumps."""
    known = np.isfinite(time) & np.isfinite(position)
    known &= np.append(True, np.diff(time) > 0)
    time, position = time[known], position[known]
    if time.size < 2:  # noqa: PLR2004  # between which something changes
        return 0.0
    every = max(1, round(_SWEEP / float(np.median(np.diff(time)))))
    time, position = time[::every], position[::every]
    speeds = np.abs(np.diff(position)) / np.diff(time)
    return float(np.quantile(speeds, _USUAL)) if speeds.size else 0.0


def _by_rate(time: FloatArray, position: FloatArray, velocity: FloatArray) -> str:
    """Return the unit in which positions (T,) change as velocities [m/s] say; nothing if none."""
    known = np.isfinite(time) & np.append(True, np.diff(time) > 0)
    factor = abs(velocity_factor(time[known], position[known], velocity[known]) or 0.0)
    for unit in _UNITS:
        if _ALIKE[0] < factor / UNITS["position"][unit] < _ALIKE[1]:
            return unit
    return ""
