"""Contact: the finding of pushes from outside.

Pushes: short stretches of time in which something outside leans on the arm.

A push shows on several joints at once, as one wrench at the flange would: -J(q)ᵀ w, for 0.3 to
2 s. What one joint does alone, such as the transient of a friction at a reversal, is none. Pushes
are events, not properties of the arm: they cannot be predicted, and nothing else should be fitted
to the rows that they cover. The scan looks for the course of half a sine, that of a human push; one
of constant strength is found as two, at its start and at its end.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from scipy.linalg import solve_triangular
from scipy.ndimage import minimum_filter1d

from estimators.diagnosis.hypotheses.responses import Response, Sharp, ready, response, sharp
from estimators.diagnosis.residuals.held_out import rmse
from estimators.diagnosis.residuals.observations import Observations  # noqa: TC001  # read by singledispatch
from estimators.diagnosis.residuals.plausibility import doubtful_encoders
from estimators.diagnosis.settings.judgement import CONFIDENCE
from estimators.diagnosis.settings.pushes import PUSHES
from estimators.diagnosis.verdict import CONTACT, BeforeAfter, Finding, Interval, Where
from estimators.diagnosis.wording import names_of
from limo_driver.physics import ExternalContact
from limo_driver.recordings.differentiation import smooth

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from estimators.diagnosis.judgement.judgement import RemainingResidual
    from estimators.diagnosis.residuals.noise import Noise
    from limo_driver.types import FloatArray

_Z95 = 1.96
_SCALE = np.array([*3 * (PUSHES.force,), *3 * (PUSHES.force * PUSHES.lever,)])  # [N, N m]


def contact_of(
    found: Sequence[Push], observed: Observations, proven: FloatArray, remaining: RemainingResidual
) -> tuple[Finding, ...]:
    """Return the finding of pushes; they are events, so the improved simulation leaves them out.

    Args:
        found: When something pushed.
        observed: Recordings and simulation.
        proven: Residual (K, n) of the improved simulation, not fitted to these rows [N m].
        remaining: Residual that remains, with its noise floor of each joint.
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
        weight = observed.moving.any(axis=0) / remaining.floor
        X = (columns * weight[:, None, None]).reshape(-1, len(terms))
        y = (proven[rows] * weight).T.ravel()
        precision = X.T @ X + np.eye(len(terms)) / PUSHES.strongest**2
        wrench = np.linalg.solve(precision, X.T @ y)
        spread = _Z95 * np.sqrt(PUSHES.remembered * np.diag(np.linalg.inv(precision)))
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
            confidence=CONFIDENCE.of_contact,
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
    """Say how many stretches there are, and when, in the time of each recording."""
    said: list[str] = []
    names = names_of(observed.recordings)
    for number, name in enumerate(names):
        times = [f"{p.start:.1f} to {p.end:.1f} s" for p in found if p.recording == number]
        if times:
            said.append(" and ".join(times) + f" of {name}" * (len(names) > 1))
    count = "a short stretch" if len(found) == 1 else f"{len(found)} short stretches"
    return f"{count} of time ({'; '.join(said)})"


@dataclass(frozen=True)
class Push:
    """When something pushed, in the time of one recording."""

    recording: int  # 0-based
    start: float  # [s]
    end: float  # [s]
    evidence: float  # [nat] against nothing


@dataclass(frozen=True, kw_only=True)
class ContactIn(ExternalContact):
    """A contact that acts in one recording only; its column is zero in all others.

    Each recording has its own time, so a window alone does not say which one is meant.
    """

    recording: int  # 0-based


@sharp.register
def _(effect: ContactIn, observed: Observations) -> Sharp:
    """Evaluate the contact around its windows alone: everywhere else it is zero."""
    start = min(window[0] for window in effect.windows)
    end = max(window[1] for window in effect.windows)
    values = np.zeros((len(observed.kept), observed.n))
    time = observed.motion.time
    for rows in observed.segments:
        near = (time[rows] > start - 2 * PUSHES.spread) & (time[rows] < end + 2 * PUSHES.spread)
        near &= observed.recording_of_sample[rows] == effect.recording
        samples = rows.start + np.flatnonzero(near)
        if samples.size > 2:  # noqa: PLR2004  # else nothing to filter
            part = _filtered(effect, observed, samples)
            kept = (observed.kept >= samples[0]) & (observed.kept <= samples[-1])
            values[kept] = part[observed.kept[kept] - samples[0]]
    return ready(Response(tuple(range(observed.n)), values.T), observed)


def _filtered(
    effect: ExternalContact, observed: Observations, samples: NDArray[np.int64]
) -> FloatArray:
    motion, model = observed.motion[slice(samples[0], samples[-1] + 1)], observed.simulation.model
    total = np.zeros((len(motion), 6))
    for (start, end), wrench in zip(effect.windows, effect.wrench, strict=True):
        total[(motion.time >= start) & (motion.time < end)] += wrench
    torque = np.zeros_like(motion.position)
    for t in np.flatnonzero(total.any(axis=1)):
        torque[t] = -model.flange_jacobian(motion.position[t]).T @ total[t]
    return smooth(motion.time, torque, observed.bandwidth, [slice(0, len(motion))])


def wrench_of(push: Push) -> tuple[ContactIn, ...]:
    """Return six contacts: half a sine over a push, of unit size along each axis of the wrench."""
    edges = np.linspace(push.start, push.end, PUSHES.pieces + 1)
    middle = (0.5 * (edges[1:] + edges[:-1]) - push.start) / (push.end - push.start)
    windows = tuple(zip(edges[:-1].tolist(), edges[1:].tolist(), strict=True))
    return tuple(
        ContactIn(
            windows=windows,
            wrench=tuple(tuple((size * axis).tolist()) for size in np.sin(np.pi * middle)),
            recording=push.recording,
        )
        for axis in np.eye(6)
    )


def pushes(observed: Observations, residual: FloatArray, noise: Noise) -> tuple[Push, ...]:
    """Return the stretches of time in which one wrench explains several joints at once.

    Args:
        observed: Recordings and simulation, K slow rows of n joints.
        residual: What a fit leaves, (K, n) [N m].
        noise: How errors look.

    Source: Haddadin, De Luca and Albu-Schäffer, "Robot collisions: a survey on detection,
    isolation, and identification", IEEE T-RO 33(6), 2017.
    """
    if doubtful_encoders(observed):  # the load of every joint may be strange at any time
        return ()
    scan = _Scan.of(observed, residual, noise)
    trials = [
        scan.trial(recording, float(start), float(start + length))
        for recording in range(len(observed.recordings))
        for length in PUSHES.lengths
        for start in scan.starts(recording, length)
    ]
    if not trials:
        return ()
    calm = np.quantile([push.evidence for push in trials], PUSHES.calm)
    least = PUSHES.least_evidence + 3.0 * max(0.0, float(calm))
    found: list[Push] = []
    seen: list[Push] = []
    for push in sorted(trials, key=lambda push: -push.evidence):
        if push.evidence < least or len(found) > PUSHES.most:
            break
        if any(overlap(push, other) for other in seen):
            continue
        better = scan.settled(push)
        new = not any(overlap(better, other) for other in found)
        # at an end of the range it would be longer still, or a spike
        length = better.end - better.start
        inside = PUSHES.shortest + PUSHES.steps[-1] < length < PUSHES.longest - PUSHES.steps[0]
        one_wrench = better.evidence > PUSHES.least_share * scan.strangeness(better)
        if new and inside and one_wrench and better.evidence - scan.alone(better) > PUSHES.alone:
            found.append(better)
        seen.append(better)
    # what recurs all the time is no push
    return tuple(found) if len(found) <= PUSHES.most else ()


def covered(observed: Observations, found: Sequence[Push]) -> NDArray[np.bool_]:
    """Mark the rows that pushes act on, filter included, (K,)."""
    time = observed.slow.time
    result = np.zeros(time.size, dtype=bool)
    for push in found:
        near = (time > push.start - PUSHES.spread) & (time < push.end + PUSHES.spread)
        result |= near & (observed.recording == push.recording)
    return result


def overlap(a: Push, b: Push) -> bool:
    """Say whether two pushes share rows, once the filter has spread them."""
    return (
        a.recording == b.recording
        and a.start < b.end + PUSHES.spread
        and b.start < a.end + PUSHES.spread
    )


@dataclass(frozen=True)
class _Scan:
    """Whitened residual and Jacobians on the slow rows."""

    observed: Observations
    residual: FloatArray  # (K, n) whitened, zero near rest
    jacobian: FloatArray  # (K, 6, n)
    memory: FloatArray  # (lags, K, n) weights that predict an error from the rows before it
    weight: FloatArray  # (K, n) 1 over the deviation of the prediction error, 0 near rest [1/(N m)]

    @classmethod
    def of(cls, observed: Observations, residual: FloatArray, noise: Noise) -> _Scan:
        """Whiten a residual (K, n)."""
        model, joints = observed.simulation.model, range(observed.n)
        jacobian = np.stack([model.flange_jacobian(q) for q in observed.slow.position])
        white = np.stack([noise.whiten(residual[:, j], j) for j in joints], axis=1)
        memory = np.stack([noise.weight[j][noise.known[:, j]].T for j in joints], axis=2)
        weight = np.stack([1.0 / noise.white[j][noise.known[:, j]] for j in joints], axis=1)
        reach = 2 * round(PUSHES.spread / observed.row_period) + 1
        use = minimum_filter1d(observed.moving, reach, axis=0)  # a joint that stops holds anything
        return cls(observed, np.where(use, white, 0.0), jacobian, memory, weight * use)

    def starts(self, recording: int, length: float) -> FloatArray:
        """Return where windows of a length begin, in the time of a recording [s]."""
        time = self.observed.slow.time[self.observed.recording == recording]
        if not time.size or time[-1] - time[0] < 2 * length:
            return np.zeros(0)
        return np.arange(time[0], time[-1] - length, PUSHES.stride * length)

    def trial(self, recording: int, start: float, end: float) -> Push:
        """Return the evidence for a push that lasts for given seconds."""
        rows = self._rows(recording, start, end)
        course = self._course(rows, start, end)
        use = (self.weight[rows] > 0).mean(axis=0) > PUSHES.moving
        if use.sum() <= self.observed.n // 2:
            return Push(recording, start, end, 0.0)
        A = self._white(course[:, None, None] * self.jacobian[rows], rows) * _SCALE[:, None]
        return Push(recording, start, end, _evidence(A[:, :, use], self.residual[rows][:, use]))

    def alone(self, push: Push) -> float:
        """Return the evidence for something on one joint alone, whichever that is best."""
        rows = self._rows(push.recording, push.start, push.end)
        course = PUSHES.torque * self._course(rows, push.start, push.end)
        A = self._white(np.repeat(course[:, None, None], self.observed.n, axis=2), rows)
        y = self.residual[rows]
        return max(_evidence(A[:, :, j : j + 1], y[:, j : j + 1]) for j in range(self.observed.n))

    def strangeness(self, push: Push) -> float:
        """Return how much likelier a push's rows would be if all their errors were predicted [nat].

        Beyond what noise alone has of it.
        """
        white = self.residual[self._rows(push.recording, push.start, push.end)]
        return 0.5 * float(np.sum(white**2) - np.count_nonzero(white))

    def settled(self, push: Push) -> Push:
        """Move start and end to where the evidence is highest."""
        for step in PUSHES.steps:
            while True:
                moves = [
                    (push.start + a * step, push.end + b * step)
                    for a, b in ((-1, 0), (1, 0), (0, -1), (0, 1), (1, 1), (-1, -1))
                ]
                trials = [
                    self.trial(push.recording, start, end)
                    for start, end in moves
                    if PUSHES.shortest <= end - start <= PUSHES.longest
                ]
                best = max(trials, key=lambda trial: trial.evidence)
                if best.evidence <= push.evidence:
                    break
                push = best
        return push

    def _rows(self, recording: int, start: float, end: float) -> slice:
        """Return the rows of some seconds, with as many after as errors are remembered."""
        own = np.flatnonzero(self.observed.recording == recording)
        low, high = np.searchsorted(self.observed.slow.time[own], (start, end))
        return slice(int(own[0] + low), int(min(own[0] + high + len(self.memory), own[-1] + 1)))

    def _course(self, rows: slice, start: float, end: float) -> FloatArray:
        """Return half a sine from start to end, (R,)."""
        phase = np.clip((self.observed.slow.time[rows] - start) / (end - start), 0.0, 1.0)
        return np.sin(np.pi * phase)

    def _white(self, values: FloatArray, rows: slice) -> FloatArray:
        """Whiten columns (R, c, n) that are zero before these rows."""
        result = values.copy()
        for lag, memory in enumerate(self.memory, start=1):
            result[lag:] -= memory[rows][lag:, None, :] * values[:-lag]
        return result * self.weight[rows][:, None, :]


def _evidence(A: FloatArray, y: FloatArray) -> float:
    """Return the log evidence of c columns with unit prior, (R, c, n), for errors (R, n)."""
    flat = A.transpose(0, 2, 1).reshape(-1, A.shape[1])
    lower = np.linalg.cholesky(flat.T @ flat + np.eye(flat.shape[1]))
    z = solve_triangular(lower, flat.T @ y.ravel(), lower=True, check_finite=False)
    return 0.5 * float(z @ z) - float(np.log(np.diag(lower)).sum())
