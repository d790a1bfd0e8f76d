"""What came of the whole: its steps, the last of which explain its log, and the page of all."""

from __future__ import annotations

from dataclasses import dataclass, field
from math import inf, isfinite
from typing import TYPE_CHECKING, Any, Final, cast

import numpy as np

from limo_driver.app.library.whole import plant
from limo_driver.app.library.whole.processes import ARM
from limo_driver.network.messages import decode_joint_state, decode_torque_estimate
from limo_driver.network.streaming import Keys
from limo_driver.pages import Charts, Page
from limo_driver.pages.figures import DRAWN, JOINTS, curve, layout
from limo_driver.pages.markup import header, key, section, table, typeset
from limo_driver.quoting import in_html as escape
from limo_driver.recordings.recording import Recording

if TYPE_CHECKING:
    from pathlib import Path

    from estimators.diagnosis.from_torque.pipeline import Diagnosis
    from estimators.diagnosis.verdict import Finding
    from limo_driver.app.library.whole.processes import ProvenWire
    from limo_driver.physics import Simulation


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


BANDWIDTH: Final = 20.0  # [Hz] of the model, as `make demo` has it, and of what is compared
_EDGE: Final = 1.0  # [s] at either end of a recording, in which filters are not full
FLOORS: Final = 1.1  # noise floors, on another motion
EXPORT_BAR: Final = 0.05  # of the torque
_NANOSECONDS: Final = 1e9


def count_unanswered(logs: Path, delay: float, first: int, last: int) -> int:
    """Return how many states a service took and did not answer.

    Args:
        logs: Folder of its logs.
        delay: By which it answers [s].
        first: Stamp of an estimate [ns], from which on they are counted.
        last: Stamp of the last one.
    """
    from limo_driver.logs.mcap_log import log_files, read_mcap

    keys, taken, answered = Keys(ARM), set[int](), set[int]()
    for path in log_files(logs, ARM):
        for message in read_mcap(path):
            if message.topic == keys.joints:
                taken.add(decode_joint_state(message.payload).stamp_ns)
            elif message.topic == keys.estimate:
                answered.add(decode_torque_estimate(message.payload).stamp_ns)
    late = round(_NANOSECONDS * delay)
    asked = {stamp - late for stamp in taken if first <= stamp - late <= last}
    return len(asked - answered)


def read_log(logs: Path, joints: tuple[str, ...], first: int, last: int) -> Recording:
    """Return what a service logged of its arm between two stamps [ns]."""
    from limo_driver.logs.mcap_log import log_files
    from limo_driver.logs.ros.joint_state_log import joint_states

    log = joint_states(log_files(logs, ARM), joints, Keys(ARM).joints)
    columns = log.columns
    stamps = log.start_ns + np.round(columns.time * _NANOSECONDS).astype(np.int64)
    rows = (stamps >= first) & (stamps <= last)
    return Recording.from_arrays(columns.time[rows], columns.position[rows], columns.torque[rows])


def judge_finding(name: str, found: Diagnosis, effect: str, parameter: str, true: float) -> Step:
    """Return whether a finding is there, with an interval that holds the truth.

    Args:
        name: Of the step.
        found: The diagnosis.
        effect: Identifier of what was concealed.
        parameter: Of it.
        true: Its value.
    """
    findings = found.verdict.findings
    finding = next((item for item in findings if _is(item, effect)), None)
    if finding is None or (value := finding.parameters.get(parameter)) is None:
        others = ", ".join(f"{item.effect} {item.joints}" for item in findings) or "nothing"
        return Step(name, f"not found, but {others}", f"{true:.3g} lies within", held=False)
    low, high = value.ci95 or (-inf, inf)
    return Step(
        name,
        f"{effect} {float(cast('float', value.value)):.3f} {value.unit} [{low:.3f}, {high:.3f}]",
        f"{true:.3f} {value.unit} lies within",
        held=bool(low <= true <= high) and isfinite(high - low),
    )


def _is(finding: Finding, effect: str) -> bool:
    at_flange = effect == plant.LOAD.name  # whichever joints feel it
    return finding.effect == effect and (at_flange or finding.joints == (plant.WORN.joint,))


def judge_explanation(found: Simulation, true: Simulation, other: Recording) -> Step:
    """Return how well a simulation explains motion that it was not found on.

    The noise floor is what the true arm leaves: one that is estimated from a recording of a minute
    is off by a fifth at some joint, whichever simulation is judged.
    """
    motion, measured = other.motion(BANDWIDTH), other.filtered_torque(BANDWIDTH)
    whole = slice(round(_EDGE * other.rate), -round(_EDGE * other.rate))
    left, floor = (
        np.linalg.norm((measured - other.filtered(arm.predict(motion), BANDWIDTH))[whole], axis=0)
        for arm in (found, true)
    )
    floors = left / floor
    return Step(
        "Another motion is explained: error over what the true arm leaves",
        f"{floors.max():.2f} at joint {int(np.argmax(floors)) + 1}, median {np.median(floors):.2f}",
        f"{FLOORS:g}, every joint",
        held=bool(floors.max() <= FLOORS),
    )


def judge_export(found: Simulation, believed: Simulation, out: Path) -> Step:
    """Write what was found into the file of somebody who believed something else."""
    from backends.mujoco_sim.scene import bare_mjcf
    from limo_driver.app.library.exporting import export

    own = out / "user" / "arm.xml"
    own.parent.mkdir(exist_ok=True)
    own.write_text(bare_mjcf(believed.model))
    written = export(found, "mjcf", out / "exported", into=own)
    return Step(
        "Exported into the user's MJCF: torque of plain MuJoCo off the prediction",
        f"{written.share:.2%}",
        f"{EXPORT_BAR:.0%}",
        held=written.share <= EXPORT_BAR,
    )
