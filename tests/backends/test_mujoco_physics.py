"""The simulated arm does what the catalogue says: its torque is that of `Simulation.predict`."""

from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from backends.mujoco_sim import MujocoRobot
from backends.mujoco_sim.friction_laws import friction_damping, friction_torque
from backends.mujoco_sim.realisation import draft_of
from limo_driver.errors import ConfigError, JointLimitError, ShapeError
from limo_driver.physics import (
    Armature,
    AsymmetricFriction,
    Backlash,
    CoulombFriction,
    EncoderOffset,
    ExternalContact,
    GravityDirection,
    JointCoupling,
    JointElasticity,
    LoadDependentFriction,
    MotionEffect,
    Payload,
    PositionDependentFriction,
    PreslidingHysteresis,
    QuadraticDrag,
    Sensors,
    Simulation,
    SpringLoad,
    StribeckFriction,
    TemperatureDependentFriction,
    TimeDelay,
    TorqueCrosstalk,
    TorqueDrift,
    TorqueEffect,
    TorqueGain,
    TorqueOffset,
    TorqueRipple,
    ViscousFriction,
)
from limo_driver.types import ImpedanceCommand, PositionCommand

FRICTIONS = (
    AsymmetricFriction(joint=1, tau_plus=1.5, tau_minus=0.5, v_eps=0.003),
    CoulombFriction(joint=1, tau_c=1.5, v_eps=0.002),
    QuadraticDrag(joint=1, coefficient=3.0),
    ViscousFriction(joint=1, f_v=4.0),
    ViscousFriction(joint=1, f_v_plus=4.0, f_v_minus=2.0),
    StribeckFriction(joint=1, tau_s=0.4, v_s=0.02, delta=1.5),
)


def rms(values):
    return np.sqrt(np.mean(np.square(values), axis=0))


def play(simulation, targets, **options):
    with MujocoRobot(simulation, initial_position=targets[0], **options) as robot:
        robot.receive()
        return robot.run(targets)


def iiwa(*effects, **options):
    return Simulation(robot="iiwa14", effects=effects, **options)


@settings(deadline=None)  # the first call compiles
@given(v=st.floats(-2.0, 2.0))
@pytest.mark.parametrize("effect", FRICTIONS, ids=lambda e: e.name)
def test_compiled_frictions_equal_the_catalogue(effect, v):
    (_, law, parameters), *_ = draft_of([effect], 7).frictions
    expected = effect.torque(np.array([v]))[0]
    assert friction_torque(law, *parameters, v) == pytest.approx(expected, abs=1e-12)
    damping = friction_damping(law, *parameters, v)
    assert damping >= 0
    if abs(v) > 1e-8:
        assert damping * v == pytest.approx(expected, abs=1e-12)


def test_measured_torque_is_the_predicted_one(hysteretic, exploration):
    run = play(replace(hysteretic, sensors=Sensors()), exploration)
    error = run.true_torque - hysteretic.predict(run.true_motion)
    assert rms(error).max() < 0.01
    assert np.array_equal(run.torque, run.true_torque)
    without = run.true_torque - hysteretic.without_effects().predict(run.true_motion)
    assert (rms(without) > 20 * rms(error)).all()  # the effects are really there


LAWS = (
    {"stiffness": (400.0, 60.0), "width": (0.002, 0.02)},
    {"law": "lugre", "sigma_0": 400.0, "sigma_1": 5.0, "tau_c": 1.0, "tau_s": 0.3, "v_s": 0.02},
    {"law": "dahl", "sigma_0": 400.0, "tau_c": 1.0, "exponent": 1.5},
    {"law": "bouc_wen", "sigma_0": 400.0, "tau_c": 1.0, "exponent": 1.3},
    {"law": "preisach", "up": (-1.0, -0.98), "down": (-1.01, -1.0), "weight": (0.4, 0.3)},
)
ON_JOINT_4 = (
    Armature(joint=4, inertia=1.0),
    AsymmetricFriction(joint=4, tau_plus=1.7, tau_minus=0.8),
    CoulombFriction(joint=4, tau_c=1.7, v_eps=0.002),
    LoadDependentFriction(joint=4, coefficient=0.1),
    LoadDependentFriction(joint=4, coefficient=0.1, variant="positive"),
    LoadDependentFriction(joint=4, coefficient=0.1, variant="stribeck", v_s=0.05),
    PositionDependentFriction(joint=4, positions=(-1.02, -0.98), excess=(0.4, 2.0)),
    *(PreslidingHysteresis(joint=4, **law) for law in LAWS),
    QuadraticDrag(joint=4, coefficient=60.0),
    SpringLoad(joint=4, stiffness=30.0, rest=-0.9, cubic=5.0),
    StribeckFriction(joint=4, tau_s=0.6, v_s=0.02),
    TemperatureDependentFriction(joint=4, excess=1.5, time_constant=3.0),
    TimeDelay(joint=4, delay=0.1, lag=0.2),
    TorqueCrosstalk(joint=4, source=2, gain=0.03),
    TorqueDrift(joint=4, times=(0.0, 3.0, 5.0), offset=(0.0, 1.0, -0.5)),
    TorqueGain(joint=4, gain=0.05),
    TorqueOffset(joint=4, offset=0.7),
    TorqueRipple(joint=4, cycles_per_rev=(160.0, 320.0), amplitude=(0.5, 0.2), phase=(0.0, 1.0)),
    ViscousFriction(joint=4, f_v=5.0),
    JointCoupling(joint=4, other=3, f_v=3.0, tau_c=0.6, inertia=0.05, ratio=-1),
    ExternalContact(windows=((2.0, 3.0),), wrench=((0.0, 0.0, 10.0, 0.0, 0.0, 0.0),)),
    Payload(mass=2.0, com=(0.0, 0.02, 0.1), inertia=(0.01, 0, 0, 0.01, 0, 0.005)),
    GravityDirection(gravity=(0.5, 0.3, -9.7)),
)


def of(effect):
    return "-".join(
        filter(None, (effect.name, *(getattr(effect, a, "") for a in ("law", "variant"))))
    )


@pytest.mark.parametrize("effect", ON_JOINT_4, ids=of)
def test_each_effect_is_felt_as_predicted(effect, exploration):
    simulation = iiwa(effect)
    run = play(simulation, exploration)
    error = rms(run.true_torque - simulation.predict(run.true_motion))
    missing = rms(run.true_torque - simulation.without_effects().predict(run.true_motion))
    assert error.max() < 0.01
    assert missing[3] > 0.1


@pytest.mark.parametrize(
    "effect",
    [
        Backlash(joint=4, gap=2e-3),
        EncoderOffset(joint=4, offset=0.02),
        JointElasticity(joint=4, stiffness=8000.0, cubic=1e-7),
    ],
    ids=of,
)
def test_each_displacement_is_felt_as_predicted(effect, exploration):
    simulation = iiwa(effect)
    run = play(simulation, exploration)
    error = rms(run.true_torque - simulation.predict(run.true_motion))
    missing = rms(run.true_torque - simulation.without_effects().predict(run.true_motion))
    assert error.max() < 0.01
    assert missing.max() > 5 * error.max()


@pytest.mark.parametrize("ratio", [1, -1])
def test_both_joints_feel_the_shaft_that_they_turn(ratio, exploration):
    shaft = JointCoupling(joint=6, other=7, f_v=5.0, tau_c=1.0, inertia=0.15, ratio=ratio)
    element = PreslidingHysteresis(joint=1, stiffness=(300.0,), width=(0.004,))
    simulation = iiwa(shaft, element, replace(shaft, joint=7, other=6))
    run = play(simulation, exploration)
    error = rms(run.true_torque - simulation.predict(run.true_motion))
    added = rms(run.true_torque - iiwa().predict(run.true_motion))
    assert error.max() < 0.01
    assert added[[5, 6]] == pytest.approx(added[5], rel=0.02)
    assert added[5] > 0.5


def test_a_stiff_shaft_does_not_excite_its_joints(exploration):
    shaft = JointCoupling(joint=6, other=7, f_v=50.0, tau_c=5.0, v_eps=1e-4)
    for effects in ((shaft,), (shaft, replace(shaft, joint=7, other=6))):
        run = play(iiwa(*effects), exploration)
        assert np.abs(run.position - exploration).max() < 5e-3


def test_friction_never_reverses_the_motion(exploration):
    effects = [CoulombFriction(joint=j + 1, tau_c=3.0, v_eps=1e-4) for j in range(7)]
    run = play(iiwa(*effects), exploration)
    moving = np.abs(run.true_motion.velocity) > 5e-3
    friction = run.true_torque - iiwa().predict(run.true_motion)
    assert (friction[moving] * np.sign(run.true_motion.velocity[moving]) > 0).mean() > 0.999
    assert rms(run.true_motion.position - exploration).max() < 5e-4


@pytest.mark.parametrize("frequency", [0.2, 2.0])
def test_hysteresis_loop_is_the_stop_operators(frequency):
    """Area of the settled loop against 4 k w (A - w), for element stiffness k and width w."""
    stiffness, width, amplitude = 300.0, 0.004, 0.03
    effect = PreslidingHysteresis(joint=6, stiffness=(stiffness,), width=(width,))
    cycles = round(3 / frequency / 1e-3)
    phase = 2 * np.pi * frequency * 1e-3 * np.arange(cycles)
    targets = np.zeros((cycles, 7))
    targets[:, 5] = amplitude * np.sin(phase) * np.minimum(phase / np.pi, 1) ** 3
    run = play(iiwa(effect), targets, motor_inertia=np.full(7, 1.0))
    torque = (run.true_torque - iiwa().predict(run.true_motion))[:, 5]
    last = slice(cycles - round(1 / frequency / 1e-3), cycles)
    q, tau = run.true_motion.position[last, 5], torque[last]
    area = 0.5 * abs(np.sum(q * np.roll(tau, -1) - np.roll(q, -1) * tau))
    reached = 0.5 * (q.max() - q.min())
    assert reached == pytest.approx(amplitude, rel=0.01)
    assert area == pytest.approx(4 * stiffness * width * (reached - width), rel=0.01)


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


def test_wind_up_under_gravity_is_what_the_stiffness_says():
    simulation = iiwa(JointElasticity(joint=2, stiffness=5000.0))
    pose = np.array([0.0, 1.0, 0, -0.5, 0, 0, 0])
    with MujocoRobot(simulation, initial_position=pose) as robot:
        state = robot.receive()
        link = robot._data.qpos.copy()
    load = simulation.model.gravity_torque(link)[0]
    assert abs(load[1]) > 20
    assert state.position - link == pytest.approx([0, load[1] / 5000.0, 0, 0, 0, 0, 0], abs=1e-9)
    assert state.torque == pytest.approx(load, abs=1e-6)


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


def test_drives_saturate_at_their_torque(exploration):
    with MujocoRobot(robot="iiwa14", initial_position=exploration[0]) as robot:
        robot.receive()
        command = ImpedanceCommand(
            position=exploration[0], stiffness=np.zeros(7), damping=np.zeros(7), torque=np.zeros(7)
        )
        robot.send(command)
        limit = robot.spec.limits.torque
        for _ in range(150):  # the torque rate reaches the limit on the way
            robot.send(replace(command, torque=2 * limit))
            state = robot.receive()
            if state.holding:
                break
            assert (np.abs(robot._data.qfrc_applied) <= limit + 1e-9).all()


def test_stiffness_beyond_the_step_is_refused_by_name():
    stiff = PreslidingHysteresis(joint=7, stiffness=(3e6,), width=(1e-4,))
    with pytest.raises(ConfigError, match=r"joint 7: a stiffness of 3e\+06 N m/rad.*period"):
        MujocoRobot(iiwa(stiff))
    bristles = {"law": "lugre", "sigma_0": 2e4, "tau_c": 2.0}
    with pytest.raises(ConfigError, match=r"joint 7: sigma_0 \+ sigma_1 / 0.001 s is 5.02e\+06"):
        MujocoRobot(iiwa(PreslidingHysteresis(joint=7, sigma_1=5e3, **bristles)))
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
    PreslidingHysteresis(joint=3, **LAWS[1]),
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
