"""Contact: the finding says in which recording and when something pushed."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from wandering import wander

from estimators.diagnosis.from_torque.contact import contact_of
from estimators.diagnosis.from_torque.judgement.judgement import RemainingResidual
from estimators.diagnosis.from_torque.residuals.observations import Observations
from estimators.diagnosis.from_torque.residuals.pushes import Push
from limo_driver.physics import ExternalContact, Simulation
from limo_driver.recordings.recording import Recording

EVERY = tuple(range(7))  # joint
FLOOR = np.full(7, 0.01)  # [N m]
FIRST, SECOND = (4.0, 4.8), (2.0, 3.0)  # [s]
PUSHED = ExternalContact(windows=(SECOND,), wrench=((10.0, 0.0, -5.0, 0.0, 0.0, 0.0),))


def record(seed, source, *effects):
    motion = wander(np.arange(0, 10, 0.005), np.full(7, 0.3), seed, (0.05, 0.2), (0.1, 0.3))
    torque = Simulation("iiwa14", effects).predict(motion)
    return Recording.from_arrays(motion.time, motion.position, torque, source=source)


@pytest.fixture(scope="module")
def observed():
    recordings = (record(1, "runs/monday.parquet"), record(2, "runs/tuesday.parquet", PUSHED))
    return Observations.of(Simulation("iiwa14"), recordings, 10.0)


def finding_of(found, observed):
    remaining = RemainingResidual(FLOOR, 0 * FLOOR, 0 * observed.residual)
    (finding,) = contact_of(found, observed, observed.residual, remaining)
    return finding


def test_each_stretch_is_told_with_its_recording(observed):
    pushes = (Push(1, *SECOND, 200.0, EVERY, held=True), Push(0, *FIRST, 150.0, EVERY, held=True))
    finding = finding_of(pushes, observed)
    assert finding.where.time == (FIRST, SECOND)
    assert finding.where.recording == (1, 2)
    assert finding.parameters["windows"].value == (FIRST, SECOND)
    assert finding.evidence.startswith(
        "In 2 short stretches of time (4.0 to 4.8 s of monday.parquet; 2.0 to 3.0 s of "
        "tuesday.parquet) the errors of joints 1, 2, 3, 4, 5, 6 and 7 are far larger"
    )
    assert "up to 11.2 N, explains 1 of them" in finding.evidence
    calm, pushed = (np.array(wrench) for wrench in finding.parameters["wrench"].value)
    assert np.abs(calm).max() < 0.1
    assert pushed[0] > 5.0


def test_of_one_recording_only_the_time_is_told(observed):
    alone = observed.part(1)
    finding = finding_of((Push(0, *SECOND, 200.0, EVERY, held=True),), alone)
    assert finding.evidence.startswith("In a short stretch of time (2.0 to 3.0 s) the errors of")
    assert finding.where.recording == (1,)


def test_recordings_of_one_name_are_numbered(observed):
    named = tuple(replace(r, source="run.parquet") for r in observed.recordings)
    finding = finding_of(
        (Push(1, *SECOND, 200.0, EVERY, held=True),), replace(observed, recordings=named)
    )
    assert "(2.0 to 3.0 s of recording 2)" in finding.evidence


def test_a_force_is_said_only_where_the_poses_tell_all_of_it(observed):
    pushed = (Push(1, *SECOND, 200.0, EVERY, held=True),)
    remaining = RemainingResidual(FLOOR, 0 * FLOOR, 0 * observed.residual)

    def evidence(size):
        rough = replace(remaining, floor=size * FLOOR)
        return contact_of(pushed, observed, observed.residual, rough)[0].evidence

    assert "up to 11.2 N, explains them" in evidence(1)
    assert "these poses do not tell how strong it is" in evidence(100)  # of 1 N m a row


def test_what_is_hardly_rarer_than_other_stretches_is_hardly_sure(observed):
    def confidence(*rarities):
        pushed = Push(1, *SECOND, 200.0, EVERY, held=True)
        return finding_of(
            [replace(pushed, surprisal=each) for each in rarities], observed
        ).confidence

    assert confidence(14.0) == pytest.approx(0.5, abs=0.05)
    assert confidence(400.0) > 0.95
    assert confidence(14.0, 400.0) == confidence(400.0)
