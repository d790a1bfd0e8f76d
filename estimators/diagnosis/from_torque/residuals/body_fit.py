"""Body fit: what a change of bodies explains of torques, and which are not the load of this arm.

Mounting: an arm whose base is turned so far that gravity pulls another way than is stated.

What else is sought beside a simulation is linear around it: a small tilt is an effect among others,
but for a base that hangs on a wall nothing that a simulation says of gravity torques holds, and
whatever imitates them would be found in its place. So gravity is turned first, as a whole.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from estimators.diagnosis.from_torque.residuals.mistakes import (
    Mistake,
    RowSample,
    dry_and_viscous,
    without_friction,
)
from estimators.diagnosis.from_torque.residuals.usable_joints import without_effort
from estimators.diagnosis.held_out import Split, rmse
from estimators.diagnosis.settings import (
    CLEARLY,
    DEPENDENT,
    HALF,
    MATTERS,
    MOST,
    ROUNDING,
    SOME,
    TINY,
)
from estimators.diagnosis.settings.judgement import CONFIDENCE
from estimators.diagnosis.settings.residuals import MISTAKES, MOUNTING, PLAUSIBILITY
from estimators.diagnosis.verdict import BeforeAfter, Finding, Verdict, Where
from estimators.regression.definite import SHOWN
from estimators.rigid_body.regressor import PER_LINK, RegressorChain
from limo_driver.physics import GravityDirection

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from estimators.diagnosis.from_torque.residuals.observations import Observations
    from limo_driver.physics import Simulation
    from limo_driver.types import FloatArray, IntArray


@dataclass(frozen=True)
class BodyFit:
    """Torques that are left beside load and friction, as a change of bodies may explain them."""

    n: int
    joints: tuple[int, ...]  # that move
    columns: tuple[FloatArray, ...]  # of each of those, (K_j, 10 n) beside any friction
    left: tuple[FloatArray, ...]  # (K_j,) [N m]
    size: tuple[float, ...]  # median of the torque [N m]

    @classmethod
    def of(cls, sample: RowSample) -> BodyFit:
        """Lay out torques beside load and friction, and what bodies may explain of them."""
        moves = np.flatnonzero(sample.judged).tolist()
        Y = RegressorChain.of(sample.body).regressor(sample.motion)
        return cls(
            sample.torque.shape[1],
            tuple(moves),
            tuple(_beside_friction(sample, j, Y[j]) for j in moves),
            tuple(sample.rest(j) for j in moves),
            tuple(float(np.median(np.abs(_centred(sample, j)))) + ROUNDING for j in moves),
        )

    def change(self, which: slice) -> FloatArray:
        """Return the change of some body parameters that leaves least."""
        scale = zip(self.columns, self.left, self.size, strict=True)
        A, y = zip(*((columns[:, which] / s, left / s) for columns, left, s in scale), strict=True)
        return np.linalg.lstsq(np.concatenate(A), np.concatenate(y), rcond=DEPENDENT)[0]

    def misfit(self, which: slice) -> FloatArray:
        """Return the misfit of each joint's torque with some body parameters changed, (n,).

        Median over median, which a push does not change.
        """
        change, result = self.change(which), np.zeros(self.n)
        every = zip(self.joints, self.columns, self.left, self.size, strict=True)
        for joint, columns, left, size in every:
            result[joint] = float(np.median(np.abs(left - columns[:, which] @ change))) / size
        return result


def usual_misfit(fit: BodyFit) -> FloatArray:
    """Return what load, friction and payload leave of each joint's torque, (n,).

    A payload that lifts is none.
    """
    last = slice(-PER_LINK, None)
    bare = fit.misfit(slice(0))
    return np.minimum(bare, fit.misfit(last)) if fit.change(last)[0] > 0 else bare


def by_load(sample: RowSample) -> tuple[IntArray, IntArray]:
    """Return the joints (0-based) whose torque does not follow their load, and those that do.

    Joints whose load is small beside their torque are neither.
    """
    expected = np.std(sample.load, axis=0) > SOME * np.std(sample.torque, axis=0)
    foreign = usual_misfit(BodyFit.of(sample)) > HALF
    return np.flatnonzero(foreign & expected), np.flatnonzero(~foreign & expected)


def strange_load(observed: Observations, sample: RowSample) -> str:
    """Say that most torques are not the load of this arm, with or without a payload.

    Those that are the load of some rigid body there belong to the motion: its bodies are stated
    wrong, which a diagnosis finds.
    """
    foreign, following = by_load(sample)
    foreign = np.setdiff1d(foreign, without_effort(observed))  # left out by name
    if foreign.size < 2 or following.size > 1:  # noqa: PLR2004  # one of each may be by chance
        return ""
    if (BodyFit.of(sample).misfit(slice(None))[foreign] < HALF).all():
        return ""
    return f"{not_the_load(observed, foreign)}, or torque of another motion?"


def not_the_load(observed: Observations, joints: IntArray) -> str:
    """Say of which joints (0-based) the torque is not their load, and ask of another robot."""
    named = ", ".join(str(j + 1) for j in joints.tolist())
    return (
        f"the torques of joints {named} are not the load of {observed.simulation.model.name} on "
        "this motion, with friction or a payload; is it another robot"
    )


def parts_of_load(sample: RowSample, joints: IntArray) -> str:
    """Say how much of the load each joint (0-based) shows where that, with friction, is its torque.

    Sensors, currents or bodies that are off by a factor look like this, and the factor tells which.
    """
    parts: list[str] = []
    for joint in joints.tolist():
        use, torque = sample.moving[:, joint], _centred(sample, joint)
        friction = dry_and_viscous(sample.motion.velocity[use, joint])
        columns = np.column_stack([sample.load[use, joint], friction, np.ones(torque.size)])
        found = np.linalg.lstsq(columns, torque, rcond=None)[0]
        left = float(np.std(torque - columns @ found)) / max(float(np.std(torque)), TINY)
        if left < HALF:
            parts.append(f"{found[0]:.2f} of it at joint {joint + 1}")
    if not parts:
        return ""
    return f" Beside friction they follow {' and '.join(parts)}."


def without_payload(sample: RowSample) -> RowSample:
    """Take out the torque of a load at the last link, as it explains most; none that lifts."""
    last = slice(-PER_LINK, None)
    load = BodyFit.of(sample).change(last)
    if load[0] <= 0:
        return sample
    columns = RegressorChain.of(sample.body).regressor(sample.motion)[:, :, last]
    return replace(sample, torque=sample.torque - (columns @ load).T)


def _centred(sample: RowSample, joint: int) -> FloatArray:
    torque = sample.torque[sample.moving[:, joint], joint]
    return torque - np.median(torque)


def _beside_friction(sample: RowSample, joint: int, columns: FloatArray) -> FloatArray:
    """Return what no friction of a joint explains of columns (K, p), on its moving rows."""
    use = sample.moving[:, joint]
    return without_friction(columns[use], sample.motion.velocity[use, joint])


def other_unit(observed: Observations) -> Mistake | None:
    """Return the unit that torques may be in that follow the motion by another order of size.

    All torques together are judged more strictly than one, since a sensor may be wrong, and a
    friction known badly.
    """
    scale, sliding = dict(_scales(observed)), observed.simulation.model.sliding
    wrong = [
        j for j, factor in scale.items() if not 1 / PLAUSIBILITY.scale < factor < PLAUSIBILITY.scale
    ]
    usual = float(np.exp(np.mean(np.log(list(scale.values()))))) if len(scale) > 1 else 1.0
    if not 1 / PLAUSIBILITY.scale_of_all < usual < PLAUSIBILITY.scale_of_all:
        return Mistake(
            f"the torques are {usual:.3g} times what motion and arm make of them; expected "
            f"{observed.unit('N m')}; are they in {_other_unit(usual)}, or is it another robot?",
            _divided(np.full(observed.n, usual)),
        )
    if wrong:
        j = wrong[0]
        return Mistake(
            f"torque_{j + 1} is {scale[j]:.3g} times what its motion makes of it; expected "
            f"{observed.unit('N m', j)}; is it in {_other_unit(scale[j], slides=sliding[j])}?",
            _divided(np.where(np.arange(observed.n) == j, scale[j], 1.0)),
        )
    return None


def _divided(factors: FloatArray) -> Callable[[RowSample], RowSample]:
    return lambda sample: sample.torques(np.diag(1.0 / factors))


def _other_unit(factor: float, *, slides: bool = False) -> str:
    """Return the units in which a torque would be as many times larger, or smaller."""
    if slides:
        return "mN or mA" if factor > 1 else "kN or A"
    return "N mm or mA" if factor > 1 else "kN m or A"


def _scales(observed: Observations) -> Iterator[tuple[int, float]]:
    """Yield joint (0-based) and recorded over simulated torque, where one is like the other.

    Friction of any size may be added, or be all that is recorded of a gear that holds its load:
    where what is beyond it is of the usual size, or is none, nothing is another unit. Nor is it
    where a torque varies by less than what it should be in all: a joint that turned one way, under
    a load that hardly changed, shows little but its errors.
    """
    for j in range(observed.n):
        use = observed.moving[:, j]
        if use.sum() < MISTAKES.least_moving:
            continue
        torques = observed.measured[use, j], observed.simulated[use, j]
        y, s = (torque - torque.mean() for torque in torques)
        if not _alike(y, s):
            continue
        factors = [abs(float(y @ s)) / float(s @ s)]
        v = observed.slow.velocity[use, j]
        rest, expected = without_friction(y, v), without_friction(s, v)
        if expected @ expected > PLAUSIBILITY.beyond_friction * (s @ s):
            if not _alike(rest, expected):
                continue
            factors.append(abs(float(rest @ expected)) / float(expected @ expected))
        factor = min(factors, key=lambda factor: abs(math.log(factor)))
        if factor > PLAUSIBILITY.scale and y @ y < torques[1] @ torques[1]:
            continue
        yield j, factor


def _alike(y: FloatArray, s: FloatArray) -> bool:
    """Say whether a torque (K,) follows another in all but its scale."""
    return abs(float(y @ s)) > MOST * float(np.linalg.norm(y) * np.linalg.norm(s)) > 0


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
    if angle < MOUNTING.least or not 1 / CLEARLY < share < CLEARLY:
        return observed
    turned = observed.under(_under(simulation, _nearest(found / share)))
    before, after = (_misfit(item) for item in (observed, turned))
    return turned if after < HALF * before else observed


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
    left = float(np.sum(np.maximum(after**2 - floor**2, 0.0))) / max(reducible, TINY**2)
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
        confidence=CONFIDENCE.highest,
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
        if rows.sum() < MISTAKES.least_moving:
            continue
        data = np.column_stack([*(pull[rows, j] for pull in pulls), observed.residual[rows, j]])
        data = without_friction(data, slow.velocity[rows, j])
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
    if spread > MATTERS * size:
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
        if rows.sum() < MISTAKES.least_moving:
            continue
        y = np.column_stack([observed.residual[rows, j], observed.measured[rows, j]])
        energy = np.sum(without_friction(y, observed.slow.velocity[rows, j]) ** 2, axis=0)
        left.append(float(energy[0] / max(float(energy[1]), np.finfo(float).tiny)))
    return float(np.sqrt(np.mean(left))) if left else 0.0
