"""The page of drives that were identified from commands and positions."""

from __future__ import annotations

from pathlib import PurePath
from typing import TYPE_CHECKING, Final

import numpy as np

from limo_driver.model.units import unit_of
from limo_driver.pages import Charts, Page
from limo_driver.pages.figures import AFTER, layout, numbers
from limo_driver.pages.markup import columns, header, listed, next_steps, section
from limo_driver.quoting import in_shell

if TYPE_CHECKING:
    from estimators.diagnosis.from_motion.fitting.identification import DriveIdentification
    from limo_driver.pages.markup import Figure

_LEAD: Final = (
    "Position errors of each joint, simulated forward from its commands. Where gravity hardly "
    "loads a joint, only ratios of its constants are known: they are given for the scale that the "
    "file believes."
)


def drives_page(found: DriveIdentification, file: str) -> Page:
    """Return the page of an identification without torque.

    Args:
        found: What was identified.
        file: Name of the simulation's file, for the commands that go on from it.
    """
    sim = in_shell(PurePath(file))
    charts, model = Charts(), found.simulation.model
    title = found.headline()
    title = f"{title[:1].upper()}{title[1:]}."
    unsure = [
        f"Joint {joint}: recordings at this rate do not show its {name}."
        for joint, name in found.undecided
    ]
    drawn = charts.place(_errors(found), "Error of each joint")
    body = (
        header(f"Drives of {model.name}", title)
        + section("Notes", listed([*found.warnings, *unsure]), "notes")
        + section("Drives and friction", drawn + columns(found.figures()), "joints", _LEAD)
        + next_steps(
            [
                (
                    "Ask another recording what these drives leave out.",
                    f"limo diagnose OTHER_RECORDING --sim {sim} --out diagnosis/",
                ),
                (
                    "Put the values into a copy of your own MJCF.",
                    f"limo export {sim} --to mjcf --out identified/",
                ),
            ]
        )
    )
    return Page(title, body, charts, sliding=found.simulation.model.sliding)


def _errors(found: DriveIdentification) -> Figure:
    bars = {
        "type": "bar",
        "orientation": "h",
        "y": list(found.simulation.model.joint_names),
        "x": numbers(np.array([fit.mean_error for fit in found.fits])),
        "marker": {"color": AFTER},
        "hovertemplate": "%{y}: %{x}<extra></extra>",
    }
    axes = layout(f"mean error [{unit_of('rad', found.simulation.model.sliding)}]", "")
    axes["yaxis"] |= {"autorange": "reversed"}
    return {"data": [bars], "layout": axes, "height": 80 + 28 * len(found.fits)}
