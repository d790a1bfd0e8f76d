"""Scans: hypotheses that have to be looked for in the residual, since no grid can hold them.

A ripple has any number of cycles in a revolution, and a push can come at any time. Both are
sought in what a fit of the nuisance parameters alone leaves.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from scipy.ndimage import median_filter

from estimators.diagnosis.from_torque.hypotheses.line_sums import line_sums
from estimators.diagnosis.settings import DEPENDENT, FEW, LITTLE, SOME, TINY
from estimators.diagnosis.settings.fitting import RIPPLE
from limo_driver.physics import TorqueRipple
from limo_driver.recordings.filters.differentiation import ORDER

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence

    from estimators.diagnosis.from_torque.residuals.observations import Observations
    from limo_driver.physics import Hypothesis
    from limo_driver.types import BoolArray, FloatArray, IntArray


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
        slow = _slow_line(_Angle.of(observed, residual, joint, 2))
        if slow and not any(_is_same(slow, N) for N in (*before, *lines)):
            some += [(slow, *more) for more in ((), *some)]
        found += [TorqueRipple.of_lines(joint + 1, cycles) for cycles in some]
    return found


def with_fewer_lines(hypothesis: Hypothesis, observed: Observations) -> Iterator[Hypothesis]:
    """Yield a ripple with one of each bunch of lines that the range of its joint does not resolve.

    Beside something at that joint that was not known yet, a line comes out a little off its place,
    and what it leaves there makes others.

    Args:
        hypothesis: A ripple; others have no lines.
        observed: The recordings that it was found in.
    """
    if hypothesis.effect != TorqueRipple.name:
        return
    lines = np.sort(hypothesis.settings)
    turned = float(np.ptp(observed.slow.position[:, hypothesis.joints[0]]))
    bunches = np.split(lines, np.flatnonzero(np.diff(lines) * turned >= 2 * np.pi) + 1)
    for bunch in bunches:
        if bunch.size > 1:
            others = [N for N in lines.tolist() if N not in bunch]
            for N in bunch.tolist():
                yield TorqueRipple.of_lines(hypothesis.joints[0] + 1, (N, *others))


def _is_same(line: float, other: float) -> bool:
    return abs(line / other - 1.0) < LITTLE


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
    known: FloatArray  # (R, c) orthonormal: dependence on position, lines found before
    bandwidth: float  # [Hz]
    way: float  # that half of the rows lie in and that was moved through without a gap [rad]

    @classmethod
    def of(
        cls, observed: Observations, residual: FloatArray, joint: int, knots: int = RIPPLE.shape
    ) -> _Angle:
        """Take the rows of one joint (0-based)."""
        rows = observed.moving[:, joint]
        q, v = observed.slow.position[rows, joint], observed.slow.velocity[rows, joint]
        places = _places(q, observed.recording[rows])
        shape = _shape(q, v, knots, places)
        known = _orthonormal(shape, np.linalg.norm(shape, axis=0))
        y = residual[rows, joint]
        if y.size:  # a short burst is no line, yet would have power in all of them
            middle = float(np.median(y))
            most = RIPPLE.burst * float(np.median(np.abs(y - middle)))
            y = np.clip(y, middle - most, middle + most)
        ways = [np.full(int(place.sum()), np.ptp(q[place])) for place in places]
        way = float(np.median(np.concatenate(ways))) if ways else 0.0
        return cls(q, np.abs(v), _rest(y, known), known, observed.bandwidth, way)

    @property
    def range(self) -> float:
        """Angle that nearly all rows lie in [rad]; 0 where too few do."""
        if self.position.size < RIPPLE.shape or not self.way:
            return 0.0
        low, high = np.quantile(self.position, (RIPPLE.bulk, 1 - RIPPLE.bulk))
        return float(high - low)

    def passed(self, cycles: float) -> FloatArray:
        """Return what the filter leaves of a line at each row, (R,)."""
        ratio = self.speed * (cycles / (2 * np.pi * self.bandwidth))
        gain = 1.0 / (1.0 + (ratio * ratio) ** ORDER)
        gain[gain < SOME] = 0.0
        return gain

    def power(self, first: float, step: float, count: int) -> Spectrum:
        """Return how much of the residual is in evenly spaced lines, and of even noise."""
        cosine, sine, noise, rows = line_sums(
            self.position,
            self.speed,
            self.residual,
            first,
            step,
            count,
            self.bandwidth,
            SOME,
            RIPPLE.block,
        )
        enough = rows > SOME * self.position.size
        amount = np.where(enough, cosine**2 + sine**2, 0.0)
        cycles = first + step * np.arange(count, dtype=np.float64)
        return Spectrum(cycles, amount, np.maximum(noise, TINY**2))

    def _waves(self, cycles: float) -> FloatArray:
        """Return what one line adds to all that is known, orthonormal, (R, at most 2)."""
        gain = self.passed(cycles)
        angle = cycles * self.position
        waves = np.stack([gain * np.sin(angle), gain * np.cos(angle)], axis=1)
        return _orthonormal(_rest(waves, self.known), np.linalg.norm(waves, axis=0))

    def without(self, *lines: float) -> _Angle:
        """Take lines out, one after the other [1/rev]."""
        less = self
        for cycles in lines:
            waves = less._waves(cycles)
            known = np.concatenate([less.known, waves], axis=1)
            less = replace(less, residual=_rest(less.residual, waves), known=known)
        return less

    def left(self, cycles: float) -> float:
        """Return the energy without one line more."""
        waves = self._waves(cycles)
        return self.energy - float(np.sum((waves.T @ self.residual) ** 2))

    @property
    def energy(self) -> float:
        """Sum of squares of the residual."""
        return float(self.residual @ self.residual)


def _places(position: FloatArray, recording: IntArray) -> list[BoolArray]:
    """Return the rows (R,) of each range that recordings moved through together, without a gap.

    What each of several places has of its own looks like lines, as many in a revolution as there
    are places, where none is moved through as often as a line has to be.

    Args:
        position: At each row, (R,) [rad].
        recording: Which each row is of, (R,).
    """
    own = [position[recording == k] for k in np.unique(recording)]
    ends = sorted((float(some.min()), float(some.max())) for some in own)
    merged = ends[:1]
    for low, high in ends[1:]:
        start, end = merged[-1]
        merged[-1:] = [(start, max(end, high))] if low <= end else [(start, end), (low, high)]
    return [(position >= low) & (position <= high) for low, high in merged]


def _rest(values: FloatArray, known: FloatArray) -> FloatArray:
    """Return what orthonormal columns do not explain."""
    return values - known @ (known.T @ values)


def _orthonormal(columns: FloatArray, size: FloatArray) -> FloatArray:
    """Return orthonormal columns of the same span, without what is but rounding of a size (c,)."""
    if not columns.size or not size.any():
        return columns[:, :0]
    basis, values, _ = np.linalg.svd(columns, full_matrices=False)
    return basis[:, values > DEPENDENT * size.max()]


def _shape(q: FloatArray, v: FloatArray, knots: int, places: Sequence[BoolArray]) -> FloatArray:
    """Return hats of the position at each place, alone and times the sign of motion, (R, c)."""
    hats = [np.zeros((q.size, 0))]
    for place in places:
        low, high = float(q[place].min()), float(q[place].max())
        at = np.linspace(low, max(high, low + 1e-6), knots)
        hats.append(np.maximum(0.0, 1.0 - np.abs(q[:, None] - at) / (at[1] - at[0])))
    every = np.concatenate(hats, axis=1)
    return np.concatenate([every, np.sign(v)[:, None] * every], axis=1)


def _lines(angle: _Angle, limit: int, joints: int) -> tuple[float, ...]:
    """Return the cycles per revolution of the significant lines, strongest first.

    Over a range of few revolutions lines overlap. The first one found is blurred by all others, and
    what it leaves of itself would look like a line beside it; so with each new one all are refined.
    """
    if angle.range <= 0:
        return ()
    step = 2 * np.pi / angle.range / RIPPLE.oversampling
    first = RIPPLE.least_periods * 2 * np.pi / min(angle.way, angle.range)
    count = int((RIPPLE.most_cycles - first) / step)
    if count <= 1:
        return ()
    threshold = float(np.log(joints * count / RIPPLE.false_lines))
    found: tuple[float, ...] = ()
    rest = angle
    while len(found) < limit:
        tried = (
            _together(angle, (*found, _refined(rest, peak, step)), step)
            for peak in _peaks(rest.power(first, step, count), found)
        )
        more = next(
            (some for some in tried if _last_stands_out(angle, some, step) > threshold), None
        )
        if more is None:
            break
        found, rest = more, angle.without(*more)
    for line in found:  # which another one may have made that was found later
        others = tuple(other for other in found if other != line)
        if _last_stands_out(angle, (*others, line), step) <= threshold:
            found = others
    return found


def _peaks(spectrum: Spectrum, found: Sequence[float]) -> Iterator[float]:
    """Yield the cycles per revolution of the highest peaks above their neighbourhood.

    The highest one may be what lines not found yet leave beside it. Of those below, a peak near a
    line that was found may be what that one leaves, if it is not quite where it is.
    """
    above, cycles = spectrum.above.copy(), spectrum.cycles
    resolution = RIPPLE.oversampling * float(cycles[1] - cycles[0])
    best = float(cycles[np.argmax(above)])
    yield best
    for line in found:
        above[np.abs(cycles - line) < FEW * resolution] = 0.0
    for _ in range(RIPPLE.peaks - 1):
        above[np.abs(cycles - best) < resolution] = 0.0
        if not above.any():
            return
        best = float(cycles[np.argmax(above)])
        yield best


def _together(angle: _Angle, lines: tuple[float, ...], step: float) -> tuple[float, ...]:
    """Refine lines beside one another, in turn, until they stay.

    Source: Li and Stoica, "Efficient mixed-spectrum estimation with applications to target feature
    extraction", IEEE Trans. Signal Processing 44(2), 1996 (RELAX).
    """
    for _ in range(FEW if lines[1:] else 0):
        before = lines
        for k, line in enumerate(lines):
            others = (*lines[:k], *lines[k + 1 :])
            refined = _refined(angle.without(*others), line, 0.5 * step)
            lines = (*lines[:k], refined, *lines[k + 1 :])
        if max(abs(a - b) for a, b in zip(lines, before, strict=True)) < RIPPLE.stays * step:
            break
    return lines


def _slow_line(angle: _Angle) -> float | None:
    """Return the cycles per revolution of the line of few periods that leaves least, if any.

    Where a joint was at several places, what each has of its own looks like few periods there.
    """
    if not 0 < angle.range <= angle.way:
        return None
    step = 2 * np.pi / angle.range / RIPPLE.oversampling
    few = RIPPLE.least_periods * np.array([0.5, 2.0])
    near = step * np.arange(*(RIPPLE.oversampling * few))
    energy = [angle.left(float(cycles)) for cycles in near]
    line = _refined(angle, float(near[int(np.argmin(energy))]), step)
    return line if angle.left(line) < (1.0 - RIPPLE.least_part) * angle.energy else None


def _refined(angle: _Angle, cycles: float, step: float) -> float:
    """Return the line near grid point `cycles` that leaves least; in the end by a parabola."""
    for width in (step, step / RIPPLE.around):
        near = cycles + width * np.linspace(-1.0, 1.0, RIPPLE.around)
        energy = np.array([angle.left(float(N)) for N in near])
        middle = int(np.clip(np.argmin(energy), 1, near.size - 2))
        a, b, c = energy[middle - 1 : middle + 2]
        curvature = a - 2 * b + c
        shift = float(np.clip(0.5 * (a - c) / curvature, -1.0, 1.0)) if curvature > 0 else 0.0
        cycles = float(near[middle] + shift * (near[1] - near[0]))
    return cycles


def _last_stands_out(angle: _Angle, lines: Sequence[float], step: float) -> float:
    """Return the power of the last of some lines over the level around it, beside the others.

    A strong line raises its own neighbourhood, since no joint covers its range evenly.
    """
    before = angle.without(*lines[:-1])
    rest = before.without(lines[-1])
    around = rest.power(lines[-1] - RIPPLE.neighbours // 2 * step, step, RIPPLE.neighbours)
    level = max(1.0, float(np.median(around.normalised)) / np.log(2))
    return 0.5 * (before.energy - rest.energy) / (rest.energy / rest.residual.size) / level
