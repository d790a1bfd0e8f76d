"""Mounting: an arm whose base is turned so far that gravity pulls another way than is stated.

What else is sought beside a simulation is linear around it: a small tilt is an effect among others,
but for a base that hangs on a wall nothing that a simulation says of gravity torques holds, and
whatever imitates them would be found in its place. So gravity is turned first, as a whole.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from estimators.diagnosis.from_torque.residuals.mistakes import dry_and_viscous
from estimators.diagnosis.held_out import Split, rmse
from estimators.diagnosis.settings.residuals import MOUNTING
from estimators.diagnosis.verdict import BeforeAfter, Finding, Verdict, Where
from estimators.regression.definite import SHOWN
from limo_driver.physics import GravityDirection

if TYPE_CHECKING:
    from estimators.diagnosis.from_torque.residuals.observations import Observations
    from limo_driver.physics import Simulation
    from limo_driver.types import FloatArray


def as_mounted(observed: Observations) -> Observations:
    """Return the recordings beside a simulation whose gravity pulls as the torques say.

    The same, unless gravity is turned far, and the torques are then explained much better.
    """
    simulation = observed.simulation
    stated = np.array(simulation.body.gravity)
    found = _gravity_of(observed)
    size = float(np.linalg.norm(stated))
    if found is None or not size:
        return observed
    share = float(np.linalg.norm(found)) / size
    angle = float(np.degrees(np.arccos(np.clip(found @ stated / (share * size**2), -1.0, 1.0))))
    if angle < MOUNTING.least or not 1 / MOUNTING.size < share < MOUNTING.size:
        return observed
    turned = observed.under(_under(simulation, _nearest(found / share)))
    before, after = (_misfit(item) for item in (observed, turned))
    return turned if after < MOUNTING.better * before else observed


def with_mounting(verdict: Verdict, given: Observations, mounted: Observations) -> Verdict:
    """Return a verdict on a turned arm as one on the given simulation, with what was turned.

    Args:
        verdict: What was found beside the turned simulation.
        given: The recordings beside the given one.
        mounted: The recordings beside the turned one.
    """
    rows = Split.of(given).held_out
    floor, fit = np.array(verdict.fit.noise_floor), verdict.fit
    before, after = rmse(given.residual, rows), rmse(mounted.residual, rows)
    reducible = float(np.sum(np.maximum(before**2 - floor**2, 0.0)))
    left = float(np.sum(np.maximum(after**2 - floor**2, 0.0))) / max(reducible, 1e-300)
    left = min(left, 1.0)
    others = tuple(
        replace(item, share=item.share * left)
        for item in verdict.findings
        if item.effect != GravityDirection.name
    )
    low, high = fit.ci95
    every = given.measured_on(Split.of(given).apart)
    return replace(
        verdict,
        verdict={"consistent": "explained", "unexplained": "partly_explained"}.get(
            verdict.verdict, verdict.verdict
        ),
        findings=(_turned(given, mounted, before, after, 1.0 - left), *others),
        fit=replace(
            fit,
            heldout_rmse_before=tuple(before.tolist()),
            heldout_rmse_before_all_rows=tuple(rmse(given.residual, every).tolist()),
            reducible_error_removed=1.0 - left * (1.0 - fit.reducible_error_removed),
            ci95=(1.0 - left * (1.0 - low), 1.0 - left * (1.0 - high)),
        ),
    )


def _turned(
    given: Observations, mounted: Observations, before: FloatArray, after: FloatArray, share: float
) -> Finding:
    stated, found = (np.array(item.simulation.body.gravity) for item in (given, mounted))
    cosine = float(found @ stated / (np.linalg.norm(found) * np.linalg.norm(stated)))
    angle = np.degrees(np.arccos(np.clip(cosine, -1.0, 1.0)))
    joint = int(np.argmax(before**2 - after**2))
    unit = given.unit("N m", joint)
    missing = not any(isinstance(item, GravityDirection) for item in given.simulation.effects)
    return Finding(
        effect=GravityDirection.name,
        kind="missing" if missing else "wrong_parameter",
        joints=tuple(range(1, given.n + 1)),
        equivalent=(),
        confidence=MOUNTING.confidence,
        parameters={},
        where=Where(region=f"joint {joint + 1}: wherever it bears weight"),
        share=share,
        heldout_rmse=BeforeAfter(tuple(before.tolist()), tuple(after.tolist())),
        evidence=(
            f"The torques are those of the arm with its base turned by {angle:.0f}°, so that "
            "gravity pulls another way than the simulation says; on held-out motion that reduces "
            f"the RMSE of joint {joint + 1} from {before[joint]:.3g} to {after[joint]:.3g} {unit}. "
            "All else was sought beside the turned arm."
        ),
    )


def _gravity_of(observed: Observations) -> FloatArray | None:
    """Return the gravity (3,) [m/s²] that explains most torque beside friction; None if unknown.

    Each joint weighs by what of its torque the stated gravity leaves.
    """
    body, slow = observed.simulation.body, observed.slow
    still = np.zeros_like(slow.position)
    weightless = body.with_gravity([0.0, 0.0, 0.0]).inverse_dynamics(slow.position, still, still)
    pulls = [
        body.with_gravity(axis.tolist()).inverse_dynamics(slow.position, still, still) - weightless
        for axis in np.eye(3)
    ]
    gram, right, energy, used = np.zeros((3, 3)), np.zeros(3), 0.0, 0
    for j in range(observed.n):
        rows = observed.moving[:, j]
        if rows.sum() < MOUNTING.fewest:
            continue
        own = np.column_stack([np.ones(int(rows.sum())), dry_and_viscous(slow.velocity[rows, j])])
        data = np.column_stack([*(pull[rows, j] for pull in pulls), observed.residual[rows, j]])
        data -= own @ np.linalg.lstsq(own, data)[0]
        weight = 1.0 / max(float(data[:, 3] @ data[:, 3]), np.finfo(float).tiny)
        gram += weight * data[:, :3].T @ data[:, :3]
        right += weight * data[:, :3].T @ data[:, 3]
        energy, used = energy + 1.0, used + len(data)
    size, turns = float(np.linalg.norm(body.gravity)), np.linalg.eigvalsh(gram)
    if turns[0] <= SHOWN * max(float(turns[-1]), np.finfo(float).tiny):
        return None  # one of its directions acts on no joint that moves
    change = np.linalg.solve(gram, right)
    left = max(energy - float(change @ right), 0.0)
    spread = np.sqrt(left * MOUNTING.alike / (used * turns[0]))
    if spread > MOUNTING.sure * size:
        return None
    return (np.array(body.gravity) + change).astype(np.float64)


def _nearest(gravity: FloatArray) -> FloatArray:
    """Return an axis of the base, if gravity pulls along it but for what a fit may be off by."""
    size, longest = float(np.linalg.norm(gravity)), int(np.argmax(np.abs(gravity)))
    axis = np.zeros(3)
    axis[longest] = np.sign(gravity[longest]) * size
    near = float(np.degrees(np.arccos(np.clip(gravity @ axis / size**2, -1.0, 1.0))))
    return axis if near < MOUNTING.square else gravity


def _under(simulation: Simulation, gravity: FloatArray) -> Simulation:
    x, y, z = gravity.tolist()
    others = (item for item in simulation.effects if not isinstance(item, GravityDirection))
    return replace(simulation, effects=(*others, GravityDirection(gravity=(x, y, z))))


def _misfit(observed: Observations) -> float:
    """Return what a simulation leaves of torques beside friction, over all joints; relative."""
    left: list[float] = []
    for j in range(observed.n):
        rows = observed.moving[:, j]
        if rows.sum() < MOUNTING.fewest:
            continue
        own = np.column_stack(
            [np.ones(int(rows.sum())), dry_and_viscous(observed.slow.velocity[rows, j])]
        )
        y = np.column_stack([observed.residual[rows, j], observed.measured[rows, j]])
        y -= own @ np.linalg.lstsq(own, y)[0]
        energy = np.sum(y**2, axis=0)
        left.append(float(energy[0] / max(float(energy[1]), np.finfo(float).tiny)))
    return float(np.sqrt(np.mean(left))) if left else 0.0
