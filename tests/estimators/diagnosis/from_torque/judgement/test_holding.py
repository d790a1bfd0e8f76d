"""A verdict says on which motion it stands, and which values that motion does not show."""

from __future__ import annotations

import numpy as np
import pytest
from wandering import wander

from estimators.diagnosis.from_torque.fitting.problem import RegressionProblem, fitted
from estimators.diagnosis.from_torque.judgement.conclusion import held_by
from estimators.diagnosis.from_torque.residuals.noise import Noise
from estimators.diagnosis.from_torque.residuals.observations import Observations
from estimators.diagnosis.stages import quiet
from limo_driver.physics import Simulation, ViscousFriction
from limo_driver.recordings.recording import Recording


@pytest.fixture(scope="module")
def holds():
    """Joint 1 creeps, joint 7 rests, the others move."""
    time = np.arange(0.0, 20.0, 0.01)
    motion = wander(time, np.zeros(7), 1, (0.1, 0.3), (0.3, 0.4))
    position = motion.position.copy()
    position[:, 0], position[:, 6] = 0.01 * np.sin(0.5 * time), 0.3
    friction = tuple(ViscousFriction(joint=j, f_v=2.0) for j in (1, 2))
    simulation = Simulation("iiwa14", friction)
    noise = 0.1 * np.random.default_rng(2).standard_normal(position.shape)
    recording = Recording.from_arrays(time, position, noise, source="creeps")
    torque = simulation.predict(recording) + noise
    recording = Recording.from_arrays(time, position, torque, source="creeps")
    problem = RegressionProblem.of(Observations.of(simulation, [recording], 10.0), quiet)
    white = Noise.independent(np.full(7, 0.1), problem.split.fitted)
    return held_by(fitted(problem, (), white))


def test_ranges_are_those_of_the_motion(holds):
    assert len(holds.position) == len(holds.speed) == len(holds.load) == 7
    assert holds.position[0] == pytest.approx((-0.01, 0.01), abs=1e-3)
    assert holds.speed[0][1] == pytest.approx(0.005, rel=0.1)
    assert holds.speed[1][1] > 0.1
    assert holds.position[6] == holds.speed[6] == (0.0, 0.0)


def test_a_slope_that_creep_does_not_show_stays_as_stated(holds):
    assert holds.as_stated == ("f_v of joint 1 (viscous friction)",)
