"""Arms whose drives are stated: values within their tolerance, and what is there beyond them.

How sure values are of an arm whose drives are stated.

Two things make a value wrong. Motion differs from what any constants make, more in one part than in
another: fits that each leave a part out differ by that. And each joint is simulated alone, in an
arm that moves as recorded, filtered, through an encoder: what that makes of an arm which is known
to the last digit is another one.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Final

import numpy as np

from estimators.diagnosis.from_motion.checks.conventions import conventions_of, likeliest_order
from estimators.diagnosis.from_motion.fitting.arm import ArmFit, ArmGuess, fit_arm
from estimators.diagnosis.from_motion.fitting.identification import (
    ASKED,
    SURE,
    DriveIdentification,
    gives_scale,
    largest_load,
)
from estimators.diagnosis.from_motion.fitting.joint import (
    GLANCE,
    JointFit,
    between,
    blocks,
    fit_joint,
)
from estimators.diagnosis.from_motion.fitting.starts import typical_start
from estimators.diagnosis.from_motion.search import Searched, reweighted
from estimators.diagnosis.from_motion.simulation import constants as c
from estimators.diagnosis.from_motion.simulation.free_run import (
    MOVED,
    busiest,
    commanded_range,
    free_run,
)
from estimators.diagnosis.from_motion.simulation.loads import ArmChange, ArmLoads, as_described
from estimators.diagnosis.from_motion.simulation.plant import rows_of, with_rows
from estimators.diagnosis.settings import SOME, Z95
from estimators.regression.evidence import REACH
from limo_driver.model.descriptions.geometry import Inertial
from limo_driver.physics import EncoderOffset, Payload, Simulation
from limo_driver.recordings.channels import TORQUE, commanded_by

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from estimators.diagnosis.from_motion.simulation.one_joint import LoadedJoint
    from estimators.diagnosis.from_motion.suspects import Suspect
    from limo_driver.recordings.recording import Recording
    from limo_driver.types import FloatArray

# Of the arm's largest load, from which on a glance tells a joint's gain. More than gives a scale: a
# short fit takes friction of a joint of little load for gain. Much more leaves one joint to judge.
_WELL_LOADED: Final = SOME
_LEAST: Final = 1e-6  # [N m/rad, N m s/rad]
_AFAR: Final = 1.0  # of a logarithm, from which on a gain is no tolerance
_HEAVY: Final = 0.5  # of the arm's own mass, that it may carry
_LEFT_OUT: Final = 2  # steps of fits that leave a block of motion out
_NOTHING: Final = 1e-6  # of information on a logarithm
_POINT: Final = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)  # inertia of a load about its centre


@dataclass(frozen=True)
class StatedArm:
    """What differs from a stated arm, and the fit that has it."""

    identified: DriveIdentification
    change: ArmChange
    shared: Mapping[str, float]  # deviations of what all joints share
    suspects: tuple[Suspect, ...]

    @property
    def doubtful(self) -> Suspect | None:
        """What is within its own interval of nothing, or a body or gear within tolerances.

        What it explains may be another thing.
        """
        for one in self.suspects:
            if one.effect == "gear_ratio" and one.joint is not None:
                fit = self.identified.fits[one.joint]
                tolerance = self.identified.simulation.tolerances.drive
                reach = REACH * float(np.hypot(fit.deviation["gear"], tolerance))
                if abs(np.log(fit.value("gear"))) < reach:
                    return one
            name = "mass" if one.effect == "payload" else next(iter(one.names), "")
            if one.shared and name in self.shared:
                value, reach = abs(self.change.value(name)), Z95 * self.shared[name]
                if value < reach or (name == "mass" and value < self._mass_tolerance()):
                    return one
        return None

    def _mass_tolerance(self) -> float:
        """Return the least mass that no tolerance of the stated ones explains [kg]."""
        simulation = self.identified.simulation
        mass = sum(own.mass for own in simulation.model.inertials.values())
        return REACH * simulation.tolerances.inertia * mass


def is_stated(simulation: Simulation, recordings: Sequence[Recording]) -> bool:
    """Say whether the stated drives are those of the arm, but for what may be wrong with a few.

    Descriptions of hobby arms often state gains that keep a simulation stiff, and mean no servo.
    What a drive makes of a torque is near what is stated: `check_torques` has looked at it.

    Args:
        simulation: What is stated.
        recordings: Of the arm.
    """
    if None in simulation.channels:
        return False
    served = ~commanded_by(TORQUE, recordings[0].channels)
    if not (gives_scale(largest_load(simulation.body, recordings)) & served).any():
        return True  # what is stated is the only scale there is, and nothing speaks against it
    recorded = tuple(range(simulation.model.n))
    order = likeliest_order(simulation.body, recordings)
    return any(_near(simulation, recordings, own) for own in dict.fromkeys((recorded, order)))


def _near(simulation: Simulation, recordings: Sequence[Recording], order: tuple[int, ...]) -> bool:
    """Say whether most gains are near the stated ones, of joints told in another order."""
    body, stated = simulation.body, rows_of(simulation)
    change = ArmChange((0.0,) * len(order), (1,) * len(order), order=order)
    recorded = as_described(busiest(recordings), change)
    signs = dict.fromkeys((change.sign, conventions_of(body, [recorded]).best.sign))
    weight = np.abs(body.gravity_torque(recorded.position)).max(axis=0)
    weight[commanded_range([recorded]) < MOVED] = 0.0
    weight[commanded_by(TORQUE, recorded.channels)] = 0.0
    loaded = (
        np.flatnonzero(weight > _WELL_LOADED * weight.max()) if weight.max() > 0 else np.array([])
    )
    if not loaded.size:
        return False
    loads = ArmLoads(body, [recorded])
    mass = _HEAVY * sum(own.mass for own in body.inertials.values())
    # a hobby arm's load, which nobody may have stated, makes all gains look smaller than they are
    tried = (
        replace(change, sign=sign, order=(), mass=own) for sign in signs for own in (0.0, mass)
    )
    return any(_apart(loads.parts(one), stated, loaded.tolist()) < _AFAR for one in tried)


def _apart(
    parts: Sequence[Sequence[LoadedJoint]], stated: FloatArray, joints: Sequence[int]
) -> float:
    """Return how far the gains of most joints are from those stated, as a logarithm."""
    found = list[float]()
    for j in joints:
        fit = fit_joint(parts[j], typical_start(stated[j]), evaluations=GLANCE)
        gain = c.gain_of(stated[j])
        found.append(abs(np.log(fit.value(gain) / max(c.value_in(stated[j], gain), _LEAST))))
    return float(np.median(found))


def prove_on_part(
    simulation: Simulation, recordings: Sequence[Recording], found: Searched, *, held: bool = False
) -> StatedArm:
    """Fit what was found to some of the recordings alone.

    Args:
        simulation: What is stated.
        recordings: Of the arm, with commands.
        found: In all of them.
        held: Whether what was found keeps its values, and all else is fitted anew. An error that
            has many hollows along an amount has others in a part of the motion.
    """
    loads = ArmLoads(simulation.body, recordings, rows_of(simulation))
    guess = _holding(found) if held else found.fit.guess
    fit = fit_arm(replace(found.fit.problem, loads=loads), guess, GLANCE)
    return stated_arm(simulation, found, reweighted(fit))


def _holding(found: Searched) -> ArmGuess:
    """Return the guess of which all is fitted but the values of what was found."""
    guess = found.fit.guess
    own = [one for one in found.suspects if not one.shared]
    known = {(one.joint, name) for one in own for name in (*one.names, one.freed)}
    names = tuple(
        tuple(name for name in names if (j, name) not in known)
        for j, names in enumerate(guess.names)
    )
    common = {name for one in found.suspects if one.shared for name in one.names}
    shared = tuple(name for name in guess.shared if name not in common)
    return replace(guess, names=names, shared=shared)


def _about_rest(row: FloatArray, stated: FloatArray) -> FloatArray:
    """Return constants in which what a spring pulls at zero is where it rests, and no offset."""
    pull, stiffness = (
        c.value_in(row, "offset") - c.value_in(stated, "offset"),
        c.value_in(row, "spring"),
    )
    rest = c.value_in(row, "rest") - pull / stiffness
    return c.with_values(row, {"offset": c.value_in(stated, "offset"), "rest": rest})


def stated_arm(simulation: Simulation, found: Searched, fit: ArmFit) -> StatedArm:
    """Return what a fit says of an arm.

    Of a joint that gravity does not load, it says no gain; of one that no command moves, nothing.

    Args:
        simulation: What is stated.
        found: Beyond it.
        fit: That has it.
    """
    rows, change, stated = fit.guess.rows.copy(), fit.guess.change, rows_of(simulation)
    recorded = [as_described(recording, change) for recording in found.fit.problem.loads.recordings]
    scaled, moved = (
        gives_scale(largest_load(simulation.body, recorded)),
        commanded_range(recorded) > MOVED,
    )
    rows[~moved] = stated[~moved]
    if change.sag:
        rows[:, c.SAG] = change.sag
    for one in found.suspects:
        if one.effect == "spring_load" and one.joint is not None:
            rows[one.joint] = _about_rest(rows[one.joint], stated[one.joint])
    fits = list[JointFit]()
    scaled_by_stated = scaled | ~scaled.any()  # where gravity tells no joint's, stated values do
    for j, known in enumerate(fit.own):
        deviation = {n: x for n, x in known.items() if n not in c.GAINS or scaled_by_stated[j]}
        fits.append(JointFit(rows[j], tuple(deviation), deviation, fit.errors[j]))
    own = tuple(
        tuple(x.effect for x in found.suspects if x.joint == j and not (x.shared or x.freed))
        for j in range(len(rows))
    )
    improved = with_rows(simulation, list(rows))
    more = tuple(
        EncoderOffset(joint=j, offset=zero) for j, zero in enumerate(change.zero, start=1) if zero
    )
    if change.mass > 0.0 and change.carrier is None:
        more = (*more, Payload(mass=change.mass, com=change.com))
    elif change.mass > 0.0:
        improved = _loaded(improved, change)
    improved = replace(improved, effects=(*improved.effects, *more))
    shows = tuple(scaled.tolist()), tuple(moved.tolist())
    identified = DriveIdentification(improved, tuple(fits), own, *shows)
    return StatedArm(identified, change, fit.shared, found.suspects)


def _loaded(simulation: Simulation, change: ArmChange) -> Simulation:
    """Return a simulation of which another link than the last has a load in it."""
    model, load = simulation.model, Inertial(change.mass, change.com, _POINT)
    name = model.link_names[-1 if change.carrier is None else change.carrier]
    heavier = {name: model.inertials[name].joined(load)}
    return replace(simulation, inertials={**simulation.inertials, **heavier})


def with_intervals(simulation: Simulation, found: Searched, ticks: FloatArray) -> StatedArm:
    """Return what was found, as sure as fits agree that should find the same.

    The largest counts of: the curvature at the best; the spread between fits that each leave a
    block of motion out; the error of a fit to motion simulated forward with what was found.

    Args:
        simulation: What is stated.
        found: In all recordings.
        ticks: Steps of the encoders, (n,) [rad].
    """
    fit = found.fit
    apart = np.maximum(_between(found), np.abs(_rehearsed(simulation, found, ticks)))
    wide = iter(apart.tolist())
    own = tuple(
        {name: max(value, next(wide)) for name, value in joint.items()} for joint in fit.own
    )
    shared = {name: max(value, next(wide)) for name, value in fit.shared.items()}
    own_values = tuple({**known, **_not_shown(found, j)} for j, known in enumerate(own))
    return stated_arm(simulation, found, replace(fit, own=own_values, shared=shared))


def _between(found: Searched) -> FloatArray:
    """Return deviations of all values, by the delete-a-group jackknife."""
    fit, problem = found.fit, found.fit.problem
    parts = problem.loads.parts(fit.guess.change)[0]
    block = blocks([part.time.size for part in parts])
    many = int(block.max()) + 1
    values = np.array(
        [
            _values(fit_arm(replace(problem, kept=block != k), fit.guess, _LEFT_OUT))
            for k in range(many)
        ]
    )
    return between(values)


def _rehearsed(simulation: Simulation, found: Searched, ticks: FloatArray) -> FloatArray:
    """Return what a fit makes of an arm that has all values found, minus these.

    The whole arm is simulated forward from the recorded commands and read by its encoders.

    Args:
        simulation: What is stated.
        found: In all recordings.
        ticks: Steps of the encoders, (n,) [rad]; 0 where none shows.
    """
    known, change, problem = found.fit, found.fit.guess.change, found.fit.problem
    arm = stated_arm(simulation, found, known).identified.simulation
    fine = np.where(ticks > 0.0, ticks, np.inf)
    played = []
    for recording in problem.loads.recordings:
        recording_in_model = as_described(recording, change)
        position = free_run(arm, recording_in_model)
        read = np.where(ticks > 0.0, ticks * np.round(position / fine), position)
        played.append(replace(recording_in_model, position=read))
    straight = replace(change, sign=(1,) * len(change.sign), order=())
    loads = ArmLoads(simulation.body, played, problem.loads.stated)
    guess = replace(known.guess, change=straight)
    return _values(fit_arm(replace(problem, loads=loads), guess, GLANCE)) - _values(known)


def _not_shown(found: Searched, j: int) -> dict[str, float]:
    """Return what recordings alone say of the constants of a joint that they leave undecided.

    What is believed of a value makes it look sure where no motion says anything of it.
    """
    alone = dict[str, float]()
    for name, deviation in found.fit.own[j].items():
        prior = found.fit.problem.priors[j].get(name)
        if name in ASKED and prior is not None and (j, name) not in found.fit.guess.free:
            information = max(deviation**-2 - prior.deviation**-2, 0.0) if deviation > 0.0 else 0.0
            if information < SURE**-2:
                alone[name] = max(information, _NOTHING) ** -0.5
    return alone


def _values(fit: ArmFit) -> FloatArray:
    """Return all fitted values, as they are fitted."""
    own = [
        c.inner(name, c.value_in(row, name))
        for row, names in zip(fit.guess.rows, fit.guess.names, strict=True)
        for name in names
    ]
    return np.array([*own, *(fit.guess.change.value(name) for name in fit.guess.shared)])
