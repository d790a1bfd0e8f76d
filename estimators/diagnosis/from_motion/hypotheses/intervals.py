"""How sure values are of an arm whose drives are stated.

Two things make a value wrong. Motion differs from what any constants make, more in one part than in
another: fits that each leave a part out differ by that. And each joint is simulated alone, in an
arm that moves as recorded, filtered, through an encoder: what that makes of an arm which is known
to the last digit is another one.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Final

import numpy as np

from estimators.diagnosis.from_motion.fitting.arm import glance_at
from estimators.diagnosis.from_motion.fitting.constants import inner, value_in
from estimators.diagnosis.from_motion.fitting.identification import ASKED, SURE
from estimators.diagnosis.from_motion.fitting.joint import between, blocks
from estimators.diagnosis.from_motion.hypotheses.stated import stated_arm
from estimators.diagnosis.from_motion.simulation.free_run import free_run
from estimators.diagnosis.from_motion.simulation.loads import ArmLoads, as_described

if TYPE_CHECKING:
    from estimators.diagnosis.from_motion.fitting.arm import ArmFit
    from estimators.diagnosis.from_motion.hypotheses.search import Searched
    from estimators.diagnosis.from_motion.hypotheses.stated import StatedArm
    from limo_driver.physics import Simulation
    from limo_driver.types import FloatArray

_LEFT_OUT: Final = 2  # steps of fits that leave a block of motion out
_NOTHING: Final = 1e-6  # of information on a logarithm
_REHEARSED: Final = 8  # steps of the fit to an arm that is known


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
    told = tuple({**known, **_not_shown(found, j)} for j, known in enumerate(own))
    return stated_arm(simulation, found, replace(fit, own=told, shared=shared))


def _between(found: Searched) -> FloatArray:
    """Return deviations of all values, by the delete-a-group jackknife."""
    problem, fit = found.problem, found.fit
    parts = problem.loads.parts(fit.guess.change)[0]
    block = blocks([part.time.size for part in parts])
    many = int(block.max()) + 1
    values = np.array(
        [
            _values(glance_at(replace(problem, kept=block != k), fit.guess, _LEFT_OUT))
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
    known, change, problem = found.fit, found.fit.guess.change, found.problem
    arm = stated_arm(simulation, found, known).identified.simulation
    fine = np.where(ticks > 0.0, ticks, np.inf)
    played = []
    for recording in problem.loads.recordings:
        told = as_described(recording, change)
        position = free_run(arm, told)
        read = np.where(ticks > 0.0, ticks * np.round(position / fine), position)
        played.append(replace(told, position=read))
    straight = replace(change, sign=(1,) * len(change.sign), order=())
    loads = ArmLoads(simulation.body, played, problem.loads.stated)
    guess = replace(known.guess, change=straight)
    return _values(glance_at(replace(problem, loads=loads), guess, _REHEARSED)) - _values(known)


def _not_shown(found: Searched, j: int) -> dict[str, float]:
    """Return what recordings alone say of the constants of a joint that they leave undecided.

    What is believed of a value makes it look sure where no motion says anything of it.
    """
    alone = dict[str, float]()
    for name, deviation in found.fit.own[j].items():
        prior = found.problem.priors[j].get(name)
        if name in ASKED and prior is not None and (j, name) not in found.fit.guess.free:
            said = max(deviation**-2 - prior.deviation**-2, 0.0) if deviation > 0.0 else 0.0
            if said < SURE**-2:
                alone[name] = max(said, _NOTHING) ** -0.5
    return alone


def _values(fit: ArmFit) -> FloatArray:
    """Return all fitted values, as they are fitted."""
    own = [
        inner(name, value_in(row, name))
        for row, names in zip(fit.guess.rows, fit.guess.names, strict=True)
        for name in names
    ]
    return np.array([*own, *(fit.guess.change.value(name) for name in fit.guess.shared)])
