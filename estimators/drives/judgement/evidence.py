"""What was identified from a part of the recordings and from all, and what all joints feel."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from estimators.diagnosis.verdict import BeforeAfter, Finding
from estimators.drives.fitting.joint import errors
from estimators.drives.hypotheses.suspects import COUNTED
from estimators.drives.judgement.held_out import CONFIDENT, LEAST, removes
from estimators.drives.judgement.of_the_arm import shared_finding, without
from estimators.drives.simulation.loads import ArmLoads
from estimators.drives.simulation.one_joint import loaded_joints
from estimators.drives.simulation.plant import rows_of

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from estimators.drives.fitting.identification import DriveIdentification
    from estimators.drives.hypotheses.stated import StatedArm
    from estimators.drives.hypotheses.suspects import Suspect
    from estimators.drives.simulation.one_joint import LoadedJoint
    from limo_driver.physics import Simulation
    from limo_driver.recordings.recording import Recording
    from limo_driver.types import FloatArray


@dataclass(frozen=True)
class DriveEvidence:
    """What was identified, from which recordings, and what of it all joints feel."""

    proof: DriveIdentification  # from a part of the recordings
    final: DriveIdentification  # from all
    recordings: tuple[Recording, ...]  # as the description counts
    unseen: tuple[Recording, ...]
    turned: tuple[Suspect, ...] = ()  # joints that count against the description
    shared: tuple[StatedArm, StatedArm] | None = None  # of the same two, where drives are stated
    counted: DriveEvidence | None = None  # with joints turned, as they were recorded

    def parts(self, given: Simulation) -> list[list[LoadedJoint]]:
        """Return the held-out motion of each joint, loaded as was proven."""
        if self.shared is None:
            return loaded_joints(given.body, self.unseen)
        loads = ArmLoads(given.body, self.unseen, rows_of(given))
        return loads.parts(self.shared[0].change)

    def of_the_arm(self, given: Simulation) -> Iterator[tuple[float, Finding]]:
        """Yield what all joints feel, with the squared held-out error that each removes."""
        if self.counted is not None:
            yield from self.counted.of_the_arm(given)
        if self.shared is None:
            return
        loads = ArmLoads(given.body, self.unseen, rows_of(given))
        proof, final = self.shared
        rows = [fit.row for fit in self.proof.fits]
        full = _squares(loads.parts(proof.change), rows)
        noise = np.array([max(float(np.median(x)), LEAST) for x in full])
        for one in proof.suspects:
            if not one.shared or (self.turned and one.effect in COUNTED):
                continue
            less = _squares(loads.parts(without(proof.change, one)), rows)
            confidence = removes(
                np.concatenate([x / s for x, s in zip(full, noise, strict=True)]),
                np.concatenate([x / s for x, s in zip(less, noise, strict=True)]),
            )
            if confidence < CONFIDENT:
                continue
            lost = sum(float(x.mean()) for x in less) - sum(float(x.mean()) for x in full)
            rmse = [tuple(float(np.sqrt(x.mean())) for x in squares) for squares in (less, full)]
            yield lost, shared_finding(one, final, confidence, BeforeAfter(*rmse))


def _squares(
    parts: Sequence[Sequence[LoadedJoint]], rows: Sequence[FloatArray]
) -> list[FloatArray]:
    """Return squared errors of each joint [rad²]."""
    return [errors(own, row) ** 2 for own, row in zip(parts, rows, strict=True)]
