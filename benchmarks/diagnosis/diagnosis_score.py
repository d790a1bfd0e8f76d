"""The lines of the diagnosis benchmark: each figure that a user was promised, beside its bar."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from math import inf, nan
from typing import TYPE_CHECKING

import numpy as np
from diagnosis_judged import UNKNOWN, Judged, ambiguities, coverage, names
from diagnosis_oracle import worst
from scipy.stats import beta

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

BINS = 10
KINDS = ("null", "single", "set", "unknown", "wrong_parameter")


@dataclass(frozen=True)
class Line:
    """One line of the result."""

    what: str
    value: str
    bar: str = ""


def rate(what: str, hits: Sequence[bool], bar: str = "") -> Line:
    """Return a share with its Clopper-Pearson interval."""
    k, n = sum(hits), len(hits)
    if not n:
        return Line(what, "no case", bar)
    low = beta.ppf(0.025, k, n - k + 1) if k else 0.0
    high = beta.ppf(0.975, k + 1, n - k) if k < n else 1.0
    return Line(what, f"{k / n:6.1%}  ({k} of {n}; {low:.1%} to {high:.1%})", bar)


def score(judged: Sequence[Judged]) -> list[Line]:
    """Return every line of the bar but that of the next motion."""
    nulls, singles, sets, unknowns, wrong = (
        [c for c in judged if c.kind == kind] for kind in KINDS
    )  # fmt: skip
    known = [*(c for c in singles if c.size >= 3), *sets, *wrong]
    lines = [rate("false alarm on nulls", [c.alarmed for c in nulls], "<= 2 %")]
    for size in sorted({c.size for c in singles}):
        at = [c for c in singles if c.size == size]
        bars = (">= 98 %", ">= 90 %") if size >= 3 else ("", "")
        lines += [
            rate(f"single {size:g}x: right class", [c.main_class_right for c in at], bars[0]),
            rate(f"single {size:g}x: exact name and joint", [c.main_named for c in at], bars[1]),
            rate("  by its own name, not an equivalent's", [c.main_named_first for c in at]),
        ]
    return [
        *lines,
        rate("sets: exact set of classes", [c.classes_right for c in sets], ">= 85 %"),
        rate("sets: all names and joints", [c.all_named for c in sets]),
        rate("wrong parameter: named", [c.all_named for c in wrong]),
        rate("wrong parameter: named and called wrong", [c.called_wrong for c in wrong]),
        rate("unknown: said so at its joint alone, no wrong name",
             [c.unknown_right for c in unknowns], ">= 90 %"),
        rate("unknown: seen at its joint, whatever else is said",
             [c.unknown_located for c in unknowns]),
        rate("false abstention: unknown said, the name is not",
             [c.abstained and not c.all_named for c in known], "<= 5 %"),
        rate("  unknown said beside the right names",
             [c.abstained and c.all_named for c in known]),
        rate("cases exactly right, 3x and more", [c.exactly_right for c in known], ">= 85 %"),
        *_calibration(judged),
        *_closures([*singles, *sets], wrong),
        _times(judged),
        Line("command failed", f"{sum(c.verdict is None for c in judged)} of {len(judged)}", "0"),
    ]  # fmt: skip


def _calibration(judged: Iterable[Judged]) -> list[Line]:
    said: list[tuple[float, bool]] = []
    covered: list[bool] = []
    listed: list[int] = []
    for case in judged:
        for finding in case.findings:
            matched = [e for e in case.effects if names(finding, e)]
            said.append((float(finding["confidence"]), bool(matched)))
            listed.append(len(finding.get("equivalent") or ()))
            for effect in matched:
                covered += coverage(finding, effect)
    error = f"{calibration_error(said):.3f}  ({len(said)} findings)" if said else "no finding"
    return [
        Line(f"calibration error of the confidence, {BINS} bins", error, "<= 0.05"),
        rate("coverage of 95 % intervals", covered, "92 to 98 %"),
        Line("equivalents listed per finding", f"{np.mean(listed):.2f}" if listed else "-"),
    ]


def calibration_error(said: Sequence[tuple[float, bool]]) -> float:
    """Return the mean gap between confidence and correctness over bins, weighted by their rows."""
    confidence, right = (np.array(x, float) for x in zip(*said, strict=True))
    at = np.minimum((confidence * BINS).astype(int), BINS - 1)
    gaps = [abs(float((confidence - right)[at == b].sum())) for b in range(BINS)]
    return sum(gaps) / len(said)


def _closures(cases: Sequence[Judged], wrong: Sequence[Judged]) -> list[Line]:
    """Return closure over single effects of every size and sets, where the motion predicts them."""
    told = [c for c in cases if c.truth["foretellable"]]
    largest = [c.closure.worst if c.closure else inf for c in told]
    if not largest:
        return [Line("closure", "no case", "<= 1.10")]
    removed = [c.closure.removed if c.closure else 0.0 for c in told]
    near = [c.closure_near_rest.worst if c.closure_near_rest else inf for c in told]
    quantiles = np.quantile(largest, [0.25, 0.75, 0.95], method="nearest")
    spread = "quartiles, 95 %: " + ", ".join(f"{q:.2f}" for q in quantiles)
    other = [c.closure.worst if c.closure else inf for c in wrong]
    return [
        Line("closure, worst joint: median", f"{np.median(largest):.3f}  ({spread})",
             "<= 1.10"),
        rate("closure <= 1.2", [w <= 1.2 for w in largest], ">= 95 %"),
        Line("closure with rows near rest: median", f"{np.median(near):.3f}"),
        Line("closure of wrong parameters: median", f"{np.median(other):.3f}" if other else "-"),
        Line("reducible error removed: median", f"{np.nanmedian(removed):.2%}"),
        *_oracle(told),
    ]  # fmt: skip


def _oracle(cases: Sequence[Judged]) -> list[Line]:
    """Return what the true effects reach, fitted to the same rows, and what they were to reach."""
    known = [(c.closure.worst, *reached) for c in cases if c.closure and (reached := worst(c.case))]
    if not known:
        return []
    found, reached, expected = np.array(known).T
    beyond = found / reached
    return [
        Line(f"  of the true effects, fitted to the same rows ({len(known)} cases): median",
             f"{np.median(reached):.3f}  (<= 1.2: {np.mean(reached <= 1.2):.0%}; "
             f"expected {np.median(expected):.3f})"),
        Line("  closure over that of the true effects: median",
             f"{np.median(beyond):.3f}  (<= 1.1: {np.mean(beyond <= 1.1):.0%})"),
    ]  # fmt: skip


def _times(judged: Sequence[Judged]) -> Line:
    seconds = [c.seconds for c in judged] or [nan]
    value = f"median {np.median(seconds):.1f} s, largest {max(seconds):.1f} s"
    return Line("time of a diagnosis (2 recordings of about 75 s)", value, "<= 60 s for 5 min")


def resolution(cases: Sequence[tuple[Judged, Judged | None]], waiting: int = 0) -> list[Line]:
    """Return how often one requested motion settles what was ambiguous before it.

    An effect counts if it was named beside others that the truth can be told apart from. The rival
    to rule out is the one that the motion was asked for; where none was, nothing is resolved.

    Args:
        cases: Each case before and after the motion that its diagnosis asked for; None: it asked
            for none.
        waiting: Cases whose motion has yet to be recorded.
    """
    found = [(a, after) for before, after in cases for a in ambiguities(before)]
    asked = [a.asked is not None and after is not None and a.resolved(after) for a, after in found]
    entirely = [after is not None and a.resolved(after, entirely=True) for a, after in found]
    unasked = f"{sum(a.asked is None for a, _ in found)} of {len(found)}"
    left = f"; {waiting} cases still to be followed" if waiting else ""
    return [
        rate("ambiguous pairs resolved by one requested motion", asked, ">= 80 %"),
        rate("  with every rival out", entirely),
        Line("  ambiguous effects that no motion was asked for", unasked + left),
    ]


def confusion(judged: Iterable[Judged]) -> list[tuple[str, list[tuple[str, int]]]]:
    """Return, for each hidden effect of single cases, what the main finding called it."""
    counts: dict[str, Counter[str]] = {}
    for case in judged:
        if len(case.effects) != 1:
            continue
        effect = case.effects[0]
        hidden = effect["law"] if effect["effect"] == UNKNOWN else effect["effect"]
        said = case.findings[0]["effect"] if case.findings else "nothing"
        counts.setdefault(hidden, Counter())[said] += 1
    return [(hidden, said.most_common()) for hidden, said in sorted(counts.items())]
