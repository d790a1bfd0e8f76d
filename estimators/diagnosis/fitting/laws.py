"""Laws: choose among several equations of one effect by their evidence.

Some effects follow one of several laws, as presliding does those of Maxwell slip, LuGre, Dahl, and
Bouc and Wen. Where the grid of settings of one law lies badly, another looks better than it is; so
each competes at its best settings, and pays for them by Schwarz' criterion.

Source: Schwarz, "Estimating the dimension of a model", Annals of Statistics 6(2), 1978.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from estimators.diagnosis.fitting.refinement import refine
from estimators.diagnosis.hypotheses.catalogue import rivals
from estimators.diagnosis.hypotheses.ripple import with_fewer_lines
from estimators.diagnosis.selection.candidates import LawEvidence
from estimators.diagnosis.settings.fitting import CONTRIBUTION, LAWS
from estimators.diagnosis.wording import likelier

if TYPE_CHECKING:
    from collections.abc import Sequence

    from estimators.diagnosis.fitting.problem import RegressionProblem, Solution
    from estimators.diagnosis.fitting.refinement import Setting
    from limo_driver.physics import Hypothesis


def likeliest(
    problem: RegressionProblem, solution: Solution, member: int, around: Setting
) -> tuple[Hypothesis, tuple[LawEvidence, ...]]:
    """Let the laws of a member's effect compete.

    Returns:
        The likeliest hypothesis, its settings refined, and the evidence of the named laws, best
        first.
    """
    near = _best_of_each(problem, solution, member)
    competing = [*near, *rivals(near[0]), *with_fewer_lines(near[0], problem.observed)]
    tried = [refine(hypothesis, around) for hypothesis in competing]
    setting = 0.5 * float(np.log(around.use.sum()))  # [nat]
    scored = [(hypothesis, gain - setting * len(hypothesis.settings)) for hypothesis, gain in tried]
    scored.sort(key=lambda item: -item[1])
    laws: dict[str, float] = {}
    for hypothesis, evidence in scored:
        laws.setdefault(hypothesis.law, evidence)
    named = tuple(LawEvidence(law, evidence) for law, evidence in laws.items() if law)
    return scored[0][0], named


def _best_of_each(problem: RegressionProblem, solution: Solution, member: int) -> list[Hypothesis]:
    """Return the best hypothesis of each law of a member's effect, best first.

    Of equations that have no name, those that are far behind are left out.
    """
    rest = tuple(i for i in solution.members if i != member)
    best: dict[object, tuple[float, Hypothesis]] = {}
    for i, candidate in enumerate(problem.candidates):
        hypothesis = candidate.hypothesis
        if hypothesis is None or candidate.place != problem.candidates[member].place:
            continue
        law = hypothesis.law or getattr(hypothesis.family, "func", None)
        gain = solution.search.gain((*rest, i))
        if law not in best or gain > best[law][0]:
            best[law] = (gain, hypothesis)
    ranked = sorted(best.values(), key=lambda item: -item[0])
    least = ranked[0][0] - LAWS.refinable
    return [hypothesis for gain, hypothesis in ranked if hypothesis.law or gain > least]


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
