"""Fit what a diagnosis says of its own certainty to concealed cases on which it may be tuned.

`python benchmarks/diagnosis/diagnosis_calibration.py FOLDER...` reads finished cases, prints the
weights that
`estimators/diagnosis/from_torque/judgement/findings.py` needs, and by how much intervals have to
be wider.
Never give it cases whose figures are to be reported.
"""

from __future__ import annotations

from pathlib import Path  # read by typer
from typing import Annotated

import numpy as np
import typer
from diagnosis_judged import UNKNOWN, judge, misses, names
from diagnosis_score import calibration_error
from scipy.optimize import minimize

from estimators.diagnosis.from_torque.judgement.findings import Signs, features

PULL = 0.3  # of weights towards zero; there are few wrong names to learn from


def fit(
    folders: Annotated[list[Path], typer.Argument(help="Folders of diagnosed cases.")],
    name: Annotated[str, typer.Option(help="Folder inside each case with the results.")] = "out",
) -> None:
    """Print weights of the confidence and the factor of the intervals."""
    cases = [
        judge(path.parent, name) for f in folders for path in sorted(f.glob(f"*/{name}"))
        if (path / "result.json").exists()
    ]  # fmt: skip
    said = [(f, any(names(f, e) for e in c.effects)) for c in cases for f in c.findings]
    named = [(Signs(**f["signs"]), right) for f, right in said if f.get("signs")]
    if not named:
        raise SystemExit("none of these cases has a finding with signs; diagnose them again")
    X = np.array([features(signs) for signs, _ in named])
    y = np.array([right for _, right in named], float)
    weights = logistic(X, y)
    confidence = 1 / (1 + np.exp(-X @ weights))
    print(f"{len(named)} names, {y.mean():.1%} right; weights of 1, lead and size:")
    print(np.round(weights, 2).tolist())
    print(f"calibration error {calibration_error(list(zip(confidence, y, strict=True))):.3f}")
    for effect in (UNKNOWN, "external_contact"):
        right = [r for f, r in said if f["effect"] == effect]
        print(f"{effect}: {sum(right)} of {len(right)} right")
    z = np.abs([m for c in cases for f in c.findings for e in c.effects for m in misses(f, e)])
    if z.size:
        print(f"{z.size} values; 95 % are within {np.quantile(z, 0.95):.2f} half-intervals")


def logistic(X: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Return weights (p,) of features (N, p); all but the first are pulled towards zero."""

    def cost(w: np.ndarray) -> float:
        score = X @ w
        return float(np.sum(np.logaddexp(0, score) - y * score) + PULL * np.sum(w[1:] ** 2))

    return minimize(cost, np.zeros(X.shape[1])).x


if __name__ == "__main__":
    typer.run(fit)
