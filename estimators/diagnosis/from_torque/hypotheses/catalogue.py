"""Hypotheses: each effect of the catalogue, wherever it could act, at a unit size."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from limo_driver.physics.catalogue import every_effect, known_as
from limo_driver.physics.effect import Recorded

if TYPE_CHECKING:
    from collections.abc import Iterator

    from estimators.diagnosis.from_torque.residuals.observations import Observations
    from limo_driver.physics import Hypothesis


def every(observed: Observations) -> Iterator[Hypothesis]:
    """Yield all hypotheses for a recorded arm."""
    recorded = recorded_in(observed)
    for joint in range(1, observed.n + 1):
        for effect in every_effect():
            yield from effect.at_joint(joint, recorded)
    for effect in every_effect():
        yield from effect.on_arm(recorded)


def rivals(hypothesis: Hypothesis) -> Iterator[Hypothesis]:
    """Yield further laws of an effect that was found."""
    effect = known_as(hypothesis.effect)
    if effect is not None:
        yield from effect.further_laws(hypothesis)


def recorded_in(observed: Observations) -> Recorded:
    """Return what recordings show of an arm before anything is fitted."""
    recordings = observed.recordings
    return Recorded(
        position=observed.slow.position,
        temperature=observed.motion.temperature,
        start=min(float(recording.time[0]) for recording in recordings),
        end=max(float(recording.time[-1]) for recording in recordings),
        longest=max(recording.duration for recording in recordings),
        gravity=np.array(observed.chain.gravity),
        effects=observed.reference.effects,
    )
