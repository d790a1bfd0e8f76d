"""Which base parameters a motion shows, and what motion would show the others.

What a motion adds is counted as information: with rows Y of the regressor and a weight w for each
joint's rows, I = Σ w YᵀY. Motions that anybody can make are tried in thought, the plainest first:
one joint slowly or quickly, in one pose of the others or in several, then all joints at once. The
first whose information, added to that of the recording, tells next to most of a parameter is the
advice. How well it would be known then is not said: errors that are correlated hold more back.

Source: Fedorov, "Theory of Optimal Experiments", 1972 (information adds up over experiments).
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Final

import numpy as np

from estimators.rigid_body.base_parameters import regressor_of
from estimators.rigid_body.identification import Identification
from estimators.rigid_body.regressor import PER_LINK, RegressorChain
from estimators.rigid_body.tables import BaseEstimate, base_estimates, sizes_of
from limo_driver.logs.readers.inspection import NO_MOTION, WELL, ShownParameter
from limo_driver.model import RobotModel
from limo_driver.recordings.recording import Recording
from limo_driver.types import FloatArray, Motion

_ROWS: Final = 1500  # of the recording, that its information is counted from
_TRIED: Final = 240  # samples of a motion that is tried
_SECONDS: Final = 20.0  # that it would take
_SLOW, _QUICK = 0.1, 0.7  # [Hz]
_POSES: Final = 6  # of the other joints
_USED: Final = 0.8  # of a joint's range and half of its limits of speed, that a motion takes
_FARTHEST, _FASTEST, _STRONGEST = 1.5, 2.0, 10.0  # [rad, rad/s, rad/s²] where limits are wider
_WIDEST: Final = 100.0  # standard deviation of any base parameter before the data [SI]
_AS_GOOD: Final = 3.0  # times the least deviation that a plainer motion may leave
_MATTERS: Final = 0.01  # of a joint's torque, by its terms at 1 rad/s and 1 rad/s²
_SINES: Final = 3  # of each joint, where all move


def shown_by(found: Identification, recording: Recording) -> tuple[ShownParameter, ...]:
    """Say of each base parameter how well a recording shows it.

    Args:
        found: Identified from the recording.
        recording: T samples of n joints.
    """
    estimates = base_estimates(found)
    size = _sizes(found, recording, estimates)
    known = np.array([item.deviation for item in estimates]) / size
    motion = recording.motion(found.rows.bandwidth)
    step = -(-len(motion) // _ROWS)
    tell = _Information(found)
    before = tell.of(motion[::step], len(motion))
    least = tell.deviation(before)
    # Errors that are correlated are in the fit's deviations, and would be in those of more motion.
    ratios = (found.fit.deviation / least)[np.isfinite(known)]
    larger = max(float(np.median(ratios)), 1.0) if ratios.size else 1.0
    tried = list(_tried(found.model, np.median(motion.position, axis=0)))
    rows = round(_SECONDS * recording.rate)
    after = [larger * tell.deviation(before + tell.of(m, rows)) / size for _, m in tried]
    names = [name for name, _ in tried]
    remedies = [
        _remedy([a[k] for a in after], names) if known[k] > WELL else "" for k in range(known.size)
    ]
    every = zip(estimates, known.tolist(), remedies, strict=True)
    return tuple(ShownParameter(x.combination, x.unit, x.value, k, how) for x, k, how in every)


def _sizes(
    found: Identification, recording: Recording, estimates: Sequence[BaseEstimate]
) -> FloatArray:
    """Return what each parameter is as large as, (b,).

    One that is not identified is as large as its like; a joint's friction, offset or inertia at
    least what makes a torque that matters there, since one of zero is never known to its size.
    """
    size = sizes_of(estimates)
    kind = [item.name.rpartition("_")[0] for item in estimates]
    known = [(k, size[x.name]) for k, x in zip(kind, estimates, strict=True) if x.is_identified]
    usual = {own: float(np.median([s for k, s in known if k == own])) for own, _ in known}
    links, torque = (
        PER_LINK * found.model.linkage.links,
        np.sqrt((recording.torque**2).mean(axis=0)),
    )
    joint = (found.base.independent - links) % torque.size
    matters = np.where(found.base.independent >= links, _MATTERS * torque[joint], 0.0)
    own = [
        size[x.name] if x.is_identified else max(size[x.name], usual.get(k, 0.0))
        for k, x in zip(kind, estimates, strict=True)
    ]
    return np.maximum(own, matters)


def _remedy(known: list[float], names: list[str]) -> str:
    """Say the plainest of the motions that tell next to most of a parameter."""
    least = min(known)
    if least > 1.0:
        return NO_MOTION
    return names[next(k for k, value in enumerate(known) if value <= _AS_GOOD * least)]


class _Information:
    """What rows of motion say of the base parameters of one identification."""

    def __init__(self, found: Identification) -> None:
        self._found, self._chain = found, RegressorChain.of(found.model)

    def of(self, motion: Motion, rows: int) -> FloatArray:
        """Return the information (b, b) of so many rows that are like a motion's."""
        found = self._found
        K = regressor_of(self._chain, found.terms, found.base, motion)
        weight = found.fit.weight * rows / len(motion)
        return np.einsum("j,jtb,jtc->bc", weight, K, K, optimize=True)

    def deviation(self, information: FloatArray) -> FloatArray:
        """Return the standard deviation (b,) of parameters of which so much is known."""
        whole = information + np.eye(len(information)) / _WIDEST**2
        scale = 1.0 / np.sqrt(np.diag(whole))
        inverse = np.linalg.pinv(whole * np.outer(scale, scale), hermitian=True)
        return scale * np.sqrt(np.maximum(np.diag(inverse), 0.0))


def _tried(model: RobotModel, middle: FloatArray) -> Iterator[tuple[str, Motion]]:
    """Yield motions that anybody can make around a pose (n,), the plainest first."""
    n, limits, random = model.n, model.limits, np.random.default_rng(0)
    low, high = (np.clip(x, middle - _FARTHEST, middle + _FARTHEST) for x in
                 (limits.position_min, limits.position_max))  # fmt: skip
    centre, reach = (low + high) / 2, _USED * np.maximum(high - low, 0.0) / 2
    pieces = np.arange(_TRIED) * _POSES // _TRIED
    poses = centre + reach * random.uniform(-1, 1, (_POSES, n))
    held = (("", np.tile(np.clip(middle, low, high), (_TRIED, 1))),
            (", in several poses of the others", poses[pieces]))  # fmt: skip
    for where, pose in held:
        for name, frequency in (("slowly over its range", _SLOW), ("quickly to and fro", _QUICK)):
            for j in range(n):
                swings = np.zeros((1, n))
                swings[0, j] = _swing(model, reach, frequency)[j]
                start = pose.copy()
                start[:, j] = centre[j]
                yield f"joint {j + 1} {name}{where}", _swung(start, swings, np.array([frequency]))
    frequencies = np.linspace(_SLOW, _QUICK, _SINES)
    every = np.stack([_swing(model, reach, f) for f in frequencies]) / _SINES
    yield (
        "all joints at once, as limo excite plans",
        _swung(np.tile(centre, (_TRIED, 1)), every, frequencies),
    )


def _swing(model: RobotModel, reach: FloatArray, frequency: float) -> FloatArray:
    """Return how far each joint may swing to either side at a frequency, (n,) [rad]."""
    rate = 2 * np.pi * frequency
    velocity = np.fmin(_USED / 2 * model.limits.velocity, _FASTEST)
    acceleration = np.fmin(_USED / 2 * model.limits.acceleration, _STRONGEST)
    return np.minimum(reach, np.minimum(velocity / rate, acceleration / rate**2))


def _swung(pose: FloatArray, swings: FloatArray, frequencies: FloatArray) -> Motion:
    """Return poses (T, n) about which each joint swings by sines (k, n) of its own phase."""
    time = np.linspace(0.0, _SECONDS, len(pose), endpoint=False)
    k, n = swings.shape
    phase = np.outer(np.arange(1, k + 1), 2.4 * np.arange(n))  # the golden angle: none is alike
    rate = 2 * np.pi * frequencies[:, None]
    angle = rate * time[:, None, None] * (1 + 0.05 * np.arange(n)) + phase
    rate = rate * (1 + 0.05 * np.arange(n))
    position = pose + (swings * np.sin(angle)).sum(axis=1)
    velocity = (swings * rate * np.cos(angle)).sum(axis=1)
    return Motion(time, position, velocity, -(swings * rate**2 * np.sin(angle)).sum(axis=1))
