"""Last steps of the whole: the log of the service, what is found in it, and what that explains."""

from __future__ import annotations

from math import inf, isfinite
from typing import TYPE_CHECKING, Final, cast

import numpy as np

from limo_driver.app.library.whole import plant
from limo_driver.app.library.whole.page import Step
from limo_driver.app.library.whole.processes import ARM
from limo_driver.network.messages import decode_joint_state, decode_torque_estimate
from limo_driver.network.streaming import Keys
from limo_driver.recordings.recording import Recording

if TYPE_CHECKING:
    from pathlib import Path

    from estimators.diagnosis.from_torque.pipeline import Diagnosis
    from estimators.diagnosis.verdict import Finding
    from limo_driver.physics import Simulation

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
