"""The page of an identification: errors, friction and offsets, links, and every base parameter."""

from __future__ import annotations

from pathlib import PurePath
from typing import TYPE_CHECKING, Final

import numpy as np

from estimators.rigid_body.tables import base_estimates, known_of, notes_of
from limo_driver.model.units import unit_of
from limo_driver.pages import Charts, Page, Pin, arm_view
from limo_driver.pages.figures import AFTER, BEFORE, joint_errors, layout, numbers
from limo_driver.pages.markup import columns, folded, grid, header, listed, next_steps, section
from limo_driver.pages.motion import arm_section
from limo_driver.physics import display_name
from limo_driver.quoting import in_shell
from limo_driver.runtime.display import joint_labels

if TYPE_CHECKING:
    from estimators.rigid_body.identification import Identification, TermEstimate
    from limo_driver.pages.arm import ArmView
    from limo_driver.pages.markup import Figure

_Z95: Final = 1.96  # standard deviations of a 95 % interval
_MOVED: Final = 0.1  # of its mass, from which on a link is pointed at
_POINTED: Final = 4  # links at most
_ERRORS: Final = (
    "RMSE of the torque on the recordings that were fitted; `limo diagnose` says what it is on "
    "others. Base parameters: the least-squares fit, whose links may have impossible inertias. "
    "Consistent: the fit in which every link has a positive mass and a possible inertia; that is "
    "what sim.yaml has."
)
_TERMS: Final = (
    "Bars: 95 % intervals of the fit; a point without a bar is at its bound. Physics that the "
    "model lacks can shift all values, and the intervals do not show that."
)
_LINKS: Final = (
    "What the motion does not show stays as the robot description has it. A single link can "
    "hardly be identified: mass can move between neighbouring links without any change of torque."
)
_BASE: Final = (
    "The combinations of inertial parameters that torque depends on. ± is one standard deviation; "
    "it allows for errors that are correlated in time, and is for motion like that recorded."
)


def identification_page(found: Identification, file: str) -> Page:
    """Return the page of an identification.

    Args:
        found: What was identified.
        file: Name of the simulation's file, for the commands that go on from it.
    """
    sim = in_shell(PurePath(file))
    charts, view = Charts(), _arm(found)
    kind = found.model.description.kind.lower()
    errors = found.rmse_consistent
    title = (
        f"Inertias and friction of {found.model.n} joints explain the recorded torque to "
        f"{errors.min():.2g} to {errors.max():.2g} {_torque(found)} RMSE; {known_of(found)}."
    )
    known = found.simulation.tolerances
    source = (
        f"{found.samples} samples behind a zero-phase filter of {found.rows.bandwidth:g} Hz; "
        f"condition number {found.fit.condition:.3g}, columns scaled. For such motion, torque of "
        f"inertias is known to {known.inertia:.1%}, friction to {known.friction:.0%} (1 sigma)."
    )
    pointed = "Drag to turn. Labels: the links whose mass moved most from the robot description."
    body = (
        header(f"Identification of {found.model.name}", title, source)
        + section("Notes", listed(notes_of(found)), "notes")
        + section("Errors", charts.place(_errors(found), "Error of each joint"), "errors", _ERRORS)
        + section("Friction, offset, drive", _terms(found, charts), "terms", _TERMS)
        + (arm_section(view, "Where inertias moved", pointed) if view else "")
        + section("Links", columns(_links(found)), "links", _LINKS)
        + section("Base parameters", folded("All of them", columns(_base(found))), "base", _BASE)
        + next_steps(
            [
                (
                    "Ask another recording what this simulation leaves out.",
                    f"limo diagnose OTHER_RECORDING --sim {sim} --out diagnosis/",
                ),
                (
                    "Learn what it leaves, and how sure that is.",
                    f"limo train RECORDING --sim {sim} --model joint-physics --out model/",
                ),
                (
                    "Put its values into a copy of your own robot file.",
                    f"limo export {sim} --to {kind} --out identified/",
                ),
            ]
        )
    )
    return Page(title, body, charts, view, sliding=found.model.sliding)


def _torque(found: Identification) -> str:
    """Return the unit of the joints' torques."""
    return unit_of("N m", found.model.sliding)


def _errors(found: Identification) -> Figure:
    sides = [
        ("base parameters", found.fit.rmse, "circle-open", BEFORE),
        ("consistent", found.rmse_consistent, "circle", AFTER),
    ]
    return joint_errors(sides, joint_labels(found.model.joint_names), _torque(found))


def _terms(found: Identification, charts: Charts) -> str:
    kinds = dict.fromkeys((item.effect, item.parameter, item.unit) for item in found.estimates)
    drawn = [
        charts.place(
            _term([item for item in found.estimates if item.effect == effect], unit),
            f"{display_name(effect).capitalize()}: {parameter} [{unit}]",
        )
        for effect, parameter, unit in kinds
    ]
    labels = joint_labels(found.model.joint_names)
    rows: dict[str, list[object]] = {
        "term": [
            f"{display_name(item.effect)}, {labels[item.joint - 1]}" for item in found.estimates
        ],
        "value": [item.value for item in found.estimates],
        "±": [f"{item.deviation:.1g}" if item.deviation else "bound" for item in found.estimates],
        "unit": [item.unit for item in found.estimates],
    }
    return grid(drawn, "three") + folded("All values", columns(rows))


def _term(items: list[TermEstimate], unit: str) -> Figure:
    reach = _Z95 * np.array([item.deviation for item in items])
    bars = {
        "type": "scatter", "mode": "markers",
        "x": [f"{item.joint}" for item in items],
        "y": numbers(np.array([item.value for item in items])),
        "error_y": {"type": "data", "array": numbers(reach), "color": AFTER},
        "marker": {"size": 9, "color": AFTER},
        "hovertemplate": "joint %{x}: %{y} " + unit + "<extra></extra>",
    }  # fmt: skip
    axes = layout("joint", unit)
    axes["xaxis"] |= {"type": "category"}
    axes["yaxis"] |= {"rangemode": "tozero"}
    return {"data": [bars], "layout": axes}


def _links(found: Identification) -> dict[str, list[object]]:
    return {
        "link": [link.link for link in found.links],
        "mass [kg]": [f"{link.mass:.3f}" for link in found.links],
        "was [kg]": [f"{link.mass_nominal:.3f}" for link in found.links],
        "centre moved [mm]": [f"{1e3 * link.com_shift:.1f}" for link in found.links],
        "inertia ratio": [link.inertia_ratio for link in found.links],
    }


def _base(found: Identification) -> dict[str, list[object]]:
    estimates = base_estimates(found)
    return {
        "parameter": [item.combination for item in estimates],
        "value": [f"{item.value:.4g}" for item in estimates],
        "±": [
            f"{item.deviation:.1g}" if item.is_identified else "not identified"
            for item in estimates
        ],
        "nominal": [f"{item.nominal:.4g}" for item in estimates],
        "unit": [item.unit for item in estimates],
    }


def _arm(found: Identification) -> ArmView | None:
    """Return the arm with the links whose inertias moved; nothing where all stayed."""
    limits = found.model.limits
    pose = np.clip(0.5 * np.ones(found.model.n), limits.position_min, limits.position_max)
    moved = {
        joint: abs(link.mass - link.mass_nominal) / link.mass_nominal
        for joint, link in enumerate(found.links)
        if abs(link.mass - link.mass_nominal) > _MOVED * link.mass_nominal
    }
    most = sorted(sorted(moved, key=lambda joint: -moved[joint])[:_POINTED])
    pins = tuple(
        Pin(f"{link.link}: {link.mass:.2f} kg, was {link.mass_nominal:.2f}", joint, "#links")
        for joint in most
        for link in [found.links[joint]]
    )
    return arm_view(found.model, pose, pins=pins) if pins else None
