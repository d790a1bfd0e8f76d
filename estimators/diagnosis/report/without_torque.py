"""The page of a diagnosis without torque: the arm beside its free runs, findings, errors."""

from __future__ import annotations

from pathlib import PurePath
from typing import TYPE_CHECKING, Final

import numpy as np

from estimators.diagnosis.headline import headline, names_of
from estimators.diagnosis.quantities import (
    heading_of,
    in_noise_floors,
    of_joints,
    of_several,
    rounded,
)
from estimators.diagnosis.report import findings as shared
from estimators.diagnosis.report.cards import cards
from estimators.diagnosis.report.findings import GIVEN_ARM, IMPROVED_ARM, pins
from estimators.diagnosis.report.page import unobservable
from estimators.diagnosis.report.sections import identified, stated_values
from estimators.diagnosis.settings.judgement import WORDING
from limo_driver.model.units import unit_of
from limo_driver.pages import Charts, Ghost, Page, PlayedMotion, arm_view
from limo_driver.pages.figures import (
    AFTER,
    BEFORE,
    DRAWN,
    MEASURED,
    NARROW,
    WIDE,
    curve,
    layout,
)
from limo_driver.pages.markup import (
    columns,
    folded,
    grid,
    header,
    paragraph,
    section,
)
from limo_driver.pages.motion import arm_section

if TYPE_CHECKING:
    from collections.abc import Sequence

    from estimators.diagnosis.result import DriveReplay, DriveResult
    from estimators.diagnosis.verdict import Verdict
    from limo_driver.pages.arm import ArmView
    from limo_driver.pages.markup import Figure

_IDENTIFIED: Final = (
    "Constants of drives and friction, stated or not, as all of the motion has them; fitted "
    "together, with 95 % intervals."
)
DRAWN_SAID: Final = (
    "RMS on held-out motion. A free run adds up what is amiss. One step begins at each recorded "
    "position and velocity and ends at the next row: little is lost on the way, and the steps of "
    "the encoder weigh most. Torque is that of drive and friction minus what the recorded motion "
    "needs, by inverse dynamics: what a simulation with these drives pushes wrongly."
)
_FOOTER: Final = (
    "The same content for programs: "
    "<code>verdict.json</code>; the improved simulation: <code>sim.yaml</code>."
)
_MOTION: Final = (
    "Held-out motion: recorded, and simulated forward from the commands alone, with the given and "
    "with the improved simulation. Nothing was fitted to it."
)


def drive_report(found: DriveResult) -> Page:
    """Return the page of a diagnosis of drives.

    Args:
        found: What was found.
    """
    charts, verdict, names = Charts(), found.verdict, names_of(found.recordings)
    head = header(
        f"Diagnosis of drives of {PurePath(found.before.model.name).stem}, without torque",
        headline(verdict),
        shared.removed(verdict),
        f"{shared.compared_with(found.recordings)} No torque was recorded: errors are of "
        "positions, simulated forward from the commands.",
        badge=shared.badge(verdict),
    )
    view, drawn = _arm(found, found.replay) if found.replay else (None, "")
    body = (
        head
        + shared.export_instructions(found.before, found.after, verdict)
        + drawn
        + shared.errors(verdict, charts)
        + _from_rows(verdict)
        + cards(verdict, names, found.after.effects, charts)
        + _left(verdict)
        + shared.notes(verdict.notes)
        + stated_values(verdict)
        + identified(verdict, _IDENTIFIED, "Identified drives and friction")
        + (_motion(found.replay, verdict, charts) if found.replay else "")
        + section("What is unsure", unobservable(verdict), "unsure")
    )
    return Page(headline(verdict), body, charts, view, footer=_FOOTER, sliding=verdict.sliding)


def _arm(found: DriveResult, replay: DriveReplay) -> tuple[ArmView, str]:
    """Return the arm that plays the held-out motion, and its place in the page."""
    fit = found.verdict.fit
    rows = np.unique(np.linspace(0, len(replay.recording) - 1, DRAWN).astype(int))
    position = replay.recording.position[rows]
    sides = ((GIVEN_ARM, BEFORE, replay.given), (IMPROVED_ARM, AFTER, replay.improved))
    ghosts = tuple(
        Ghost(name, colour, run[rows] - position, run[rows]) for name, colour, run in sides
    )
    name = names_of((replay.recording,))[0]
    caption = f"Solid: the recorded motion of {name}. Translucent: simulated from its commands."
    worst = int(np.argmax(np.abs(replay.given[rows] - position).max(axis=1)))
    view = arm_view(
        found.before.model, position[worst],
        errors=((GIVEN_ARM, fit.heldout_rmse_before), (IMPROVED_ARM, fit.heldout_rmse_after)),
        floor=fit.noise_floor, pins=pins(found.verdict),
        motion=PlayedMotion(replay.recording.time[rows], position, ghosts, caption=caption),
    )  # fmt: skip
    lead = (
        "Drag to turn. The ring around each joint is coloured by the position error there, in "
        "multiples of its noise floor."
    )
    return view, arm_section(view, "Where on the arm", lead)


def _from_rows(verdict: Verdict) -> str:
    """Return the errors that start anew at each recorded row, beside those of the free run."""
    fit = verdict.fit
    values: dict[str, Sequence[object]] = {"joint": verdict.labels}
    for name, turning, before, after in (
        ("free run", "rad", fit.heldout_rmse_before, fit.heldout_rmse_after),
        ("one step", "rad", fit.one_step_rmse_before, fit.one_step_rmse_after),
        ("torque", "N m", fit.inverse_dynamics_rmse_before, fit.inverse_dynamics_rmse_after),
    ):
        unit = unit_of(turning, verdict.sliding)
        values[f"{name}, given [{unit}]"] = [rounded(x) for x in before]
        values[f"{name}, improved [{unit}]"] = [rounded(x) for x in after]
    return folded(
        "Errors of one step, and of inverse dynamics", paragraph(DRAWN_SAID) + columns(values)
    )


def _left(verdict: Verdict) -> str:
    """Say what the improved simulation does not explain; nothing where it explains all."""
    fit, joints = verdict.fit, verdict.unexplained.joints
    if not joints:
        return ""
    worst = max(joints, key=lambda j: fit.heldout_rmse_after[j - 1] / fit.noise_floor[j - 1])
    unit = unit_of("rad", verdict.sliding, worst - 1)
    sentence = (
        f"At {of_several(joints, verdict.names)} held-out motion is still predicted worse "
        f"than the encoder resolves it, most of all at {of_joints((worst,), verdict.names)}: "
        f"{rounded(fit.heldout_rmse_after[worst - 1], 2)} {unit} RMSE, where its steps alone make "
        f"{rounded(fit.noise_floor[worst - 1], 2)} {unit}. Nothing that was tried removes this: "
        "unknown loads, flexible links or an unmodelled servo law would."
    )
    return section("What stays unexplained", paragraph(sentence), "unknown")


def _motion(replay: DriveReplay, verdict: Verdict, charts: Charts) -> str:
    """Return the held-out motion of each joint, those first that are missed most."""
    fit = verdict.fit
    order = np.argsort(-in_noise_floors(fit.heldout_rmse_before, fit), kind="stable").tolist()
    called = [heading_of(j + 1, verdict.names) for j in range(len(order))]
    drawn = {
        j: _joint(replay, j, called[j], charts, unit_of("rad", verdict.sliding, j)) for j in order
    }
    rest = "".join(
        f'<div id="joint-{j + 1}">{folded(called[j], drawn[j])}</div>'
        for j in order[WORDING.listed :]
    )
    opened = "".join(f'<div id="joint-{j + 1}">{drawn[j]}</div>' for j in order[: WORDING.listed])
    return section("Held-out motion", opened + rest, "where", _MOTION)


def _joint(replay: DriveReplay, j: int, called: str, charts: Charts, unit: str) -> str:
    recording = replay.recording
    rows = slice(None, None, max(1, len(recording) // DRAWN))
    time, position = recording.time[rows], recording.position[rows, j]
    runs = ((GIVEN_ARM, replay.given, BEFORE), (IMPROVED_ARM, replay.improved, AFTER))
    moved = [curve(time, position, "recorded", MEASURED, WIDE)]
    moved += [curve(time, run[rows, j], name, colour, NARROW) for name, run, colour in runs]
    errors = [curve(time, position - run[rows, j], name, colour) for name, run, colour in runs]
    figures: list[tuple[Figure, str]] = [
        ({"data": moved, "layout": layout("time [s]", f"position [{unit}]")},
         f"{called}: position"),
        ({"data": errors, "layout": layout("time [s]", f"position error [{unit}]")},
         f"{called}: recorded minus simulated position"),
    ]  # fmt: skip
    return grid(charts.place(figure, caption, follows=True) for figure, caption in figures)
