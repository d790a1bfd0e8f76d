"""Tree of nested tests: the variables that the residual of a joint depends on.

Does it remember where the joint turned? If not only that, does it change with speed, with load,
with position, with time? Each question adds a generic family of columns to those that said yes
before it. They name no effect; they show on what ground the names stand.

Sizes: findings whose interval leaves it open whether there is anything at all.

An effect may predict better on motion held out and still be of no known size: a spring whose
stiffness may be zero, since a wrong body of the link does nearly as well. What the recordings do
not tell from nothing is no finding. Of elements that stand in for one another, as those of
presliding, what all of them take off says whether they are nothing.

Guesses: tolerances that nobody stated, and what other ones would change.

Where a recording's torques are currents times a constant, that constant is rarely known to better
than a tenth: an arm on a table stands level more often than a drive's constant is right.

What is guessed is tried: the search goes on around what was found, with a tolerance half and twice
as wide, or with scales of torques that may be off. Names that come or go are reported, but for
those that the same search brings without any change.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from estimators.diagnosis.from_torque.hypotheses.catalogue import found_in
from estimators.diagnosis.from_torque.hypotheses.search import Search
from estimators.diagnosis.from_torque.judgement.surrogate import stops
from estimators.diagnosis.from_torque.residuals.noise import ColumnTable, normal_equations
from estimators.diagnosis.quantities import listed, placed
from estimators.diagnosis.result import Test
from estimators.diagnosis.settings import LITTLE, MATTERS, TINY
from estimators.diagnosis.settings.fitting import CONTRIBUTION
from estimators.diagnosis.settings.judgement import BLACK_BOX, WORDING
from estimators.regression.evidence import Evidence, Prior, joined, posterior
from limo_driver.logs.readers.columns import CURRENT
from limo_driver.physics import GravityDirection, TorqueGain
from limo_driver.physics.catalogue import every_effect
from limo_driver.runtime.parameters import REAL

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence

    from estimators.diagnosis.from_torque.fitting.problem import RegressionProblem, Solution
    from estimators.diagnosis.from_torque.judgement.judged_set import JudgedSet
    from estimators.diagnosis.from_torque.residuals.noise import Noise
    from estimators.diagnosis.from_torque.residuals.observations import Observations
    from estimators.diagnosis.verdict import Finding, Interval
    from estimators.regression.evidence import NormalEquations, Posterior
    from limo_driver.physics import Simulation, Tolerances
    from limo_driver.recordings.recording import Recording
    from limo_driver.types import FloatArray


def tests_of(solution: Solution) -> tuple[Test, ...]:
    """Ask every question of every joint whose error is above its noise floor.

    A joint that moves in no stretch held out has nothing to judge an answer by, and is not asked.

    Args:
        solution: The chosen set; what it leaves is the noise floor, and its noise counts.
    """
    problem = solution.problem
    empty = solution.search.prior(())
    before = problem.left(solution.search.evidence.posterior(empty))
    after = problem.left(solution.fitted)
    tests: list[Test] = []
    for joint in range(problem.observed.n):
        rows = problem.observed.moving[:, joint]
        if not problem.split.held_out[:, joint].any():
            continue
        energy, floor = (float(np.sum(left[rows, joint] ** 2)) for left in (before, after))
        if energy > WORDING.at_floor**2 * floor:
            floor /= max(1, int(rows.sum()))
            tests += _Questions.of(problem, solution.noise, joint, floor).asked()
    return tuple(tests)


_Family = tuple[str, "Callable[[Observations, int], FloatArray]"]


@dataclass(frozen=True)
class _Questions:
    """One joint's residual, with nuisance columns and those of every question in a table."""

    problem: RegressionProblem
    joint: int  # 0-based
    columns: ColumnTable  # of one joint
    nuisance: Prior
    families: tuple[tuple[str, Prior], ...]
    products: NormalEquations
    floor: float  # mean square of the noise [N² m²]

    @classmethod
    def of(cls, problem: RegressionProblem, noise: Noise, joint: int, floor: float) -> _Questions:
        """Lay out the columns of all questions at a joint (0-based)."""
        residual = problem.target[:, joint : joint + 1]
        columns = ColumnTable(residual.shape[0], 1)
        nuisance = _nuisance(problem, columns, joint)
        level = float(problem.level[joint])
        sharp = [family(problem.observed, joint) for _, family in _FAMILIES]
        ends = np.cumsum([part.shape[1] for part in sharp])[:-1]
        made = np.split(problem.observed.filter(np.concatenate(sharp, axis=1)), ends, axis=1)
        families: list[tuple[str, Prior]] = []
        for (question, _), part in zip(_FAMILIES, made, strict=True):
            strength = np.maximum(np.sqrt(np.mean(part**2, axis=0)), TINY)
            index = columns.add((0,), np.ascontiguousarray(part / strength)[None])
            families.append((question, Prior.free(index, np.full(index.size, level))))
        return cls(
            problem,
            joint,
            columns,
            nuisance,
            tuple(families),
            normal_equations(
                columns, residual, _own(noise, joint), problem.split.fitted[:, [joint]]
            ),
            floor,
        )

    def asked(self) -> list[Test]:
        """Ask one question after the other; a yes stays for those that follow."""
        evidence = Evidence(self.products, self.nuisance)
        known = joined()
        gain, error = 0.0, self._error(known)
        reducible = max(error - self.floor, MATTERS * self.floor, TINY)
        tests: list[Test] = []
        for question, family in self.families:
            both = joined(known, family)
            more, less = evidence.gain(both), self._error(both)
            share = float(np.clip((error - less) / reducible, 0.0, 1.0))
            yes = more - gain > CONTRIBUTION.tellable and share > LITTLE
            tests.append(Test(self.joint + 1, question, share, yes))
            if yes:
                known, gain, error = both, more, less
        return tests

    def _error(self, prior: Prior) -> float:
        """Return the mean square on rows held out after a fit to the others [N² m²]."""
        fit: Posterior = posterior(self.products, self.nuisance, prior)
        left = self.problem.target[:, self.joint] - self.columns.apply(fit.index, fit.mean)[:, 0]
        return float(np.mean(left[self.problem.split.held_out[:, self.joint]] ** 2))


def _nuisance(problem: RegressionProblem, columns: ColumnTable, joint: int) -> Prior:
    """Copy the nuisance columns that act on a joint."""
    values, at = problem.columns.of_joint(joint)
    prior = problem.nuisance.prior
    place = {int(index): k for k, index in enumerate(prior.index)}
    own = np.array([k for k, index in enumerate(at) if int(index) in place], dtype=np.int64)
    index = columns.add((0,), np.ascontiguousarray(values[:, own])[None])
    known = np.array([place[int(at[k])] for k in own], dtype=np.int64)
    return replace(prior.of(known), index=index)


def _own(noise: Noise, joint: int) -> Noise:
    """Return the noise of one joint as that of an arm of one joint."""
    return replace(
        noise,
        weight=noise.weight[[joint]],
        white=noise.white[[joint]],
        known=noise.known[:, [joint]],
    )


def _sign(observed: Observations, j: int) -> FloatArray:
    return np.tanh(observed.motion.velocity[:, j] / BLACK_BOX.speeds[0])


def _memory(observed: Observations, j: int) -> FloatArray:
    return np.stack(stops(observed, j), axis=1)


def _rate(observed: Observations, j: int) -> FloatArray:
    v = observed.motion.velocity[:, j]
    sign = _sign(observed, j)
    fading = [sign * np.exp(-np.abs(v) / speed) for speed in BLACK_BOX.of_others]
    return np.stack([sign, v, v * np.abs(v), *fading], axis=1)


def _load(observed: Observations, j: int) -> FloatArray:
    load = observed.load[:, j]
    load = load / max(float(np.abs(load).max()), TINY)
    sign = _sign(observed, j)
    return np.stack([load, sign * np.abs(load), sign * load], axis=1)


def _position(observed: Observations, j: int) -> FloatArray:
    return _with_sign(_hats(observed.motion.position[:, j]), _sign(observed, j))


def _time(observed: Observations, j: int) -> FloatArray:
    return _with_sign(_hats(observed.motion.time), _sign(observed, j))


def _with_sign(hats: FloatArray, sign: FloatArray) -> FloatArray:
    return np.concatenate([hats, sign[:, None] * hats], axis=1)


def _hats(values: FloatArray) -> FloatArray:
    knots = np.linspace(values.min(), max(values.max(), values.min() + 1e-6), BLACK_BOX.hats)
    return np.maximum(0.0, 1.0 - np.abs(values[:, None] - knots) / (knots[1] - knots[0]))


_FAMILIES: tuple[_Family, ...] = (
    ("Does the residual depend on the distance since the last reversal?", _memory),
    ("Does it change with speed?", _rate),
    ("Does it change with the load on the joint?", _load),
    ("Does it change with the position of the joint?", _position),
    ("Does it change with time, at the same position and speed?", _time),
)


def unsure(findings: Sequence[Finding], given: Simulation) -> set[tuple[str, tuple[int, ...]]]:
    """Return effect and joints (1-based) of findings whose size may be nothing.

    Args:
        findings: With parameters and their intervals.
        given: The simulation that was compared; a wrong value differs from the one stated there.
    """
    sized_by = {effect.name: effect.sized_by for effect in every_effect()}
    return {
        (item.effect, item.joints)
        for item in findings
        if not _is_sure(item, given, sized_by.get(item.effect, ()))
    }


def _is_sure(item: Finding, given: Simulation, sized_by: tuple[str, ...]) -> bool:
    """Say whether an interval of the size is known and leaves out nothing, or what was stated."""
    stated = None
    if item.kind == "wrong_parameter":
        stated = found_in(given, item.effect, item.joints, missing=False)
    elif item.effect == GravityDirection.name:  # every simulation states where gravity points to
        x, y, z = map(float, given.model.gravity)
        stated = GravityDirection(gravity=(x, y, z))
    known = sized_by
    if stated is not None:
        known = tuple(p.name for p in stated.parameters() if p.kind == REAL)
    pairs = [
        (interval, getattr(stated, name, None))
        for name in known
        if (interval := item.parameters.get(name)) is not None and interval.ci95 is not None
    ]
    if not pairs or any(_leaves_out(interval, was) for interval, was in pairs):
        return True
    # each element of a list may be nothing for the sake of its neighbours, but hardly all of them
    several = any(np.size(interval.value) > 1 for interval, _ in pairs)
    return several and stated is None and item.signs.get("material", 0.0) >= 1.0


def _leaves_out(interval: Interval, was: Any) -> bool:  # noqa: ANN401  # of any parameter
    """Say whether an interval, or one of several, does not hold what was; zero if that is None."""
    ends = np.asarray(interval.ci95, dtype=float).reshape(-1, 2)
    before = np.zeros(len(ends)) if was is None else np.ravel(np.asarray(was, dtype=float))
    if before.size != len(ends):
        return True  # of another form than before
    return bool(np.any((ends[:, 0] > before) | (ends[:, 1] < before)))


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
    return replace(simulation, tolerances=replace(known, gain=MATTERS, stated=stated))


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
    off = np.sum((tau - constant * i) ** 2, axis=0) / np.maximum(np.sum(tau**2, axis=0), TINY**2)
    return bool(some.any() and (off[some] < LITTLE**2).all())


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
    as_it_is = _sought(solution, _Guess("", 1.0)) | named | base
    for guess in _guesses(known):
        found = _sought(solution, guess)
        gone, come = sorted(named - found), sorted(found - as_it_is)
        # a wider tolerance takes names away, a narrower one adds some; what else comes or goes is
        # in exchange for those
        if gone if guess.times >= 1.0 else come:
            yield _sentence(guess, gone, come[: WORDING.listed])


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
            yield from (_Guess(name, times, times * width) for times in (0.5, 2.0))
    if "gain" in known.assumed and not known.gain:
        yield _Guess("gain", 1.0, MATTERS)


def _sought(solution: Solution, guess: _Guess) -> set[_Place]:
    """Return what is found around a solution with another tolerance, by effect and joints."""
    problem = solution.problem
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
