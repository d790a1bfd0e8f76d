"""DriveResult: what was found of an arm that tells no torque."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from estimators.diagnosis.headline import headline
from estimators.diagnosis.summary import lines_of
from limo_driver.runtime.display import Displayed

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from estimators.diagnosis.stages import Failure
    from estimators.diagnosis.verdict import Finding, Verdict
    from limo_driver.physics import Simulation
    from limo_driver.recordings.recording import Recording
    from limo_driver.types import FloatArray


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
