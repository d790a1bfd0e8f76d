"""Guesses: tolerances that nobody stated, and what other ones would change.

Where a recording's torques are currents times a constant, that constant is rarely known to better
than a tenth: an arm on a table stands level more often than a drive's constant is right.

What is guessed is tried: the search goes on around what was found, with a tolerance half and twice
as wide, or with scales of torques that may be off. Names that come or go are reported, but for
those that the same search brings without any change.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Final

import numpy as np

from estimators.diagnosis.from_torque.selection.search import Search
from estimators.diagnosis.quantities import listed, placed
from estimators.diagnosis.settings.judgement import GUESSES
from estimators.regression.evidence import Evidence, Prior, joined
from limo_driver.logs.readers.columns import CURRENT
from limo_driver.physics import TorqueGain

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from estimators.diagnosis.from_torque.fitting.problem import RegressionProblem, Solution
    from estimators.diagnosis.from_torque.judgement.judged_set import JudgedSet
    from limo_driver.physics import Simulation, Tolerances
    from limo_driver.recordings.recording import Recording

_Place = tuple[str, tuple[int, ...]]


def with_guesses(simulation: Simulation, recordings: Sequence[Recording]) -> Simulation:
    """Return a simulation that tolerates gains of drives where torques are their currents.

    The same where a tolerance of gains is stated, of nothing, too.

    Args:
        simulation: What is believed of the arm.
        recordings: Of it.
    """
    known = simulation.tolerances
    if "gain" not in known.assumed or not any(map(are_currents, recordings)):
        return simulation
    stated = known.stated if known.stated is not None else known.all_names - known.usual
    return replace(simulation, tolerances=replace(known, gain=GUESSES.gain, stated=stated))


def are_currents(recording: Recording) -> bool:
    """Say whether torques are the recorded currents, each times one constant."""
    current = recording.extras.get(CURRENT)
    if current is None:
        return False
    torque = recording.torque
    rows = np.isfinite(torque) & np.isfinite(current)
    i, tau = np.where(rows, current, 0.0), np.where(rows, torque, 0.0)
    square = np.sum(i**2, axis=0)
    some = (square > 0.0) & (np.sum(tau**2, axis=0) > 0.0)
    constant = np.sum(i * tau, axis=0) / np.where(some, square, 1.0)
    off = np.sum((tau - constant * i) ** 2, axis=0) / np.maximum(np.sum(tau**2, axis=0), 1e-300)
    return bool(some.any() and (off[some] < GUESSES.constant**2).all())


def guessed_notes(judged: JudgedSet, given: Simulation) -> Iterator[str]:
    """Yield what would be named otherwise if a guessed tolerance were another, one sentence each.

    Args:
        judged: What was found.
        given: The simulation as it was given.
    """
    problem, solution, known = judged.problem, judged.solution, given.tolerances
    if "gain" in known.assumed and known.gain:
        yield (
            "The torques are currents times a constant, so the scale of each is taken to be known "
            f"to {100 * known.gain:g} % (limo's guess; state `tolerances: {{gain: ...}}`)."
        )
    named = {place for place in judged.places(judged.findings) if place[0] != TorqueGain.name}
    base = {problem.candidates[i].place for i in problem.base}
    as_it_is = _sought(problem, solution, _Guess("", 1.0)) | named | base
    for guess in _guesses(known):
        found = _sought(problem, solution, guess)
        gone, come = sorted(named - found), sorted(found - as_it_is)
        if gone or come:
            yield _sentence(guess, gone, come[: GUESSES.listed])


@dataclass(frozen=True)
class _Guess:
    """Another width of a tolerance."""

    name: str  # of the tolerance
    times: float  # what it is
    width: float = 0.0  # relative, where it is none


def _guesses(known: Tolerances) -> Iterator[_Guess]:
    for name in ("inertia", "friction"):
        width = getattr(known, name)
        if name in known.assumed and width:
            yield from (_Guess(name, times, times * width) for times in GUESSES.times)
    if "gain" in known.assumed and not known.gain:
        yield _Guess("gain", 1.0, GUESSES.gain)


def _sought(problem: RegressionProblem, solution: Solution, guess: _Guess) -> set[_Place]:
    """Return what is found around a solution with another tolerance, by effect and joints."""
    prior, bodies = problem.nuisance.prior, problem.observed.chain.width
    of_effects = np.array([item.of_effect for item in problem.nuisance.parameters], dtype=bool)
    some = {"inertia": np.arange(of_effects.size) < bodies, "friction": of_effects}
    times = np.where(some[guess.name], guess.times, 1.0) if guess.name in some else 1.0
    prior = replace(prior, deviation=times * prior.deviation)
    if guess.name == "gain":
        gains = [x.prior for x in problem.candidates if x.effect == TorqueGain.name]
        index = np.unique(np.concatenate([np.zeros(0, dtype=np.int64), *(x.index for x in gains)]))
        prior = joined(prior, Prior.free(index, np.full(index.size, guess.width)))
    held = None if problem.held is None or guess.name == "gain" else problem.held
    evidence = Evidence(problem.products(solution.noise), prior, held)
    found = Search(problem.candidates, evidence, problem.base).around(solution.members)
    return {problem.candidates[member].place for member in found.members}


_SPOKEN: Final = {
    "inertia": "inertias were known to",
    "friction": "friction and what else is stated of joints were known to",
    "gain": "the scale of each torque were known to no better than",
}


def _sentence(guess: _Guess, gone: Sequence[_Place], come: Sequence[_Place]) -> str:
    parts = [
        *([f"{_places(gone)} would not be named"] if gone else []),
        *([f"{_places(come)} would be found"] if come else []),
    ]
    return (
        f"If {_SPOKEN[guess.name]} {100 * guess.width:.2g} %, {' and '.join(parts)}: nobody has "
        f"stated that tolerance, and it is limo's guess (`tolerances: {{{guess.name}: ...}}`)."
    )


def _places(some: Sequence[_Place]) -> str:
    return listed([placed(effect, [j + 1 for j in on]) for effect, on in some])
