"""What a diagnosis found, with torque and without, and all that a report shows."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Self

from estimators.diagnosis.headline import headline
from estimators.diagnosis.summary import columns_of, lines_of
from limo_driver.recordings.bandwidth import BANDWIDTH
from limo_driver.runtime.display import Displayed

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    import numpy as np
    from numpy.typing import NDArray

    from estimators.diagnosis.stages import Failure
    from estimators.diagnosis.verdict import Finding, Verdict
    from limo_driver.physics import Simulation
    from limo_driver.recordings.recording import Recording
    from limo_driver.trajectory import Trajectory
    from limo_driver.types import FloatArray

CHOSEN = "chosen"  # the note of the explanation that the verdict is about


@dataclass(frozen=True)
class Traces:
    """Filtered signals of all recordings on a slow grid of K rows, in order of time."""

    time: FloatArray  # (K,) [s], of the recording
    recording: NDArray[np.int64]  # (K,) which recording, 0-based
    position: FloatArray  # (K, n) [rad]
    velocity: FloatArray  # (K, n) [rad/s]
    load: FloatArray  # (K, n) nominal rigid-body torque [N m]
    since_reversal: FloatArray  # (K, n) distance travelled since the last reversal [rad]
    measured: FloatArray  # (K, n) [N m]
    before: FloatArray  # (K, n) torque of the given simulation [N m]
    tolerances: FloatArray  # (K, n) of the given one, its values moved inside tolerances [N m]
    after: FloatArray  # (K, n) torque of the improved simulation [N m]
    held_out: NDArray[np.bool_]  # (K,) rows that the proof was made on
    moving: NDArray[np.bool_]  # (K, n) not near rest; all other rows are neither fitted nor scored


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
class DiagnosisResult(Displayed):
    """Result of a diagnosis: verdict, improved simulation, and evidence."""

    verdict: Verdict
    before: Simulation
    after: Simulation
    recordings: tuple[Recording, ...]
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
    failures: tuple[Failure, ...] = ()  # stages that failed; the verdict has a note on each

    @property
    def simulation(self) -> Simulation:
        """The improved simulation."""
        return self.after

    def failed(self, failure: Failure) -> Self:
        """Return the same with a stage that failed, which is the first note of the verdict."""
        notes = (failure.note(), *self.verdict.notes)
        verdict = replace(self.verdict, notes=notes)
        return replace(self, verdict=verdict, failures=(*self.failures, failure))

    def headline(self) -> str:
        """Say the verdict in one sentence."""
        return headline(self.verdict)

    def __str__(self) -> str:
        motion = self.next_motion is not None
        more = f"next motion: {self.next_motion_purpose}" if motion else self.next_motion_note
        return "\n".join([*lines_of(self.verdict), *filter(None, [more])])

    @property
    def findings(self) -> tuple[Finding, ...]:
        """The effects that were left out or have a wrong parameter, as the verdict has them."""
        return self.verdict.findings

    def figures(self) -> Mapping[str, Sequence[object]]:
        """Return the errors of each joint on motion that nothing was fitted to."""
        names = {"given": "held-out RMSE before [N m]", "rows judged": "part of the rows judged"}
        columns = {names.get(k, f"{k} [N m]"): v for k, v in columns_of(self.verdict).items()}
        return {"joint": self.before.model.joint_names, **columns}


@dataclass(frozen=True)
class Replay:
    """A recorded motion run on the simulated robot, T samples on the slow grid."""

    time: FloatArray  # (T,) [s]
    measured: FloatArray  # (T, n) recorded torque [N m]
    before: FloatArray  # (T, n) measured on the robot of the given simulation [N m]
    after: FloatArray  # (T, n) measured on the robot of the improved simulation [N m]
    tracking: FloatArray  # (n,) RMS distance of simulated from recorded position [rad]
    moving: NDArray[np.bool_]  # (T, n) not near rest: rows that are scored
    recording: int  # 0-based
    position: FloatArray  # (T, n) recorded [rad]
    position_before: FloatArray  # (T, n) of the robot of the given simulation [rad]
    position_after: FloatArray  # (T, n) of the robot of the improved simulation [rad]


@dataclass(frozen=True)
class DriveReplay:
    """A held-out recording beside two simulations that were run forward from its commands."""

    recording: Recording  # T samples of n joints, as the description counts
    given: FloatArray  # (T, n) [rad]
    improved: FloatArray


@dataclass(frozen=True, repr=False)
class DriveResult(Displayed):
    """Verdict, improved simulation and evidence of an arm that tells commands and positions."""

    verdict: Verdict
    before: Simulation
    after: Simulation
    recordings: tuple[Recording, ...]
    held_out_error: tuple[tuple[float, ...], tuple[float, ...]]  # mean absolute, [rad] by joint
    failures: tuple[Failure, ...] = ()
    replay: DriveReplay | None = None

    @property
    def simulation(self) -> Simulation:
        """The improved simulation, which can be run forward from commands."""
        return self.after

    @property
    def findings(self) -> tuple[Finding, ...]:
        """What differs from what was stated, as the verdict has it."""
        return self.verdict.findings

    def headline(self) -> str:
        """Say the verdict in one sentence."""
        return headline(self.verdict)

    def figures(self) -> Mapping[str, Sequence[object]]:
        """Return the free-running errors of each joint on motion that nothing was fitted to."""
        given, improved = self.held_out_error
        return {
            "joint": self.before.model.joint_names,
            "held-out |error| given [rad]": given,
            "improved [rad]": improved,
        }

    def __str__(self) -> str:
        return "\n".join(lines_of(self.verdict))
