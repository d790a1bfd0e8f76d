"""Pushes: short stretches of time in which something outside acts on the arm.

A push is an event, not a property of the arm: nothing is fitted to its rows, and it cannot be
predicted. It may act on any link, so that one joint alone or all of them feel it, may rebound, or
may be held. What tells it from physics that is left out is that it is rare: over its seconds the
errors of the joints are much larger than over nearly all others of the same length, in a way that
neither the errors before them nor the arm's own acceleration explain.

Source: Haddadin, De Luca and Albu-Schäffer, "Robot collisions: a survey on detection, isolation,
and identification", IEEE T-RO 33(6), 2017.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from typing import TYPE_CHECKING, Final

import numpy as np
from scipy.ndimage import maximum_filter1d, minimum_filter1d, uniform_filter1d

from estimators.diagnosis.from_torque.residuals.noise import Noise, usual_errors
from estimators.diagnosis.from_torque.residuals.reversals import (
    about_reversals,
    ends_of_motion,
    rows_in,
    steadily_moving,
    surprisal,
    usual_about_reversals,
)
from estimators.diagnosis.from_torque.residuals.usable_joints import doubtful_encoders
from estimators.diagnosis.settings import FAR, FEW, NEARLY_ALL, TINY
from estimators.diagnosis.settings.judgement import PUSHES
from estimators.regression.evidence import REACH
from limo_driver.types import BoolArray, FloatArray, IntArray

if TYPE_CHECKING:
    from collections.abc import Sequence

    from estimators.diagnosis.from_torque.residuals.observations import Observations

LENGTHS: Final = tuple(np.geomspace(*PUSHES.lengths).tolist())  # [s]


@dataclass(frozen=True)
class TimeSpan:
    """Time of a recording in which something happened."""

    recording: int  # 0-based
    start: float  # [s]
    end: float  # [s]


@dataclass(frozen=True)
class Push(TimeSpan):
    """When something pushed, in the time of one recording."""

    evidence: float  # [nat] against errors as they are elsewhere
    joints: tuple[int, ...]  # 0-based, that felt it
    surprisal: float = 0.0  # [nat], how seldom errors that scatter as those elsewhere are as large
    held: bool = False  # at one strength, rather than in the course of half a sine
    friction: tuple[float, ...] = ()  # [N m], that each joint may bear as well at rest


def pushes(observed: Observations, residual: FloatArray) -> tuple[Push, ...]:
    """Return the stretches of time in which something pushed, however many: none that is not rare.

    Args:
        observed: Recordings and simulation, K slow rows of n joints.
        residual: What a fit leaves, (K, n) [N m].
    """
    if doubtful_encoders(observed):  # the load of every joint may be strange at any time
        return ()
    scan = _Scan.of(observed.undisturbed(None), residual)
    trials = scan.trials()
    strong: list[Push] = []
    for push in trials:
        if push.evidence < PUSHES.least_evidence:
            break
        if not any(_near(push, other) for other in strong):
            strong.append(push)
    # many hide one another, so the weakest that is rare beside all stronger ones ends the list
    rare = [scan.surprisal(push, strong[:k]) > PUSHES.rare for k, push in enumerate(strong)]
    found: list[Push] = []
    for push in strong[: len(rare) - [*reversed(rare), True].index(True)]:
        found.append(scan.with_final_times(push, found))
    others = [trial for trial in trials if not any(_near(trial, push) for push in found)]
    events: list[Push] = []
    for push in found:
        if scan.is_event(push, others):
            events.append(push)
        else:  # so it tells what there is besides events
            others.append(push)
    events = [replace(push, surprisal=scan.surprisal(push, events)) for push in events]
    return tuple(push for push in events if push.surprisal > PUSHES.rare)


def covered(observed: Observations, found: Sequence[TimeSpan]) -> BoolArray:
    """Mark the rows that pushes or jolts act on, filter included, (K,)."""
    time = observed.slow.time
    result = np.zeros(time.size, dtype=bool)
    for own in found:
        near = (time > own.start - PUSHES.spread) & (time < own.end + PUSHES.spread)
        result |= near & (observed.recording == own.recording)
    return result


def overlap(a: TimeSpan, b: TimeSpan, within: float = PUSHES.spread) -> bool:
    """Say whether two events share rows, once the filter has spread them.

    Args:
        a: One event.
        b: Another.
        within: What may lie between them [s].
    """
    between = max(a.start, b.start) - min(a.end, b.end)
    return a.recording == b.recording and between < within


def _overlapping(
    push: Push, recording: IntArray, first: FloatArray, last: FloatArray, within: float = 0.0
) -> BoolArray:
    """Mark windows (S,) that share time with a push, or have less than a time [s] between."""
    own = recording == push.recording
    return own & (first < push.end + within) & (last > push.start - within)


def _near(a: Push, b: Push) -> bool:
    """Say whether two pushes may be one, that rebounds or that errors remember."""
    return overlap(a, b, PUSHES.apart)


@dataclass(frozen=True)
class _Scan:
    """Errors that those before them do not explain, over what each joint usually leaves."""

    observed: Observations
    residual: FloatArray  # (K, n) [N m]
    floor: FloatArray  # (n,) [N m], what is usual
    surprise: FloatArray  # (K, n) over as long as a short hit, zero where it is not judged
    lasting: FloatArray  # (K, n) over longer, by which the confidence was learned
    judged: BoolArray  # (K, n)
    steady: BoolArray  # (K, n), those of them that are not about a reversal
    resting: BoolArray  # (K,)

    @classmethod
    def of(cls, observed: Observations, residual: FloatArray) -> _Scan:
        """Whiten a residual (K, n), smooth it over a push's least length, and scale it."""
        resting, turns = _resting(observed), about_reversals(observed)
        moving = steadily_moving(observed) & ~ends_of_motion(observed)[:, None]
        steady = moving | resting[:, None]
        result = residual.copy()
        edges = np.flatnonzero(np.diff(resting.astype(int), prepend=0, append=0))
        for start, end in edges.reshape(-1, 2):
            result[start:end] -= np.median(residual[start:end], axis=0)
        residual = result
        floor = usual_errors(residual, steady)
        noise = _noise(observed, residual, observed.moving | resting[:, None])
        white = np.stack([noise.whiten(residual[:, j], j) for j in range(observed.n)], axis=1)
        # at reversals others tell as much
        own = np.where(turns, 1.0, _grown(white, _inertial(observed, moving), moving))
        judged, averaged = steady | turns, []
        for seconds in (PUSHES.shortest, 2 * PUSHES.shortest):
            errors = uniform_filter1d(white * judged, _odd_rows(observed, seconds), axis=0) / own
            usual = usual_about_reversals(observed, errors, steady, turns)
            judged = judged & np.isfinite(usual)
            averaged.append(errors / usual)
        surprise, lasting = (np.where(judged, errors, 0.0) for errors in averaged)
        return cls(observed, residual, floor, surprise, lasting, judged, steady, resting)

    def trials(self) -> list[Push]:
        """Return all windows in which some joint felt something, the strongest first."""
        found: list[Push] = []
        time = self.observed.slow.time
        for length in LENGTHS:
            rows = max(3, rows_in(self.observed, length))
            evidence = self._evidence(rows)
            total = np.maximum(evidence - PUSHES.joint, 0.0).sum(axis=1)
            for first in np.flatnonzero((evidence > PUSHES.felt).any(axis=1)).tolist():
                last = first + rows - 1
                felt = np.flatnonzero(evidence[first] > PUSHES.felt).tolist()
                recording = int(self.observed.recording[first])
                start, end = float(time[first]), float(time[last])
                found.append(Push(recording, start, end, float(total[first]), tuple(felt)))
        return sorted(found, key=lambda push: -push.evidence)

    def is_event(self, push: Push, others: Sequence[Push]) -> bool:
        """Say whether what was found may be an event: if several joints felt it, it is.

        What one joint alone felt is physics of that joint where the joint has just turned or
        stopped, and where it leaves weaker ones of the kind at other times. And what reaches over
        the start or the end of the arm's motion is what friction does there, unless many joints
        feel one and the same course; single joints stop and turn at any time, also while the arm is
        pushed. While the whole arm rests, its physics does nothing that recurs, once it has
        with_final_times: as it stops, all joints creep within their friction, and in one course.
        """
        within = self._within(push)
        judged = self.judged[within].any(axis=1)
        rests = not self.observed.moving[within].any()
        alike = len(push.joints) >= FEW and self._explained(push) >= NEARLY_ALL
        known = not judged.size or judged.mean() >= PUSHES.judged
        if not (known or alike):
            return False
        if rests:  # creep is largest as it begins
            apart = (alike and not push.held) or self._has_settled(push)
        else:
            apart = alike or self._apart_from_ends(push)
        if not apart:
            return False
        return len(push.joints) > 1 or self._is_event_of_one(push, others)

    def _is_event_of_one(self, push: Push, others: Sequence[Push]) -> bool:
        """Say whether what one joint alone felt may be an event."""
        (joint,), within = push.joints, self._within(push)
        turned = self.steady[within, joint].mean() < PUSHES.judged
        if turned or self._explained(push) < PUSHES.explained:
            return False
        time = self.observed.slow.time
        before = (self.observed.recording == push.recording) & (time < push.end)
        before &= time > push.start - PUSHES.apart
        rested = bool(self.resting[before].all())
        if rested and self.resting[within].all():
            return True
        steady = rested or self.observed.moving[before, joint].all()
        alike = (other.evidence for other in others if joint in other.joints)
        return bool(steady and push.evidence > FAR * max(alike, default=0.0))

    def _explained(self, push: Push) -> float:
        """Return the part of squared errors in and around a push that its course explains."""
        near = covered(self.observed, (push,))
        time, errors = self.observed.slow.time[near], self.residual[near][:, list(push.joints)]
        course = partial(_hold, ramp=1.0 / self.observed.bandwidth) if push.held else _half_sine
        others = np.ones((time.size, 1))
        columns = np.column_stack([_felt(course, time, push.start, push.end), others])
        return 1.0 - (_left(columns, errors) / max(_left(others, errors), TINY)) ** 2

    def _evidence(self, rows: int) -> FloatArray:
        """Return how much likelier each joint's errors are if they vary more than usual [nat].

        Over so many rows from each on, (K, n); zero where too few of them are judged, or a
        segment ends among them.
        """
        result = np.zeros_like(self.surprise)
        energy, enough, independent = self._energies(self.surprise, PUSHES.shortest, rows)
        starts, resting = np.arange(len(energy)), self._touch_rest(rows)
        for j, (use, away) in enumerate(zip(enough.T, (enough & ~self._turn(rows)).T, strict=True)):
            if away.sum() < PUSHES.fewest:
                continue
            usual = np.full(starts.size, max(np.median(energy[away, j]), np.finfo(float).tiny))
            for alike in (resting, ~resting):  # what is usual at rest is not so in motion
                if (own := away & alike).any():
                    usual[alike] = max(usual[0], float(np.median(energy[own, j])))
            ratio = np.where(use, np.maximum(energy[:, j] / usual, 1.0), 1.0)
            result[starts, j] = 0.5 * independent * (ratio - 1.0 - np.log(ratio))
        return result

    def _energies(
        self, surprise: FloatArray, smoothed: float, rows: int
    ) -> tuple[FloatArray, BoolArray, float]:
        """Return sums of squares over so many rows from each on, (S, n), and which are judged.

        Not judged are those of too few judged rows, and those in which a segment ends. The last is
        how many independent errors there are in each.
        """
        energy, known = (_sums(x, rows) for x in (surprise**2, self.judged.astype(float)))
        segment = self.observed.segment
        whole = segment[: len(energy)] == segment[rows - 1 :][: len(energy)]
        independent = rows / (PUSHES.alike * _odd_rows(self.observed, smoothed))
        return energy, whole[:, None] & (known >= PUSHES.judged * rows), independent

    def _touch_rest(self, rows: int) -> BoolArray:
        return np.asarray(_sums(self.resting[:, None].astype(float), rows)[:, 0] > 0)

    def _turn(self, rows: int) -> BoolArray:
        """Mark windows (S, n) in which a joint turns: they do not tell what is usual."""
        return np.asarray(_sums((self.judged & ~self.steady).astype(float), rows) > 0)

    def surprisal(self, push: Push, stronger: Sequence[Push] = ()) -> float:
        """Return how seldom errors that scatter as those of other stretches are as large [nat].

        Of all joints together. While the whole arm rests its physics scatters nothing: there it is
        the evidence.

        Args:
            push: What may be one.
            stronger: Others, which are no scatter as long as most stretches are apart from them.
        """
        time, most = self.observed.slow.time, 0.0
        for rows in {max(3, rows_in(self.observed, length)) for length in LENGTHS}:
            energy, enough, independent = self._energies(self.lasting, 2 * PUSHES.shortest, rows)
            count = len(energy)
            ends = self.observed.recording[:count], time[:count], time[rows - 1 :]
            within, resting = _overlapping(push, *ends), self._touch_rest(rows)
            if (within & resting).any():
                return push.evidence
            enough &= ~resting[:, None]  # which say nothing of what is usual in motion
            total = np.zeros(count)
            others = enough & ~self._turn(rows)
            others &= ~_overlapping(push, *ends, PUSHES.spread)[:, None]
            apart = others.copy()
            for other in stronger:
                apart &= ~_overlapping(other, *ends, PUSHES.spread)[:, None]
            for j, (use, away, far) in enumerate(zip(enough.T, others.T, apart.T, strict=True)):
                usual = far if 2 * far.sum() > away.sum() else away
                if usual.sum() >= PUSHES.fewest and (use & within).any():
                    rare = surprisal(energy[use & within, j], energy[usual, j], independent)
                    total[use & within] += np.maximum(rare - PUSHES.joint, 0.0)
            most = max(most, float(total.max(initial=0.0)))
        return most

    def with_final_times(self, push: Push, others: Sequence[Push]) -> Push:
        """Move start and end to where half a sine, or a hold, leaves least of what was felt.

        Of rows on which other pushes act nothing is asked.
        """
        middle = (push.start + push.end) / 2
        away = np.abs(self.observed.slow.time - middle)
        near = (self.observed.recording == push.recording) & (away < PUSHES.longest)
        near &= ~covered(self.observed, others) | self._within(push)
        time, joints = self.observed.slow.time[near], list(push.joints)
        errors = self.residual[near][:, joints] / self.floor[joints]
        sine, hold = (
            min(
                _fitted(course, time, errors, middle - length / 2, middle + length / 2)
                for length in (push.end - push.start, *LENGTHS)
            )
            for course in (_half_sine, partial(_hold, ramp=1.0 / self.observed.bandwidth))
        )
        _, start, end = min(sine, hold)
        return replace(push, start=start, end=end, held=hold < sine)

    def _within(self, push: Push) -> BoolArray:
        """Mark the rows (K,) between the start and the end of a push."""
        time = self.observed.slow.time
        own = self.observed.recording == push.recording
        return own & (time >= push.start) & (time <= push.end)

    def _apart_from_ends(self, push: Push) -> bool:
        """Say whether errors are as usual for a while between a push and the ends of the motion.

        Where they are not, nobody can tell a push from what starting or braking does.
        """
        time, quiet = self.observed.slow.time, self._quiet(push)
        own = self.observed.recording == push.recording
        moves = time[own & self.observed.moving.any(axis=1)]
        before = own & (time > moves[0]) & (time < push.start)
        after = own & (time < moves[-1]) & (time > push.end)
        return bool(quiet[before].any() and quiet[after].any())

    def _has_settled(self, push: Push) -> bool:
        """Say whether errors of an arm at rest are as usual for a while before a push."""
        time, quiet = self.observed.slow.time, self._quiet(push)
        before = (self.observed.recording == push.recording) & (time < push.start)
        moves = np.flatnonzero(before & self.observed.moving.any(axis=1))
        return not moves.size or bool(quiet[moves[-1] + 1 :][before[moves[-1] + 1 :]].any())

    def _quiet(self, push: Push) -> BoolArray:
        """Mark rows (K,) about which errors of what felt a push are as usual for a while."""
        joints = list(push.joints)
        large = (np.abs(self.residual[:, joints]) > REACH * self.floor[joints]).any(axis=1)
        rows = _odd_rows(self.observed, PUSHES.ends)
        return np.asarray(minimum_filter1d(~large, rows), dtype=bool)


_Course = Callable[[FloatArray, float, float], FloatArray]


def _half_sine(time: FloatArray, start: float, end: float) -> FloatArray:
    return np.sin(np.pi * np.clip((time - start) / (end - start), 0.0, 1.0))


def _hold(time: FloatArray, start: float, end: float, ramp: float) -> FloatArray:
    """Return a course of constant strength, with the ends that the filter makes of it."""
    return np.clip(np.minimum(time - start, end - time) / ramp + 0.5, 0.0, 1.0)


def _felt(course: _Course, time: FloatArray, start: float, end: float) -> FloatArray:
    """Return what joints may feel of a course, (R, 2): the arm moves on under the force.

    So its lever at a joint changes over the push, by about as much in each second.
    """
    strength = course(time, start, end)
    return np.stack([strength, strength * (time - (start + end) / 2) / (end - start)], axis=1)


def _fitted(
    course: _Course, time: FloatArray, errors: FloatArray, start: float, end: float
) -> tuple[float, float, float]:
    """Return what a course leaves of errors (R, j), and the start and end at which it is least."""
    others = np.stack([np.ones_like(time), time - time[0]], axis=1)
    start, end = max(start, float(time[0])), min(end, float(time[-1]))

    def left(start: float, end: float) -> float:
        return _left(np.column_stack([_felt(course, time, start, end), others]), errors)

    best = (left(start, end), start, end)
    for step in (PUSHES.shortest, PUSHES.shortest / 2, PUSHES.shortest / 2**2):
        found = None
        while found != best:
            found = best
            for a, b in ((-1, 0), (1, 0), (0, -1), (0, 1), (1, 1), (-1, -1)):
                start, end = found[1] + a * step, found[2] + b * step
                inside = time[0] <= start and end <= time[-1]
                if inside and PUSHES.shortest <= end - start <= PUSHES.longest:
                    best = min(best, (left(start, end), start, end))
    return best


def _left(columns: FloatArray, errors: FloatArray) -> float:
    """Return the size of what columns (R, c) leave of errors (R, j)."""
    return float(np.linalg.norm(errors - columns @ np.linalg.lstsq(columns, errors)[0]))


def _odd_rows(observed: Observations, seconds: float) -> int:
    """Return how many rows some seconds are, an odd number, so that a window has a middle."""
    return rows_in(observed, seconds) | 1


def _noise(observed: Observations, residual: FloatArray, use: BoolArray) -> Noise:
    """Return how errors (K, n) usually look: what a push adds is cut, and passes for none."""
    most = PUSHES.cut * usual_errors(residual, use)
    return Noise.of(np.clip(residual, -most, most), use, observed.segment, observed.least_noise)


def _resting(observed: Observations) -> BoolArray:
    """Mark the rows (K,) on which the whole arm has been at rest for a while, and stays.

    While others move, a joint that rests holds any torque within its friction. So does an arm that
    is about to move, and nobody knows what came before a recording, or after it.
    """
    still = np.asarray(~observed.moving.any(axis=1))
    rows = 2 * rows_in(observed, PUSHES.ends) + 1
    result = np.zeros_like(still)
    for recording in range(len(observed.recordings)):
        own = observed.recording == recording
        result[own] = minimum_filter1d(still[own], rows, mode="constant", cval=False)
    return result


def _inertial(observed: Observations, moving: BoolArray) -> FloatArray:
    """Return the largest torque of the arm's own acceleration about each row, (K, n).

    Over what it usually is while a joint moves: an error that grows with it is no push.
    """
    slow, body = observed.slow, observed.reference.body
    still = np.zeros_like(slow.velocity)
    torque = body.inverse_dynamics(
        slow.position, slow.velocity, slow.acceleration
    ) - body.inverse_dynamics(slow.position, still, still)
    near = maximum_filter1d(np.abs(torque), 2 * rows_in(observed, PUSHES.spread) + 1, axis=0)
    usual = [float(np.median(near[use, j])) if use.any() else 1.0 for j, use in enumerate(moving.T)]
    return near / np.maximum(usual, np.finfo(float).tiny)


def _grown(errors: FloatArray, inertial: FloatArray, moving: BoolArray) -> FloatArray:
    """Return how many times as large as at rest errors (K, n) are, as they grow with inertia.

    By what nearly all stay below in the slower and in the faster half of the rows of motion: noise
    of sensors does not grow, and an error of it during fast motion is as good as any other.
    """
    result = np.ones_like(errors)
    for j in np.flatnonzero(moving.any(axis=0)):
        use = moving[:, j]
        torque, squares = inertial[use, j] ** 2, errors[use, j] ** 2
        fast = torque > np.median(torque)
        if fast.any():
            (slow_square, slow), (fast_square, large) = (
                (np.quantile(squares[half], NEARLY_ALL), np.median(torque[half]))
                for half in (~fast, fast)
            )
            growth = max((fast_square - slow_square) / (large - slow), 0.0)
            least = max(slow_square - growth * slow, TINY)
            result[:, j] = np.sqrt(1.0 + growth / least * inertial[:, j] ** 2)
    return result


def _sums(values: FloatArray, rows: int) -> FloatArray:
    """Return the sums (K - rows + 1, n) over so many rows from each on."""
    total = np.concatenate([np.zeros((1, values.shape[1])), np.cumsum(values, axis=0)])
    return total[rows:] - total[:-rows]
