"""Search for the set of effects of most evidence.

Greedy addition fails: two effects together can explain what neither does alone, and the first one
chosen is often a blend of both. So a beam of the best sets is grown, then every member is tried
out of it and every member is swapped for every other candidate.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from estimators.diagnosis.settings.selection import SEARCH
from estimators.regression.evidence import Evidence, Prior, Priors, joined

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from estimators.diagnosis.selection.candidates import Candidate


@dataclass(frozen=True)
class Explained:
    """A set of candidates, by index, and its log evidence against none, less its rarity."""

    members: tuple[int, ...]
    gain: float


class Search:
    """Finds the best set.

    Args:
        candidates: What competes.
        evidence: How sets compare.
        base: Candidates, by index, of the set that is grown; what brings nothing is taken out.
    """

    def __init__(
        self, candidates: Sequence[Candidate], evidence: Evidence, base: tuple[int, ...] = ()
    ) -> None:
        self.candidates, self.evidence, self.base = candidates, evidence, base
        self._known: dict[tuple[int, ...], float] = {(): 0.0}
        self._priors = Priors.of_each([item.prior for item in candidates])
        self._prices = [item.rarity + float(np.log(item.variants)) for item in candidates]

    def gain(self, members: Iterable[int]) -> float:
        """Return the log evidence of a set, less its rarity."""
        key = tuple(sorted(members))
        if key not in self._known:
            self._known[key] = self.evidence.gain(self.prior(key)) - self._price(key)
        return self._known[key]

    def _price(self, members: Iterable[int]) -> float:
        return sum(self._prices[i] for i in members)

    def prior(self, members: Sequence[int]) -> Prior:
        """Return the columns of a set, in the order of its members."""
        return joined(*(self.candidates[i].prior for i in members))

    def best(self) -> Explained:
        """Return the best set."""
        return self._settled(self._grown_from(self._needed(self.base)))

    def around(self, members: Iterable[int]) -> Explained:
        """Return the best set near a given one: others may be added, and idle members removed."""
        return self._needed(self._grown_from(self._needed(tuple(members))).members)

    def _grown_from(self, best: Explained) -> Explained:
        beam = [best.members]
        for _ in range(SEARCH.largest + len(self.base) - len(best.members)):
            grown = self._grown(beam, SEARCH.width)
            if not grown or grown[0].gain <= best.gain:
                break
            best = grown[0]
            beam = [item.members for item in grown]
        return best

    def _needed(self, members: tuple[int, ...]) -> Explained:
        """Take out of a set what the recordings do not speak for, one after the other."""
        best = Explained(tuple(sorted(members)), self.gain(members))
        while best.members:
            options = [best.members[:k] + best.members[k + 1 :] for k in range(len(best.members))]
            smaller = max(options, key=self.gain)
            if self.gain(smaller) <= best.gain:
                break
            best = Explained(smaller, self.gain(smaller))
        return best

    def ranked(self, base: Sequence[int], limit: int) -> list[Explained]:
        """Return the best single additions to a set."""
        return self._grown([tuple(base)], limit)

    def _grown(self, beam: Sequence[tuple[int, ...]], width: int) -> list[Explained]:
        seen: dict[tuple[int, ...], float] = {}
        for members in beam:
            seen |= self._with_one_more(members)
        ranked = sorted(seen.items(), key=lambda item: -item[1])
        return [Explained(key, gain) for key, gain in ranked[:width]]

    def _with_one_more(self, members: tuple[int, ...]) -> dict[tuple[int, ...], float]:
        """Return the gain of a set with each candidate that fits beside it."""
        taken = {self.candidates[i].slot for i in members}
        keys = {
            tuple(sorted((*members, i))): i
            for i, candidate in enumerate(self.candidates)
            if i not in members and candidate.slot not in taken
        }
        new = {key: i for key, i in keys.items() if key not in self._known}
        if new:
            some = np.fromiter(new.values(), dtype=np.int64)
            gains = self.evidence.gains(self.prior(members), self._priors, some)
            price = self._price(members)
            for (key, i), gain in zip(new.items(), gains.tolist(), strict=True):
                self._known[key] = gain - price - self._prices[i]
        return {key: self._known[key] for key in keys}

    def _settled(self, best: Explained) -> Explained:
        """Take members out and swap them while that helps."""
        for _ in range(2 * (SEARCH.largest + len(self.base))):
            options = [best.members[:k] + best.members[k + 1 :] for k in range(len(best.members))]
            trials = [Explained(option, self.gain(option)) for option in options]
            trials += self._grown(options, SEARCH.width) if options else []
            better = max(trials, key=lambda item: item.gain, default=best)
            if better.gain <= best.gain:
                return best
            best = better
        return best
