"""Drives and friction of an arm, identified from commands and positions alone.

The masses of the robot's description are taken for known. Gravity on them is the only torque in
newton metres that such recordings hold: it gives the scale of a joint's gain, friction and inertia.
Where gravity hardly loads a joint, only their ratios are known.
"""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field, replace
from functools import partial
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from threadpoolctl import threadpool_limits

from estimators.diagnosis.from_motion.fitting.extras import (
    PROFILE,
    OfAKind,
    fit_with_extras,
    of_a_kind,
)
from estimators.diagnosis.from_motion.fitting.joint import JointFit, errors
from estimators.diagnosis.from_motion.fitting.starts import (
    TYPICAL,
    choose_start,
    typical_start,
    with_gain,
)
from estimators.diagnosis.from_motion.simulation import constants as c
from estimators.diagnosis.from_motion.simulation.free_run import MOVED, commanded_range
from estimators.diagnosis.from_motion.simulation.loads import loaded_joints
from estimators.diagnosis.from_motion.simulation.plant import rows_of, with_rows
from estimators.diagnosis.settings import LITTLE, MATTERS
from limo_driver.model.units import unit_of
from limo_driver.physics import (
    PositionServo,
    TorqueDrive,
    VelocityServo,
)
from limo_driver.recordings.channels import POSITION, TORQUE, VELOCITY
from limo_driver.runtime.display import Displayed

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from estimators.diagnosis.from_motion.simulation.one_joint import LoadedJoint
    from limo_driver.model import RobotModel
    from limo_driver.physics import Simulation
    from limo_driver.recordings.recording import Recording
    from limo_driver.types import BoolArray, FloatArray

# Of the largest load of the arm, from which on gravity gives a joint's scale and tells its sign. A
# smaller part lets friction and masses known to some percent pass for gravity; a larger one leaves
# more joints with ratios alone.
_LOADED: Final = LITTLE
_WEIGHTLESS: Final = 1e-6  # [N m]
_USUAL: Final = (c.DAMPING, "delay", "inertia", "kv")  # known to a factor of e
# said to be undecided where recordings do not show them
ASKED: Final = (*c.GAINS, "delay", "inertia")
_OF_A_KIND: Final = np.log(2.0)  # deviation of the logarithm of the gains of an arm's servos
SURE: Final = 0.5  # of a logarithm; above, recordings at this rate do not show a constant
_TYPICAL_DRIVES: Final = {  # by what a joint is told
    POSITION.name: partial(PositionServo, kp=TYPICAL["kp"]["kp"]),
    VELOCITY.name: partial(VelocityServo, kv=TYPICAL["kv"]["kv"]),
    TORQUE.name: partial(TorqueDrive, gain=TYPICAL["gain"]["gain"]),
}


@dataclass(frozen=True, repr=False)
class DriveIdentification(Displayed):
    """Drives and friction of n joints."""

    simulation: Simulation
    fits: tuple[JointFit, ...]
    extras: tuple[tuple[str, ...], ...]  # of each joint, effects beyond the usual ones
    scaled: tuple[bool, ...]  # whether gravity gives the scale of a joint
    moved: tuple[bool, ...]  # whether a joint is told to move; else its constants are of others
    warnings: tuple[str, ...] = field(default=(), kw_only=True)  # what makes one doubt recordings

    def headline(self) -> str:
        """Say of what it is, and how far the simulated joints stay from the recorded ones."""
        error = float(np.mean([fit.mean_error for fit in self.fits]))
        far = unit_of("rad", self.simulation.model.sliding)
        return (
            f"drives and friction of {self.simulation.model.n} joints; each simulated forward from "
            f"its commands is {error:.4f} {far} from where it was"
        )

    def figures(self) -> Mapping[str, Sequence[object]]:
        """Return the usual constants of each joint, and how sure the gain is."""
        fits, sliding = self.fits, self.simulation.model.sliding
        gains = [c.gain_of(fit.row) for fit in fits]
        named = {
            f"{gain} [{unit_of(c.constant_of(gain).unit, sliding)}]": [
                fit.value(gain) if gain == own else "-"
                for fit, own in zip(fits, gains, strict=True)
            ]
            for gain in dict.fromkeys(gains)
        }
        return {
            "joint": self.simulation.model.joint_names,
            **named,
            "95 %": [
                "{:.3g} to {:.3g}".format(*fit.interval(gain))
                if gain in fit.names
                else "ratios"
                if moved
                else "of others"
                for fit, gain, moved in zip(fits, gains, self.moved, strict=True)
            ],
            f"damping [{unit_of('N m s/rad', sliding)}]": [fit.value(c.DAMPING) for fit in fits],
            f"dry friction [{unit_of('N m', sliding)}]": [fit.value(c.COULOMB) for fit in fits],
            "delay [s]": [fit.value("delay") for fit in fits],
            f"offset [{unit_of('N m', sliding)}]": [fit.value("offset") for fit in fits],
            f"error [{unit_of('rad', sliding)}]": [fit.mean_error for fit in fits],
            "beside": [", ".join(own) or "-" for own in self.extras],
        }

    def as_values(self) -> dict[str, Any]:
        """Return the constants of each joint with their 95 % intervals, for JSON."""
        return {
            "warnings": list(self.warnings),
            "joints": [
                {
                    "scale_known": scaled,
                    "beside": list(own),
                    "error": fit.mean_error,
                    "values": {name: [fit.value(name), *fit.interval(name)] for name in fit.names},
                }
                for fit, own, scaled in zip(self.fits, self.extras, self.scaled, strict=True)
            ],
        }

    @property
    def undecided(self) -> tuple[tuple[int, str], ...]:
        """Joints, 1-based, and constants that recordings at this rate do not show."""
        return tuple(
            (joint, name)
            for joint, fit in enumerate(self.fits, start=1)
            for name in ASKED
            if name not in c.GAINS or name == c.gain_of(fit.row)
            if self.moved[joint - 1] and (self.scaled[joint - 1] or name not in c.GAINS)
            if not 0.0 < fit.deviation.get(name, 0.0) <= SURE
        )


@threadpool_limits.wrap(limits=1, user_api="blas")  # more collapse on busy cores, and gain nothing
def fit_drives(
    simulation: Simulation, recordings: Sequence[Recording], *, intervals: bool = True
) -> DriveIdentification:
    """Fit drives and friction to recordings that `check_commanded` has looked at.

    Args:
        simulation: The rigid body, and what is believed of the drives; a joint without one gets a
            position servo.
        recordings: With commands, of that robot.
        intervals: Whether fits that leave motion out tell how sure values are; a third of the time.
            Without, deviations are those of a model that explains all of the motion.

    Returns:
        A simulation that can be run forward, and how sure its values are.

    Raises:
        ConfigError: The simulation has an effect that cannot be run forward.
        RecordingError: A recording has no commands.
    """
    given, recordings = with_servos(simulation, recordings)
    parts = loaded_joints(given.body, recordings)
    stated = rows_of(given)
    load = largest_load(given.body, recordings)
    scaled = gives_scale(load)
    moved = commanded_range(recordings) > MOVED
    rows = np.stack([typical_start(row) for row in stated])
    gains = np.array([c.gain_of(row) for row in rows])
    found = dict[int, tuple[JointFit, tuple[str, ...]]]()
    for gain in c.GAINS:  # joints behind one kind of servo
        own = gains == gain
        first = np.flatnonzero(scaled & moved & own).tolist()
        for j in first:
            rows[j] = choose_start(parts[j], rows[j])
        believed = [_believed(rows[j], float(load[j])) for j in first]
        found |= _fitted(parts, rows, first, believed, intervals=intervals)
        sure = [j for j in first if found[j][0].deviation[gain] < SURE]
        values = [found[j][0].value(gain) for j in sure or first] or [TYPICAL[gain][gain]]
        kind = float(np.exp(np.mean(np.log(values))))  # are of one kind more often than not
        if sure and (unsure := [j for j in first if j not in sure]):
            for j in unsure:
                rows[j] = with_gain(rows[j], kind)
            believed = [
                {**_believed(rows[j], float(load[j])), gain: c.BelievedValue(kind, _OF_A_KIND)}
                for j in unsure
            ]
            found |= _fitted(parts, rows, unsure, believed, intervals=intervals)
        weightless = np.flatnonzero(~scaled & moved & own).tolist()
        for j in weightless:
            rows[j] = with_gain(rows[j], kind)
        believed = [_believed(rows[j], None) for j in weightless]
        found |= _fitted(parts, rows, weightless, believed, scaled=False, intervals=intervals)
    found = _of_a_kind(parts, found, stated, load, scaled, intervals=intervals)
    shown = [fit for fit, _ in found.values()]
    for j in np.flatnonzero(~moved).tolist():
        row = _of_others(rows[j], [fit for fit in shown if c.gain_of(fit.row) == gains[j]])
        found[j] = (JointFit(row, (), {}, errors(parts[j], row)), ())
    fits, extras = zip(*(found[j] for j in range(len(rows))), strict=True)
    improved = with_rows(given, [fit.row for fit in fits])
    return DriveIdentification(
        improved, fits, extras, tuple(scaled.tolist()), tuple(moved.tolist())
    )


def _fitted(
    parts: Sequence[Sequence[LoadedJoint]],
    rows: FloatArray,
    joints: Sequence[int],
    believed: Sequence[Mapping[str, c.BelievedValue]],
    *,
    scaled: bool = True,
    intervals: bool,
) -> dict[int, tuple[JointFit, tuple[str, ...]]]:
    """Return the fit of some joints of one kind of servo, with effects beyond the usual ones.

    By joint. Of those whose scale is not known, the gain is not fitted.
    """
    if not joints:
        return {}
    own, names = [parts[j] for j in joints], c.base_of(rows[joints[0]])[0 if scaled else 1 :]
    fit = partial(fit_with_extras, intervals=intervals)
    with ThreadPoolExecutor() as pool:  # the compiled loops let each other run
        done = list(pool.map(fit, own, rows[list(joints)], [names] * len(joints), believed))
    return dict(zip(joints, done, strict=True))


def _of_a_kind(
    parts: Sequence[Sequence[LoadedJoint]],
    found: dict[int, tuple[JointFit, tuple[str, ...]]],
    stated: FloatArray,
    load: FloatArray,
    scaled: BoolArray,
    *,
    intervals: bool,
) -> dict[int, tuple[JointFit, tuple[str, ...]]]:
    """Return the fits with the profile that some servos show, if all joints together err less.

    Servos of an arm are of one kind more often than not, and few joints move fast enough to show
    a profile each by itself: all of them have it, or those alone that show it.

    Args:
        parts: Stretches of each joint.
        found: Fits and effects, by joint.
        stated: Constants of each joint, (n, columns).
        load: Largest torque of gravity on each, (n,) [N m].
        scaled: Whether that gives the scale of a joint, (n,).
        intervals: Whether fits that leave motion out tell how sure values are.
    """
    has = {j for j, (fit, _) in found.items() if c.value_in(fit.row, "straight") > 0.0}
    others = [
        j
        for j, (fit, own) in found.items()
        if j not in has and PROFILE.effect not in own and PROFILE.fits(fit.row)
    ]
    if not has or not others:
        return found

    def tried(j: int) -> OfAKind:
        believed = _believed(typical_start(stated[j]), float(load[j]) if scaled[j] else None)
        return of_a_kind(parts[j], *found[j], believed, intervals=intervals)

    with ThreadPoolExecutor() as pool:
        alike = list(pool.map(tried, others))
    if len(has) * np.log(1 - LITTLE) + np.log([one.ratio for one in alike]).sum() >= 0.0:
        return found
    return found | {j: (one.fit, one.found) for j, one in zip(others, alike, strict=True)}


def _of_others(row: FloatArray, fits: Sequence[JointFit]) -> FloatArray:
    """Return the constants of a joint that is not told to move: the mean of those that are."""
    if not fits:
        return row
    usual = {
        name: float(np.exp(np.mean([np.log(max(fit.value(name), c.LEAST)) for fit in fits])))
        for name in TYPICAL[c.gain_of(row)]
    }
    return c.with_values(row, usual)


def _believed(row: FloatArray, load: float | None) -> dict[str, c.BelievedValue]:
    """Return what is believed of a joint before any data.

    Slow motion shows neither delay nor inertia nor, under much friction, damping, and that of a
    servo which follows its velocity at once no gain: without a belief they would run to nothing or
    to anything, and other motion would be predicted by these.

    Args:
        row: The constants that the fit starts from.
        load: Largest torque of gravity on it [N m], where that gives the scale.
    """
    believed = {name: c.BelievedValue(c.value_in(row, name), 1.0) for name in _USUAL}
    if load is not None:
        believed["offset"] = c.BelievedValue(0.0, MATTERS * load)
    return believed


def gives_scale(load: FloatArray) -> BoolArray:
    """Say at which joints gravity gives the scale of gain, friction and inertia, (n,).

    Args:
        load: Largest torque of gravity on each joint, (n,) [N m].
    """
    return load >= max(_LOADED * float(load.max()), _WEIGHTLESS)


def largest_load(body: RobotModel, recordings: Sequence[Recording]) -> FloatArray:
    """Return the largest torque of gravity on each joint, (n,) [N m].

    Args:
        body: The rigid body.
        recordings: Of the arm, whose joints count as described.
    """
    return np.max(
        [np.abs(body.gravity_torque(each.position)).max(axis=0) for each in recordings], axis=0
    )


def with_servos(
    simulation: Simulation, recordings: Sequence[Recording]
) -> tuple[Simulation, list[Recording]]:
    """Return the same with a typical drive at each joint that has none, and what they are told.

    Args:
        simulation: What is stated.
        recordings: Of the arm. By what the first one tells a joint, its drive is a servo of
            position or velocity, or none.

    Raises:
        RecordingError: What a drive takes was not recorded.
    """
    commanded = [recording.led(simulation.channels) for recording in recordings]
    kinds = commanded[0].channels if commanded else (POSITION.name,) * simulation.model.n
    simulation = simulation.with_motors(kinds)
    every = enumerate(zip(kinds, simulation.channels, strict=True), start=1)
    more = [_TYPICAL_DRIVES[kind](joint=j) for j, (kind, own) in every if own is None]
    given = replace(simulation, drives=(*simulation.drives, *more)) if more else simulation
    return given, [recording.led(given.channels) for recording in commanded]
