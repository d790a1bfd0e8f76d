"""Mistakes of a log are refused before anything is identified, as a diagnosis refuses them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from lanes import sampled

import limo_driver as limo
from limo_driver.app.library.converting import convert_log
from limo_driver.errors import RecordingError
from limo_driver.physics import CoulombFriction

RATE, DURATION, BANDWIDTH = 50.0, 40.0, 5.0  # [Hz], [s], [Hz]
ARM = limo.RobotModel.load("iiwa14")
TRUE = limo.Simulation(
    "iiwa14", tuple(CoulombFriction(joint=j, tau_c=0.3 * j) for j in range(1, 8))
)
ONE = np.eye(7)
EXCHANGED = ONE[[0, 3, 2, 1, 4, 5, 6]]


def measured(simulation=TRUE):
    t = np.arange(int(DURATION * RATE)) / RATE
    w = 2 * np.pi * np.array([0.31, 0.23, 0.37, 0.29, 0.41, 0.43, 0.47])
    angle = w * t[:, None] + np.arange(7)
    motion = limo.Motion.from_positions(t, 0.7 * np.sin(angle) + 0.5 * np.sin(0.3 * angle))
    noise = 0.01 * np.random.default_rng(0).standard_normal((t.size, 7))
    torque = simulation.predict(motion) + noise
    return limo.Recording.from_arrays(t, motion.position, torque, source="run")


@pytest.fixture(scope="module")
def recording():
    return measured()


def identified(*recordings, robot=ARM):
    from estimators.rigid_body import JointTerms, Rows

    terms = JointTerms((0.01,), offset=False, armature=False)
    return limo.identify(robot, recordings, terms, Rows(BANDWIDTH), tolerance=0.1)


@sampled(
    ("matrix", "said"),
    [
        (EXCHANGED, "torque_2 belongs to joint 4 and torque_4 to joint 2"),
        (-ONE, "all torques have the other sign than expected"),
        (ONE - 2 * np.diag(ONE[3]), "torque_4 has the other sign than expected"),
        (1e-3 * ONE, r"the torques are 0\.00\d+ times .*; are they in kN m or A"),
        (8.0 * ONE, r"the torques are 8\.?\d* times .*; are they in N mm or mA"),
    ],
    "identifies a recording each",
)
def test_torques_in_the_wrong_place_sign_or_unit_are_refused(recording, matrix, said):
    mistaken = replace(recording, torque=recording.torque @ matrix.T)
    with pytest.raises(RecordingError, match=f"^run: {said}"):
        identified(mistaken)


def test_positions_in_the_wrong_place_are_refused_beside_a_good_recording(recording):
    mistaken = replace(measured(), position=recording.position @ EXCHANGED.T, source="second")
    with pytest.raises(RecordingError, match=r"^second: position_2 belongs to joint 4"):
        identified(recording, mistaken)


@pytest.mark.slow("identifies a recording")
def test_what_may_be_another_arm_is_identified_and_doubted_first(recording):
    """Finding other bodies than the description has is what an identification is for."""
    found = identified(replace(recording, torque=np.roll(recording.torque, 300, axis=0)))
    assert "are not the load of iiwa14 on this motion" in found.warnings[0]
    assert not any("load of" in warning for warning in identified(recording).warnings)


@pytest.mark.slow("identifies recordings")
def test_a_robot_on_the_wall_is_judged_as_it_hangs():
    wall = (0.0, -9.81, 0.0)
    from limo_driver.physics import GravityDirection

    hanging = measured(replace(TRUE, effects=(*TRUE.effects, GravityDirection(gravity=wall))))
    with pytest.raises(RecordingError, match="torque_4 has the other sign"):
        identified(
            replace(hanging, torque=hanging.torque * (1 - 2 * ONE[3])),
            robot=ARM.with_gravity(wall),
        )


@pytest.mark.slow("identifies a recording")
def test_a_mounting_that_the_description_does_not_have_is_said_first():
    from limo_driver.physics import GravityDirection

    hung = GravityDirection(gravity=(9.81, 0.0, 0.0))
    found = identified(measured(replace(TRUE, effects=(*TRUE.effects, hung))))
    assert found.warnings[0].startswith("gravity acts along +x of the base, so the arm is mounted")


def test_too_little_to_judge_by_is_said(recording):
    found = identified(recording[:100])
    assert found.warnings[0].startswith("signs, units and order of the columns cannot be checked:")


@pytest.mark.slow("inspects and converts two logs")
def test_an_inspection_asks_and_a_conversion_doubts_what_would_be_refused(recording, tmp_path):
    """A log that is converted may be mended later, so it is written all the same."""
    log = {"time_s": recording.time, "q_rad": recording.position}
    good, bad = log | {"tau_nm": recording.torque}, log | {"tau_nm": recording.torque @ EXCHANGED}
    assert limo.inspect(good, ARM).questions == ()
    (question,) = limo.inspect(bad, ARM).questions
    assert "refused: torque_2 belongs to joint 4 and torque_4 to joint 2" in question
    for name, columns in (("good", good), ("bad", bad)):
        np.savez(tmp_path / f"{name}.npz", **columns)
    written = [
        convert_log(tmp_path / f"{name}.npz", tmp_path / f"{name}.parquet", ARM)
        for name in ("good", "bad")
    ]
    assert written[0].samples == written[1].samples == len(recording)
    said = "identification and diagnosis will refuse it: torque_2 belongs to joint 4"
    assert said in written[1].notes[-1]
    assert not any(said in note for note in written[0].notes)
