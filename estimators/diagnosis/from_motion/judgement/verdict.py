"""The verdict of an arm that tells no torque, with errors in rad."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np

from estimators.diagnosis.from_motion.judgement.findings import (
    KINDS,
    USUAL,
    findings_of,
    is_known,
    parameters_of,
)
from estimators.diagnosis.from_motion.judgement.held_out import (
    LEAST,
    by_recording,
    resolution_of,
    rms_of_rows,
)
from estimators.diagnosis.from_motion.judgement.wording import joints_named, undecided
from estimators.diagnosis.from_motion.simulation.one_joint import loaded_joints
from estimators.diagnosis.from_motion.simulation.plant import DRIFTS, rows_of
from estimators.diagnosis.verdict import (
    Fit,
    Identified,
    NotObservable,
    RowCount,
    Unexplained,
    Verdict,
)
from limo_driver.recordings.channels import drifting

if TYPE_CHECKING:
    from collections.abc import Iterable

    from estimators.diagnosis.from_motion.judgement.evidence import DriveEvidence
    from limo_driver.physics import Simulation
    from limo_driver.types import FloatArray

_NEAR_FLOOR: Final = 3.0  # floors, below which nothing is left to be explained


def verdict_of(
    stated: Simulation,
    given: Simulation,
    evidence: DriveEvidence,
    before: FloatArray,
    after: FloatArray,
    notes: tuple[str, ...],
    hidden: Iterable[tuple[str, str]],
) -> Verdict:
    """Return the verdict.

    Args:
        stated: The simulation as it was given.
        given: The same with a servo at each joint.
        evidence: What was identified.
        before: Free-running errors of the held-out rows, as given, (K, n) [rad].
        after: The same with what was identified.
        notes: To be told.
        hidden: Effects that these recordings cannot show, and why.
    """
    final, recordings, unseen = evidence.final, evidence.recordings, evidence.unseen
    rmse_before, rmse_after = (np.sqrt(np.mean(e**2, axis=0)) for e in (before, after))
    floor = np.array([resolution_of(recordings, j) for j in range(given.model.n)]) / np.sqrt(12.0)
    reducible = float(np.sum(np.maximum(rmse_before**2 - floor**2, 0.0)))
    removed = float(np.sum(rmse_before**2) - np.sum(rmse_after**2)) / max(reducible, LEAST)
    findings = findings_of(stated, given, evidence, reducible)
    # a joint whose positions never change tells no step of its encoder, and so no floor
    left = np.flatnonzero((floor > 0.0) & (rmse_after > _NEAR_FLOOR * floor))
    summary = "consistent" if not findings else "partly_explained" if left.size else "explained"
    if findings and removed <= 0.0:
        summary = "unexplained"
    rows = [len(r) for r in unseen]
    blocks = by_recording(before, after, rows, floor)
    as_given = loaded_joints(given.body, evidence.unseen)
    (step_before, torque_before), (step_after, torque_after) = (
        rms_of_rows(parts, constants)
        for parts, constants in (
            (as_given, list(rows_of(given))),
            (evidence.first.parts(given), [fit.row for fit in evidence.proof.fits]),
        )
    )
    return Verdict(
        verdict=summary,
        findings=findings,
        unexplained=Unexplained(
            tuple(int(j) + 1 for j in left),
            tuple(
                float(min(1.0, rmse_after[j] ** 2 / max(rmse_before[j] ** 2, LEAST))) for j in left
            ),
        ),
        not_observable=tuple(
            NotObservable(effect, reason)
            for effect, reason in (
                *undecided(final, min(r.rate for r in recordings)),
                *hidden,
            )
        ),
        next_motion=None,
        fit=Fit(
            tuple(rmse_before.tolist()),
            tuple(rmse_after.tolist()),
            tuple(floor.tolist()),
            removed,
            blocks,
            unit=_unit(given),
            one_step_rmse_before=step_before,
            one_step_rmse_after=step_after,
            inverse_dynamics_rmse_before=torque_before,
            inverse_dynamics_rmse_after=torque_after,
        ),
        rows=RowCount(
            used=sum(map(len, recordings)),
            left_out={item.reason: len(item.rows) for r in recordings for item in r.left_out},
            total=sum(map(len, recordings)),
            held_out=sum(rows),
            judged=(sum(rows),) * given.model.n,
        ),
        notes=notes,
        identified=tuple(
            Identified(effect, joint, parameters_of(fit, KINDS[effect]))
            for joint, fit in enumerate(final.fits, start=1)
            for effect in USUAL
            if is_known(fit, KINDS[effect])
        ),
    )


def _unit(given: Simulation) -> str:
    """Return the unit of errors: of a whole run, or of as long as what drifts has."""
    joints = drifting(given.channels)
    if not joints:
        return "rad"
    where = "" if len(joints) == given.model.n else f" at {joints_named(joints)}"
    return f"rad in {DRIFTS:g} s{where}"
