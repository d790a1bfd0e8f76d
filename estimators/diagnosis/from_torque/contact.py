"""Contact: the finding of pushes, with the wrench at the flange that would act as they did."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from estimators.diagnosis.from_torque.hypotheses.responses import (
    Response,
    Sharp,
    ready,
    response,
    sharp,
)
from estimators.diagnosis.from_torque.residuals.observations import (
    Observations,  # read by singledispatch
)
from estimators.diagnosis.from_torque.residuals.pushes import covered
from estimators.diagnosis.headline import names_of
from estimators.diagnosis.held_out import rmse
from estimators.diagnosis.quantities import listed
from estimators.diagnosis.settings import MOST, Z95
from estimators.diagnosis.settings.judgement import CONFIDENCE, PUSHES
from estimators.diagnosis.verdict import CONTACT, BeforeAfter, Finding, Interval, Where
from estimators.regression.definite import inverse_root
from limo_driver.physics import ExternalContact
from limo_driver.recordings.filters.differentiation import smooth

if TYPE_CHECKING:
    from collections.abc import Sequence

    from estimators.diagnosis.from_torque.judgement.judgement import RemainingResidual
    from estimators.diagnosis.from_torque.residuals.pushes import Push
    from limo_driver.types import FloatArray, IntArray


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
    found = sorted(found, key=lambda push: (push.recording, push.start))
    floor = np.maximum(remaining.floor, _at_rest(observed, proven))
    wrenches = [_Wrench.of(push, observed, proven, floor) for push in found]
    windows = tuple((push.start, push.end) for push in found)
    felt = sorted({joint for push in found for joint in push.joints})
    joints = f"joint{'s' * (len(felt) > 1)} {listed([str(joint + 1) for joint in felt])}"
    values = tuple(rmse(proven, observed.moving).tolist())
    return (
        Finding(
            effect=CONTACT,
            kind="missing",
            joints=tuple(joint + 1 for joint in felt),
            equivalent=(),
            confidence=_confidence(max(push.surprisal for push in found)),
            parameters={
                "windows": Interval(windows, "s"),
                "wrench": Interval(
                    tuple(wrench.value for wrench in wrenches),
                    "N, N m",
                    tuple(wrench.ci95 for wrench in wrenches),
                ),
            },
            where=Where(windows, "the arm", recording=tuple(p.recording + 1 for p in found)),
            share=0.0,
            heldout_rmse=BeforeAfter(values, values),
            evidence=(
                f"In {_stretches(found, observed)} the errors of {joints} are far larger "
                f"than they otherwise are; {_acts(wrenches)} Nothing was fitted to those rows."
            ),
        ),
    )


def _confidence(surprisal: float) -> float:
    """Return the probability that what looks like a push is one, by how rare it is [nat]."""
    one, rare = CONFIDENCE.of_contact
    return min(
        CONFIDENCE.highest, 1.0 / (1.0 + math.exp(-one - rare * math.log(max(surprisal, 1.0))))
    )


def _at_rest(observed: Observations, proven: FloatArray) -> FloatArray:
    """Return what errors (K, n) of joints that never move usually are, zero of others; (n,) [N m].

    No noise floor is known of them: friction holds any torque at rest.
    """
    apart = np.abs(proven - np.median(proven, axis=0))
    return np.where(observed.undisturbed(None).moving.any(axis=0), 0.0, np.median(apart, axis=0))


@dataclass(frozen=True)
class _Wrench:
    """The wrench at the flange that explains most of a push."""

    value: tuple[float, ...]  # (6,) [N, N m]
    ci95: tuple[tuple[float, float], ...]
    share: float  # of the squared errors that it explains

    @property
    def is_determined(self) -> bool:
        """Whether every direction of its force is known to a part of the whole."""
        low, high = np.array(self.ci95[:3]).T
        force = float(np.linalg.norm(self.value[:3]))
        return bool(np.max(high - low) < force)

    @classmethod
    def of(
        cls, push: Push, observed: Observations, proven: FloatArray, floor: FloatArray
    ) -> _Wrench:
        terms, rows = wrench_of(push), covered(observed, (push,))
        columns = np.zeros((observed.n, int(rows.sum()), len(terms)))
        for k, term in enumerate(terms):
            joints, values = response(term, observed)
            columns[list(joints), :, k] = values[:, rows]
        errors = proven[rows].T
        same, constant = columns.mean(axis=1, keepdims=True), errors.mean(axis=1, keepdims=True)
        if push.friction:  # one torque a joint, all the time, and somewhere in its friction
            columns, errors, floor = same, constant, np.array(push.friction)
        else:  # at rest friction holds any torque: what stays the same is no push
            columns, errors = columns - same, errors - constant
        X = (columns / floor[:, None, None]).reshape(-1, len(terms))
        y = (errors / floor[:, None]).ravel()
        precision = X.T @ X + np.eye(len(terms)) / PUSHES.strongest**2
        root = inverse_root(precision)
        wrench = root.T @ (root @ (X.T @ y))
        spread = Z95 * np.sqrt(PUSHES.remembered) * np.linalg.norm(root, axis=0)
        ends = zip((wrench - spread).tolist(), (wrench + spread).tolist(), strict=True)
        left, energy = y - X @ wrench, max(float(y @ y), np.finfo(float).tiny)
        return cls(tuple(wrench.tolist()), tuple(ends), 1.0 - float(left @ left) / energy)


def _acts(wrenches: Sequence[_Wrench]) -> str:
    """Say where pushes act, and how strongly where that is known."""
    at_flange = [wrench for wrench in wrenches if wrench.share > MOST]
    if not at_flange:
        return "something acts there that is no wrench at the flange, as on a link before it."
    some = "them" if len(at_flange) == len(wrenches) else f"{len(at_flange)} of them"
    known = [float(np.linalg.norm(w.value[:3])) for w in at_flange if w.is_determined]
    if not known:
        return (
            f"one wrench at the flange explains {some}, of which these poses do not tell how "
            "strong it is."
        )
    other = "" if len(known) == len(at_flange) else ", where its poses tell how strong it is"
    return f"one wrench at the flange, up to {max(known):.1f} N{other}, explains {some}."


def _stretches(found: Sequence[Push], observed: Observations) -> str:
    """Say how many stretches there are, and when, in the time of each recording."""
    parts: list[str] = []
    names = names_of(observed.recordings)
    for number, name in enumerate(names):
        times = [f"{p.start:.1f} to {p.end:.1f} s" for p in found if p.recording == number]
        if times:
            parts.append(" and ".join(times) + f" of {name}" * (len(names) > 1))
    count = "a short stretch" if len(found) == 1 else f"{len(found)} short stretches"
    return f"{count} of time ({'; '.join(parts)})"


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


def _filtered(effect: ExternalContact, observed: Observations, samples: IntArray) -> FloatArray:
    motion, model = observed.motion[slice(samples[0], samples[-1] + 1)], observed.simulation.model
    total = np.zeros((len(motion), 6))
    for (start, end), wrench in zip(effect.windows, effect.wrench, strict=True):
        total[(motion.time >= start) & (motion.time < end)] += wrench
    torque = np.zeros_like(motion.position)
    for t in np.flatnonzero(total.any(axis=1)):
        torque[t] = -model.flange_jacobian(motion.position[t]).T @ total[t]
    return smooth(motion.time, torque, observed.bandwidth, [slice(0, len(motion))])


def wrench_of(push: Push) -> tuple[ContactIn, ...]:
    """Return six contacts: the course of a push, of unit size along each axis of the wrench."""
    edges = np.linspace(push.start, push.end, PUSHES.pieces + 1)
    middle = (0.5 * (edges[1:] + edges[:-1]) - push.start) / (push.end - push.start)
    course = np.ones_like(middle) if push.held else np.sin(np.pi * middle)
    windows = tuple(zip(edges[:-1].tolist(), edges[1:].tolist(), strict=True))
    return tuple(
        ContactIn(
            windows=windows,
            wrench=tuple(tuple((size * axis).tolist()) for size in course),
            recording=push.recording,
        )
        for axis in np.eye(6)
    )
