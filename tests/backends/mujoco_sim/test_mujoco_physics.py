"""The simulated arm does what the catalogue says: its torque is that of `Simulation.predict`."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from lanes import sampled
from simulated_runs import felt, iiwa, play, rms

from backends.mujoco_sim import MujocoRobot
from backends.mujoco_sim.realisation import friction_damping
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
    Payload,
    PositionDependentFriction,
    PreslidingHysteresis,
    QuadraticDrag,
    Sensors,
    SpringLoad,
    StribeckFriction,
    TemperatureDependentFriction,
    TimeDelay,
    TorqueCrosstalk,
    TorqueDrift,
    TorqueGain,
    TorqueOffset,
    TorqueRipple,
    ViscousFriction,
)
from limo_driver.physics.domain import Domain, JointMotion

FRICTIONS = (
    AsymmetricFriction(joint=1, tau_plus=1.5, tau_minus=0.5, v_eps=0.003),
    CoulombFriction(joint=1, tau_c=1.5, v_eps=0.002),
    QuadraticDrag(joint=1, coefficient=3.0),
    ViscousFriction(joint=1, f_v=4.0),
    ViscousFriction(joint=1, f_v_plus=4.0, f_v_minus=2.0),
    StribeckFriction(joint=1, tau_s=0.4, v_s=0.02, delta=1.5),
    CoulombFriction(joint=1, tau_c=1.5, v_eps=0.002, domain=Domain(speed=0.5)),
    CoulombFriction(joint=1, tau_c=1.5, v_eps=0.002, domain=Domain(speed=0.5, slope=2.0)),
    ViscousFriction(joint=1, f_v_plus=4.0, f_v_minus=2.0, domain=Domain(speed=0.5)),
)


@settings(deadline=None)  # the first call compiles
@given(v=st.floats(-2.0, 2.0))
@pytest.mark.parametrize("effect", FRICTIONS, ids=lambda e: e.name)
def test_a_friction_is_a_damping_that_dissipates(effect, v):
    damping = friction_damping(effect.friction_law, *effect.row, *effect.end, v)
    assert 0 <= damping < np.inf
    if abs(v) > 1e-8:
        still, moving = np.zeros(1), np.array([v])
        torque, _ = effect.evaluate(still, JointMotion(still, still, moving, still, still))
        assert damping * v == pytest.approx(torque[0], abs=1e-12)


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
ON_JOINT_4 = (  # first one of each way in which the simulator takes effects in
    CoulombFriction(joint=4, tau_c=1.7, v_eps=0.002),
    PositionDependentFriction(joint=4, positions=(-1.02, -0.98), excess=(0.4, 2.0)),
    PreslidingHysteresis(joint=4, **LAWS[0]),
    TorqueGain(joint=4, gain=0.05),
    JointCoupling(joint=4, other=3, f_v=3.0, tau_c=0.6, inertia=0.05, ratio=-1),
    Payload(mass=2.0, com=(0.0, 0.02, 0.1), inertia=(0.01, 0, 0, 0.01, 0, 0.005)),
    Armature(joint=4, inertia=1.0),
    AsymmetricFriction(joint=4, tau_plus=1.7, tau_minus=0.8),
    LoadDependentFriction(joint=4, coefficient=0.1),
    LoadDependentFriction(joint=4, coefficient=0.1, variant="positive"),
    LoadDependentFriction(joint=4, coefficient=0.1, variant="stribeck", v_s=0.05),
    *(PreslidingHysteresis(joint=4, **law) for law in LAWS[1:]),
    QuadraticDrag(joint=4, coefficient=60.0),
    SpringLoad(joint=4, stiffness=30.0, rest=-0.9, cubic=5.0),
    StribeckFriction(joint=4, tau_s=0.6, v_s=0.02),
    TemperatureDependentFriction(joint=4, excess=1.5, time_constant=3.0),
    TimeDelay(joint=4, delay=0.1, lag=0.2),
    TorqueCrosstalk(joint=4, source=2, gain=0.03),
    TorqueDrift(joint=4, times=(0.0, 3.0, 5.0), offset=(0.0, 1.0, -0.5)),
    TorqueOffset(joint=4, offset=0.7),
    TorqueRipple(joint=4, cycles_per_rev=(160.0, 320.0), amplitude=(0.5, 0.2), phase=(0.0, 1.0)),
    ViscousFriction(joint=4, f_v=5.0),
    ExternalContact(windows=((2.0, 3.0),), wrench=((0.0, 0.0, 10.0, 0.0, 0.0, 0.0),)),
    GravityDirection(gravity=(0.5, 0.3, -9.7)),
)


def of(effect):
    return "-".join(
        filter(None, (effect.name, *(getattr(effect, a, "") for a in ("law", "variant"))))
    )


@sampled("effect", ON_JOINT_4, "simulates six seconds each", first=4, ids=of)
def test_each_effect_is_felt_as_predicted(effect, exploration):
    error, missing = felt(iiwa(effect), exploration)
    assert error.max() < 0.01
    assert missing[3] > 0.1


def test_friction_is_sensed_at_the_time_of_its_sample(exploration):
    """That of half a step later is 0.013 N m off here, over steps of 4 ms."""
    still, worn = iiwa(), iiwa(ViscousFriction(joint=4, f_v=50.0))
    runs = [play(arm, exploration[::4], period=4e-3) for arm in (still, worn)]
    errors = [
        rms(run.true_torque - arm.predict(run.true_motion))[3]
        for run, arm in zip(runs, (still, worn), strict=True)
    ]
    assert errors[1] == pytest.approx(errors[0], abs=1e-5)


@sampled(
    "effect",
    [
        Backlash(joint=4, gap=2e-3),
        EncoderOffset(joint=4, offset=0.02),
        JointElasticity(joint=4, stiffness=8000.0, cubic=1e-7),
    ],
    "simulates six seconds each",
    ids=of,
)
def test_each_displacement_is_felt_as_predicted(effect, exploration):
    error, missing = felt(iiwa(effect), exploration)
    assert error.max() < 0.01
    assert missing.max() > 5 * error.max()


@sampled(
    "loose",
    [
        Backlash(joint=4, gap=0.01, drag=1.5, width=1.5e-4, v_eps=0.002),
        Backlash(joint=4, gap=0.01, drag=1.5),
    ],
    "simulates six seconds each",
    ids=["winding up", "at once"],
)
def test_a_drag_that_lets_go_is_felt_as_predicted(loose, exploration):
    error, missing = felt(
        iiwa(CoulombFriction(joint=4, tau_c=1.7, v_eps=0.002), loose), exploration
    )
    assert error.max() < 0.01
    assert missing[3] > 0.1


@sampled("ratio", [1, -1], "simulates six seconds each")
def test_both_joints_feel_the_shaft_that_they_turn(ratio, exploration):
    shaft = JointCoupling(joint=6, other=7, f_v=5.0, tau_c=1.0, inertia=0.15, ratio=ratio)
    element = PreslidingHysteresis(joint=1, stiffness=(300.0,), width=(0.004,))
    error, added = felt(iiwa(shaft, element, replace(shaft, joint=7, other=6)), exploration)
    assert error.max() < 0.01
    assert added[[5, 6]] == pytest.approx(added[5], rel=0.02)
    assert added[5] > 0.5


@pytest.mark.slow("simulates six seconds of two stiff arms")
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


def test_friction_before_a_gear_follows_the_motor_and_not_the_link():
    """Where friction of 2 N m turns, the gear winds up by a sixth of what its bristles bend."""
    gear = JointElasticity(joint=4, stiffness=6000.0)
    bristles = PreslidingHysteresis(joint=4, stiffness=(1000.0,), width=(2e-3,))
    s = np.linspace(0.0, 1.0, 1500)
    targets = np.tile([0.1, 0.5, -0.2, -1.0, 0.3, 0.8, 0.0], (s.size, 1))
    targets[:, 3] += 0.05 * np.sin(6 * np.pi * s) * (4 * s * (1 - s)) ** 3
    error, missing = felt(iiwa(gear, bristles), targets)
    assert error[3] < 0.02 * missing[3]


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
