"""Fit the confidence of names to cases whose truth is known, and test it on sources left out.

Three kinds of cases: real recordings with documented truth (`--real CASES=RESULTS`, results as
score_real.py writes them), effects hidden in real recordings (`--hidden`, a folder of what
`conceal_on_recording.py` wrote) and concealed plants (`--concealed`, folders of `diagnosis.py`).
For each source of recordings, the weights of
`estimators/diagnosis/from_torque/judgement/findings.py` are fitted to the names of all other
sources, and applied to its own: no case of a source helps to judge another of it. Printed are the
weights fitted to all, and how well those of the others hold.

    python benchmarks/diagnosis/diagnosis_calibration.py --rules ../shared/data/real_cases \
        --real ../shared/data/real_cases=out/first --hidden out/own --concealed out/single

A name whose truth nobody knows is left out: an effect that a recording shows before anything is
hidden in it, or that the truth of a case only tolerates.
"""

from __future__ import annotations

import json
from argparse import ArgumentParser
from collections import Counter
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from ablation import scorer
from diagnosis_judged import UNKNOWN, judge, misses, names
from diagnosis_score import calibration_error
from scipy.optimize import minimize

from estimators.diagnosis.from_torque.judgement.findings import Signs, features

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from limo_driver.types import FloatArray

PULL = 0.3  # of weights towards zero; there are few wrong names to learn from
BINS = (0.0, 0.5, 0.8, 0.95, 1.0)  # of confidence, in the table
SURE = 0.95
RESAMPLES = 2000
REAL, HIDDEN, CONCEALED = "real recordings", "hidden in real recordings", "concealed plants"
CONTACT = "external_contact"  # has a confidence of its own


@dataclass(frozen=True)
class Name:
    """A finding and whether it is right."""

    kind: str
    source: str
    case: str
    finding: dict[str, Any]
    right: bool

    @property
    def signs(self) -> Signs:
        """Return what its confidence is computed from."""
        return Signs(**self.finding["signs"])


def of_real(
    cases: Path,
    results: Path,
    rules: Any,  # noqa: ANN401  # a module
    verdict: str = "verdict.json",
) -> Iterator[Name]:
    """Yield the names in real cases, whose truth files say what is right, tolerated and wrong."""
    for path in sorted(cases.glob("*/truth.json")):
        case, truth = path.parent.name, json.loads(path.read_text())
        findings = _findings(results / case / verdict)
        merged = [f | {"joints": set(f["joints"]), "equivalent": set(f["equivalent"])}
                  for f in findings]  # fmt: skip
        for finding, item in zip(findings, merged, strict=True):
            right = _is_among(finding, truth["effects"]) or rules.covered(
                truth["accept_also"], item, merged
            )
            wrong = rules.covered(truth["must_not"], item, merged)
            if right or wrong or not rules.covered(truth["tolerated"], item, merged):
                yield Name(REAL, case.split("_")[0], case, finding, right)


def of_hidden(folder: Path) -> Iterator[Name]:
    """Yield the names in cases of hidden effects, in a folder for each recording."""
    for path in sorted(folder.glob("*/*/truth.json")):
        case, truth = path.parent, json.loads(path.read_text())
        ordinary = _findings(case.parent / "nothing" / "found" / "verdict.json")
        shown = {(f["effect"], j) for f in ordinary for j in f["joints"]}
        for finding in _findings(case / "found" / "verdict.json"):
            also = [e | {"effect": a} for e in truth["effects"] for a in truth["accept_also"]]
            right = _is_among(finding, [*truth["effects"], *also])
            if right or not {(finding["effect"], j) for j in finding["joints"]} & shown:
                source = case.parent.name.split("_")[0]
                yield Name(HIDDEN, source, f"{case.parent.name}/{case.name}", finding, right)


def of_concealed(folder: Path, out: str) -> Iterator[Name]:
    """Yield the names in concealed cases; each plant is a source of its own."""
    for path in sorted(folder.glob(f"*/{out}/result.json")):
        case = judge(path.parents[1], out)
        for finding in case.findings:
            right = any(names(finding, e) for e in case.effects)
            yield Name(CONCEALED, str(case.case), str(case.case), finding, right)


def _findings(verdict: Path) -> list[dict[str, Any]]:
    found = json.loads(verdict.read_text())["findings"] if verdict.exists() else []
    return [f for f in found if f["effect"] != UNKNOWN and f.get("signs")]


def _is_among(finding: dict[str, Any], effects: Sequence[dict[str, Any]]) -> bool:
    said = {finding["effect"], *finding["equivalent"]}
    return any(
        e["effect"] in said and (not e["joints"] or {*e["joints"]} & {*finding["joints"]})
        for e in effects
    )


def logistic(X: FloatArray, y: FloatArray) -> FloatArray:
    """Return weights (p,) of features (N, p); all but the first are pulled towards zero."""

    def cost(w: FloatArray) -> float:
        score = X @ w
        return float(np.sum(np.logaddexp(0, score) - y * score) + PULL * np.sum(w[1:] ** 2))

    return minimize(cost, np.zeros(X.shape[1])).x


def left_out(X: FloatArray, y: FloatArray, sources: FloatArray) -> FloatArray:
    """Return the confidence of each name by weights of all other sources, (N,)."""
    confidence = np.empty(len(y))
    for source in np.unique(sources):
        own = sources == source
        confidence[own] = 1 / (1 + np.exp(-X[own] @ logistic(X[~own], y[~own])))
    return confidence


def report(confidence: FloatArray, y: FloatArray, sources: FloatArray) -> None:
    """Print the reliability of names of several sources."""
    for low, high in pairwise(BINS):
        inside = (confidence >= low) & ((confidence < high) | (high == BINS[-1]))
        if inside.any():
            print(f"  {low:.2f} to {high:.2f}: {y[inside].sum():3.0f} of {inside.sum():3d} right, "
                  f"mean confidence {confidence[inside].mean():.3f}")  # fmt: skip
    pairs = list(zip(confidence, y, strict=True))
    better = (y - y.mean()) ** 2 - (confidence - y) ** 2
    low, high = _interval(better, sources)
    sure = confidence >= SURE
    print(f"  calibration error, 10 bins: {calibration_error(pairs):.3f}")
    brier = np.mean((confidence - y) ** 2)
    print(f"  Brier score {brier:.4f}, of the base rate {y.var():.4f}; better by "
          f"{better.mean():.4f} ({low:.4f} to {high:.4f}, sources resampled)")  # fmt: skip
    print(f"  at {SURE} and more: {(1 - y[sure]).sum():.0f} of {sure.sum()} wrong, "
          f"{y[sure].sum():.0f} of {y.sum():.0f} right names")  # fmt: skip


def _interval(values: FloatArray, sources: FloatArray) -> tuple[float, float]:
    """Return the 95 % interval of a mean of names, whole sources resampled."""
    rng = np.random.default_rng(0)
    groups = [values[sources == source] for source in np.unique(sources)]
    means = [
        np.concatenate([groups[k] for k in rng.integers(len(groups), size=len(groups))]).mean()
        for _ in range(RESAMPLES)
    ]
    low, high = np.quantile(means, [0.025, 0.975])
    return float(low), float(high)


def main() -> None:
    """Gather the names, fit, and print."""
    options = ArgumentParser(description=__doc__.splitlines()[0])
    options.add_argument("--rules", type=Path, help="folder of score_real.py, for --real")
    options.add_argument("--real", nargs="*", default=[], metavar="CASES=RESULTS")
    options.add_argument("--hidden", type=Path, nargs="*", default=[])
    options.add_argument("--concealed", type=Path, nargs="*", default=[])
    options.add_argument("--name", default="out", help="folder of the results in concealed cases")
    options.add_argument("--wrong", action="store_true", help="list the names that are wrong")
    given = options.parse_args()
    found: list[Name] = []
    if given.real:
        rules = scorer(given.rules)
        for pair in given.real:
            cases, results = map(Path, pair.split("="))
            found += of_real(cases, results, rules)
            for folder in given.hidden:  # in a part of a case's recording nothing was hidden
                found += of_real(cases, folder, rules, "nothing/found/verdict.json")
    found += [name for folder in given.hidden for name in of_hidden(folder)]
    found += [name for folder in given.concealed for name in of_concealed(folder, given.name)]
    tried = [name for name in found if name.finding.get("signs")]
    if not tried:
        raise SystemExit("none of these cases has a finding with signs; diagnose them again")
    X = np.array([features(name.signs) for name in tried])
    y = np.array([name.right for name in tried], float)
    sources = np.array([name.source for name in tried])
    said = np.array([name.finding["confidence"] for name in tried])
    print(f"weights fitted to all: {np.round(logistic(X, y), 2).tolist()}")
    confidence = left_out(X, y, sources)
    for kind in (REAL, HIDDEN, CONCEALED):
        own = np.array([name.kind == kind for name in tried])
        if own.any():
            print(f"{kind}: {own.sum()} names of {len({*sources[own]})} sources, "
                  f"{y[own].sum():.0f} right")  # fmt: skip
            for what, values in (("as said", said), ("by weights of other sources", confidence)):
                print(f" {what}")
                report(values[own], y[own], sources[own])
    if given.wrong:
        for name, c in zip(tried, confidence, strict=True):
            if not name.right:
                f = name.finding
                print(name.kind, name.case, f["effect"], f["joints"], round(f["confidence"], 2),
                      round(c, 2), f["signs"])  # fmt: skip
    _others(found, given.concealed, given.name)


def _others(found: Sequence[Name], concealed: Sequence[Path], out: str) -> None:
    """Print what has no signs, and how wide intervals have to be."""
    bare = Counter((n.finding["effect"], n.right) for n in found if not n.finding.get("signs"))
    for effect in (UNKNOWN, CONTACT):
        right, wrong = bare[effect, True], bare[effect, False]
        print(f"{effect}: {right} of {right + wrong} right")
    cases = [judge(path.parents[1], out) for folder in concealed
             for path in folder.glob(f"*/{out}/result.json")]  # fmt: skip
    z = np.abs([m for c in cases for f in c.findings for e in c.effects for m in misses(f, e)])
    if z.size:
        print(f"{z.size} values, {np.mean(z <= 1):.1%} within their intervals; "
              f"95 % are within {np.quantile(z, 0.95):.2f} half-intervals")  # fmt: skip


if __name__ == "__main__":
    main()
