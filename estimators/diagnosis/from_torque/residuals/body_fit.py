"""Body fit: what a change of bodies explains of torques, and which are not the load of this arm."""

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
from estimators.diagnosis.settings.residuals import MISTAKES, PLAUSIBILITY
from estimators.rigid_body.regressor import PER_LINK, RegressorChain

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from numpy.typing import NDArray

    from estimators.diagnosis.from_torque.residuals.observations import Observations
    from limo_driver.types import FloatArray


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
            tuple(
                float(np.median(np.abs(_centred(sample, j)))) + PLAUSIBILITY.constant for j in moves
            ),
        )

    def change(self, which: slice) -> FloatArray:
        """Return the change of some body parameters that leaves least."""
        scale = zip(self.columns, self.left, self.size, strict=True)
        A, y = zip(*((columns[:, which] / s, left / s) for columns, left, s in scale), strict=True)
        return np.linalg.lstsq(np.concatenate(A), np.concatenate(y), rcond=PLAUSIBILITY.dependent)[
            0
        ]

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


def by_load(sample: RowSample) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return the joints (0-based) whose torque does not follow their load, and those that do.

    Joints whose load is small beside their torque are neither.
    """
    expected = np.std(sample.load, axis=0) > PLAUSIBILITY.expected * np.std(sample.torque, axis=0)
    foreign = usual_misfit(BodyFit.of(sample)) > PLAUSIBILITY.foreign
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
    if (BodyFit.of(sample).misfit(slice(None))[foreign] < PLAUSIBILITY.fits).all():
        return ""
    return f"{not_the_load(observed, foreign)}, or torque of another motion?"


def not_the_load(observed: Observations, joints: NDArray[np.int64]) -> str:
    """Say of which joints (0-based) the torque is not their load, and ask of another robot."""
    named = ", ".join(str(j + 1) for j in joints.tolist())
    return (
        f"the torques of joints {named} are not the load of {observed.simulation.model.name} on "
        "this motion, with friction or a payload; is it another robot"
    )


def parts_of_load(sample: RowSample, joints: NDArray[np.int64]) -> str:
    """Say how much of the load each joint (0-based) shows where that, with friction, is its torque.

    Sensors, currents or bodies that are off by a factor look like this, and the factor tells which.
    """
    parts: list[str] = []
    for joint in joints.tolist():
        use, torque = sample.moving[:, joint], _centred(sample, joint)
        friction = dry_and_viscous(sample.motion.velocity[use, joint])
        columns = np.column_stack([sample.load[use, joint], friction, np.ones(torque.size)])
        found = np.linalg.lstsq(columns, torque, rcond=None)[0]
        left = float(np.std(torque - columns @ found)) / max(float(np.std(torque)), MISTAKES.tiny)
        if left < PLAUSIBILITY.fits:
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
        told = [abs(float(y @ s)) / float(s @ s)]
        v = observed.slow.velocity[use, j]
        rest, expected = without_friction(y, v), without_friction(s, v)
        if expected @ expected > PLAUSIBILITY.beyond_friction * (s @ s):
            if not _alike(rest, expected):
                continue
            told.append(abs(float(rest @ expected)) / float(expected @ expected))
        factor = min(told, key=lambda factor: abs(math.log(factor)))
        if factor > PLAUSIBILITY.scale and y @ y < torques[1] @ torques[1]:
            continue
        yield j, factor


def _alike(y: FloatArray, s: FloatArray) -> bool:
    """Say whether a torque (K,) follows another in all but its scale."""
    return abs(float(y @ s)) > PLAUSIBILITY.alike * float(np.linalg.norm(y) * np.linalg.norm(s)) > 0
