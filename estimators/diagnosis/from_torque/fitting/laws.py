"""Laws: choose among several equations by their evidence, each at its best settings.

Some effects follow one of several laws, as presliding does those of Maxwell slip, LuGre, Dahl, and
Bouc and Wen. Where the grid of settings of one law lies badly, another looks better than it is; so
each competes at its best settings, and pays for them by Schwarz' criterion. So do effects that are
confused with each other: play of a width between two of the grid looks like presliding.

Source: Schwarz, "Estimating the dimension of a model", Annals of Statistics 6(2), 1978.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from estimators.diagnosis.from_torque.fitting.refinement import refine
from estimators.diagnosis.from_torque.hypotheses.catalogue import rivals
from estimators.diagnosis.from_torque.hypotheses.ripple import with_fewer_lines
from estimators.diagnosis.from_torque.selection.candidates import LawEvidence
from estimators.diagnosis.settings.fitting import CONTRIBUTION, LAWS
from estimators.diagnosis.wording import likelier
from estimators.regression.ties import is_more, ranked
from limo_driver.physics.catalogue import confusion_of

if TYPE_CHECKING:
    from collections.abc import Sequence

    from estimators.diagnosis.from_torque.fitting.problem import RegressionProblem, Solution
    from estimators.diagnosis.from_torque.fitting.refinement import Setting
    from estimators.diagnosis.from_torque.selection.candidates import Candidate
    from limo_driver.physics import Hypothesis


@dataclass(frozen=True)
class Likeliest:
    """The likeliest law of an effect, its settings refined."""

    hypothesis: Hypothesis
    evidence: float  # of it, less what its settings and the rarity of the effect cost [nat]
    laws: tuple[LawEvidence, ...]  # the evidence of the named ones, best first


def likeliest(
    problem: RegressionProblem, solution: Solution, member: int, other: int, around: Setting
) -> Likeliest:
    """Let the laws of an effect compete in a member's place.

    Args:
        problem: What is fitted.
        solution: The set with the member.
        member: In whose place.
        other: A candidate of the effect; the member itself for its own.
        around: Everything else of the set.
    """
    near = _best_of_each(problem, solution, member, other)
    competing = [*near, *rivals(near[0]), *with_fewer_lines(near[0], problem.observed)]
    tried = [refine(hypothesis, around) for hypothesis in competing]
    setting = 0.5 * float(np.log(around.use.sum()))  # [nat]
    scored = [(hypothesis, gain - setting * len(hypothesis.settings)) for hypothesis, gain in tried]
    scored = ranked(scored, lambda item: item[1])
    laws: dict[str, float] = {}
    for hypothesis, evidence in scored:
        laws.setdefault(hypothesis.law, evidence)
    named = tuple(LawEvidence(law, evidence) for law, evidence in laws.items() if law)
    best, evidence = scored[0]
    return Likeliest(best, evidence - problem.candidates[other].price, named)


def confused(problem: RegressionProblem, solution: Solution, member: int) -> list[int]:
    """Return the best candidate of each effect that may only look worse for its settings.

    Those have settings that were tried on a grid, as a member has, are confused with it by what the
    catalogue says, act at the same joints, and bring most of what it brings as they are.
    """
    own, taken = problem.candidates[member], {problem.candidates[i].slot for i in solution.members}
    gain, rest = solution.search.gain, tuple(i for i in solution.members if i != member)
    enough = gain(rest) + LAWS.resembling * (gain((*rest, member)) - gain(rest))
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


def _best_of_each(
    problem: RegressionProblem, solution: Solution, member: int, other: int
) -> list[Hypothesis]:
    """Return the best hypothesis of each law of an effect in a member's place, best first.

    Of equations that have no name, those that are far behind are left out.
    """
    rest = tuple(i for i in solution.members if i != member)
    best: dict[object, tuple[float, Hypothesis]] = {}
    for i, candidate in enumerate(problem.candidates):
        hypothesis = candidate.hypothesis
        if hypothesis is None or candidate.place != problem.candidates[other].place:
            continue
        law = hypothesis.law or getattr(hypothesis.family, "func", None)
        gain = solution.search.gain((*rest, i))
        if law not in best or is_more(gain, best[law][0]):
            best[law] = (gain, hypothesis)
    falling = ranked(best.values(), lambda item: item[0])
    least = falling[0][0] - LAWS.refinable
    return [hypothesis for gain, hypothesis in falling if hypothesis.law or gain > least]


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
