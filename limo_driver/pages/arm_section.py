"""The arm as a section of a page: in 3-D, and as a drawing where there is no WebGL.

A motion that is to be made, as pages show it: the arm that plays it, and its joints.
"""

from __future__ import annotations

from textwrap import wrap
from typing import TYPE_CHECKING, Final

import numpy as np

from limo_driver.model.kinematics import KinematicChain
from limo_driver.pages.arm import ArmView, PlayedMotion, arm_view
from limo_driver.pages.figures import joint_motion
from limo_driver.pages.markup import Charts, grid, paragraph, typeset
from limo_driver.quoting import in_html as escape
from limo_driver.runtime.display import shortened

if TYPE_CHECKING:
    from limo_driver.model import RobotModel
    from limo_driver.trajectory import Trajectory
    from limo_driver.types import FloatArray

_MAGNIFIED = (1, 10, 100, 1000, 10_000)  # times that a ghost's distance is drawn
_SEEN = 0.3  # [rad] of that distance, at most, at first
WIDTH, HEIGHT = 720, 460  # of the picture
_ARM: Final = 0.62  # of its width, beside the texts
_AZIMUTH, _ELEVATION = 0.9, 0.35  # [rad], from where it is seen
_MARGIN: Final = 26
_LINE: Final = 26  # between two texts
_WRAPPED: Final = 16  # between two lines of one
_LONGEST: Final = 34  # characters of a line
_LINES: Final = 3  # of a text, at most
_PATH: Final = "#d9730d"  # as in arm.js
_MOST: Final = 100.0  # floors of an error that has the last colour
# From an error at the noise floor to a hundred times that: told apart by any colour vision, and
# three times as dark as the stage.
SCALE: Final = ("#75899d", "#ab7c0a", "#c95d00", "#9e1b16")


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
        f"{stage(still(view, first))}{_pins(view)}{_colours(view, first)}"
        f"{_player(motion) if motion else ''}{lost_meshes(view)}</section>"
    )


def stage(content: str = "") -> str:
    """Return the place in which the script of a page draws its arm, over what stands there."""
    return f'<div class="stage"><svg class="leaders" aria-hidden="true"></svg>{content}</div>'


def lost_meshes(view: ArmView) -> str:
    """Say which meshes are not drawn; nothing where all are."""
    lost = view.drawing.lost
    if not lost:
        return ""
    what = "mesh" if len(lost) == 1 else f"{len(lost)} meshes"
    said = f"Not there or not readable: {what} {shortened(lost, 3)}; simple shapes stand for it."
    return paragraph(said, "small")


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


def still(view: ArmView, name: str) -> str:
    """Return the arm in its first pose, joints coloured by an error of the view.

    Args:
        view: The arm.
        name: Of the error, as the view has it.
    """
    seen = _Camera.of(view)
    poses = view.chain.joint_poses(view.pose[None])[0]
    errors = dict(view.errors).get(name, ())
    colours = [colour_of(e, f) for e, f in zip(errors, view.floor, strict=False)]
    drawn: list[tuple[float, str]] = []
    for item in view.capsules:
        ends = np.stack([item.start, item.end])
        if item.joint >= 0:
            ends = ends @ poses[item.joint, :3, :3].T + poses[item.joint, :3, 3]
        (a, b), depth = seen.flat(ends), seen.depth(ends)
        width = 2 * item.radius * seen.scale
        for stroke, wide in (("#8b949d", width), ("#dfe4e8", width - 2)):
            drawn.append((depth, _line(a, b, stroke, wide)))
    own = poses[view.chain.linkage.own]
    for j, pose in enumerate(own):
        colour = colours[j] if j < len(colours) else SCALE[0]
        drawn.append((seen.depth(pose[None, :3, 3]), _ring(view, seen, pose, j, colour)))
    order = sorted(range(len(drawn)), key=lambda k: drawn[k][0])
    shapes = _path(view, seen) + "".join(drawn[k][1] for k in order)
    shapes += "".join(_number(seen, pose, j) for j, pose in enumerate(own))
    return (
        f'<svg class="still" viewBox="0 0 {WIDTH} {HEIGHT}" role="img" '
        f'aria-label="The arm with what was found at its joints">{shapes}{_texts(view, seen)}</svg>'
    )


def colour_of(error: float, floor: float) -> str:
    """Return the colour of an error [N m] by how many noise floors [N m] it is."""
    ratio = error / floor if floor > 0 else 1.0
    at = np.log(np.clip(ratio, 1.0, _MOST)) / np.log(_MOST) * (len(SCALE) - 1)
    k = min(int(at), len(SCALE) - 2)
    low, high = (np.array([int(SCALE[i][c : c + 2], 16) for c in (1, 3, 5)]) for i in (k, k + 1))
    mixed = np.round(low + (at - k) * (high - low)).astype(int)
    return "#" + "".join(f"{v:02x}" for v in mixed)


class _Camera:
    """A view from the side and above, without perspective, that the arm fills."""

    def __init__(self, points: FloatArray, room: float) -> None:
        c, s = np.cos(_AZIMUTH), np.sin(_AZIMUTH)
        up, level = np.sin(_ELEVATION), np.cos(_ELEVATION)
        self.right = np.array([-s, c, 0.0])
        self.up = np.array([-up * c, -up * s, level])
        self.towards = np.array([level * c, level * s, up])
        self.scale, self.middle = 1.0, np.zeros(2)
        flat = points @ np.stack([self.right, self.up]).T
        low, high = flat.min(axis=0) - room, flat.max(axis=0) + room
        box = np.array([_ARM * WIDTH, HEIGHT - 2 * _MARGIN])
        self.scale = float(np.min(box / np.maximum(high - low, 1e-9)))
        self.middle = (low + high) / 2

    @classmethod
    def of(cls, view: ArmView) -> _Camera:
        poses = view.chain.joint_poses(view.pose[None])[0]
        flange = poses[-1, :3, :3] @ view.chain.flange + poses[-1, :3, 3]
        path = np.zeros((1, 3)) if view.motion is None else view.motion.path
        path = np.zeros((1, 3)) if path is None else path
        points = np.concatenate([path, poses[:, :3, 3], flange[None]])
        return cls(points, max(view.rings))

    def flat(self, points: FloatArray) -> FloatArray:
        """Return where points (K, 3) [m] are in the picture, (K, 2)."""
        seen = points @ np.stack([self.right, self.up]).T - self.middle
        centre = np.array([_ARM * WIDTH / 2 + _MARGIN / 2, HEIGHT / 2])
        return centre + seen * self.scale * np.array([1.0, -1.0])

    def depth(self, points: FloatArray) -> float:
        """Return how near points (K, 3) [m] are, in the mean."""
        return float((points @ self.towards).mean())


def _line(a: FloatArray, b: FloatArray, stroke: str, width: float) -> str:
    if np.allclose(a, b):
        b = a + 0.01  # a line without length is not drawn
    return (
        f'<line x1="{a[0]:.1f}" y1="{a[1]:.1f}" x2="{b[0]:.1f}" y2="{b[1]:.1f}" '
        f'stroke="{stroke}" stroke-width="{width:.1f}" stroke-linecap="round"/>'
    )


def _ring(view: ArmView, seen: _Camera, pose: FloatArray, j: int, colour: str) -> str:
    axis = view.chain.direction[view.chain.linkage.own[j]]
    first = np.linalg.svd(axis[None])[2][1:]
    turn = np.linspace(0, 2 * np.pi, 37)[:, None]
    circle = view.rings[j] * (np.cos(turn) * first[0] + np.sin(turn) * first[1])
    flat = seen.flat(circle @ pose[:3, :3].T + pose[:3, 3])
    points = " ".join(f"{x:.1f},{y:.1f}" for x, y in flat)
    return f'<polyline points="{points}" fill="none" stroke="{colour}" stroke-width="7"/>'


def _path(view: ArmView, seen: _Camera) -> str:
    if view.motion is None or view.motion.path is None:
        return ""
    points = " ".join(f"{x:.0f},{y:.0f}" for x, y in seen.flat(view.motion.path))
    return f'<polyline points="{points}" fill="none" stroke="{_PATH}" stroke-width="1"/>'


def _number(seen: _Camera, pose: FloatArray, j: int) -> str:
    x, y = seen.flat(pose[None, :3, 3])[0]
    return f'<text x="{x:.1f}" y="{y + 5:.1f}" class="joint">{j + 1}</text>'


def _texts(view: ArmView, seen: _Camera) -> str:
    """Return the pins beside the arm, from top to bottom as their places are."""
    poses = view.chain.joint_poses(view.pose[None])[0]
    own = poses[view.chain.linkage.own]
    flange = poses[-1, :3, :3] @ view.chain.flange + poses[-1, :3, 3]
    places = [
        seen.flat((flange if p.joint is None else own[p.joint, :3, 3])[None])[0] for p in view.pins
    ]
    order = sorted(range(len(places)), key=lambda k: float(places[k][1]))
    x, y, said = _ARM * WIDTH + 1.2 * _MARGIN, float(_MARGIN), ""
    for k in order:
        a = places[k]
        lines = wrap(
            typeset(view.pins[k].text), _LONGEST, max_lines=_LINES, break_on_hyphens=False,
            placeholder="\N{HORIZONTAL ELLIPSIS}",
        )  # fmt: skip
        text = "".join(
            f'<tspan x="{x:.1f}" dy="{_WRAPPED if number else 0}">{escape(line)}</tspan>'
            for number, line in enumerate(lines)
        )
        y = max(y, min(float(a[1]), HEIGHT - _LINE * (len(order) - order.index(k))))
        said += (
            f'<path d="M{a[0]:.1f},{a[1]:.1f} L{x - 6:.1f},{y:.1f}" class="leader"/>'
            f'<circle cx="{a[0]:.1f}" cy="{a[1]:.1f}" r="3.5" class="dot"/>'
            f'<text x="{x:.1f}" y="{y + 4:.1f}">{text}</text>'
        )
        y += _LINE + _WRAPPED * (len(lines) - 1)
    return said


_ROWS: Final = 3000  # that are played: an hour of them is a file that a phone opens


def planned_motion(
    model: RobotModel, trajectory: Trajectory, charts: Charts
) -> tuple[ArmView, str]:
    """Return the arm that plays a motion, and its place in the page with the joints over time.

    Args:
        model: The robot it was planned for.
        trajectory: The motion.
        charts: Of the page.
    """
    rows = np.unique(np.linspace(0, len(trajectory) - 1, _ROWS).astype(int))
    position = trajectory.position[rows]
    played = PlayedMotion(
        trajectory.time[rows],
        position,
        caption="Orange line: path of the flange.",
        path=KinematicChain.of(model).flange_position(position),
    )
    view = arm_view(model, position[0], motion=played)
    lead = "Drag to turn; the slider, or a click into the chart below, moves the arm."
    drawn = charts.place(
        joint_motion(trajectory, model.joint_names, model.sliding),
        "Joints over time",
        "from where each starts",
        follows=True,
    )
    return view, arm_section(view, "The motion", lead) + grid([drawn], "one")
