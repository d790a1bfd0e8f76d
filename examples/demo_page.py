"""What the parts of the demo left, as one page: OUT/index.html."""

from __future__ import annotations

import base64
import html
import json
import os
from collections import Counter
from dataclasses import dataclass, replace
from enum import StrEnum
from pathlib import Path
from string import Template
from typing import TYPE_CHECKING

import stream_and_push

from limo_driver.errors import LimoError
from limo_driver.physics import Payload, QuadraticDrag

if TYPE_CHECKING:
    from collections.abc import Callable

    from limo_driver.physics.effect import Effect

MISSING = '<span class="failed">missing, see above</span>'
HERE = Path(os.path.relpath(Path(__file__).parent))
TRUTH = HERE / "iiwa14_hysteretic.yaml"
CONCEALED = (
    Payload(mass=0.8, com=(0.0, 0.02, 0.08), inertia=(2e-3, 0.0, 0.0, 2e-3, 0.0, 1e-3)),
    QuadraticDrag(joint=4, coefficient=6.0),
)


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


def picture(path: Path, caption: str) -> str:
    """Return an HTML figure with the PNG inside."""
    data = base64.b64encode(path.read_bytes()).decode()
    return (
        f'<figure><img src="data:image/png;base64,{data}" alt="{html.escape(caption)}">'
        f"<figcaption>{html.escape(caption)}</figcaption></figure>"
    )


def figure(value: float | None) -> str:
    """Return a figure of the table; a noise floor can be unknown."""
    return "unknown" if value is None else f"{value:.3f}"


def table(evaluation: dict) -> str:
    """Return the errors per joint as an HTML table."""
    columns = ("rmse_rigid_body", "rmse_hybrid", "noise_floor")
    rows = [
        f"<tr><td>{html.escape(joint)}</td>"
        + "".join(f"<td>{figure(evaluation[key][j])}</td>" for key in columns)
        + f"<td>{evaluation['mse_ratio'][j]:.0f}</td>"
        + f"<td>{evaluation['coverage_of_95_percent'][j]:.0%}</td></tr>"
        for j, joint in enumerate(evaluation["joints"])
    ]
    return (
        "<table><thead><tr><th>joint</th><th>rigid body<br>RMSE [N m]</th>"
        "<th>joint physics<br>RMSE [N m]</th><th>noise floor<br>[N m]</th>"
        "<th>ratio<br>of MSE</th><th>within the<br>95 % interval</th></tr></thead><tbody>"
        + "".join(rows)
        + '<tr class="mean"><td>mean MSE [(N m)²]</td>'
        + f"<td>{evaluation['mean_mse_rigid_body']:.4f}</td>"
        + f"<td>{evaluation['mean_mse_hybrid']:.4f}</td><td></td>"
        + f"<td>{evaluation['mean_mse_ratio']:.0f}</td><td></td></tr></tbody></table>"
    )


def live(out: Path) -> str:
    """Return the figure of the stream as HTML."""
    found = stream_and_push.Live.read(out / "live")
    began, ended = stream_and_push.PUSH.windows[0]
    told = sorted({event.facts["joint"] for _, event in stream_and_push.contacts(found)})
    return picture(
        out / "live.png",
        f"The same model on a stream of 1 kHz, in a process of its own; someone leans on the arm "
        f"for {ended - began:g} s. Torque as measured and as the motion alone needs it, and "
        f"the difference on all joints. Contact was told on joints {told}. From a state "
        f"taken to its estimate out: {1e3 * found.status['latency']['p50']:.2f} ms (p50).",
    )


def value_of(item: dict) -> str:
    """Return the first value of a finding that is one number, with unit and interval."""
    for name, known in item["parameters"].items():
        if isinstance(known["value"], float) and known["ci95"]:
            low, high = known["ci95"]
            return f"{name} {known['value']:.3f} [{low:.3f}, {high:.3f}] {known['unit']}"
    return ""


def hidden(effect: Effect) -> str:
    """Say what is concealed, with its size."""
    name = effect.name.replace("_", " ")
    if isinstance(effect, Payload):
        return f"{name} of {effect.mass:g} kg"
    return f"{name} at joint {', '.join(map(str, effect.joints))}"


def diagnosis(out: Path) -> str:
    """Return what was concealed and what was found as an HTML list."""
    verdict = json.loads((out / "diagnosis" / "verdict.json").read_text())
    concealed = " and ".join(hidden(effect) for effect in CONCEALED)
    found = [
        f"<li>{html.escape(item['effect'].replace('_', ' '))}, joint "
        f"{html.escape(', '.join(map(str, item['joints'])))}: {html.escape(value_of(item))} "
        f"(confidence {item['confidence']:.0%})"
        f"<br><span>{html.escape(item['evidence'])}</span></li>"
        for item in verdict["findings"]
    ]
    return (
        f"<p>Concealed in the arm, and told to nobody: {html.escape(concealed)}. Found:</p>"
        f"<ul>{''.join(found) or '<li>nothing</li>'}</ul>"
        '<p><a href="diagnosis/report.html">The whole report</a></p>'
    )


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
    if not failed:
        return ""
    return (
        f'<section class="failed"><h2>{summary(outcomes)}</h2><ol>{"".join(failed)}</ol></section>'
    )


def note(evaluation: dict) -> str:
    """Return what the columns of the table are, as HTML."""
    return (
        '<p class="note">Rigid body: identified, with Coulomb and viscous friction. Measured '
        "torque and motion went through the same zero-phase low-pass of "
        f"{evaluation['bandwidth']:g} Hz. Noise floor: what the torque sensor's noise leaves after "
        "that filter, as far as can be estimated. Joint physics: hysteresis, friction, elasticity "
        "of each joint, fitted in closed form; it says how sure it is, and 95 % of its errors "
        "should lie within the interval that it gives.</p>"
    )


def evaluation_of(out: Path) -> dict:
    """Return what `limo evaluate` found."""
    return json.loads((out / "evaluation" / "evaluation.json").read_text())


def headline(out: Path) -> str:
    """Return the result in one line."""
    evaluation = evaluation_of(out)
    rigid, learned = evaluation["mean_mse_rigid_body"] ** 0.5, evaluation["mean_mse_hybrid"] ** 0.5
    return f"Torque error: {rigid:.2f} N m with a rigid body, {learned:.2f} N m with what drives do"


SECTIONS: dict[str, tuple[str, Callable[[Path], str]]] = {  # the part that each shows, and how
    "headline": ("evaluate", headline),
    "table": ("evaluate", lambda out: table(evaluation_of(out)) + note(evaluation_of(out))),
    "loops": (
        "evaluate",
        lambda out: picture(
            out / "evaluation" / "loops.png",
            "Friction torque over position while the joints reverse: measured, rigid body with "
            "Coulomb friction, and joint physics.",
        ),
    ),
    "torques": (
        "evaluate",
        lambda out: picture(
            out / "evaluation" / "torque.png", "Joint torque over time in the same stretch."
        ),
    ),
    "plan": (
        "plan",
        lambda out: picture(
            out / "plan.png",
            "Locally isotropic motion: reaching from pose to pose, exploring each with small "
            "random sinusoids on every joint.",
        ),
    ),
    "live": ("stream", live),
    "diagnosis": ("diagnose", diagnosis),
}


def sections(outcomes: list[Outcome], out: Path) -> tuple[dict[str, str], list[Outcome]]:
    """Return the sections of the page, and the outcomes with those that cannot be shown failed."""
    known = {one.part.name: one for one in outcomes}
    shown = {}
    for name, (part, show) in SECTIONS.items():
        if not known[part].failure:
            try:
                shown[name] = show(out)
            except (OSError, LookupError, ValueError, LimoError) as error:
                failure = f"what it left cannot be shown: {error!r}"
                known[part] = replace(known[part], failure=failure, how=How.FAILED)
        if known[part].failure:
            shown[name] = MISSING if name != "headline" else "The demo did not get through"
    return shown, list(known.values())


def page(shown: dict[str, str], outcomes: list[Outcome]) -> str:
    """Return the demo's page."""
    return Template((HERE / "demo.html").read_text()).substitute(
        shown,
        failures=failures(outcomes),
        lead="Root mean square over seven joints of a simulated KUKA iiwa 14 whose joints have "
        "friction, hysteresis and elasticity, while it creeps and reverses.",
        commands="\n".join(
            f"<li>{html.escape(one.part.purpose)} "
            f"<span>({one.how.value if one.failure else f'{one.seconds:.0f} s'})</span>"
            f"<pre>{html.escape(one.part.command)}</pre></li>"
            for one in outcomes
        ),
        truth=html.escape(str(TRUTH)),
    )
