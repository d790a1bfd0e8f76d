"""The simulated arm as a robot: whole runs, servo, drives, sensors, and what it refuses."""

import re
from dataclasses import replace

import numba
import numpy as np
import pytest
from simulated_runs import iiwa, play, rms

from backends.mujoco_sim import MujocoRobot
from limo_driver.errors import BackendError, ConfigError, JointLimitError, ShapeError
from limo_driver.model import RobotModel
from limo_driver.physics import (
    Backlash,
    JointCoupling,
    JointElasticity,
    PreslidingHysteresis,
    Sensors,
    Simulation,
    TemperatureDependentFriction,
)
from limo_driver.types import ImpedanceCommand, PositionCommand


def test_without_the_compiler_it_is_refused(monkeypatch):
    monkeypatch.setattr(numba.config, "DISABLE_JIT", 1)
    with pytest.raises(ConfigError, match="needs numba's compiler, which NUMBA_DISABLE_JIT switc"):
        MujocoRobot(robot="iiwa14")


def test_whole_run_in_one_call_equals_cycle_by_cycle(hysteretic, exploration):
    targets = exploration[:700]
    with MujocoRobot(hysteretic, initial_position=targets[0], seed=4) as robot:
        robot.receive()
        for target in targets:
            sent = robot.send(PositionCommand(position=target))
            state = robot.receive()
        after = [robot.receive() for _ in range(5)][-1]
    with MujocoRobot(hysteretic, initial_position=targets[0], seed=4) as robot:
        robot.receive()
        run = robot.run(targets)
        afterwards = [robot.receive() for _ in range(5)][-1]
    for name in ("position", "velocity", "torque"):
        assert np.array_equal(getattr(run, name)[-1], getattr(state, name)), name
        assert np.array_equal(getattr(afterwards, name), getattr(after, name)), name
    assert run.time[-1] == state.time
    assert np.array_equal(run.target[-1], sent.position)
    assert afterwards.sequence == after.sequence


def test_what_is_written_into_a_run_moves_nothing(exploration):
    with MujocoRobot(robot="iiwa14", initial_position=exploration[0]) as robot:
        robot.receive()
        run = robot.run(exploration[:50])
        last = run.target[-1].copy()
        run.target[:] += 0.5
        np.testing.assert_array_equal(robot.setpoint, last)


def test_run_limits_its_targets(exploration):
    targets = exploration.copy()
    targets[300:] += 0.2
    run = play(iiwa(), targets)
    assert set(run.limited_by) == {"velocity", "acceleration"}
    assert np.abs(np.diff(run.target, axis=0)).max() < 2.4e-3


def test_run_refuses_what_send_refuses(exploration):
    with MujocoRobot(robot="iiwa14", initial_position=exploration[0]) as robot:
        robot.receive()
        with pytest.raises(JointLimitError, match="first position"):
            robot.run(exploration + 0.1)
        broken = exploration.copy()
        broken[500, 2] = np.nan
        with pytest.raises(JointLimitError, match="joint 3: position nan"):
            robot.run(broken)
        with pytest.raises(ShapeError):
            robot.run(exploration[:, :6])


def test_servo_follows_slow_motion_closely(hysteretic, exploration):
    run = play(replace(hysteretic, sensors=Sensors()), exploration)
    # Measured and commanded of the same cycle: row k + 1 answers target k.
    assert rms(run.position[1:] - exploration[1:]).max() < 1e-4


def test_held_arm_comes_to_rest(hysteretic, exploration):
    quiet = replace(hysteretic, sensors=Sensors())
    stop = np.concatenate([exploration[:2000], np.repeat(exploration[1999:2000], 4000, axis=0)])
    run = play(quiet, stop)
    assert np.abs(run.true_motion.velocity[-1000:]).max() < 1e-5  # no hunting around friction
    assert np.abs(run.position[-1] - stop[-1]).max() < 1e-5


def test_sensors_are_noisy_and_quantised(exploration):
    sensors = Sensors(torque_noise=(0.05,), torque_resolution=(0.01,), encoder_resolution=(1e-4,))
    run = play(iiwa(sensors=sensors), exploration)
    noise = run.torque - run.true_torque
    assert rms(noise) == pytest.approx(np.full(7, 0.05), rel=0.05)
    assert np.abs(noise.mean(axis=0)).max() < 0.004
    steps = run.position / 1e-4
    assert np.abs(steps - np.round(steps)).max() < 1e-6
    assert np.abs(run.torque / 0.01 - np.round(run.torque / 0.01)).max() < 1e-6


def test_velocity_is_the_encoders_low_passed(exploration):
    run = play(iiwa(), exploration, velocity_bandwidth=50.0)
    gain = 1 - np.exp(-2 * np.pi * 50.0 * 1e-3)
    expected = np.zeros(7)
    for k in range(1, 2000):
        expected = expected + gain * ((run.position[k] - run.position[k - 1]) / 1e-3 - expected)
        assert run.velocity[k] == pytest.approx(expected, abs=1e-9)


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_drives_saturate_at_their_torque(sign):
    """Gravity pulls joint 4 down by 23 N m beside all that may be commanded, 176 N m."""
    pose = sign * np.array([0.0, 0.5, 0.0, -1.0, 0.0, 0.8, 0.0])
    still = np.full(7, 1e4)  # [kg m²], so that nothing moves far
    with MujocoRobot(robot="iiwa14", initial_position=pose, motor_inertia=still) as robot:
        gravity = RobotModel.load("iiwa14").gravity_torque(pose)[0, 3]
        robot.receive()
        command = ImpedanceCommand(
            position=pose, stiffness=np.zeros(7), damping=np.zeros(7), torque=np.zeros(7)
        )
        robot.send(command)
        limit = robot.spec.limits.torque
        for _ in range(150):  # the torque rate reaches the limit on the way
            robot.send(replace(command, torque=2 * sign * limit))
            assert not robot.receive().holding
            assert (np.abs(robot._data.qfrc_applied) <= limit + 1e-9).all()
        assert sign * gravity > 20.0
        assert robot._data.qfrc_applied[3] == pytest.approx(sign * limit[3])


def test_stiffness_beyond_the_step_is_refused_by_name():
    stiff = PreslidingHysteresis(joint=7, stiffness=(3e6,), width=(1e-4,))
    with pytest.raises(ConfigError, match=r"joint 7: a stiffness of 3e\+06 N m/rad.*period"):
        MujocoRobot(iiwa(stiff))
    bristles = {"law": "lugre", "sigma_0": 2e4, "tau_c": 2.0}
    with pytest.raises(ConfigError, match=r"joint 7: .*sigma_1 / 0.001 s\).* 5.02e\+06"):
        MujocoRobot(iiwa(PreslidingHysteresis(joint=7, sigma_1=5e3, **bristles)))
    with pytest.raises(ConfigError, match=r"joint 7: .*play \(drag / width\) are 2e\+06 N m/rad"):
        MujocoRobot(iiwa(Backlash(joint=7, gap=1e-3, drag=2.0, width=1e-6)))
    with pytest.raises(ConfigError, match="joint_coupling, joint 7: inertia = 2 kg m²"):
        MujocoRobot(iiwa(JointCoupling(joint=7, other=6, inertia=2.0)))
    soft_gear = (
        JointElasticity(joint=3, stiffness=500.0),
        PreslidingHysteresis(joint=3, stiffness=(400.0,), width=(1e-3,)),
    )
    with pytest.raises(ConfigError, match="joint 3: its stiffness of 400"):
        MujocoRobot(iiwa(*soft_gear))
    with MujocoRobot(robot="iiwa14") as robot:
        position = robot.receive().position
        with pytest.raises(JointLimitError, match="joint 7: stiffness"):
            robot.send(
                ImpedanceCommand(
                    position=position,
                    stiffness=[0.0] * 6 + [1e7],
                    damping=[0.0] * 7,
                    torque=[0] * 7,
                )
            )


def test_a_temperature_that_nobody_simulates_is_refused():
    warm = TemperatureDependentFriction(joint=2, per_kelvin=-0.1)
    with pytest.raises(ConfigError, match="joint 2: the simulated robot has no temperature"):
        MujocoRobot(iiwa(warm))


@pytest.mark.parametrize("inertia", [[1.0] * 6, [-1.0] * 7, [np.nan] * 7])
def test_motor_inertia_is_checked(inertia):
    with pytest.raises((ConfigError, ShapeError), match="motor_inertia"):
        MujocoRobot(robot="iiwa14", motor_inertia=inertia)


def test_an_arm_without_limits_of_velocity_is_refused_by_the_joint(tmp_path):
    path = tmp_path / "exported.urdf"
    text = RobotModel.load("iiwa14").description.text
    path.write_text(re.sub(r'velocity="[^"]*"', 'velocity="0"', text))
    with pytest.raises(
        ConfigError, match=r"joint 1 \(\w+\) has no limit of velocity.* in the URDF"
    ):
        MujocoRobot(robot=str(path))


def test_an_arm_without_limits_of_torque_is_named_and_not_run(tmp_path):
    path = tmp_path / "weak.urdf"
    text = RobotModel.load("iiwa14").description.text
    path.write_text(re.sub(r'effort="[^"]*"', 'effort="0"', text, count=1))
    assert RobotModel.load(path).notes == (
        "joint joint1 states no effort limit; without one, the arm cannot be planned or run",
    )
    with pytest.raises(ConfigError, match=r"joint 1 \(joint1\) has no limit of torque.* the URDF"):
        MujocoRobot(robot=str(path))


def test_an_arm_of_mjcf_without_limits_of_torque_follows(tmp_path):
    path = tmp_path / "unlimited.xml"
    path.write_text(
        """<mujoco><worldbody><body><joint name="shoulder" axis="0 1 0" range="-150 150"/>
        <geom type="capsule" fromto="0 0 0 0 0 0.4" size="0.05" mass="4"/>
        <body pos="0 0 0.4">
        <joint name="elbow" axis="0 1 0" range="-150 150" actuatorfrcrange="-40 40"/>
        <geom type="capsule" fromto="0 0 0 0 0 0.3" size="0.04" mass="2"/>
        </body></body></worldbody>
        <actuator><motor joint="shoulder"/></actuator></mujoco>"""
    )
    simulation = Simulation(str(path))
    assert np.isinf(simulation.model.limits.torque[0])
    turn = 0.02 * (1.0 - np.cos(2.0 * np.pi * np.arange(1000) / 1000))
    run = play(simulation, 0.5 + np.column_stack([turn, turn]))
    assert np.abs(run.position - run.target).max() < 1e-3
    torque = simulation.predict(run.true_motion)
    np.testing.assert_allclose(run.true_torque[10:], torque[10:], atol=0.5)


def test_a_simulation_that_diverges_says_so(exploration):
    with MujocoRobot(iiwa(), initial_position=exploration[0]) as robot:
        robot.receive()
        robot._data.qvel[3] = 1e12  # as of a torque that no step can follow
        with pytest.raises(BackendError, match="left the finite numbers"):
            robot.run(exploration[:50])
