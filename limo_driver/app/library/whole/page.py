"""Steps of the proof of the whole, what came of them, and the page that shows it."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from limo_driver.pages import Charts, Page
from limo_driver.pages.figures import DRAWN, JOINTS, curve, layout
from limo_driver.pages.markup import header, key, section, table, typeset
from limo_driver.quoting import in_html as escape

if TYPE_CHECKING:
    from limo_driver.app.library.whole.processes import ProvenWire


@dataclass(frozen=True)
class Step:
    """What came of one step.

    Args:
        name: What was proven.
        figure: What was measured, with its unit.
        bar: What it is held to.
        held: Whether it is.
    """

    name: str
    figure: str
    bar: str
    held: bool


@dataclass
class Proof:
    """The steps, what a consumer felt, and how long all took."""

    wire: ProvenWire
    steps: list[Step] = field(default_factory=list)
    felt: list[tuple[Any, Any]] = field(default_factory=list)  # stamps [ns], external [N m]
    seconds: float = 0.0
    failure: str = ""  # why it ended early

    @property
    def held(self) -> bool:
        """Whether every step was reached and held to its bar."""
        return not self.failure and all(step.held for step in self.steps)


_LEAD: Final = (
    "Separate processes, real Zenoh: an arm in MuJoCo and its driver, a service, a consumer. Each "
    "step waits for what happens in the one before."
)
_FELT: Final = (
    "Measured less estimated torque, as a consumer heard it. Pushes, then a load, then the model "
    "that knows it; gaps are where no service was, or no motion."
)


def whole_page(proof: Proof) -> Page:
    """Return the page."""
    charts, held = Charts(), sum(step.held for step in proof.steps)
    reached = len(proof.steps)
    title = (
        f"{held} of {reached} steps hold"
        + (f"; then it ended: {proof.failure}" if proof.failure else "")
        + "."
    )
    badge = ("holds", "consistent") if proof.held else ("missed", "unexplained")
    about = f"An iiwa 14 over {proof.wire.name}, {proof.seconds:.0f} s from plan to export."
    body = header("The whole of limo", title, about, badge=badge)
    body += section("Each step and its bar", _steps(proof), "steps", _LEAD)
    body += section("What a consumer felt", _felt(proof, charts), "felt", _FELT)
    body += section("Files", key(_FILES), "files")
    return Page(f"The whole of limo over {proof.wire.name}", body, charts)


_FILES: Final = {
    "diagnosis": "`diagnosis/`: verdict and improved simulation, from the service's log",
    "logs": "`logs/`: what the service took and answered (MCAP)",
    "models": "`models/`: both versions, and which is the champion",
    "export": "`exported/arm.xml`: the user's file with what was found",
}


def _steps(proof: Proof) -> str:
    rows = [
        [
            "held" if step.held else '<b class="failed">missed</b>',
            escape(typeset(step.name)),
            escape(typeset(step.figure)),
            escape(typeset(step.bar)),
        ]
        for step in proof.steps
    ]
    return table(["", "step", "figure", "bar"], rows) if rows else "<p>None was reached.</p>"


def _felt(proof: Proof, charts: Charts) -> str:
    if not proof.felt:
        return ""
    time, external = (np.concatenate(parts) for parts in zip(*proof.felt, strict=True))
    rows = slice(None, None, max(1, len(time) // DRAWN))
    seconds = 1e-9 * (time[rows] - time[0])
    data = [
        curve(seconds, column, f"joint {j + 1}", JOINTS[j % len(JOINTS)])
        for j, column in enumerate(external[rows].T)
    ]
    axes = layout("time [s]", "difference [N m]") | {"showlegend": True}
    figure = {"data": data, "layout": axes}
    return charts.place(figure, "Measured less estimated torque of each joint")
