"""What the parts of the demo left, as one page: OUT/index.html."""

from __future__ import annotations

import base64
import html
import json
import os
from collections import Counter
from dataclasses import dataclass, field, replace
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import stream_and_push

from estimators.diagnosis.reading import verdict_in
from estimators.diagnosis.report.truth import beside_the_truth, recovered
from limo_driver.errors import LimoError
from limo_driver.model import RobotModel
from limo_driver.pages import Charts, Page
from limo_driver.pages.figures import (
    AFTER,
    BEFORE,
    DRAWN,
    FLOOR,
    JOINTS,
    MEASURED,
    curve,
    joint_errors,
    layout,
)
from limo_driver.pages.markup import columns, grid, header, paragraph, section
from limo_driver.pages.motion import planned_motion
from limo_driver.physics import Payload, QuadraticDrag
from limo_driver.trajectory import Trajectory

if TYPE_CHECKING:
    from collections.abc import Callable

    from limo_driver.pages.arm import ArmView
    from limo_driver.pages.markup import Figure

ROBOT = "iiwa14"
HERE = Path(os.path.relpath(Path(__file__).parent))
TRUTH = HERE / "iiwa14_hysteretic.yaml"
CONCEALED = (
    Payload(mass=0.8, com=(0.0, 0.02, 0.08), inertia=(2e-3, 0.0, 0.0, 2e-3, 0.0, 1e-3)),
    QuadraticDrag(joint=4, coefficient=6.0),
)
MISSING = '<p class="failed">missing, see above</p>'


@dataclass(frozen=True)
class Part:
    """One command of the demo, what it is for, and which parts it goes on from."""

    name: str
    purpose: str
    command: str  # of limo, or of an example
    needs: tuple[str, ...] = ()


class How(StrEnum):
    """How a part ended."""

    DONE = "done"
    FAILED = "failed"
    LEFT_OUT = "left out"
    INTERRUPTED = "interrupted"


@dataclass(frozen=True)
class Outcome:
    """How a part went."""

    part: Part
    seconds: float
    failure: str = ""  # its last lines, or why it was left out; empty where it went well
    how: How = How.DONE


@dataclass
class Drawn:
    """What the sections of the page draw beside their text."""

    charts: Charts = field(default_factory=Charts)
    arm: ArmView | None = None


def headline(out: Path, _drawn: Drawn) -> str:
    """Return what was concealed and what was found of it, in a sentence."""
    joints = RobotModel.load(ROBOT).joint_names
    return recovered(CONCEALED, verdict_in(out / "diagnosis").findings, joints)


def diagnosis(out: Path, _drawn: Drawn) -> str:
    """Return what was concealed beside what was found."""
    found = verdict_in(out / "diagnosis").findings
    link = '<p><a href="diagnosis/report.html">The whole report of the diagnosis</a></p>'
    return beside_the_truth(CONCEALED, found, RobotModel.load(ROBOT).joint_names) + link


def errors(out: Path, drawn: Drawn) -> str:
    """Return the errors of rigid body and joint physics on motion that nothing was fitted to."""
    found = json.loads((out / "evaluation" / "evaluation.json").read_text())
    names = found["joints"]
    rigid, learned = (found[f"mean_mse_{of}"] ** 0.5 for of in ("rigid_body", "hybrid"))
    said = (
        f"Off the measured torque: the rigid body with Coulomb and viscous friction {rigid:.2f} "
        f"N m, with what was learned of the joints {learned:.2f} N m (RMS over joints)."
    )
    of_floor, of_rigid_body, of_model = (
        [np.nan if v is None else v for v in found[key]]
        for key in ("noise_floor", "rmse_rigid_body", "rmse_hybrid")
    )
    sides = (
        ("noise floor", of_floor, "line-ns-open", FLOOR),
        ("rigid body", of_rigid_body, "circle-open", BEFORE),
        ("joint physics", of_model, "circle", AFTER),
    )
    chart = joint_errors(sides, names, "N m")
    values = {"joint": names} | {f"{side[0]} [N m]": side[1] for side in sides}
    values["ratio of MSE"] = found["mse_ratio"]
    values["within the 95 % interval"] = [f"{p:.0%}" for p in found["coverage_of_95_percent"]]
    return (
        paragraph(said)
        + drawn.charts.place(chart, "Error of each joint")
        + columns(values)
        + '<p><a href="evaluation/report.html">The whole evaluation</a></p>'
    )


def loops(out: Path, _drawn: Drawn) -> str:
    """Return the hysteresis loops."""
    said = (
        "Friction torque over position while the joints reverse: measured, rigid body with Coulomb "
        "friction, and joint physics."
    )
    data = base64.b64encode((out / "evaluation" / "loops.png").read_bytes()).decode()
    return (
        f'<figure class="picture"><figcaption>{said}</figcaption><div class="scroll">'
        f'<img src="data:image/png;base64,{data}" alt="{said}"></div></figure>'
    )


def live(out: Path, drawn: Drawn) -> str:
    """Return the stream: torque of the joint that feels the push most, and what none explains."""
    found = stream_and_push.Live.read(out / "live")
    began, ended = stream_and_push.PUSH.windows[0]
    told = sorted({event.facts["joint"] for _, event in stream_and_push.contacts(found)})
    said = (
        f"The same model on a stream of 1 kHz, in a process of its own; someone leans on the arm "
        f"for {ended - began:g} s. Contact was told on joints {', '.join(map(str, told))}. From a "
        f"state taken to its estimate out: {1e3 * found.status['latency']['p50']:.2f} ms (p50)."
    )
    rows = slice(None, None, max(1, len(found.time) // DRAWN))
    time, torque, external = found.time[rows], found.torque[rows], found.external[rows]
    j = int(np.nanargmax(np.nanmax(np.abs(found.external), axis=0)))
    above: list[Figure] = [
        curve(time, torque[:, j] + external[:, j], "measured", MEASURED, 4.0),
        curve(time, torque[:, j], "estimated", AFTER, 1.4),
    ]
    below = [
        curve(time, column, f"joint {k + 1}", JOINTS[k % len(JOINTS)])
        for k, column in enumerate(external.T)
    ]
    pictures = (
        (above, f"Torque of joint {j + 1}", "torque [N m]"),
        (below, "Measured less estimated torque", "difference [N m]"),
    )
    return paragraph(said) + grid(
        drawn.charts.place(
            {"data": data, "layout": layout("time [s]", y) | {"showlegend": True}},
            caption,
        )
        for data, caption, y in pictures
    )


def plan(out: Path, drawn: Drawn) -> str:
    """Return the motion that was trained on, played by the arm."""
    motion = Trajectory.load(out / "train.traj.parquet")
    drawn.arm, body = planned_motion(RobotModel.load(ROBOT), motion, drawn.charts)
    return body


# in the order of the page: title, the part that each shows, and how
SECTIONS: dict[str, tuple[str, Callable[[Path, Drawn], str]]] = {
    "headline": ("diagnose", headline),
    "diagnosis": ("diagnose", diagnosis),
    "What drives do beyond a rigid body": ("evaluate", errors),
    "The hysteresis loops": ("evaluate", loops),
    "Live": ("stream", live),
    "plan": ("plan", plan),
}
WHOLE = ("diagnosis", "plan")  # sections that bring their own title


def summary(outcomes: list[Outcome]) -> str:
    """Return how many parts failed and were left out."""
    count = Counter(one.how for one in outcomes)
    if count[How.INTERRUPTED]:
        failed = f", {count[How.FAILED]} failed" if count[How.FAILED] else ""
        return f"Interrupted: {count[How.DONE]} of {len(outcomes)} parts were done{failed}"
    text = f"{count[How.FAILED]} of {len(outcomes)} parts failed"
    if not count[How.LEFT_OUT]:
        return text
    need, were = ("needs", "was") if count[How.LEFT_OUT] == 1 else ("need", "were")
    them = "it" if count[How.FAILED] == 1 else "them"
    return f"{text}, {count[How.LEFT_OUT]} that {need} {them} {were} left out"


def failures(outcomes: list[Outcome]) -> str:
    """Return which parts failed, and their last lines, as HTML; empty where all went well."""
    failed = [
        f"<li>{html.escape(one.part.purpose)}<pre>$ {html.escape(one.part.command)}\n"
        f"{html.escape(one.failure)}</pre></li>"
        for one in outcomes
        if one.failure
    ]
    return section(summary(outcomes), f"<ol>{''.join(failed)}</ol>" if failed else "", "failures")


def done(outcomes: list[Outcome]) -> str:
    """Return the commands, as they were run."""
    items = "".join(
        f"<li>{html.escape(one.part.purpose)} "
        f"<small>({one.how.value if one.failure else f'{one.seconds:.0f} s'})</small>"
        f"<pre>{html.escape(one.part.command)}</pre></li>"
        for one in outcomes
    )
    lead = (
        "All of this page was computed on this machine by these commands. Identification, learning "
        f"and diagnosis see recordings alone; the simulated arm is {TRUTH}."
    )
    return section("What was done", f"<ol>{items}</ol>", "done", lead)


def sections(outcomes: list[Outcome], out: Path) -> tuple[dict[str, str], Drawn, list[Outcome]]:
    """Return the sections of the page, and the outcomes with those that cannot be shown failed."""
    known = {one.part.name: one for one in outcomes}
    shown, drawn = {}, Drawn()
    for name, (part, show) in SECTIONS.items():
        if not known[part].failure:
            try:
                shown[name] = show(out, drawn)
            except (OSError, LookupError, ValueError, LimoError) as error:
                failure = f"what it left cannot be shown: {error!r}"
                known[part] = replace(known[part], failure=failure, how=How.FAILED)
        if known[part].failure:
            shown[name] = MISSING if name != "headline" else "The demo did not get through"
    return shown, drawn, list(known.values())


def page(shown: dict[str, str], drawn: Drawn, outcomes: list[Outcome]) -> Page:
    """Return the demo's page."""
    lead = (
        f"A simulated KUKA iiwa 14, with friction, hysteresis and elasticity in its joints, from "
        f"planned motion to a diagnosis, in {sum(one.seconds for one in outcomes):.0f} s."
    )
    body = header("The whole way of the data", shown["headline"], lead) + failures(outcomes)
    for number, (name, text) in enumerate(shown.items()):
        if name in WHOLE:
            body += text
        elif name != "headline":
            body += section(name, text, f"part-{number}")
    return Page(shown["headline"], body + done(outcomes), drawn.charts, drawn.arm)
