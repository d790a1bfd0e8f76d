"""Effects without a native form act in the simulated arm all the same, and remember."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
import pytest
from simulated_runs import iiwa, play, rms

from backends.mujoco_sim import MujocoRobot
from limo_driver.physics import (
    Backlash,
    JointCoupling,
    JointElasticity,
    MotionEffect,
    PreslidingHysteresis,
    Sensors,
    TimeDelay,
    TorqueDrift,
    TorqueEffect,
)
from limo_driver.types import PositionCommand


@dataclass(frozen=True, kw_only=True)
class Foreign(TorqueEffect):
    """An effect that the simulator does not know: a spring element, by composition."""

    name: ClassVar[str] = "foreign"

    @property
    def inner(self):
        return PreslidingHysteresis(joint=self.joint, stiffness=(300.0,), width=(0.004,))

    def initial_state(self):
        return self.inner.initial_state()

    def advance(self, state, motion):
        return self.inner.advance(state, motion)


@dataclass(frozen=True, kw_only=True)
class ForeignWindUp(MotionEffect):
    """A displacement that the simulator does not know."""

    name: ClassVar[str] = "foreign_wind_up"

    def advance(self, state, motion):
        return motion.load / 8000.0, state


@pytest.mark.slow("plays a motion on two arms with effects in Python")
def test_unknown_effects_are_sampled(exploration):
    targets = exploration[:3000]
    known = iiwa(
        PreslidingHysteresis(joint=4, stiffness=(300.0,), width=(0.004,)),
        JointElasticity(joint=2, stiffness=8000.0),
    )
    foreign = iiwa(Foreign(joint=4), ForeignWindUp(joint=2))
    one, other = play(known, targets), play(foreign, targets)
    assert rms(one.true_torque - other.true_torque).max() < 0.01
    apart = rms(one.true_motion.position - other.true_motion.position)
    assert np.delete(apart, 1).max() < 1e-6
    assert apart[1] < 1e-4  # its servo leaves the inertial share of the wind-up out
    predicted = foreign.predict(other.true_motion)
    assert rms(other.true_torque - predicted).max() < 0.01


REMEMBERING = (
    Foreign(joint=4),
    JointElasticity(joint=4, stiffness=8000.0),
    Backlash(joint=2, gap=1e-3),
    Backlash(joint=5, gap=2e-3, drag=0.3),
    PreslidingHysteresis(
        joint=3, law="lugre", sigma_0=400.0, sigma_1=5.0, tau_c=1.0, tau_s=0.3, v_s=0.02
    ),
    JointCoupling(joint=6, other=7, tau_c=0.5),
    JointCoupling(joint=7, other=6, tau_c=0.5),
    TorqueDrift(joint=4, times=(0.3, 0.4), offset=(0.0, 1.0)),
    TimeDelay(joint=4, delay=0.0203, lag=0.01),
)


def test_sampled_effects_are_saved_and_restored(exploration):
    with MujocoRobot(iiwa(*REMEMBERING), initial_position=exploration[0]) as robot:
        robot.receive()
        robot.run(exploration[:300])
        saved = robot.save_state()
        first = robot.run(exploration[300:400])
        robot.restore_state(saved)
        second = robot.run(exploration[300:400])
        robot.restore_state(saved)
        robot.send(PositionCommand(position=exploration[300]))
        cycle_by_cycle = robot.receive()
    assert np.array_equal(first.torque, second.torque)
    assert np.array_equal(first.position, second.position)
    assert np.array_equal(first.torque[0], cycle_by_cycle.torque)


def test_drift_and_delay_change_what_is_measured_and_not_the_run(exploration):
    sensors = Sensors(torque_noise=(0.05,), torque_resolution=(0.01,))
    plain = play(iiwa(sensors=sensors), exploration[:2000])
    sensed = play(iiwa(*REMEMBERING[-2:], sensors=sensors), exploration[:2000])
    assert np.array_equal(plain.true_motion.position, sensed.true_motion.position)
    assert np.array_equal(np.delete(plain.torque, 3, axis=1), np.delete(sensed.torque, 3, axis=1))
    noise = sensed.torque - sensed.true_torque
    assert np.abs(noise - (plain.torque - plain.true_torque)).max() < 0.011  # quantised elsewhere
