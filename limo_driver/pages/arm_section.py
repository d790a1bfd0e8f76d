"""The place of the arm in a page: stage, picture for paper, colours, ghosts and time slider."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from limo_driver.pages.markup import paragraph, typeset
from limo_driver.pages.still import still
from limo_driver.quoting import in_html as escape

if TYPE_CHECKING:
    from limo_driver.pages.arm import ArmView, PlayedMotion

_MAGNIFIED = (1, 10, 100, 1000, 10_000)  # times that a ghost's distance is drawn
_SEEN = 0.3  # [rad] of that distance, at most, at first


def arm_section(view: ArmView, title: str, lead: str) -> str:
    """Return the section in which the script of a page draws its arm.

    Args:
        view: The arm; the first of its errors is shown first.
        title: Of the section.
        lead: What to see in it.
    """
    first = view.errors[0][0] if view.errors else ""
    motion = view.motion
    start = 0 if motion is None else int(np.argmin(np.abs(motion.position - view.pose).sum(axis=1)))
    return (
        f'<section id="arm" class="arm" data-first="{start}"><h2>{escape(title)}</h2>'
        f"{paragraph(lead, 'lead screen')}"
        f'<div class="stage"><svg class="leaders" aria-hidden="true"></svg>{still(view, first)}'
        f"</div>{_pins(view)}{_colours(view, first)}{_player(motion) if motion else ''}</section>"
    )


def _pins(view: ArmView) -> str:
    """Return the texts of the arm as a list, for a stage on which they would hide it."""
    items = "".join(
        f'<li><a href="{escape(pin.link)}">{escape(typeset(pin.text))}</a></li>'
        if pin.link
        else f"<li>{escape(typeset(pin.text))}</li>"
        for pin in view.pins
    )
    return f'<ul class="pins">{items}</ul>' if items else ""


def _colours(view: ArmView, first: str) -> str:
    if not view.errors:
        return ""
    shown = {name: name for name, _ in view.errors}
    if view.motion:
        shown |= {f"now {one.name}": f"{one.name}, now" for one in view.motion.ghosts}
    buttons = "".join(
        f'<label><input type="radio" name="colour" value="{escape(value)}"'
        f"{' checked' if value == first else ''}> {escape(name)}</label>"
        for value, name in shown.items()
    )
    return (
        f'<fieldset class="controls"><legend>Rings show the error of</legend>{buttons}'
        f'<span class="scale"><i></i>'
        f"{escape(view.scale)}</span></fieldset>"
    )


def _player(motion: PlayedMotion) -> str:
    moved = [ghost for ghost in motion.ghosts if ghost.position is not None]
    ghosts = ""
    if moved:
        boxes = "".join(
            f'<label><input type="checkbox" name="ghost" value="{escape(ghost.name)}" checked>'
            f'<i class="dot" data-colour="{ghost.colour}"></i> {escape(ghost.name)}</label>'
            for ghost in moved
        )
        times = _magnified(motion)
        options = "".join(
            f'<option value="{k}"{" selected" if k == times else ""}>{_times(k)}</option>'
            for k in _MAGNIFIED
        )
        ghosts = (
            f'<fieldset class="controls"><legend>Simulated arms, translucent</legend>{boxes}'
            f'<label>distance to the recorded arm <select name="magnify">{options}</select></label>'
            "</fieldset>"
        )
    return (
        f'{ghosts}<div class="controls player"><button type="button" class="play">Play</button>'
        f'<input type="range" min="0" max="{len(motion.time) - 1}" value="0" step="1" '
        'aria-label="Time"><output aria-live="off"></output></div>'
        f"{paragraph(motion.caption, 'small')}"
    )


def _times(k: int) -> str:
    return "to scale" if k == 1 else f"{k} times enlarged"


def _magnified(motion: PlayedMotion) -> int:
    """Return how many times the distance of the ghosts is drawn at first, so that it shows."""
    apart = [
        np.abs(ghost.position - motion.position)
        for ghost in motion.ghosts
        if ghost.position is not None
    ]
    largest = max((float(np.nanmax(a)) for a in apart if np.isfinite(a).any()), default=0.0)
    return max(k for k in _MAGNIFIED if k == 1 or k * largest <= _SEEN)
