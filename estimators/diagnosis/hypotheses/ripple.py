"""Scans: hypotheses that have to be looked for in the residual, since no grid can hold them.

A ripple has any number of cycles in a revolution, and a push can come at any time. Both are
sought in what a fit of the nuisance parameters alone leaves.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from scipy.ndimage import median_filter

from estimators.diagnosis.settings.hypotheses import RIPPLE
from limo_driver.physics import TorqueRipple
from limo_driver.recordings.differentiation import ORDER

if TYPE_CHECKING:
    from collections.abc import Mapping

    from estimators.diagnosis.residuals.observations import Observations
    from limo_driver.physics import Hypothesis
    from limo_driver.types import FloatArray


def ripples(
    observed: Observations,
    residual: FloatArray,
    known: Mapping[int, tuple[float, ...]] | None = None,
) -> list[Hypothesis]:
    """Look for lines over the joint angle.

    Args:
        observed: Recordings and simulation, K slow rows of n joints.
        residual: What the nuisance parameters leave, (K, n) [N m].
        known: Lines of each joint (0-based) that the residual is already without [1/rev]; those
            found are hypotheses together with them.

    Returns:
        For each joint with lines one hypothesis of the strongest line, one of the two strongest,
        and so on, and the same beside a line of so few periods that the first scan takes it for a
        shape; they are one effect at one place and exclude each other.

    Source: Scargle, "Studies in astronomical time series analysis II", ApJ 263, 1982; the lines
    are taken out one by one as in Högbom, "Aperture synthesis with a non-regular distribution of
    interferometer baselines", A&A Suppl. 15, 1974.
    """
    found: list[Hypothesis] = []
    for joint in range(observed.n):
        before = (known or {}).get(joint, ())
        lines = _lines(_Angle.of(observed, residual, joint), RIPPLE.lines - len(before), observed.n)
        lines = tuple(N for N in lines if not any(_is_same(N, other) for other in before))
        some = [(*before, *lines[: k + 1]) for k in range(len(lines))]
        slow = _slow_line(_Angle.of(observed, residual, joint, RIPPLE.flat))
        if slow and not any(_is_same(slow, N) for N in (*before, *lines)):
            some += [(slow, *more) for more in ((), *some)]
        found += [TorqueRipple.of_lines(joint + 1, cycles) for cycles in some]
    return found


def _is_same(line: float, other: float) -> bool:
    return abs(line / other - 1.0) < RIPPLE.same


@dataclass(frozen=True)
class Spectrum:
    """Power of a residual in lines over the joint angle; each array (F,)."""

    cycles: FloatArray  # [1/rev]
    amount: FloatArray  # squared sum
    noise: FloatArray  # what it would be in white noise of the same size

    @property
    def normalised(self) -> FloatArray:
        """Amount over that of white noise."""
        return self.amount / self.noise

    @property
    def above(self) -> FloatArray:
        """Power over its neighbourhood's level, exponential of mean 1 for noise of any colour.

        Half of an exponential variable lies below log 2 of its mean.
        """
        level = median_filter(self.normalised, RIPPLE.neighbours, mode="nearest") / np.log(2)
        return self.normalised / np.maximum(level, 1.0)


@dataclass(frozen=True)
class _Angle:
    """Residual of one joint over its angle, on R rows that move."""

    position: FloatArray  # (R,) [rad]
    speed: FloatArray  # (R,) [rad/s]
    residual: FloatArray  # (R,) less what `known` explains [N m]
    known: FloatArray  # (R, c) low-order dependence on position, and lines found before
    bandwidth: float  # [Hz]

    @classmethod
    def of(
        cls, observed: Observations, residual: FloatArray, joint: int, knots: int = RIPPLE.shape
    ) -> _Angle:
        """Take the rows of one joint (0-based)."""
        rows = observed.moving[:, joint]
        q, v = observed.slow.position[rows, joint], observed.slow.velocity[rows, joint]
        known = _shape(q, v, knots)
        y = residual[rows, joint]
        if y.size:  # a short burst is no line, yet would have power in all of them
            middle = float(np.median(y))
            most = RIPPLE.burst * float(np.median(np.abs(y - middle)))
            y = np.clip(y, middle - most, middle + most)
        return cls(q, np.abs(v), _rest(y, known), known, observed.bandwidth)

    @property
    def range(self) -> float:
        """Angle that nearly all rows lie in [rad]."""
        if self.position.size < RIPPLE.shape:
            return 0.0
        low, high = np.quantile(self.position, (0.01, 0.99))
        return float(high - low)

    def passed(self, cycles: FloatArray) -> FloatArray:
        """Return what the filter leaves of lines at each row, (R, len(cycles))."""
        ratio = self.speed[:, None] * (cycles / (2 * np.pi * self.bandwidth))
        gain = 1.0 / (1.0 + ratio ** (2 * ORDER))
        gain[gain < RIPPLE.passed] = 0.0
        return gain

    def power(self, first: float, step: float, count: int) -> Spectrum:
        """Return how much of the residual is in evenly spaced lines, and how much noise would be.

        The phase of a line is a product, so that few exponentials are needed.
        """
        ahead = np.exp(-1j * step * self.position[:, None] * np.arange(min(count, RIPPLE.block)))
        amount, noise = np.zeros(count), np.zeros(count)
        energy = self.residual**2
        for start in range(0, count, RIPPLE.block):
            size = min(RIPPLE.block, count - start)
            N = first + step * np.arange(start, start + size, dtype=np.float64)
            gain = self.passed(N)
            turned = self.residual * np.exp(-1j * N[0] * self.position)
            sums = np.einsum("r,rb,rb->b", turned, ahead[:, :size], gain)
            enough = (gain > 0).mean(axis=0) > RIPPLE.least_share
            rows = slice(start, start + size)
            amount[rows] = np.where(enough, np.abs(sums) ** 2, 0.0)
            noise[rows] = energy @ gain**2
        cycles = first + step * np.arange(count, dtype=np.float64)
        return Spectrum(cycles, amount, np.maximum(noise, RIPPLE.tiny))

    def without(self, cycles: float) -> _Angle:
        """Take one line out."""
        gain = self.passed(np.array([cycles]))[:, 0]
        angle = cycles * self.position
        waves = np.stack([gain * np.sin(angle), gain * np.cos(angle)], axis=1)
        known = np.concatenate([self.known, waves], axis=1)
        return replace(self, residual=_rest(self.residual, known), known=known)

    @property
    def energy(self) -> float:
        """Sum of squares of the residual."""
        return float(self.residual @ self.residual)


def _rest(values: FloatArray, known: FloatArray) -> FloatArray:
    """Return what columns do not explain."""
    gram = known.T @ known
    ridge = 1e-9 * max(float(np.trace(gram)), RIPPLE.tiny) * np.eye(gram.shape[0])
    return values - known @ np.linalg.solve(gram + ridge, known.T @ values)


def _shape(q: FloatArray, v: FloatArray, knots: int) -> FloatArray:
    """Return hats of the position, alone and times the sign of motion, (R, 2 knots)."""
    if not q.size:
        return np.zeros((0, 2 * knots))
    at = np.linspace(q.min(), max(q.max(), q.min() + 1e-6), knots)
    hats = np.maximum(0.0, 1.0 - np.abs(q[:, None] - at) / (at[1] - at[0]))
    return np.concatenate([hats, np.sign(v)[:, None] * hats], axis=1)


def _lines(angle: _Angle, limit: int, joints: int) -> tuple[float, ...]:
    """Return the cycles per revolution of the significant lines, strongest first."""
    if angle.range <= 0 or RIPPLE.least_periods * 2 * np.pi / angle.range > RIPPLE.most_cycles:
        return ()
    step = 2 * np.pi / angle.range / RIPPLE.oversampling
    first = RIPPLE.least_periods * RIPPLE.oversampling * step
    count = int((RIPPLE.most_cycles - first) / step)
    threshold = float(np.log(joints * count / RIPPLE.false_lines))
    found: list[float] = []
    while len(found) < limit:
        spectrum = angle.power(first, step, count)
        best = float(spectrum.cycles[np.argmax(spectrum.above)])
        line = _refined(angle, best, step)
        rest = angle.without(line)
        if _stands_out(angle, rest, line, step) < threshold:
            break
        found.append(line)
        angle = rest
    return tuple(found)


def _slow_line(angle: _Angle) -> float | None:
    """Return the cycles per revolution of the line of few periods that leaves least, if any."""
    if angle.range <= 0:
        return None
    step = 2 * np.pi / angle.range / RIPPLE.oversampling
    near = step * np.arange(*(RIPPLE.oversampling * np.array(RIPPLE.few_periods)))
    energy = [angle.without(float(cycles)).energy for cycles in near]
    line = _refined(angle, float(near[int(np.argmin(energy))]), step)
    return line if angle.without(line).energy < (1.0 - RIPPLE.least_part) * angle.energy else None


def _refined(angle: _Angle, cycles: float, step: float) -> float:
    """Return the line near grid point `cycles` that leaves least; in the end by a parabola."""
    for width in (step, step / 5):
        near = cycles + width * np.linspace(-1.0, 1.0, 5)
        energy = np.array([angle.without(float(N)).energy for N in near])
        middle = int(np.clip(np.argmin(energy), 1, near.size - 2))
        a, b, c = energy[middle - 1 : middle + 2]
        curvature = a - 2 * b + c
        shift = float(np.clip(0.5 * (a - c) / curvature, -1.0, 1.0)) if curvature > 0 else 0.0
        cycles = float(near[middle] + shift * (near[1] - near[0]))
    return cycles


def _stands_out(angle: _Angle, rest: _Angle, line: float, step: float) -> float:
    """Return a line's power over the level around it once it is taken out.

    A strong line raises its own neighbourhood, since no joint covers its range evenly.
    """
    around = rest.power(line - RIPPLE.neighbours // 2 * step, step, RIPPLE.neighbours)
    level = max(1.0, float(np.median(around.normalised)) / np.log(2))
    own = 0.5 * (angle.energy - rest.energy) / (rest.energy / rest.residual.size)
    return own / level
