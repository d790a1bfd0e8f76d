"""Writing: which parts of a fit go into the improved simulation.

A part is what is found or moved of one effect at its joints, or of the bodies. From the fit to all
rows, one step leads to the fit without motion of another kind, several times, which is each time
held against that motion. A joint that is surely worse there than given has parts that do not hold:
those are as given, the fewest that mend it. Nor is a part written that acts on less than a share of
the rows that count, as in half a second at one position, and surely helps on nothing left out. What
may as well be better as worse is written, and a note says so if it was found.

A diagnosis is helped where a law was learned from too little motion to be known beyond it.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property, partial
from itertools import chain
from typing import TYPE_CHECKING

import numpy as np

from estimators.diagnosis.comparison import BODIES, ComparedPart, parts_of, widths_of
from estimators.diagnosis.from_torque.fitting.contribution import TINY, own_joints
from estimators.diagnosis.from_torque.fitting.laws import farther, in_domains
from estimators.diagnosis.from_torque.fitting.linearised import linearised
from estimators.diagnosis.from_torque.judgement.judged_set import places_of
from estimators.diagnosis.headline import LINK_INERTIA
from estimators.diagnosis.held_out import Split, blocks, of_another_kind, rmse, rmse_change
from estimators.diagnosis.quantities import of_joints
from estimators.diagnosis.settings.fitting import CONTRIBUTION
from estimators.diagnosis.settings.judgement import JUDGEMENT
from estimators.diagnosis.settings.residuals import ELSEWHERE
from limo_driver.model.units import unit_of
from limo_driver.physics import QuadraticDrag

if TYPE_CHECKING:
    from collections.abc import Collection, Iterator, Sequence

    from estimators.diagnosis.from_torque.hypotheses.candidates import Candidate
    from estimators.diagnosis.from_torque.judgement.judged_set import JudgedSet
    from estimators.diagnosis.from_torque.residuals.observations import Observations
    from limo_driver.physics import Effect, Simulation
    from limo_driver.types import BoolArray, FloatArray


@dataclass(frozen=True)
class Withheld:
    """A part that is not written."""

    part: str
    why: str


@dataclass(frozen=True)
class Elsewhere:
    """Fits without motion of another kind, and that motion."""

    kind: str  # what was left out
    given: Simulation
    floor: FloatArray  # noise floor of each joint, (n,) [N m]
    turns: tuple[tuple[Observations, BoolArray], ...]  # with each fit; rows left out

    @classmethod
    def of(cls, judged: JudgedSet, improved: Observations, given: Simulation) -> Elsewhere:
        """Fit a judged set again without each kind of motion.

        Args:
            judged: The set.
            improved: The recordings with its fit to all rows.
            given: The simulation that it may improve.
        """
        observed, places = judged.problem.observed, places_of(judged.solution)
        kind, chosen = of_another_kind(observed)
        around = linearised(improved, observed.simulation, places)

        def fitted(rows: BoolArray) -> Observations:
            split = Split.without(observed, rows).fitted
            return in_domains(around.learned_from(split, observed.simulation), given, split)

        turns = tuple((fitted(rows), rows) for rows in chosen)
        return cls(kind, given, judged.remaining.floor, turns)

    @cached_property
    def _as_given(self) -> Observations:
        return self.turns[0][0].under(self.given)

    @property
    def _measured(self) -> BoolArray:
        """Mark the torques that were measured while nothing pushed, at rest as well, (K, n)."""
        first = self._as_given
        pushed = first.disturbed
        return first.measured_on(
            np.ones(len(first.kept), dtype=bool) if pushed is None else ~pushed
        )

    @property
    def as_given(self) -> FloatArray:
        """RMSE of each joint by the given simulation, (n,) [N m]."""
        return rmse(self._as_given.residual, self._measured)

    def change(self, parts: Collection[str], than: Collection[str] | None = None) -> FloatArray:
        """Return the change of each joint's RMSE, and the ends of its interval, (3, n) [N m].

        Args:
            parts: That are as given, by name.
            than: Likewise, of what is changed; all of it, if not said.
        """
        if than is not None:
            return self._compared(self._left(than), self._left(parts))
        first = self._as_given.residual
        given = np.concatenate([first[rows] for _, rows in self.turns])
        return self._compared(given, self._left(parts))

    def _compared(self, before: FloatArray, after: FloatArray) -> FloatArray:
        out = np.concatenate([np.flatnonzero(rows) for _, rows in self.turns])
        counts, block = self._measured[out], blocks(self._as_given)[out]
        middle = rmse(after, counts) - rmse(before, counts)
        return np.stack([middle, *rmse_change(before, after, block, counts)])

    def offset(self, parts: Collection[str]) -> FloatArray:
        """Return the change that an offset of each joint's torque makes, as `change` does, (3, n).

        It is what the fits leave in the mean of the motion that they know.

        Args:
            parts: That are as given, by name.
        """
        return self._compared(self._left(parts), self._left(parts, less_mean=True))

    @property
    def reaches(self) -> bool:
        """Whether drags surely go on as themselves beyond the speeds they were learned from."""
        left = [farther(turn, self.given).residual[rows] for turn, rows in self.turns]
        change = self._compared(self._left(()), np.concatenate(left))
        return bool((change[2] < 0).any() and not (change[1] > 0).any())

    def _left(self, parts: Collection[str], *, less_mean: bool = False) -> FloatArray:
        """Return what fits leave of the motion that was left out for them, some parts as given."""

        def left(turn: Observations, rows: BoolArray) -> FloatArray:
            found = turn.under(without(turn.simulation, self.given, parts))
            less = mean_left(found, ~rows) if less_mean else 0.0
            return found.residual[rows] - less

        return np.concatenate([left(*turn) for turn in self.turns])


def mean_left(found: Observations, rows: BoolArray) -> FloatArray:
    """Return the mean of what is left over moving rows among `rows` (K,), (n,) [N m]."""
    some = found.moving & rows[:, None]
    return np.sum(np.where(some, found.residual, 0.0), axis=0) / np.maximum(some.sum(axis=0), 1)


def without(improved: Simulation, given: Simulation, parts: Collection[str]) -> Simulation:
    """Return the improved simulation with some parts, by name, as given."""
    for name in parts:
        every = chain(parts_of(improved, given), widths_of(improved, given))
        improved = next((part.without for part in every if part.name == name), improved)
    return improved


@dataclass(frozen=True)
class Written:
    """What of a fit is written, and what is not."""

    judged: JudgedSet  # with its proof by what is written
    improved: Observations
    withheld: tuple[Withheld, ...] = ()
    kind: str = ""  # of motion that was left out for the proof

    unsure: tuple[int, ...] = ()  # joints, 1-based, of what was found, that are not surely better
    elsewhere: Elsewhere | None = None  # the proof
    silent: tuple[str, ...] = ()  # parts that are as given, since no verdict reports them
    offsets: tuple[tuple[int, float], ...] = ()  # of torques: joint, 1-based, and [N m]

    def recurs(self, effect: Effect) -> bool:
        """Say whether what passes came again in recordings that were left out whole."""
        if self.elsewhere is None or np.unique(self.improved.recording).size < 2:  # noqa: PLR2004
            return False
        known = [*(item.part for item in self.withheld), *self.silent]
        name = effect.place.replace("_", " ")
        more = self.elsewhere.change([*known, name], known)[1]
        return bool((more[[joint - 1 for joint in effect.joints]] > 0).any())

    def notes(self) -> Iterator[str]:
        """Say what is not written, and where that may as well not be, in one sentence each."""
        parts: dict[str, list[str]] = {}
        for item in self.withheld:
            parts.setdefault(item.why, []).append(item.part)
        if parts:
            some = "; ".join(f"{', '.join(names)} ({why})" for why, names in parts.items())
            yield (
                "Not written into the improved simulation, which has these as given, since they do "
                f"not hold where {self.kind} were left out: {some}."
            )
        if self.offsets:
            unit = self.improved.unit
            some = ", ".join(
                f"{value:+.3g} {unit('N m', joint - 1)} at joint {joint}"
                for joint, value in self.offsets
            )
            yield (
                f"Where {self.kind} were left out, offsets of the torque surely help, and are "
                f"written into the improved simulation: {some}."
            )
        if self.unsure:
            where = of_joints(self.unsure)
            yield (
                f"Where {self.kind} were left out, the improved simulation is not surely better "
                f"than the given one at {where}."
            )


def written(judged: JudgedSet, improved: Observations, given: Simulation) -> Written:
    """Return what of a fit is written.

    Args:
        judged: The set.
        improved: The recordings with its fit to all rows.
        given: The simulation that it may improve.
    """
    proven = in_domains(judged.beside, given, judged.problem.split.fitted)
    elsewhere = Elsewhere.of(judged, improved, given)
    improved = in_domains(improved, given, improved.moving)
    if any(isinstance(x, QuadraticDrag) for x in improved.simulation.effects) and elsewhere.reaches:
        proven, improved = (farther(some, given) for some in (proven, improved))
    found = withheld(elsewhere, improved)
    names = [item.part for item in found]

    def kept(some: Observations) -> Observations:
        return some.under(without(some.simulation, given, names)) if names else some

    judged = replace(judged, beside=kept(proven))
    still, unknown = still_named(judged, names)
    judged = replace(judged, named=still, unknown=unknown)
    some = {j for i in judged.findings for j in judged.problem.candidates[i].joints}
    not_better = elsewhere.change(names)[2] >= 0
    unsure = tuple(j + 1 for j in sorted(some) if not_better[j])
    return Written(judged, kept(improved), found, elsewhere.kind, unsure, elsewhere)


def still_named(
    judged: JudgedSet, parts: Collection[str]
) -> tuple[tuple[int, ...], tuple[int, ...]]:
    """Return what is still named where some parts do not hold, and the joints of what is unknown.

    What a law that does not hold was found for is there all the same, as far as it is no noise.

    Args:
        judged: The set, proven without those parts.
        parts: By name.
    """
    problem, floor = judged.problem, judged.remaining.floor
    gone = [i for i in judged.findings if _part_of(problem.candidates[i]) in parts]
    error = rmse(judged.proven, problem.split.held_out)
    large = error > np.hypot(1.0, JUDGEMENT.predictable) * floor
    joints = {j for i in gone for j in own_joints(problem, i) if large[j]}
    named = tuple(i for i in judged.named if i not in gone)
    return named, tuple(sorted({*judged.unknown, *joints}))


def _part_of(candidate: Candidate) -> str:
    """Return the name of the part that a candidate becomes."""
    if candidate.effect == LINK_INERTIA:
        return BODIES
    place = (candidate.effect.replace("_", " "), of_joints([j + 1 for j in candidate.joints]))
    return ", ".join(place if candidate.joints else place[:1])


def withheld(elsewhere: Elsewhere, improved: Observations) -> tuple[Withheld, ...]:
    """Return the parts that are not to be written.

    Args:
        elsewhere: The proof.
        improved: The recordings with what would be written.
    """
    parts = list(parts_of(improved.simulation, elsewhere.given))
    found: dict[str, Withheld] = {}
    for step in (_of_several_joints, _of_one_joint, _of_several_joints, partial(_rare, improved)):
        rest = [part for part in parts if part.name not in found]
        found |= {item.part: item for item in step(elsewhere, rest, tuple(found))}
    return tuple(found.values())


def _of_several_joints(
    elsewhere: Elsewhere, parts: Sequence[ComparedPart], known: Sequence[str]
) -> Iterator[Withheld]:
    """Yield the parts of several joints that make one surely worse: clearly so, or the arm, too.

    Args:
        elsewhere: The proof.
        parts: That may be written.
        known: Names of those that are not.
    """
    scale = np.maximum(elsewhere.as_given, TINY)
    now = elsewhere.change(known)
    for part in parts:
        own = [j - 1 for j in part.joints] or list(range(scale.size))
        if len(part.joints) == 1 or not (now[1][own] > 0).any():
            continue
        other = elsewhere.change([*known, part.name])
        mended = now[0] - other[0]
        j = own[int(np.argmax(np.where(now[1] > 0, mended / scale, -np.inf)[own]))]
        sum_now, sum_other = (np.sum(((scale + x[0]) / scale) ** 2) for x in (now, other))
        much = mended[j] > CONTRIBUTION.material * elsewhere.floor[j]
        if much or (mended[j] > 0 and sum_other < sum_now):
            yield Withheld(part.name, _in_words(now, j, elsewhere))
            known, now = (*known, part.name), other


def _of_one_joint(
    elsewhere: Elsewhere, parts: Sequence[ComparedPart], known: Sequence[str]
) -> Iterator[Withheld]:
    """Yield the parts of joints that are surely worse: the one without which it is not, or all."""
    now = elsewhere.change(known)
    own = {
        j: [part.name for part in parts if part.joints == (j + 1,)]
        for j in np.flatnonzero(now[1] > 0).tolist()
    }
    best: dict[int, tuple[float, list[str]]] = {}
    for k in range(max(map(len, own.values()), default=0)):
        some = {j: names[k] for j, names in own.items() if len(names) > max(k, 1)}
        other = elsewhere.change([*known, *some.values()]) if some else now
        for j, name in some.items():
            if other[0][j] < min(best.get(j, (0.0, []))[0], 0.0):
                best[j] = (float(other[0][j]), [name])
    for j, names in own.items():
        yield from (
            Withheld(name, _in_words(now, j, elsewhere)) for name in best.get(j, (0.0, names))[1]
        )


def _rare(
    improved: Observations,
    elsewhere: Elsewhere,
    parts: Sequence[ComparedPart],
    known: Sequence[str],
) -> Iterator[Withheld]:
    """Yield laws that were missing, act on too few rows, and surely help on none left out."""
    rows = improved.moving
    stated = {effect.place.replace("_", " ") for effect in elsewhere.given.effects}
    for part in parts:
        if part.name in stated or part.name == BODIES:
            continue
        other = improved.under(part.without).simulated
        added = np.where(rows, improved.simulated - other, 0.0)
        square, fourth = np.sum(added**2, axis=0), np.sum(added**4, axis=0)
        acts = square > 0
        share = square[acts] ** 2 / (fourth[acts] * rows.sum(axis=0)[acts])
        if not acts.any() or share.max() >= ELSEWHERE.share:
            continue
        if not (elsewhere.change(known, [*known, part.name])[2][acts] < 0).any():
            yield Withheld(part.name, f"acts on {100 * share.max():.1g} % of the rows alone")


def _in_words(change: FloatArray, j: int, elsewhere: Elsewhere) -> str:
    middle, low, high = change[:, j]
    unit = unit_of("N m", elsewhere.given.model.sliding, j)
    return f"RMSE of joint {j + 1} {middle:+.2g} {unit}, 95 % interval {low:+.2g} to {high:+.2g}"
