from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import signal

from limo_driver.errors import ConfigError, ShapeError
from limo_driver.model import RobotModel
from limo_driver.physics import (
    CoulombFriction,
    JointElasticity,
    PreslidingHysteresis,
    Sensors,
    Simulation,
    StribeckFriction,
    TorqueGain,
    TorqueOffset,
    ViscousFriction,
)
from limo_driver.types import Motion

HYSTERETIC = Simulation(
    "iiwa14",
    effects=(
        CoulombFriction(joint=1, tau_c=2.2),
        ViscousFriction(joint=1, f_v=4.0),
        StribeckFriction(joint=2, tau_s=0.5, v_s=0.02),
        PreslidingHysteresis(joint=2, stiffness=(900.0, 120.0), width=(5e-4, 4e-3)),
        JointElasticity(joint=2, stiffness=1e4, cubic=1e-9),
        JointElasticity(joint=4, stiffness=8e3),
        TorqueOffset(joint=7, offset=0.1),
    ),
)


@pytest.fixture(scope="module")
def motion() -> Motion:
    t = np.arange(400) * 5e-3
    rate = np.arange(1, 8)
    q = 0.5 + 0.3 * np.sin(np.outer(t, rate))
    return Motion(t, q, 0.3 * rate * np.cos(np.outer(t, rate)), -(rate**2) * (q - 0.5))


def test_without_effects_it_is_the_rigid_body(motion: Motion):
    expected = RobotModel.load("iiwa14").inverse_dynamics(
        motion.position, motion.velocity, motion.acceleration
    )
    np.testing.assert_allclose(Simulation("iiwa14").predict(motion), expected)


def test_scanning_step_equals_predict(motion: Motion):
    state, scanned = HYSTERETIC.init(), []
    for t in range(len(motion)):
        torque, state = HYSTERETIC.step(state, motion.sample(t))
        scanned.append(torque)
    np.testing.assert_allclose(scanned, HYSTERETIC.predict(motion), rtol=0, atol=1e-10)


TOGETHER = (
    CoulombFriction(joint=3, tau_c=1.0),
    PreslidingHysteresis(joint=2, stiffness=(900.0, 120.0), width=(5e-4, 4e-3)),
    ViscousFriction(joint=3, f_v=2.0),
    PreslidingHysteresis(joint=5, law="dahl", sigma_0=2e3, tau_c=0.5),
    PreslidingHysteresis(joint=6, stiffness=(60.0,), width=(0.01,)),
    PreslidingHysteresis(joint=2, stiffness=(30.0, 20.0, 10.0), width=(0.01, 0.02, 0.03)),
)


def test_effects_that_are_evaluated_together_are_those_evaluated_alone(motion: Motion):
    rigid = Simulation("iiwa14").predict(motion)
    alone = [Simulation("iiwa14", (effect,)) for effect in TOGETHER]
    expected = rigid + sum(simulation.predict(motion) - rigid for simulation in alone)
    together = Simulation("iiwa14", TOGETHER)
    torque, memories = together.advance(together.init(), motion)
    np.testing.assert_allclose(torque, expected, rtol=0, atol=1e-10)
    for simulation, memory in zip(alone, memories, strict=True):
        _, (own,) = simulation.advance(simulation.init(), motion)
        np.testing.assert_allclose(memory, own, rtol=0, atol=1e-12)


def test_elastic_springs_in_a_row_wind_up_by_their_sum(motion: Motion):
    springs = (JointElasticity(joint=4, stiffness=800.0), JointElasticity(joint=4, stiffness=400.0))
    one = JointElasticity(joint=4, stiffness=1.0 / (1.0 / 800.0 + 1.0 / 400.0))
    np.testing.assert_allclose(
        Simulation("iiwa14", springs).predict(motion), Simulation("iiwa14", (one,)).predict(motion)
    )


def test_elasticity_moves_the_links_and_so_the_torque_of_other_joints(motion: Motion):
    elastic = Simulation("iiwa14", effects=(JointElasticity(joint=4, stiffness=5e2),))
    change = elastic.predict(motion) - Simulation("iiwa14").predict(motion)
    assert np.abs(change[:, 1]).max() > 1e-2


def swing(duration: float = 6.0) -> Motion:
    """Move all joints of an iiwa by sinusoids below 1 Hz, 200 samples a second."""
    t = np.arange(0, duration, 5e-3)
    w = 2 * np.pi * np.array([0.4, 0.5, 0.6, 0.7, 0.8, 0.55, 0.65])
    angle = np.outer(t, w)
    return Motion(
        t, 0.6 + 0.3 * np.sin(angle), 0.3 * w * np.cos(angle), -0.3 * w**2 * np.sin(angle)
    )


def test_where_the_future_is_known_elastic_joints_wind_with_velocity_and_acceleration():
    motion, k = swing(), 300.0
    elastic = Simulation("iiwa14", effects=(JointElasticity(joint=4, stiffness=k),))
    body = elastic.body
    load = body.inverse_dynamics(motion.position, motion.velocity, motion.acceleration)
    wound = np.zeros_like(load)
    wound[:, 3] = load[:, 3] / k
    rate = np.gradient(wound, motion.time, axis=0)
    links = motion.position - wound, motion.velocity - rate
    true = body.inverse_dynamics(
        *links, motion.acceleration - np.gradient(rate, motion.time, axis=0)
    )
    found = elastic.predict_stretches(motion, [slice(0, len(motion))], bandwidth=10.0)
    middle = slice(200, -200)
    quasi_static = np.abs(elastic.predict(motion) - true)[middle].max()
    assert quasi_static > 0.05  # it matters
    assert np.abs(found - true)[middle].max() < 0.02 * quasi_static


def test_a_link_that_swings_behind_its_drive_needs_the_torque_of_its_spring():
    """The arm turns about its vertical joint as its drive does, in jerks, behind a spring."""
    k, d, rate, pose = 900.0, 1.2, 500.0, np.array([0.0, 0.9, 0.0, -0.6, 0.0, 0.4, 0.0])
    body = RobotModel.load("iiwa14")
    inertia = float(body.inertia_of(pose[None], 0)[0, 0])
    t = np.arange(0.0, 6.0, 1.0 / rate)
    low_pass = signal.butter(4, 8.0, fs=rate, output="sos")
    turned = signal.sosfiltfilt(low_pass, np.clip(0.4 * (t - 0.5), 0.0, 0.6))
    speed = np.gradient(turned, t)
    _, followed, _ = signal.lsim(signal.lti([d, k], [inertia, d, k]), turned, t)
    spring = k * (turned - followed) + d * np.gradient(turned - followed, t)
    own, arm = (turned, speed, np.gradient(speed, t)), np.zeros((3, t.size, 7))
    arm[0], arm[:, :, 0] = pose, own
    drive = Motion(t, *arm)
    found, wound = (
        Simulation(
            "iiwa14", (JointElasticity(joint=1, stiffness=k, damping=damping),)
        ).predict_stretches(drive, [slice(0, t.size)], 10.0)[:, 0]
        for damping in (d, None)
    )
    size = np.sqrt(np.mean(spring**2))
    assert np.sqrt(np.mean((found - spring) ** 2)) < 0.02 * size
    assert np.sqrt(np.mean((wound - spring) ** 2)) > 0.5 * size


def test_two_gears_of_which_one_swings_are_one_that_does():
    soft = JointElasticity(joint=4, stiffness=400.0, damping=2.0)
    both = JointElasticity(joint=4, stiffness=1200.0).with_more(soft)
    assert both == JointElasticity(joint=4, stiffness=300.0, damping=1.5)


def test_without_elastic_joints_stretches_are_predictions_that_start_relaxed():
    motion, stretches = swing(), (slice(0, 500), slice(500, 1200))
    effects = tuple(e for e in HYSTERETIC.effects if not isinstance(e, JointElasticity))
    simulation = Simulation("iiwa14", effects=effects)
    expected = [simulation.predict(motion[rows]) for rows in stretches]
    np.testing.assert_array_equal(
        simulation.predict_stretches(motion, stretches, 10.0), np.concatenate(expected)
    )
    assert np.abs(simulation.predict(motion)[500:] - expected[1]).max() > 1e-3  # memory


def test_elastic_joints_wind_in_each_stretch_for_itself():
    motion, stretches = swing(), (slice(0, 500), slice(500, 1200))
    elastic = Simulation("iiwa14", effects=(JointElasticity(joint=2, stiffness=3e3),))
    both = elastic.predict_stretches(motion, stretches, 10.0)
    for rows in stretches:
        alone = elastic.predict_stretches(motion[rows], [slice(0, len(motion[rows]))], 10.0)
        np.testing.assert_allclose(both[rows], alone, atol=1e-9)


def test_sensors_feel_the_winding_of_elastic_joints_as_any_torque():
    motion, k = swing(), 300.0
    elastic = JointElasticity(joint=4, stiffness=k)
    plain, scaled = (
        Simulation("iiwa14", effects=effects).predict_stretches(motion, [slice(0, 1200)], 10.0)
        for effects in ((elastic,), (elastic, TorqueGain(joint=4, gain=0.5)))
    )
    np.testing.assert_allclose(scaled[:, 3], 1.5 * plain[:, 3], atol=1e-9)


def test_a_motion_of_another_robot_is_refused(motion: Motion):
    six = Motion(
        *(
            getattr(motion, name)[..., :6] if name != "time" else motion.time
            for name in ("time", "position", "velocity", "acceleration")
        )
    )
    with pytest.raises(ShapeError, match=r"expected \(T, 7\)"):
        HYSTERETIC.predict(six)


def test_a_joint_that_does_not_exist_is_refused():
    with pytest.raises(ConfigError, match="joint 8 does not exist; iiwa14 has joints 1 to 7"):
        Simulation("iiwa14", effects=(CoulombFriction(joint=8, tau_c=1.0),))


def test_the_sensor_quantises_and_its_noise_has_the_stated_size():
    sensors = Sensors(torque_noise=(0.05,), torque_resolution=(0.01,), encoder_resolution=(1e-3,))
    measured = sensors.measure_torque(np.zeros((20000, 2)), np.random.default_rng(1))
    np.testing.assert_allclose(measured / 0.01, np.round(measured / 0.01), atol=1e-9)
    assert measured.std() == pytest.approx(0.05, rel=0.03)
    np.testing.assert_allclose(
        sensors.measure_position(np.array([[0.0124, -0.0126]])), [[0.012, -0.013]]
    )


def test_a_file_reads_back_equal(tmp_path):
    path = tmp_path / "sim.yaml"
    HYSTERETIC.save(path)
    assert Simulation.load(path) == HYSTERETIC


@settings(max_examples=8, deadline=None)
@given(
    tau_c=st.floats(0, 1e3),
    v_eps=st.floats(1e-6, 1.0),
    noise=st.lists(st.floats(0, 1e3), min_size=7, max_size=7),
)
def test_every_number_survives_the_file(tmp_path_factory, tau_c, v_eps, noise):
    path = tmp_path_factory.mktemp("sim") / "sim.yaml"
    simulation = Simulation(
        "iiwa14",
        effects=(CoulombFriction(joint=3, tau_c=tau_c, v_eps=v_eps),),
        sensors=Sensors(torque_noise=tuple(noise)),
    )
    simulation.save(path)
    assert Simulation.load(path) == simulation


def test_what_is_made_of_a_simulation_does_not_read_its_robot_again_but_another_one(tmp_path):
    urdf = tmp_path / "arm.urdf"
    urdf.write_text(RobotModel.load("iiwa14").urdf.read_text())
    simulation = Simulation(str(urdf))
    urdf.unlink()
    heavier = replace(simulation.model.inertials["link7"], mass=2.0)
    other = replace(simulation, inertials={"link7": heavier})
    assert other.model.inertials["link7"].mass == 2.0
    assert simulation.model.inertials["link7"].mass != 2.0
    with pytest.raises(ConfigError, match="joint 8 does not exist"):
        replace(simulation, effects=(ViscousFriction(joint=8, f_v=4.0),))
    assert replace(simulation, robot="iiwa14").model.name == "iiwa14"
    with pytest.raises(ConfigError, match="is neither built in"):
        replace(simulation, robot=str(tmp_path / "none.urdf"))


def test_a_robot_file_is_referred_to_relative_to_the_simulation(tmp_path):
    urdf = tmp_path / "robots" / "arm.urdf"
    urdf.parent.mkdir()
    urdf.write_text(RobotModel.load("iiwa14").urdf.read_text())
    path = tmp_path / "sim.yaml"
    Simulation(str(urdf)).save(path)
    assert "robot: robots/arm.urdf" in path.read_text()
    assert Simulation.load(path).model.n == 7
