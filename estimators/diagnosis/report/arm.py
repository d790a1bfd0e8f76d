"""The arm of a report: errors and findings at its joints, and the recorded motion with ghosts."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np

from estimators.diagnosis.headline import carrier_of, is_of_bodies, named, names_of, quantity_of
from estimators.diagnosis.quantities import heading_of, of_joints
from estimators.diagnosis.report import figures
from estimators.diagnosis.verdict import CONTACT, UNKNOWN, Finding, Verdict
from limo_driver.pages.arm import ArmView, Ghost, Pin, PlayedMotion, PushArrow, arm_view
from limo_driver.pages.markup import Charts, grid
from limo_driver.pages.motion import arm_section
from limo_driver.physics import Payload

if TYPE_CHECKING:
    from collections.abc import Sequence

    from estimators.diagnosis.result import DiagnosisResult, Replay
    from limo_driver.types import FloatArray

GIVEN, IMPROVED = "given simulation", "improved simulation"
_ROWS: Final = 1500  # of the motion that is played: more cannot be seen
_ALL: Final = 3  # findings at one joint from which on they are counted, not named


def arm(diagnosis: DiagnosisResult, charts: Charts) -> tuple[ArmView, str]:
    """Return the arm and its place in the page."""
    fit, traces = diagnosis.verdict.fit, diagnosis.traces
    recording = played(diagnosis)
    motion = _motion(diagnosis, recording)
    view = arm_view(
        diagnosis.before.model,
        motion.position[_worst(diagnosis, motion.time, recording)],
        errors=(
            (GIVEN, fit.heldout_rmse_before),
            (IMPROVED, fit.heldout_rmse_after),
            ("noise floor", fit.noise_floor),
        ),
        floor=fit.noise_floor,
        pins=pins(diagnosis.verdict),
        motion=motion,
    )
    excess = np.array(fit.heldout_rmse_before) / np.maximum(np.array(fit.noise_floor), 1e-12)
    j = int(np.argmax(np.nan_to_num(excess)))
    caption = f"{heading_of(j + 1, diagnosis.verdict.names)}: recorded minus simulated torque"
    drawn = charts.place(
        figures.error_over_time(traces, j, recording),
        caption,
        "pale: near rest, not scored; click to move the arm there",
        follows=True,
    )
    lead = (
        "Drag to turn. The ring around each joint is coloured by the torque error there, in "
        "multiples of its noise floor: over the held-out motion, or at the moment of the slider, "
        "where its size shows it, too."
    )
    return view, arm_section(view, "Where on the arm", lead) + grid([drawn], "one")


def played(diagnosis: DiagnosisResult) -> int:
    """Return which recording is played, 0-based: one with pushes, else the one replayed."""
    pushed = [
        k for f in diagnosis.verdict.findings if f.effect == CONTACT for k in f.where.recording
    ]
    if pushed:
        return pushed[0] - 1
    return diagnosis.replay[0].recording if diagnosis.replay else 0


def _motion(diagnosis: DiagnosisResult, recording: int) -> PlayedMotion:
    traces = diagnosis.traces
    rows = np.flatnonzero(traces.recording == recording)
    rows = rows[:: max(1, -(-len(rows) // _ROWS))]
    time, position = traces.time[rows], traces.position[rows]
    replay = next((item for item in diagnosis.replay if item.recording == recording), None)
    ghosts = (
        Ghost(GIVEN, figures.BEFORE, (traces.measured - traces.before)[rows],
              _ghost(replay, time, position, "position_before")),
        Ghost(IMPROVED, figures.AFTER, (traces.measured - traces.after)[rows],
              _ghost(replay, time, position, "position_after")),
    )  # fmt: skip
    name = names_of(diagnosis.recordings)[recording]
    texts = f"Solid: the recorded motion of {name}."
    if replay is not None:
        texts += (
            f" Translucent, from {replay.time[0]:.1f} to {replay.time[-1]:.1f} s: the simulated "
            "robot, told to follow that motion by its own drives; its distance from the recorded "
            "pose is enlarged as chosen above."
        )
    pushes = _pushes(diagnosis.verdict.findings, recording)
    if pushes:
        texts += " Pink arrow: the force at the flange that explains a push best."
    return PlayedMotion(time, position, ghosts, pushes, texts)


def _ghost(
    replay: Replay | None, time: FloatArray, position: FloatArray, which: str
) -> FloatArray | None:
    """Return where a simulated arm was at some times, (T, n) [rad]; NaN where it was not run."""
    if replay is None:
        return None
    apart = getattr(replay, which) - replay.position
    columns = [
        np.interp(time, replay.time, column, left=np.nan, right=np.nan) for column in apart.T
    ]
    return position + np.stack(columns, axis=1)


def _pushes(findings: Sequence[Finding], recording: int) -> tuple[PushArrow, ...]:
    found = next((item for item in findings if item.effect == CONTACT), None)
    known = found.parameters.get("wrench") if found else None
    if found is None or known is None or isinstance(known.value, (str, float, int)):
        return ()
    every = zip(found.where.time, found.where.recording, known.value, strict=True)
    return tuple(
        PushArrow(start, end, tuple(np.array(wrench, dtype=float)[:3].tolist()))
        for (start, end), of, wrench in every
        if of == recording + 1
    )


def _worst(diagnosis: DiagnosisResult, time: FloatArray, recording: int) -> int:
    """Return the row at which the given simulation is farthest off, in noise floors."""
    traces = diagnosis.traces
    floor = np.maximum(np.array(diagnosis.verdict.fit.noise_floor), 1e-12)
    error = np.abs(traces.measured - traces.before) * traces.moving / floor
    own = traces.recording == recording
    for replay in diagnosis.replay:  # there the simulated arms can be seen beside the recorded one
        if replay.recording == recording:
            own &= (traces.time >= replay.time[0]) & (traces.time <= replay.time[-1])
    worst = traces.time[own][int(np.argmax(error[own].max(axis=1)))]
    return int(np.argmin(np.abs(time - worst)))


def pins(verdict: Verdict) -> tuple[Pin, ...]:
    """Return one text for each joint that has findings, and one for the flange."""
    at: dict[int | None, list[tuple[str, str, int]]] = {}
    for number, item in enumerate(verdict.findings, start=1):
        name = "something unknown" if item.effect == UNKNOWN else named(item)
        name = "pushes" if item.effect == CONTACT else name
        for place in _places(item, len(verdict.names)):
            at.setdefault(place, []).append((name, quantity_of(item), number))
    return tuple(
        Pin(_together(texts, joint, verdict.names), joint, f"#finding-{texts[0][2]}")
        for joint, texts in at.items()
    )


def _places(item: Finding, n: int) -> tuple[int | None, ...]:
    if (carrier := carrier_of(item, n)) is not None:
        return (carrier - 1,)
    if item.effect in {Payload.name, CONTACT}:
        return (None,)
    joints = item.joints[:1] if is_of_bodies(item.effect) else item.joints
    return tuple(j - 1 for j in joints) or (0,)


def _together(
    texts: Sequence[tuple[str, str, int]], joint: int | None, names: Sequence[str]
) -> str:
    where = "flange" if joint is None else of_joints((joint + 1,), names)
    if len(texts) == 1:
        name, value, _ = texts[0]
        return f"{where}: {name} {value}".rstrip()
    names = [name for name, _, _ in texts]
    return f"{where}: " + (", ".join(names) if len(texts) < _ALL else f"{len(texts)} findings")
