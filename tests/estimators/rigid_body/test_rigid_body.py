"""Rigid-body identification: regressor, base parameters, consistent bodies, the estimator."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest
from lanes import sampled

from estimators.rigid_body import JointTerms, RigidBodyModel, Rows, identify
from estimators.rigid_body.base_parameters import find_base_parameters
from estimators.rigid_body.fitting.consistent import inertial_of, pseudo_inertia, thickened
from estimators.rigid_body.fitting.normal_equations import accumulate
from estimators.rigid_body.regressor import (
    RegressorChain,
    inverse_dynamics,
    link_parameters,
    parameters_of,
)
from limo_driver.errors import ConfigError, NotFittedError, RecordingError, ShapeError
from limo_driver.model import RobotModel
from limo_driver.model.descriptions.geometry import Inertial
from limo_driver.physics import (
    Armature,
    CoulombFriction,
    Payload,
    PreslidingHysteresis,
    Simulation,
    TorqueOffset,
    ViscousFriction,
)
from limo_driver.recordings.recording import Recording
from limo_driver.types import Motion

RATE = 100.0
NOISE = 0.02  # [N m]
PAPER = JointTerms((0.01,), offset=False, armature=False)


@pytest.fixture(scope="module")
def iiwa():
    return RobotModel.load("iiwa14")


@pytest.fixture(scope="module")
def planar(two_links_urdf):
    return RobotModel.load(two_links_urdf)


@pytest.fixture(scope="module")
def rail(tmp_path_factory):
    """An arm whose first and third of five joints slide, along skew axes."""
    slide = '<limit lower="-3" upper="3" effort="300" velocity="1"/>'
    links = "".join(
        f'<link name="l{k}"><inertial><origin xyz="0.1 {0.1 * k} 0.2"/><mass value="{1 + k}"/>'
        '<inertia ixx="0.1" ixy="0.02" ixz="0" iyy="0.2" iyz="0.01" izz="0.15"/></inertial></link>'
        for k in range(6)
    )
    joints = "".join(
        f'<joint name="j{k}" type="{"revolute" if k % 2 or k > 2 else "prismatic"}">'
        f'<origin xyz="0.2 0.1 0.3" rpy="0.{k} 0.3 0.5"/><parent link="l{k}"/>'
        f'<child link="l{k + 1}"/><axis xyz="{k} 1 {2 - k}"/>{slide}</joint>'
        for k in range(5)
    )
    path = tmp_path_factory.mktemp("rail") / "rail.urdf"
    path.write_text(f'<robot name="rail">{links}{joints}</robot>')
    return RobotModel.load(path)


def sinusoids(n, T, seed, largest=0.5):
    random = np.random.default_rng(seed)
    t = np.arange(T) / RATE
    position, velocity, acceleration = (np.zeros((T, n)) for _ in range(3))
    for _ in range(4):
        w = 2 * np.pi * random.uniform(0.05, largest, n)
        angle = w * t[:, None] + random.uniform(0, 6.28, n)
        position += 0.4 * np.sin(angle)
        velocity += 0.4 * w * np.cos(angle)
        acceleration -= 0.4 * w**2 * np.sin(angle)
    return Motion(t, position, velocity, acceleration)


def explore(poses, seed):
    """Move like a locally isotropic plan: small sinusoids about poses, and reaches between."""
    random = np.random.default_rng(seed)
    at = random.uniform(-1.2, 1.2, (poses, 7))
    s = 0.5 - 0.5 * np.cos(np.linspace(0, np.pi, 250))[:, None]
    t = np.arange(1500)[:, None] / RATE
    fade = np.minimum(1.0, np.minimum(t, t[::-1]))
    parts = []
    for here, there in zip(at, np.roll(at, -1, axis=0), strict=True):
        sway = sum(
            random.uniform(0.01, 0.05, 7)
            * np.sin(2 * np.pi * random.uniform(0.1, 0.6, 7) * t + random.uniform(0, 6.28, 7))
            for _ in range(3)
        )
        parts += [here + fade**2 * (3 - 2 * fade) * sway, here + s * (there - here)]
    position = np.concatenate(parts)
    time = np.arange(len(position)) / RATE
    return Recording(time, position, np.zeros_like(position)).motion(10.0)


def record(simulation, T=6000, seed=0, noise=NOISE, motion=None):
    motion = sinusoids(simulation.model.n, T, seed) if motion is None else motion
    torque = simulation.predict(motion)
    torque = torque + noise * np.random.default_rng(seed + 100).standard_normal(torque.shape)
    return Recording.from_arrays(motion.time, motion.position, torque)


FRICTION = tuple(
    effect
    for j in range(1, 8)
    for effect in (
        CoulombFriction(joint=j, tau_c=0.5 + 0.2 * j, v_eps=0.01),
        ViscousFriction(joint=j, f_v=4.0 - 0.4 * j),
    )
)


@pytest.mark.parametrize("robot", ["iiwa", "planar", "rail"])
def test_regressor_agrees_with_pinocchio(robot, request):
    model = request.getfixturevalue(robot)
    random = np.random.default_rng(0)
    q, dq, ddq = random.uniform(-3, 3, (3, 50, model.n))
    Y = RegressorChain.of(model).regressor(Motion(np.arange(50.0), q, dq, ddq))
    data = model.pin_model.createData()
    for t in range(50):
        expected = pin.computeJointTorqueRegressor(model.pin_model, data, q[t], dq[t], ddq[t])
        np.testing.assert_allclose(Y[:, t], expected, atol=1e-10)


def test_regressor_times_parameters_is_the_torque(iiwa):
    motion = sinusoids(7, 40, 1)
    pi = np.concatenate([parameters_of(iiwa.inertials[link]) for link in iiwa.link_names])
    torque = (RegressorChain.of(iiwa).regressor(motion) @ pi).T
    expected = iiwa.inverse_dynamics(motion.position, motion.velocity, motion.acceleration)
    np.testing.assert_allclose(torque, expected, atol=1e-10)


def test_iiwa_has_57_base_parameters_with_friction(iiwa):
    assert find_base_parameters(iiwa, PAPER).rank == 57
    assert find_base_parameters(iiwa, JointTerms(armature=False)).rank == 57 + 7
    # joint 1's and 2's drives turn about axes on which a link's inertia does the same
    assert find_base_parameters(iiwa, JointTerms()).rank == 57 + 7 + 5


def test_base_parameters_predict_what_full_parameters_do(iiwa):
    base = find_base_parameters(iiwa, PAPER)
    random = np.random.default_rng(4)
    full = random.standard_normal(70 + 14)
    difference = full - base.expand(base.reduce(full))
    Y = RegressorChain.of(iiwa).regressor(sinusoids(7, 30, 2))
    assert np.abs(Y @ difference[:70]).max() < 1e-9 * np.abs(Y).max()
    np.testing.assert_allclose(difference[70:], 0, atol=1e-9)


@pytest.mark.slow("identifies a recording")
def test_a_rail_is_identified_in_newtons(rail):
    friction = (CoulombFriction(joint=1, tau_c=3.0, v_eps=0.01), ViscousFriction(joint=3, f_v=20.0))
    found = identify(rail, [record(Simulation(str(rail.urdf), friction))]).simulation
    by_place = {effect.place: effect for effect in found.effects}
    assert by_place["coulomb_friction, joint 1"].tau_c == pytest.approx(3.0, abs=0.1)
    assert by_place["viscous_friction, joint 3"].f_v == pytest.approx(20.0, abs=0.5)


@pytest.mark.slow("identifies a recording of an arm of seven joints")
def test_estimator_reaches_the_noise_on_other_motion():
    simulation = Simulation("iiwa14", FRICTION)
    model = RigidBodyModel("iiwa14", PAPER).fit([record(simulation)])
    held_out = record(simulation, T=2000, seed=5)
    error = model.predict(held_out) - simulation.predict(held_out.motion(10.0))
    inside = ~held_out.edges(10.0)
    assert np.sqrt(np.mean(error[inside] ** 2, axis=0)).max() < 0.5 * NOISE


def test_estimator_says_what_is_missing():
    model = RigidBodyModel("iiwa14")
    with pytest.raises(NotFittedError, match="RigidBodyModel is not fitted"):
        model.torque(sinusoids(7, 5, 0))
    simulation = Simulation("iiwa14", FRICTION)
    model.fit([record(simulation, T=1000)])
    with pytest.raises(ShapeError):
        model.torque(sinusoids(6, 5, 0))


@pytest.mark.slow("identifies a recording of an arm of seven joints")
def test_friction_offset_and_sign_width_are_found():
    offsets = tuple(TorqueOffset(joint=j, offset=0.1 * j - 0.4) for j in range(1, 8))
    found = identify(
        RobotModel.load("iiwa14"), [record(Simulation("iiwa14", (*FRICTION, *offsets)))]
    )
    assert found.terms.chosen == (0.01,) * 7
    true = {(e.name, e.joint): e for e in (*FRICTION, *offsets)}
    for item in found.estimates:
        if item.effect == "armature":
            continue
        expected = getattr(true[item.effect, item.joint], item.parameter)
        assert abs(item.value - expected) < 5 * item.deviation + 0.02, item
    assert not [item for item in found.estimates if item.effect == "armature"]
    np.testing.assert_allclose(found.rmse_consistent, found.fit.rmse, rtol=0.05)


def test_moved_masses_are_found_as_bodies_that_exist(iiwa):
    true = {
        link: Inertial(1.15 * body.mass, tuple(0.9 * np.array(body.com)), body.inertia)
        for link, body in iiwa.inertials.items()
    }
    simulation = Simulation("iiwa14", FRICTION, inertials=true)
    found = identify(iiwa, [record(simulation)], PAPER)
    held_out = sinusoids(7, 1000, 8)
    error = found.simulation.predict(held_out) - simulation.predict(held_out)
    nominal = Simulation("iiwa14", FRICTION).predict(held_out) - simulation.predict(held_out)
    assert np.sqrt(np.mean(error**2)) < 0.02 * np.sqrt(np.mean(nominal**2))
    assert all(body.is_consistent() for body in found.simulation.inertials.values())
    assert found.tolerance >= 0.1


def test_simulation_says_how_well_it_is_known(iiwa):
    heavier = {
        link: Inertial(1.5 * body.mass, body.com, body.inertia)
        for link, body in iiwa.inertials.items()
    }
    quiet, loud = (
        identify(iiwa, [record(Simulation("iiwa14", FRICTION, heavier), T, noise=noise)], PAPER)
        for T, noise in ((3000, NOISE), (1000, 20.0))
    )
    known = quiet.simulation.tolerances
    assert quiet.tolerance >= 0.2
    assert known.inertia == 0.02  # what the torque depends on is known better; this is the floor
    assert known.friction == 0.15  # the same
    assert 0.02 < loud.simulation.tolerances.inertia < 0.2
    assert loud.simulation.tolerances.friction > 0.15
    blind = identify(iiwa, [record(Simulation("iiwa14"), 1000, noise=200.0)], PAPER, tolerance=0.3)
    assert 0.2 < blind.simulation.tolerances.inertia <= 0.3  # hardly better than the description


@pytest.fixture(scope="module")
def hysteretic():
    stiffness = (300.0, 330.0, 220.0, 230.0, 120.0, 60.0, 50.0)
    memory = (
        PreslidingHysteresis(joint=j, stiffness=(s, s / 4), width=(0.002, 0.02))
        for j, s in enumerate(stiffness, 1)
    )
    return (*FRICTION, *memory)


@sampled("seed", [None, 3, 5], "identifies a recording each")
def test_hysteresis_does_not_pull_masses(iiwa, hysteretic, seed):
    motion = None if seed is None else explore(8, seed)
    found = identify(iiwa, [record(Simulation("iiwa14", hysteretic), motion=motion)])
    assert found.fit.rmse.max() > 10 * NOISE  # what is not explained is not the noise
    assert found.tolerance <= 0.05
    for link in found.links:
        assert link.mass == pytest.approx(link.mass_nominal, rel=0.05)


@sampled("seed", [3, 6], "identifies a recording each")
def test_the_tolerance_holds_what_a_wrong_model_does_to_the_torque(iiwa, hysteretic, seed):
    heavy = {
        link: Inertial(1.2 * body.mass, body.com, body.inertia)
        for link, body in iiwa.inertials.items()
    }
    arm = Simulation("iiwa14", hysteretic, heavy)
    found = identify(iiwa, [record(arm, motion=explore(8, seed))]).simulation
    other = explore(4, seed + 10)
    state = other.position, other.velocity, other.acceleration
    right, written = (each.model.inverse_dynamics(*state) for each in (arm, found))
    off = np.sqrt(np.mean((written - right) ** 2, axis=0) / np.mean(right**2, axis=0))
    assert off[[1, 3]].max() < found.tolerances.inertia  # they carry the arm


@sampled(
    ("mass", "tolerance"), [(5.0, None), (30.0, None), (30.0, 0.1)], "identifies a recording each"
)
def test_bodies_far_from_the_description_are_found(iiwa, mass, tolerance):
    tool = Payload(mass=mass, com=(0.0, 0.1, 0.2), inertia=(0.05, 0, 0, 0.05, 0, 0.05))
    recording = record(Simulation("iiwa14", (*FRICTION, tool)), T=2000)
    found = identify(iiwa, [recording], PAPER, tolerance=tolerance)
    assert found.links[-1].mass > mass
    assert found.rmse_consistent.max() < NOISE


@pytest.mark.slow("identifies a recording")
def test_a_changed_mass_is_found_beside_hysteresis(iiwa, hysteretic):
    body = iiwa.inertials["link4"]
    heavier = {"link4": Inertial(1.5 * body.mass, body.com, body.inertia)}
    arm = Simulation("iiwa14", hysteretic, inertials=heavier)
    found = {
        link.link: link.mass / link.mass_nominal
        for link in identify(iiwa, [record(arm, motion=explore(16, seed=5))]).links
    }
    assert found.pop("link4") == pytest.approx(1.5, abs=0.25)
    assert found == pytest.approx(dict.fromkeys(found, 1.0), abs=0.15)


def test_white_noise_leaves_as_many_rows_as_the_bandwidth_does(iiwa):
    recording = record(Simulation("iiwa14", FRICTION), noise=0.5)
    effective = identify(iiwa, [recording], PAPER, Rows(10.0)).fit.effective
    assert effective == pytest.approx(np.full(7, 2 * 10.0 * recording.duration), rel=0.25)


def test_deviations_hold_when_errors_last(iiwa):
    T, memory = 12000, 0.5 * RATE  # samples
    random = np.random.default_rng(7)
    shocks = random.standard_normal((T, 7))
    lasting = np.zeros((T, 7))
    for t in range(1, T):
        lasting[t] = lasting[t - 1] * (1 - 1 / memory) + shocks[t]
    simulation = Simulation("iiwa14", FRICTION)
    clean = record(simulation, T, noise=0.0)
    torque = clean.torque + 0.5 * lasting / lasting.std()
    recording = Recording.from_arrays(clean.time, clean.position, torque)
    found = identify(iiwa, [recording], JointTerms((0.01,), armature=False), tolerance=0.02)
    true = {(e.name, e.joint): e for e in FRICTION}
    off = [
        (item.value - getattr(true[item.effect, item.joint], item.parameter)) / item.deviation
        for item in found.estimates
        if item.effect != "torque_offset"
    ]
    assert 0.5 < np.sqrt(np.mean(np.square(off))) < 1.6
    assert np.all(found.fit.effective < 2 * 10.0 * recording.duration / 3)


@pytest.mark.slow("identifies recordings")
def test_base_parameters_are_less_sure_where_the_model_is_wrong(iiwa):
    """Other recordings of an arm with hysteresis give other values: by as much as is said."""
    slip = [PreslidingHysteresis(joint=j, stiffness=(40.0,), width=(0.05,)) for j in range(1, 8)]
    simulation = Simulation("iiwa14", tuple(slip))
    fits = [identify(iiwa, [record(simulation, 3000, seed)], PAPER).fit for seed in range(4)]
    deviation = np.sqrt(np.mean([np.diag(fit.covariance) for fit in fits], axis=0))
    values = np.array([fit.parameters for fit in fits])
    scatter = values.std(axis=0, ddof=1) / deviation
    assert 0.2 < np.sqrt(np.mean(scatter**2)) < 1.6


def test_what_the_motion_does_not_reveal_stays_at_the_description(iiwa):
    found = identify(iiwa, [record(Simulation("iiwa14", FRICTION))], PAPER)
    first = found.links[0]  # of link 1 only the inertia about the joint shows in torque
    assert first.mass == pytest.approx(first.mass_nominal, rel=0.01)
    assert first.com_shift < 2e-3


def test_drives_are_told_from_links_by_the_description(iiwa):
    drives = (Armature(joint=1, inertia=3.0), Armature(joint=3, inertia=1.0))
    found = identify(iiwa, [record(Simulation("iiwa14", (*FRICTION, *drives)))])
    values = {item.joint: item.value for item in found.estimates if item.effect == "armature"}
    assert values == pytest.approx({1: 3.0, 3: 1.0}, rel=0.05)


def test_a_still_joint_keeps_its_inertia_and_is_told(iiwa):
    simulation = Simulation("iiwa14", FRICTION)
    motion = sinusoids(7, 3000, 0)
    position = motion.position.copy()
    position[:, 6] = 0.3
    still = Recording.from_arrays(motion.time, position, np.zeros_like(position)).motion(10.0)
    torque = simulation.predict(still)
    found = identify(iiwa, [Recording.from_arrays(motion.time, position, torque)], PAPER)
    assert found.fit.excited < 57
    assert any("of 57 base parameters" in text for text in found.warnings)
    assert found.links[6].mass == pytest.approx(1.2, rel=0.2)


TOOL = Payload(mass=0.8, com=(0.0, 0.02, 0.1), inertia=(0.002, 0, 0, 0.002, 0, 0.001))


@pytest.mark.parametrize("tools", [(), (TOOL,)], ids=["none", "tool"])
def test_a_tool_that_the_last_link_takes_up_is_asked_about(iiwa, tools):
    found = identify(iiwa, [record(Simulation("iiwa14", (*FRICTION, *tools)))], PAPER)
    asked = [text for text in found.warnings if "is there a tool?" in text]
    assert len(asked) == len(tools)
    gained = f"link7 gained {found.links[6].mass - 1.2:.2f} kg"
    assert all(text.startswith(gained) for text in asked)


def test_a_torque_that_reads_zero_throughout_is_no_exact_measurement(iiwa):
    """As a drive whose torque is below what it can tell; the others are known as well as before."""
    measured = record(Simulation("iiwa14", FRICTION), T=3000)
    torque = measured.torque.copy()
    torque[:, 6] = 0.0
    found = identify(iiwa, [Recording(measured.time, measured.position, torque)])
    other = record(Simulation("iiwa14", FRICTION), T=3000, seed=5)
    assert (found.simulation.score(other).rmse[:6] < 2 * NOISE).all()


def test_friction_never_drives_the_joint(iiwa):
    simulation = Simulation("iiwa14", FRICTION[2:])  # joint 1 has none
    found = identify(iiwa, [record(simulation, T=2000)], PAPER)
    assert min(item.value for item in found.estimates) >= 0
    assert found.simulation.without_effects().effects == ()


def test_rows_at_rest_can_be_left_out():
    simulation = Simulation("iiwa14", FRICTION)
    moving = record(simulation, T=3000)
    held = np.repeat(moving.position[-1:], 1500, axis=0)
    position = np.concatenate([moving.position, held])
    stuck = np.full((1500, 7), 30.0)  # anything the motors please
    torque = np.concatenate([moving.torque, stuck])
    time = np.arange(4500) / RATE
    time[3000:] += 1.0  # a gap, so that nothing passes from one to the other
    recording = Recording.from_arrays(time, position, torque)
    model = RobotModel.load("iiwa14")
    misled = accumulate(model, PAPER, [recording], Rows())
    right = accumulate(model, PAPER, [recording], Rows(moving_only=True))
    assert misled.count.min() > 4300
    assert right.count.max() < 3000
    fitted = identify(model, [recording], PAPER, Rows(moving_only=True))
    assert fitted.fit.rmse.max() < NOISE


def test_normal_equations_do_not_depend_on_the_blocks(iiwa, monkeypatch):
    recording = record(Simulation("iiwa14", FRICTION), T=3000)
    whole = accumulate(iiwa, PAPER, [recording], Rows())
    monkeypatch.setattr("estimators.rigid_body.fitting.normal_equations.BLOCK", 700)
    pieces = accumulate(iiwa, PAPER, [recording], Rows())
    np.testing.assert_allclose(pieces.gram, whole.gram, rtol=1e-4, atol=1e-4 * whole.gram.max())
    np.testing.assert_array_equal(pieces.count, whole.count)


def test_rows_between_those_summed_say_nothing_new(iiwa, monkeypatch):
    recording = record(Simulation("iiwa14", FRICTION), T=6000, noise=0.2)
    few = identify(iiwa, [recording], PAPER, Rows(bandwidth=3.0)).fit
    monkeypatch.setattr("estimators.rigid_body.fitting.normal_equations._DENSE", 1000)
    every = identify(iiwa, [recording], PAPER, Rows(bandwidth=3.0)).fit
    off = (few.parameters - every.parameters) / np.sqrt(np.diag(every.covariance))
    assert np.abs(off).max() < 0.1


def test_thickened_points_and_rods_exist():
    for mass, inertia in ((0.0, (0,) * 6), (1.0, (0,) * 6), (2.0, (0, 0, 0, 0.1, 0, 0.1))):
        body = inertial_of(thickened(parameters_of(Inertial(mass, (0.1, 0, 0.2), inertia))))
        assert body.is_consistent()
    good = parameters_of(Inertial(2.0, (0.1, 0, 0.2), (0.02, 0, 0, 0.03, 0, 0.025)))
    np.testing.assert_allclose(thickened(good), good, rtol=1e-9)
    assert np.linalg.eigvalsh(pseudo_inertia(good))[0] > 0


def test_bad_requests_are_refused(iiwa):
    with pytest.raises(ConfigError, match="weighting is 'speed', expected one of error, torque"):
        Rows(weighting="speed")
    with pytest.raises(ConfigError, match="sign width 0 rad"):
        JointTerms((0.0,))
    six = Recording(np.arange(100) / RATE, np.zeros((100, 6)), np.zeros((100, 6)))
    with pytest.raises(RecordingError, match="has 6 joints"):
        identify(iiwa, [six])
    t = np.arange(100) / RATE
    rest = Recording(t, np.tile(0.01 * t[:, None], 7), np.tile(t[:, None], 7))
    with pytest.raises(RecordingError, match="no row is left"):
        identify(iiwa, [rest], PAPER, Rows(moving_only=True))


@pytest.mark.parametrize("robot", ["iiwa", "rail"])
def test_newton_and_euler_agree_with_pinocchio(robot, request):
    model = request.getfixturevalue(robot)
    random, chain = np.random.default_rng(5), RegressorChain.of(model)
    parameters, torque = link_parameters(model), np.empty(model.n)
    arm = (chain.rotation, chain.translation, chain.axis, chain.gravity, parameters)
    for _ in range(20):
        q, v, a = random.uniform(-2.5, 2.5, (3, model.n))
        inverse_dynamics(*arm, q, v, a, torque)
        expected = model.inverse_dynamics(q[None], v[None], a[None])[0]
        np.testing.assert_allclose(torque, expected, rtol=0, atol=1e-11)


@pytest.mark.parametrize("torque", [0.0, 0.02], ids=["none", "next to nothing"])
def test_a_joint_without_torque_says_nothing_of_bodies_and_gets_no_friction(iiwa, torque):
    """A drive that tells nothing, or amperes, carries as much as any."""
    given = Simulation("iiwa14", FRICTION)
    whole = record(given)
    measured = np.array(whole.torque)
    measured[:, 3] *= torque
    silent = Recording.from_arrays(whole.time, whole.position, measured)
    found, beside = identify(iiwa, [silent]), identify(iiwa, [whole])
    assert {j for effect in found.simulation.effects for j in effect.joints} == {1, 2, 3, 5, 6, 7}
    assert "no row is used for joint 4" in found.warnings
    for name, stated in iiwa.inertials.items():
        assert found.simulation.model.inertials[name].mass == pytest.approx(stated.mass, rel=0.3)
    others = [0, 1, 2, 4, 5, 6]
    np.testing.assert_allclose(
        found.rmse_consistent[others], beside.rmse_consistent[others], rtol=0.1
    )


def test_where_one_recording_of_two_lacks_a_torque_the_other_tells_it(iiwa):
    given = Simulation("iiwa14", FRICTION)
    whole, other = record(given), record(given, seed=1)
    torque = np.array(other.torque)
    torque[:, 3] = 0.0
    part = Recording.from_arrays(other.time, other.position, torque)
    both, alone = identify(iiwa, [whole, part]), identify(iiwa, [whole])
    assert both.rmse_consistent[3] == pytest.approx(alone.rmse_consistent[3], rel=0.1)
    (dry,) = [
        effect.tau_c
        for effect in both.simulation.effects
        if isinstance(effect, CoulombFriction) and effect.joint == 4
    ]
    assert dry == pytest.approx(1.3, rel=0.05)
