"""Laws: choose among several equations by their evidence, each at its best settings.

Some effects follow one of several laws, as presliding does those of Maxwell slip, LuGre, Dahl, and
Bouc and Wen. Where the grid of settings of one law lies badly, another looks better than it is; so
each competes at its best settings, and pays for them by Schwarz' criterion. So do effects that are
confused with each other: play of a width between two of the grid looks like presliding.

Domains: the motion that laws were learned from is said with them, and how far they go on.

Source: Schwarz, "Estimating the dimension of a model", Annals of Statistics 6(2), 1978.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import combinations
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy.optimize import minimize

from estimators.diagnosis.from_torque.fitting.contribution import coefficients
from estimators.diagnosis.from_torque.hypotheses.candidates import Candidate, LawEvidence, entered
from estimators.diagnosis.from_torque.hypotheses.catalogue import rivals
from estimators.diagnosis.from_torque.hypotheses.ripple import with_fewer_lines
from estimators.diagnosis.from_torque.residuals.noise import ColumnTable
from estimators.diagnosis.headline import likelier
from estimators.diagnosis.settings import FAR, FEW, HALF, LITTLE, MATTERS, TINY
from estimators.diagnosis.settings.fitting import CONTRIBUTION, LAWS, REFINEMENT
from estimators.diagnosis.stages import end_if_late
from estimators.regression.definite import is_more, ranked
from estimators.regression.evidence import Evidence, NormalEquations, Prior, joined
from limo_driver.physics import PreslidingHysteresis, QuadraticDrag, ViscousFriction
from limo_driver.physics.catalogue import confusion_of
from limo_driver.physics.domain import Domain
from limo_driver.physics.effect import TorqueEffect

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from estimators.diagnosis.from_torque.fitting.problem import RegressionProblem, Solution
    from estimators.diagnosis.from_torque.residuals.noise import Noise
    from estimators.diagnosis.from_torque.residuals.observations import Observations
    from limo_driver.physics import Effect, Hypothesis, Simulation
    from limo_driver.types import BoolArray, FloatArray, IntArray


@dataclass(frozen=True)
class Likeliest:
    """The likeliest law of an effect, its settings refined."""

    hypothesis: Hypothesis
    evidence: float  # of it, less what its settings and the rarity of the effect cost [nat]
    laws: tuple[LawEvidence, ...]  # the evidence of the named ones, best first


def likeliest(solution: Solution, member: int, other: int, around: Setting) -> Likeliest:
    """Let the laws of an effect compete in a member's place.

    Args:
        solution: The set with the member.
        member: In whose place.
        other: A candidate of the effect; the member itself for its own.
        around: Everything else of the set.
    """
    problem = solution.problem
    near = _best_of_each(solution, member, other)
    competing = [*near, *rivals(near[0]), *with_fewer_lines(near[0], problem.observed)]
    for i, item in enumerate(problem.candidates):
        if item.hypothesis is not None and any(item.hypothesis is one for one in near):
            found = solution.having((*(m for m in solution.members if m != member), i))
            competing += _of_few_slips(item.hypothesis, coefficients(found, i))
    tried = [refine(hypothesis, around) for hypothesis in competing]
    setting = 0.5 * float(np.log(problem.split.fitted.sum()))  # [nat]
    scored = [(hypothesis, gain - setting * len(hypothesis.settings)) for hypothesis, gain in tried]
    scored = ranked(scored, lambda item: item[1])
    laws: dict[str, float] = {}
    for hypothesis, evidence in scored:
        laws.setdefault(hypothesis.law, evidence)
    named = tuple(LawEvidence(law, evidence) for law, evidence in laws.items() if law)
    best, evidence = scored[0]
    return Likeliest(best, evidence - problem.candidates[other].price, named)


def confused(solution: Solution, member: int) -> list[int]:
    """Return the best candidate of each effect that may only look worse for its settings.

    Those have settings that were tried on a grid, as a member has, are confused with it by what the
    catalogue says, act at the same joints, and bring most of what it brings as they are.
    """
    problem = solution.problem
    own, taken = problem.candidates[member], {problem.candidates[i].slot for i in solution.members}
    gain, rest = solution.search.gain, tuple(i for i in solution.members if i != member)
    enough = gain(rest) + CONTRIBUTION.most * (gain((*rest, member)) - gain(rest))
    best: dict[str, tuple[float, int]] = {}
    for i, item in enumerate(problem.candidates):
        if item.slot in taken or not compete(item, own):
            continue
        brought = gain((*rest, i))
        if brought >= max(enough, best.get(item.effect, (enough,))[0]):
            best[item.effect] = (brought, i)
    return [i for _, i in best.values()]


def compete(other: Candidate, own: Candidate) -> bool:
    """Say whether another effect is refined beside a member, so that evidence tells them apart."""
    if other.hypothesis is None or own.hypothesis is None or other.joints != own.joints:
        return False
    both = other.hypothesis.family is not None and (own.hypothesis.settings or own.hypothesis.law)
    return bool(both) and confusion_of(other.effect, own.effect) is not None


def _best_of_each(solution: Solution, member: int, other: int) -> list[Hypothesis]:
    """Return the best hypothesis of each law of an effect in a member's place, best first.

    Of equations that have no name, those that are far behind are left out.
    """
    rest = tuple(i for i in solution.members if i != member)
    best: dict[object, tuple[float, Hypothesis]] = {}
    for i, candidate in enumerate(solution.problem.candidates):
        hypothesis = candidate.hypothesis
        if hypothesis is None or candidate.place != solution.problem.candidates[other].place:
            continue
        law = hypothesis.law or getattr(hypothesis.family, "func", None)
        gain = solution.search.gain((*rest, i))
        if law not in best or is_more(gain, best[law][0]):
            best[law] = (gain, hypothesis)
    falling = ranked(best.values(), lambda item: item[0])
    least = falling[0][0] - LAWS.refinable
    return [hypothesis for gain, hypothesis in falling if hypothesis.law or gain > least]


def _of_few_slips(hypothesis: Hypothesis, carried: FloatArray) -> Iterator[Hypothesis]:
    """Yield springs that slip at a few widths of their own, in place of those of a grid.

    A width between two of the grid comes out as a share of either; and what these leave looks like
    play, or like another friction.

    Args:
        hypothesis: Springs of a grid of widths; others have none.
        carried: By each of them where it slips [N m].
    """
    slips = [
        x.width[0] for x in hypothesis.terms if isinstance(x, PreslidingHysteresis) and x.width
    ]
    if hypothesis.settings or not slips:
        return
    used = carried > LAWS.carried * carried.sum()
    widths, carried = np.array(slips)[used], carried[used]

    def apart(cuts: tuple[int, ...]) -> float:
        groups = zip(np.split(np.log(widths), cuts), np.split(carried, cuts), strict=True)
        return sum(float(c @ (w - np.average(w, weights=c)) ** 2) for w, c in groups)

    for many in range(1, min(FEW, widths.size) + 1):
        cuts = min(combinations(range(1, widths.size), many - 1), key=apart)
        split = zip(np.split(carried, cuts), np.split(carried / widths, cuts), strict=True)
        own = [float(force.sum() / stiffness.sum()) for force, stiffness in split]
        if min(own) > min(slips):  # at its end is what is narrower, as any sharper sign
            yield PreslidingHysteresis.slips(hypothesis.joints[0] + 1, *own)


def sentence_of(laws: Sequence[LawEvidence]) -> str:
    """Say which law it is, and how much likelier than the next; nothing where there is but one."""
    if not laws[1:]:
        return ""
    best = laws[0]
    lead = best.log_evidence - laws[1].log_evidence
    if lead < CONTRIBUTION.tellable:
        alike = [
            law.law for law in laws if best.log_evidence - law.log_evidence < CONTRIBUTION.tellable
        ]
        return f" Which law it follows ({', '.join(alike)}) these recordings cannot tell."
    return f" Its law is {best.law}, {likelier(lead)} than {laws[1].law}."


@dataclass(frozen=True)
class Setting:
    """Everything around one candidate: the columns that are fitted with it."""

    problem: RegressionProblem
    others: Prior
    noise: Noise

    @property
    def nuisance(self) -> Prior:
        """Of what may move within its tolerance."""
        return self.problem.nuisance.prior

    def entered(self, hypothesis: Hypothesis, columns: ColumnTable) -> Candidate | None:
        """Enter a hypothesis with its columns in a table; None if it can have no influence."""
        return entered(hypothesis, self.problem.observed, columns, self.problem.level)


def refine(hypothesis: Hypothesis, around: Setting) -> tuple[Hypothesis, float]:
    """Move the settings of a hypothesis to where the evidence is highest.

    Returns:
        The hypothesis with its best settings, and its log evidence given the others.
    """
    local = _Local(around)
    if hypothesis.family is None:
        return hypothesis, local.gain(hypothesis)
    low, high = np.array(hypothesis.bounds).T
    # Positive settings span decades; others are angles and rest positions.
    scaled = low > 0
    with np.errstate(divide="ignore", invalid="ignore"):
        ratio = np.where(scaled, high / low, 1.0)

    def settings(x: FloatArray) -> tuple[float, ...]:
        x = np.clip(x, 0.0, 1.0)
        return tuple(np.where(scaled, low * ratio**x, low + (high - low) * x).tolist())

    start = np.array(hypothesis.settings)
    with np.errstate(divide="ignore", invalid="ignore"):
        x0 = np.where(scaled, np.log(start / low) / np.log(ratio), (start - low) / (high - low))
    family, begin = hypothesis.family, np.clip(x0, REFINEMENT.inside, 1.0 - REFINEMENT.inside)

    def cost(x: FloatArray) -> float:
        return -local.gain(family(*settings(x)))

    found = minimize(
        cost,
        begin,
        method="Nelder-Mead",
        options={
            "maxfev": REFINEMENT.evaluations,
            "xatol": REFINEMENT.tolerance,
            "fatol": LITTLE,
            "initial_simplex": _simplex(begin),
        },
    )
    best, gain = family(*settings(found.x)), -float(found.fun)
    unchanged = local.gain(hypothesis)
    return (best, gain) if gain > unchanged else (hypothesis, unchanged)


def _simplex(start: FloatArray) -> FloatArray:
    step = MATTERS * np.where(start > HALF, -1.0, 1.0)  # towards the middle
    return np.concatenate([start[None], start + np.diag(step)])


class _Local:
    """Evidence of one hypothesis beside fixed others, where only its own joints' sums change."""

    def __init__(self, around: Setting) -> None:
        self.around = around
        base = joined(around.nuisance, around.others)
        self.base = base
        size = base.index.size
        self._gram, self._product = np.zeros((size, size)), np.zeros(size)
        self._white: list[tuple[FloatArray, IntArray, FloatArray]] = []
        place = {int(column): k for k, column in reversed(list(enumerate(base.index)))}
        for joint in range(around.problem.observed.n):
            values, at = around.problem.columns.of_joint(joint)
            mine = [k for k, column in enumerate(at) if int(column) in place]
            rows = around.problem.split.fitted[:, joint]
            A = around.noise.whiten(values[:, mine], joint, rows)
            y = around.noise.whiten(around.problem.target[:, joint], joint, rows)
            to = np.array([place[int(at[k])] for k in mine], dtype=np.int64)
            self._gram[np.ix_(to, to)] += A.T @ A
            self._product[to] += A.T @ y
            self._white.append((A, to, y))
        count = around.nuisance.index.size
        nuisance = Prior.free(np.arange(count), around.nuisance.deviation)
        self._others = replace(around.others, index=np.arange(count, size))
        self._alone = Evidence(NormalEquations(self._gram, self._product), nuisance)

    def gain(self, hypothesis: Hypothesis) -> float:
        """Return the log evidence of the hypothesis together with the others."""
        end_if_late()
        problem = self.around.problem
        table = ColumnTable(len(problem.observed.kept), problem.observed.n)
        candidate = self.around.entered(hypothesis, table)
        if candidate is None:
            return -REFINEMENT.rejected
        size, more = self.base.index.size, table.count
        gram = np.zeros((size + more, size + more))
        gram[:size, :size] = self._gram
        product = np.append(self._product, np.zeros(more))
        for joint, (A, to, y) in enumerate(self._white):
            values, at = table.of_joint(joint)
            if not at.size:
                continue
            B = self.around.noise.whiten(values, joint, problem.split.fitted[:, joint])
            gram[np.ix_(to, size + at)] += A.T @ B
            gram[np.ix_(size + at, size + at)] += B.T @ B
            product[size + at] += B.T @ y
        gram[size:, :size] = gram[:size, size:].T
        own = replace(candidate.prior, index=size + candidate.prior.index)
        evidence = self._alone.extended(NormalEquations(gram, product))
        prior = joined(self._others, own)
        gain = evidence.gain(prior)
        if not hypothesis.sized:
            return gain
        fit = evidence.posterior(prior)  # of another size than one, its settings would be others
        off, deviation = float(fit.mean[-1]) - 1.0, float(fit.deviation[-1])  # none at a limit
        return gain - 0.5 * (off / deviation) ** 2 if deviation else -REFINEMENT.rejected


def replaced(candidate: Candidate, hypothesis: Hypothesis, around: Setting) -> Candidate | None:
    """Return the candidate with a refined hypothesis, its columns added to the table."""
    new = around.entered(hypothesis, around.problem.columns)
    kept = ("kind", "variants", "laws", "prior_penalty")
    return new and replace(new, **{name: getattr(candidate, name) for name in kept})


def in_domains(found: Observations, given: Simulation, rows: BoolArray) -> Observations:
    """Return the recordings with a simulation that says of which motion its laws were learned.

    Those are the laws that were missing. A slope of friction that was stated, and moved, goes on as
    stated far beyond the speeds that were seen, or near them where they hardly varied.

    Args:
        found: With what was fitted.
        given: What was stated.
        rows: That were fitted to, (K, n).
    """
    stated = {effect.place: effect for effect in given.effects}

    def limited(effect: Effect) -> Effect:
        before = stated.get(effect.place)
        if not isinstance(effect, TorqueEffect) or effect == before:
            return effect
        slope = before.f_v if isinstance(before, ViscousFriction) else None
        known = before.domain if isinstance(before, TorqueEffect) else None
        if before is not None and known is None and slope is None:
            return effect
        seen = _seen(found, effect, rows[:, effect.joint - 1])
        if not seen:
            return effect
        if slope is not None and known is None:
            j = effect.joint - 1
            seen["speed"] *= _reach(np.abs(found.slow.velocity[rows[:, j], j]))
        domain = Domain(**seen, slope=slope if known is None else known.slope).joined(known)
        return replace(effect, domain=domain)

    simulation = found.simulation
    return found.under(replace(simulation, effects=tuple(map(limited, simulation.effects))))


def _reach(speed: FloatArray) -> float:
    """Return how many times the speeds seen a slope goes on that was fitted to them.

    Friction at one speed tells a slope from dry friction by what is believed of both alone; what
    tells them apart is the variance of speeds. That of a swing lets a slope go on far.

    Args:
        speed: Of one joint, where it was fitted, (K,) [rad/s].
    """
    varied = float(np.mean(speed**2)) / max(float(np.mean(speed)) ** 2, TINY) - 1.0
    return 1.0 + (FAR - 1.0) * float(np.clip(varied / ((np.pi / 2.0) ** 2 / 2.0 - 1.0), 0.0, 1.0))


def farther(found: Observations, given: Simulation) -> Observations:
    """Return the recordings with new drags that hold at several times the speeds that were seen."""
    stated = {effect.place for effect in given.effects}

    def reaching(effect: Effect) -> Effect:
        known = effect.domain if isinstance(effect, QuadraticDrag) else None
        if known is None or known.speed is None or effect.place in stated:
            return effect
        return replace(effect, domain=replace(known, speed=FAR * known.speed))

    simulation = found.simulation
    return found.under(replace(simulation, effects=tuple(map(reaching, simulation.effects))))


def _seen(found: Observations, effect: TorqueEffect, rows: BoolArray) -> dict[str, Any]:
    """Return the motion of some rows (K,), as the domain of an effect has it."""
    slow, j = found.slow, effect.joint - 1
    if not rows.any():
        return {}
    values = {"position": slow.position[rows, j], "speed": np.abs(slow.velocity[rows, j])}
    if slow.temperature is not None:
        values["temperature"] = slow.temperature[rows, j]
    seen = {name: values[name] for name in effect.known_by if name in values}
    return {
        name: float(some.max()) if name == "speed" else (float(some.min()), float(some.max()))
        for name, some in seen.items()
    }
