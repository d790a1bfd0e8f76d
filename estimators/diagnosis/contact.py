"""Contact: the finding of pushes from outside."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from estimators.diagnosis.hypotheses.responses import response
from estimators.diagnosis.judgement.confidence import OF_CONTACT
from estimators.diagnosis.pushes import covered, wrench_of
from estimators.diagnosis.residuals.held_out import rmse
from estimators.diagnosis.verdict import CONTACT, BeforeAfter, Finding, Interval, Where
from estimators.diagnosis.wording import names_of

if TYPE_CHECKING:
    from collections.abc import Sequence

    from estimators.diagnosis.judgement.judgement import Leftover
    from estimators.diagnosis.pushes import Push
    from estimators.diagnosis.residuals.observations import Observations
    from limo_driver.types import FloatArray

_Z95 = 1.96
_STRONGEST_PUSH = 100.0  # [N] or [N m], 1 sigma
_REMEMBERED = 4.0  # rows over which errors are alike


def contact_of(
    found: Sequence[Push], observed: Observations, proven: FloatArray, rest: Leftover
) -> tuple[Finding, ...]:
    """Return the finding of pushes; they are events, so the improved simulation leaves them out.

    Args:
        found: When something pushed.
        observed: Recordings and simulation.
        proven: Residual (K, n) of the improved simulation, not fitted to these rows [N m].
        rest: Noise floor of each joint.
    """
    windows: list[tuple[float, float]] = []
    wrenches: list[tuple[float, ...]] = []
    intervals: list[tuple[tuple[float, float], ...]] = []
    found = sorted(found, key=lambda push: (push.recording, push.start))
    for push in found:
        terms = wrench_of(push)
        rows = covered(observed, (push,))
        columns = np.zeros((observed.n, int(rows.sum()), len(terms)))
        for k, term in enumerate(terms):
            joints, values = response(term, observed)
            columns[list(joints), :, k] = values[:, rows]
        weight = observed.moving.any(axis=0) / rest.floor
        X = (columns * weight[:, None, None]).reshape(-1, len(terms))
        y = (proven[rows] * weight).T.ravel()
        precision = X.T @ X + np.eye(len(terms)) / _STRONGEST_PUSH**2
        wrench = np.linalg.solve(precision, X.T @ y)
        spread = _Z95 * np.sqrt(_REMEMBERED * np.diag(np.linalg.inv(precision)))
        windows.append((push.start, push.end))
        wrenches.append(tuple(wrench.tolist()))
        pairs = zip((wrench - spread).tolist(), (wrench + spread).tolist(), strict=True)
        intervals.append(tuple(pairs))
    strongest = max(float(np.linalg.norm(wrench[:3])) for wrench in wrenches)
    values = tuple(rmse(proven, observed.moving).tolist())
    return (
        Finding(
            effect=CONTACT,
            kind="missing",
            joints=tuple(range(1, observed.n + 1)),
            equivalent=(),
            confidence=OF_CONTACT,
            parameters={
                "windows": Interval(tuple(windows), "s"),
                "wrench": Interval(tuple(wrenches), "N, N m", tuple(intervals)),
            },
            where=Where(
                tuple(windows), "the flange", recording=tuple(push.recording + 1 for push in found)
            ),
            share=0.0,
            heldout_rmse=BeforeAfter(values, values),
            evidence=(
                f"In {_stretches(found, observed)} one wrench at the flange, up to "
                f"{strongest:.1f} N, explains all joints at once; nothing was fitted to those rows."
            ),
        ),
    )


def _stretches(found: Sequence[Push], observed: Observations) -> str:
    """Say how many stretches there are, and when; time starts anew in each recording."""
    said: list[str] = []
    names = names_of(observed.recordings)
    for number, name in enumerate(names):
        times = [f"{p.start:.1f} to {p.end:.1f} s" for p in found if p.recording == number]
        if times:
            said.append(" and ".join(times) + f" of {name}" * (len(names) > 1))
    count = "a short stretch" if len(found) == 1 else f"{len(found)} short stretches"
    return f"{count} of time ({'; '.join(said)})"
