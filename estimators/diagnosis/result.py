"""What a diagnosis found, with torque and without, and all that a report shows.

Summary: a verdict as lines of text, the same on the terminal and where it prints itself.
"""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Final, Self

from estimators.diagnosis.headline import headline, named, place_of, values_of
from estimators.diagnosis.quantities import give_or_take, listed, rounded, several, value_columns
from estimators.diagnosis.verdict import CONTACT, UNKNOWN, Finding, Verdict
from limo_driver.model.units import unit_of
from limo_driver.physics import display_name
from limo_driver.recordings.bandwidth import BANDWIDTH
from limo_driver.runtime.display import Displayed

if TYPE_CHECKING:
    from collections.abc import Mapping

    from estimators.diagnosis.stages import Failure
    from limo_driver.physics import Simulation
    from limo_driver.recordings.recording import Recording
    from limo_driver.trajectory import Trajectory
    from limo_driver.types import BoolArray, FloatArray, IntArray

ROWS_JUDGED: Final = "rows judged"  # heading of the only column that is no error
NOT_JUDGED = "near rest, at reversals, under a push or in a jolt"
_OF_A_JOINT = re.compile(r"(.+) of joint (\d+)( \(.+\))?")
WORSE = (
    "* Worse than given: within tolerances alone, values follow whatever is in the rows fitted, "
    "and do harm on others. The improved simulation has values of its own."
)


def lines_of(verdict: Verdict) -> list[str]:
    """Return the verdict, what makes it doubtful, findings, errors of each joint, and notes."""
    findings = [line for item in verdict.findings for line in _say(item, verdict.names)]
    doubts = (f"doubtful: {doubt}" for doubt in verdict.doubts)
    notes = (f"note: {note}" for note in verdict.notes if note not in verdict.doubts)
    table = [*_table(verdict), *_seen(verdict)]
    values = [*_values(verdict), *_identified(verdict)]
    return [headline(verdict), *doubts, *findings, *values, *table, *notes]


def _values(verdict: Verdict) -> list[str]:
    """Return the stated values that moved, a line each: a table is wider than a terminal."""
    lines = [
        f"{value}{' of joint' * bool(joint)} {joint}: {stated} → {fits}; {share} of the joint's "
        f"error, {tolerance}".rstrip(", ")
        for value, joint, stated, fits, share, tolerance in zip(
            *value_columns(verdict).values(), strict=True
        )
    ]
    return ["", "stated values that moved, and by how many tolerances", *lines] if lines else []


def identified_columns(verdict: Verdict) -> dict[tuple[str, str, str], list[str]]:
    """Return the joints whose ordinary friction was identified, and its values.

    A heading is effect, parameter and unit. A value stands beside half of its 95 % interval, values
    of one parameter (the elements of a law) alone; what a joint has none of is empty.
    """
    joints = sorted({item.joint for item in verdict.identified})
    called = dict(enumerate(verdict.labels, start=1))
    columns = {("", "", "joint"): [called.get(joint, str(joint)) for joint in joints]}
    for item in verdict.identified:
        for name, known in item.parameters.items():
            if known.ci95:
                one, numbers = isinstance(known.value, float), several(known.value)
                heading = (display_name(item.effect), name, f"[{known.unit}]")
                column = columns.setdefault(heading, [""] * len(joints))
                column[joints.index(item.joint)] = give_or_take(known) if one else numbers
    return columns


def columns_of(verdict: Verdict) -> dict[str, Sequence[float]]:
    """Return the errors of each joint by heading, [N m] but for the part of the rows that counts.

    A column that the verdict does not have is left out. A joint of which no row counts has no
    error: not a number.
    """
    fit = verdict.fit
    columns: dict[str, Sequence[float]] = {
        "given": fit.heldout_rmse_before,
        "within tolerances": fit.heldout_rmse_tolerances,
        "improved": fit.heldout_rmse_after,
        "noise floor": fit.noise_floor,
        ROWS_JUDGED: verdict.rows.part_judged(),
        "all rows, given": fit.heldout_rmse_before_all_rows,
        "all rows, improved": fit.heldout_rmse_after_all_rows,
    }
    counted = verdict.rows.judged or (1,) * len(fit.noise_floor)
    return {
        heading: values if heading == ROWS_JUDGED else _of_counted(values, counted)
        for heading, values in columns.items()
        if values
    }


def _of_counted(values: Sequence[float], counted: Sequence[int]) -> list[float]:
    return [x if rows else math.nan for x, rows in zip(values, counted, strict=True)]


def hardly_shown(verdict: Verdict) -> str:
    """Say which values the motion does not show; nothing where there are none."""
    if not verdict.hardly_shown:
        return ""
    return (
        f"The motion hardly shows {_together(verdict.hardly_shown)}: of these, what is stated "
        "is all that is known."
    )


def _together(names: Sequence[str]) -> str:
    """Say values of joints, such as "tau_c of joint 2 (coulomb friction)", those alike at once."""
    alike: dict[tuple[str, str], list[str]] = {}
    for name in names:
        known = _OF_A_JOINT.fullmatch(name)
        of, joints = ((known[1], known[3] or ""), [known[2]]) if known else ((name, ""), [])
        alike.setdefault(of, []).extend(joints)
    return listed(
        [
            f"{value} of joint{'s' * (len(on) > 1)} {listed(on)}{effect}" if on else value
            for (value, effect), on in alike.items()
        ]
    )


def _seen(verdict: Verdict) -> list[str]:
    """Say to which speeds a verdict has been seen to hold, and what was not seen at all."""
    if verdict.holds is None:
        return []
    fastest = (high for _, high in verdict.holds.speed)
    speeds = listed([rounded(speed, 2) if speed > 0 else "-" for speed in fastest])
    unit = unit_of("rad/s", verdict.sliding)
    sentence = f"The joints moved at up to {speeds} {unit}; faster motion is extrapolated."
    return [sentence, *filter(None, [hardly_shown(verdict)])]


def coverage(verdict: Verdict) -> str:
    """Say which part of the rows held out the errors count; nothing where that is not known."""
    parts = verdict.rows.part_judged()
    if not parts:
        return ""
    low, high = min(filter(None, parts), default=0.0), max(parts)
    counted = dict.fromkeys(map(_percent, (low, high)))
    return (
        f"The errors are over {' to '.join(counted)} of the rows held out, by joint: rows "
        f"{NOT_JUDGED} are neither fitted nor judged. The columns of all rows include them."
    )


def _say(item: Finding, names: Sequence[str]) -> list[str]:
    """Return name and place, values, evidence and confidence of a finding."""
    name = "something unknown" if item.effect == UNKNOWN else named(item)
    values = values_of(item) if item.effect != CONTACT else ""
    same = ", ".join(display_name(other) for other in item.equivalent)
    sure = f"confidence {100 * item.confidence:.0f} %"
    return [
        f"{name}, {place_of(item, names)}{f': {values}' if values else ''}",
        f"  {item.evidence}",
        f"  {sure}{f'; cannot be told from {same}' if same else ''}",
    ]


def _identified(verdict: Verdict) -> list[str]:
    """Return what each joint's ordinary friction was identified as; none where all was stated.

    A line a joint: a table of all laws would be wider than a terminal.
    """
    if not verdict.identified:
        return []
    columns = identified_columns(verdict)
    joints = columns.pop(("", "", "joint"))
    lines = ["", "identified, with 95 % intervals"]
    for k, joint in enumerate(joints):
        laws: dict[str, list[str]] = {}
        for (effect, name, unit), values in columns.items():
            if values[k]:
                sentence = f"{name} {values[k]}" + f" {unit.strip('[]')}" * (unit != "[1]")
                laws.setdefault(effect, []).append(sentence)
        found = (f"{effect}: {', '.join(values)}" for effect, values in laws.items())
        lines.append(f"joint {joint}  {'; '.join(found)}")
    return lines


def _aligned(columns: Sequence[Sequence[str]]) -> list[str]:
    """Return columns of cells as lines of one width."""
    widths = [max(map(len, column)) for column in columns]
    rows = zip(*columns, strict=True)
    return ["  ".join(map(str.rjust, row, widths)).rstrip() for row in rows]


def _percent(part: float) -> str:
    return f"{100 * part:.0f} %"


def _table(verdict: Verdict) -> list[str]:
    """Return the errors as lines of one width, and what has to be known to read them."""
    joints = verdict.labels
    worse = verdict.fit.worse_within_tolerances
    cells = [["", "joint", *joints]]
    for heading, values in columns_of(verdict).items():
        say = _percent if heading == ROWS_JUDGED else rounded
        texts = [say(value) if math.isfinite(value) else "-" for value in values]
        if worse and heading == "within tolerances":
            texts = [text + " *"[j in worse] for j, text in enumerate(texts, start=1)]
        first, _, second = heading.rpartition(" ")
        cells.append([first, second, *texts])
    sentence = (coverage(verdict) if verdict.rows.fitted else "", WORSE if worse else "")
    unit = verdict.fit.unit
    return ["", f"held-out RMSE [{unit}]", *_aligned(cells), *filter(None, sentence)]


CHOSEN = "chosen"  # the note of the explanation that the verdict is about


@dataclass(frozen=True)
class Traces:
    """Filtered signals of all recordings on a slow grid of K rows, in order of time."""

    time: FloatArray  # (K,) [s], of the recording
    recording: IntArray  # (K,) which recording, 0-based
    position: FloatArray  # (K, n) [rad]
    velocity: FloatArray  # (K, n) [rad/s]
    load: FloatArray  # (K, n) nominal rigid-body torque [N m]
    since_reversal: FloatArray  # (K, n) distance travelled since the last reversal [rad]
    measured: FloatArray  # (K, n) [N m]
    before: FloatArray  # (K, n) torque of the given simulation [N m]
    tolerances: FloatArray  # (K, n) of the given one, its values moved inside tolerances [N m]
    after: FloatArray  # (K, n) torque of the improved simulation [N m]
    held_out: BoolArray  # (K,) rows that the proof was made on
    moving: BoolArray  # (K, n) not near rest; all other rows are neither fitted nor scored
    sliding: tuple[bool, ...] = ()  # (n,), joints in m and N; empty if all turn


@dataclass(frozen=True)
class Explanation:
    """One hypothesis that competed."""

    effects: tuple[str, ...]
    joints: tuple[tuple[int, ...], ...]  # of each effect, 1-based
    log_evidence: float  # against no effect at all, natural logarithm
    share: float  # of the reducible error that it removes
    note: str = ""  # CHOSEN, or why it is not


@dataclass(frozen=True)
class Test:
    """One node of the tree of nested tests at one joint."""

    joint: int  # 1-based
    question: str  # e.g. "Does the residual depend on the distance since reversal?"
    share: float  # of the joint's reducible error that saying yes explains
    yes: bool


@dataclass(frozen=True)
class Shift:
    """Shift of a nuisance parameter from its nominal value."""

    name: str  # e.g. "mass of link_4" or "tau_c of joint 1"
    nominal: float
    fitted: float
    unit: str
    sigmas: float  # in its prior standard deviation
    left: float = 1.0  # standard deviation that the recordings leave, in that of the prior


@dataclass(frozen=True, repr=False)
class SimulationDiagnosed(Displayed):
    """A verdict with the given and the improved simulation."""

    verdict: Verdict
    before: Simulation
    after: Simulation
    recordings: tuple[Recording, ...]
    # stages that failed; the verdict has a note on each
    failures: tuple[Failure, ...] = field(default=(), kw_only=True)

    @property
    def simulation(self) -> Simulation:
        """The improved simulation."""
        return self.after

    @property
    def findings(self) -> tuple[Finding, ...]:
        """The effects that were left out or have a wrong parameter, as the verdict has them."""
        return self.verdict.findings

    def headline(self) -> str:
        """Say the verdict in one sentence."""
        return headline(self.verdict)

    def __str__(self) -> str:
        return "\n".join(lines_of(self.verdict))


@dataclass(frozen=True, repr=False)
class DiagnosisResult(SimulationDiagnosed):
    """Result of a diagnosis: verdict, improved simulation, and evidence."""

    traces: Traces
    explanations: tuple[Explanation, ...]  # best first
    tests: tuple[Test, ...] = ()
    shifts: tuple[Shift, ...] = ()
    next_motion: Trajectory | None = None
    next_motion_purpose: str = ""  # one sentence: what it would decide
    next_motion_note: str = ""  # why there is none although one is wanted
    bandwidth: float = BANDWIDTH  # of the zero-phase filter [Hz]
    replay: tuple[Replay, ...] = field(default_factory=tuple)
    replay_note: str = ""  # why there is no replay

    def failed(self, failure: Failure) -> Self:
        """Return the same with a stage that failed, which is the first note of the verdict."""
        notes = (failure.note(), *self.verdict.notes)
        verdict = replace(self.verdict, notes=notes)
        return replace(self, verdict=verdict, failures=(*self.failures, failure))

    def __str__(self) -> str:
        motion = self.next_motion is not None
        more = f"next motion: {self.next_motion_purpose}" if motion else self.next_motion_note
        return "\n".join(filter(None, [super().__str__(), more]))

    def figures(self) -> Mapping[str, Sequence[object]]:
        """Return the errors of each joint on motion that nothing was fitted to."""
        unit = self.verdict.fit.unit
        names = {
            "given": f"held-out RMSE before [{unit}]",
            "rows judged": "part of the rows judged",
        }
        columns = {names.get(k, f"{k} [{unit}]"): v for k, v in columns_of(self.verdict).items()}
        return {"joint": self.before.model.joint_names, **columns}


@dataclass(frozen=True)
class Replay:
    """A recorded motion run on the simulated robot, T samples on the slow grid."""

    time: FloatArray  # (T,) [s]
    measured: FloatArray  # (T, n) recorded torque [N m]
    before: FloatArray  # (T, n) measured on the robot of the given simulation [N m]
    after: FloatArray  # (T, n) measured on the robot of the improved simulation [N m]
    tracking: FloatArray  # (n,) RMS distance of simulated from recorded position [rad]
    moving: BoolArray  # (T, n) not near rest: rows that are scored
    recording: int  # 0-based
    position: FloatArray  # (T, n) recorded [rad]
    position_before: FloatArray  # (T, n) of the robot of the given simulation [rad]
    position_after: FloatArray  # (T, n) of the robot of the improved simulation [rad]
    sliding: tuple[bool, ...] = ()  # (n,), joints in m and N; empty if all turn


@dataclass(frozen=True)
class DriveReplay:
    """A held-out recording beside two simulations that were run forward from its commands."""

    recording: Recording  # T samples of n joints, as the description counts
    given: FloatArray  # (T, n) [rad]
    improved: FloatArray


@dataclass(frozen=True, repr=False)
class DriveResult(SimulationDiagnosed):
    """Verdict, improved simulation and evidence of an arm of commands and positions."""

    held_out_error: tuple[tuple[float, ...], tuple[float, ...]]  # mean absolute, [rad] by joint
    replay: DriveReplay | None = None

    def figures(self) -> Mapping[str, Sequence[object]]:
        """Return the free-running errors of each joint on motion that nothing was fitted to."""
        given, improved = self.held_out_error
        unit = unit_of("rad", self.before.model.sliding)
        return {
            "joint": self.before.model.joint_names,
            f"held-out |error| given [{unit}]": given,
            f"improved [{unit}]": improved,
        }
