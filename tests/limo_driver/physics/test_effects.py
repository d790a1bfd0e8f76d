"""What single effects are held to beside the contract: limits and laws known from physics."""

from dataclasses import replace

import numpy as np
import pytest
from scipy import integrate, signal

from limo_driver.errors import ConfigError
from limo_driver.model import RobotModel
from limo_driver.physics import (
    Backlash,
    CoulombFriction,
    ExternalContact,
    JointCoupling,
    JointElasticity,
    LoadDependentFriction,
    Payload,
    Simulation,
    TemperatureDependentFriction,
    TimeDelay,
    TorqueCrosstalk,
    TorqueGain,
    TorqueOffset,
)
from limo_driver.physics.effect import STATELESS, JointMotion, SensedTorque
from limo_driver.recordings.recording import Recording
from limo_driver.types import Motion

T = np.linspace(0, 4, 801)


@pytest.fixture(scope="module")
def motion() -> Motion:
    phase = np.outer(T, np.arange(1.0, 8.0))
    rate = np.arange(1.0, 8.0)
    return Motion(
        T, 0.5 + 0.3 * np.sin(phase), 0.3 * rate * np.cos(phase), -0.3 * rate**2 * np.sin(phase)
    )


def iiwa(*effects) -> Simulation:
    return Simulation("iiwa14", effects=effects)


def sliding(load, velocity) -> JointMotion:
    load, velocity = np.asarray(load, float), np.asarray(velocity, float)
    zero = np.zeros_like(load)
    return JointMotion(zero, zero, velocity, zero, load)


def test_friction_of_resisting_and_of_driving_loads_make_up_that_of_all(motion):
    one = [
        LoadDependentFriction(joint=2, coefficient=0.1, variant=v) for v in ("positive", "negative")
    ]
    both = LoadDependentFriction(joint=2, coefficient=0.1)
    np.testing.assert_allclose(iiwa(*one).predict(motion), iiwa(both).predict(motion), atol=1e-12)
    assert one[0].advance(one[0].initial_state(), sliding([10, 10], [1, -1]))[0] == pytest.approx(
        [1, 0]
    )


def test_a_payload_is_felt_as_its_weight_at_the_flange(motion):
    """Virtual work: a point mass at the flange asks for -Jᵀ(m g) of the joints that hold it."""
    model = RobotModel.load("iiwa14")
    pose, last = model.flange_pose(np.zeros(7)), model.joint_poses(np.zeros(7))[-1]
    com = (np.linalg.inv(last) @ pose)[:3, 3]
    carried = iiwa(Payload(mass=2.0, com=tuple(com))).body.gravity_torque(motion.position)
    weight = np.array([0, 0, -2.0 * 9.81, 0, 0, 0])
    expected = [-model.flange_jacobian(q).T @ weight for q in motion.position]
    np.testing.assert_allclose(carried - model.gravity_torque(motion.position), expected, atol=1e-9)


def test_a_contact_is_felt_in_its_window_as_virtual_work_says(motion):
    contact = ExternalContact(windows=((1.0, 2.0),), wrench=((0, 0, -19.62, 0, 0, 0),))
    added = iiwa(contact).predict(motion) - iiwa().predict(motion)
    inside = (T >= 1.0) & (T < 2.0)
    assert not added[~inside].any()
    model = RobotModel.load("iiwa14")
    row = int(np.flatnonzero(inside)[0])
    step = 1e-6 * np.eye(7)
    height = [model.flange_position(motion.position[row] + s)[0, 2] for s in (*step, *-step)]
    slope = (np.array(height[:7]) - height[7:]) / 2e-6
    np.testing.assert_allclose(added[row], 19.62 * slope, atol=1e-5)


def test_both_entries_of_a_coupling_dissipate_what_the_shaft_does(motion):
    a = JointCoupling(joint=5, other=6, f_v=2.0, tau_c=0.3, ratio=-1)
    b = JointCoupling(joint=6, other=5, f_v=2.0, tau_c=0.3, ratio=-1)
    added = iiwa(a, b).predict(motion) - iiwa().predict(motion)
    w = motion.velocity[:, 4] - motion.velocity[:, 5]
    power = np.sum(added * motion.velocity, axis=1)
    np.testing.assert_allclose(power, 2.0 * w**2 + 0.3 * w * np.tanh(w / a.v_eps), atol=1e-9)
    assert (power >= 0).all()


def test_backlash_rests_on_the_flank_that_the_load_presses_on():
    play = Backlash(joint=1, gap=2e-3)
    zero = np.zeros(4)
    motion = JointMotion(np.arange(4.0), zero, zero, zero, np.array([-20.0, -5, 5, 20]))
    shift, _ = play.advance(play.initial_state(), motion)
    np.testing.assert_allclose(shift, [-1e-3, -1e-3, 1e-3, 1e-3], atol=1e-9)


def test_a_link_falls_across_the_gap_and_stays_there():
    play = Backlash(joint=1, gap=2e-3)
    time = np.arange(0.0, 0.2, 1e-3)
    zero = np.zeros_like(time)
    load = np.where(time < 0.05, 1.0, -1.0)
    motion = JointMotion(time, zero, zero, zero, load, inertia=np.full_like(time, 2.0))
    shift, _ = play.advance(play.initial_state(), motion)
    falling = (time >= 0.05) & (time < 0.05 + np.sqrt(2 * 2e-3 * 2.0) - 2e-3)
    fallen = 1e-3 - 0.5 * (1.0 / 2.0) * (time - 0.049) ** 2
    np.testing.assert_allclose(shift[falling], fallen[falling], atol=1e-9)
    np.testing.assert_allclose(shift[time > 0.15], -1e-3)


@pytest.mark.parametrize("rate", [100.0, 1000.0, 10_000.0])
def test_a_damped_fall_nears_the_speed_at_which_its_damping_bears_the_load(rate):
    play = Backlash(joint=1, gap=0.02, damping=50.0)
    time = np.arange(-0.1, 0.5, 1.0 / rate)
    load, zero = np.where(time < 0.0, 1.0, -1.0), np.zeros_like(time)
    motion = JointMotion(time, zero, zero, zero, load, inertia=np.full_like(time, 2.0))
    shift, _ = play.advance(play.initial_state(), motion)
    falling, lag = (time > 0.02) & (time < 0.45), 2.0 / 50.0  # [s] until it has that speed
    fallen = (time - lag * (1.0 - np.exp(-time / lag))) / 50.0
    np.testing.assert_allclose(shift[falling], 0.01 - fallen[falling], atol=3e-4 * 100.0 / rate)


@pytest.mark.parametrize("damping", [0.0, 4.0, 200.0])  # none, a little, more than critical
@pytest.mark.parametrize("rate", [50.0, 1000.0])
def test_a_link_swings_on_its_spring_as_the_equation_of_an_oscillator_says(damping, rate):
    spring = JointElasticity(joint=1, stiffness=900.0, damping=damping)
    time = np.arange(0.0, 1.0, 1.0 / rate)
    load, zero = 30.0 * time, np.zeros_like(time)
    motion = JointMotion(time, zero, zero, zero, load, inertia=np.full_like(time, 2.0), held=0.0)
    found, _ = spring.advance(spring.initial_state(), motion)
    oscillator = signal.lti([1.0], [2.0, damping, 900.0])
    _, expected, _ = signal.lsim(oscillator, load, time)
    np.testing.assert_allclose(found, expected, atol=1e-12)


def test_a_link_whose_inertia_grows_keeps_its_momentum():
    spring = JointElasticity(joint=1, stiffness=400.0, damping=0.0)
    time = np.linspace(0.0, 2.0, 4001)
    inertia, zero = 1.0 + time, np.zeros_like(time)
    motion = JointMotion(time, zero, zero, zero, zero, inertia=inertia, held=8.0)
    found, _ = spring.advance(spring.initial_state(), motion)
    true = integrate.solve_ivp(
        lambda t, x: [x[1] / (1.0 + t), -400.0 * x[0]], (0.0, 2.0), [0.02, 0.0],
        t_eval=time, rtol=1e-10, atol=1e-12,
    )  # fmt: skip
    np.testing.assert_allclose(found, true.y[0], atol=2e-6)


@pytest.mark.parametrize("cubic", [3e-6, -3e-6])
def test_a_link_rests_where_a_spring_that_is_bent_carries_its_load(cubic):
    bent = JointElasticity(joint=1, stiffness=1e3, cubic=cubic, damping=90.0)
    time, zero = np.linspace(0.0, 3.0, 601), np.zeros(601)
    load = np.minimum(10.0 * time, 8.0)
    motion = JointMotion(time, zero, zero, zero, load, inertia=np.full(601, 2.0), held=0.0)
    found, _ = bent.advance(bent.initial_state(), motion)
    still, _ = replace(bent, damping=None).advance(STATELESS, motion)
    assert np.abs(found - still).max() > 1e-4  # it lags
    np.testing.assert_allclose(found[-1], still[-1], rtol=1e-3)


def test_a_link_of_unknown_inertia_winds_up_at_once():
    time, zero = np.arange(4.0), np.zeros(4)
    motion = JointMotion(time, zero, zero, zero, np.array([0.0, 5.0, -5.0, 1.0]))
    swings = JointElasticity(joint=1, stiffness=1e3, damping=3.0)
    found, _ = swings.advance(swings.initial_state(), motion)
    np.testing.assert_array_equal(found, motion.load / 1e3)


def test_the_drag_of_a_drive_is_gone_from_a_reversal_to_the_end_of_the_gap():
    play = Backlash(joint=1, gap=4e-3, drag=1.5, v_eps=1e-3)
    forth = np.arange(0.0, 0.02, 1e-3)
    position = np.concatenate([forth, forth[::-1]])
    velocity = np.where(np.arange(position.size) < forth.size, 0.1, -0.1)
    motion = JointMotion(
        np.arange(position.size) * 0.01, position, velocity, 0 * position, 0 * position
    )
    torque, _ = play.advance(play.initial_state(), motion)
    ahead = np.concatenate([2e-3 - forth, 4e-3 - (forth[-1] - forth[::-1])])  # of the flank
    loose = np.clip(0.5 + ahead / 1e-3, 0.0, 1.0)  # half of the time about a sample on it
    loose[forth.size] = 0.0  # the step between both directions goes nowhere, at a flank
    np.testing.assert_allclose(torque, -1.5 * np.sign(velocity) * loose, atol=1e-9)


def test_no_drag_drives_a_joint_that_turned_back_between_two_samples():
    """At a sample the joint already goes back, though it is farther than at the last one."""
    play = Backlash(joint=1, gap=0.02, drag=1.0, v_eps=1e-6)
    dry = CoulombFriction(joint=1, tau_c=1.0, v_eps=1e-6)
    time = np.arange(0, 3, 0.01)
    zero = np.zeros_like(time)
    for late in np.linspace(0, 0.01, 5):
        q, v = np.sin(5 * (time - late)), 5 * np.cos(5 * (time - late))
        motion = JointMotion(time, q, v, zero, zero)
        felt = sum(effect.advance(effect.initial_state(), motion)[0] for effect in (play, dry))
        after = np.flatnonzero(np.diff(np.sign(v)) != 0) + 1
        np.testing.assert_allclose(felt[after], 0.0, atol=1e-9)


def test_a_drag_comes_back_at_the_gap_however_coarse_the_samples():
    play = Backlash(joint=1, gap=0.01, drag=1.0, v_eps=1e-6)
    for rate in (20.0, 100.0, 1000.0):
        loose = []  # [s], from 0.1 s after the reversal on
        for start in np.linspace(0.0, 1.0 / rate, 8, endpoint=False):  # of the samples
            time = np.arange(start - 1.0, 1.0, 1.0 / rate)
            motion = JointMotion(time, 0.1 * time**2, 0.2 * time, 0 * time, 0 * time)
            torque, _ = play.advance(play.initial_state(), motion)
            loose.append(-torque[time > 0.1].sum() / rate)
        assert np.mean(loose) == pytest.approx(np.sqrt(0.01 / 0.1) - 0.1, rel=0.02)


def test_a_drag_that_winds_something_up_goes_and_comes_in_proportion_to_the_distance():
    play = Backlash(joint=1, gap=4e-3, drag=1.5, width=2e-3, v_eps=1e-6)
    forth = np.arange(0.0, 0.02, 1e-3)
    position = np.concatenate([forth, forth[::-1]])
    velocity = np.where(np.arange(position.size) < forth.size, 0.1, -0.1)
    motion = JointMotion(
        np.arange(position.size) * 0.01, position, velocity, 0 * position, 0 * position
    )
    torque, _ = play.advance(play.initial_state(), motion)
    felt = (torque + 1.5 * np.sign(velocity))[forth.size :]  # beside dry friction as large
    away = forth[-1] - position[forth.size :]
    expected = np.interp(away, [0.0, 2e-3, 6e-3, 8e-3], [1.5, 0.0, 0.0, -1.5])
    np.testing.assert_allclose(felt, expected, atol=1e-9)


def test_a_play_is_of_one_form():
    falling, dragged = Backlash(joint=1, gap=2e-3), Backlash(joint=1, gap=2e-3, drag=1.0)
    assert (falling.displaces, dragged.displaces) == (True, False)
    assert falling.with_more(falling) == Backlash(joint=1, gap=4e-3)
    assert falling.with_more(dragged) is None
    assert dragged.with_more(dragged) is None
    for name in ("v_eps", "width"):
        with pytest.raises(ConfigError, match=f"has a {name}, and no drag"):
            Backlash(joint=1, gap=2e-3, **{name: 0.01})
    with pytest.raises(ConfigError, match="has a drag, and a damping of a fall"):
        Backlash(joint=1, gap=2e-3, drag=1.0, damping=1.0)


def test_the_impact_of_a_play_is_in_a_recorded_motion_alone(motion):
    simulation = iiwa(Backlash(joint=2, gap=2e-3))
    stretch = [slice(0, len(motion))]
    online = simulation.predict(motion) - iiwa().predict(motion)
    offline = simulation.predict_stretches(motion, stretch, 10.0) - iiwa().predict(motion)
    assert np.abs(offline[:, 1]).max() > 5 * np.abs(online[:, 1]).max()


def test_friction_fades_with_time_or_falls_with_temperature():
    zero = np.zeros(3)
    motion = JointMotion(
        np.array([0.0, 10.0, 1e4]), zero, zero + 1.0, zero, zero, np.array([25.0, 35.0, 45.0])
    )
    fading = TemperatureDependentFriction(joint=1, excess=2.0, time_constant=10.0)
    falling = TemperatureDependentFriction(joint=1, per_kelvin=-0.05)
    faded, _ = fading.advance(fading.initial_state(), motion)
    np.testing.assert_allclose(faded, [2, 2 / np.e, 0], atol=1e-9)
    np.testing.assert_allclose(falling.advance(zero, motion)[0], [0, -0.5, -1.0], atol=1e-9)


def test_a_warm_joint_cools_down_while_it_rests():
    fading = TemperatureDependentFriction(joint=1, excess=2.0, time_constant=10.0)
    time = np.arange(0.0, 100.0, 0.1)
    moves = (time < 30) | (time > 60)
    zero = np.zeros_like(time)
    motion = JointMotion(time, zero, np.where(moves, 0.5, 0.0), zero, zero)
    torque, _ = fading.advance(fading.initial_state(), motion)
    assert torque[0] == 2.0
    assert torque[time < 30][-1] < 0.11
    assert torque[time > 60][0] > 1.8  # three time constants later nearly cold again


def late(effect: TimeDelay, torque: np.ndarray) -> np.ndarray:
    sensed = SensedTorque(T, torque[:, None])
    return torque + effect.advance(effect.initial_state(), sensed)[0]


def test_a_pure_delay_shifts_and_a_lag_has_its_known_gain_and_phase():
    w = 5.0
    tau = np.sin(w * T)
    shifted = late(TimeDelay(joint=1, delay=0.03), tau)
    np.testing.assert_allclose(shifted[10:], np.sin(w * (T[10:] - 0.03)), atol=2e-4)
    lag = 0.1
    slow = late(TimeDelay(joint=1, lag=lag), tau)
    expected = np.sin(w * T - np.arctan(w * lag)) / np.hypot(1, w * lag)
    np.testing.assert_allclose(slow[400:], expected[400:], atol=1e-3)
    np.testing.assert_array_equal(late(TimeDelay(joint=1), tau), tau)


def test_sensor_effects_act_after_all_torque_and_in_their_order(motion):
    plain = iiwa().predict(motion)
    gain, leak = TorqueGain(joint=2, gain=0.1), TorqueCrosstalk(joint=4, source=2, gain=0.5)
    offset = TorqueOffset(joint=2, offset=3.0)
    torque = iiwa(gain, leak, offset).predict(motion)
    np.testing.assert_allclose(torque[:, 1], 1.1 * (plain[:, 1] + 3.0))
    np.testing.assert_allclose(torque[:, 3], plain[:, 3] + 0.5 * torque[:, 1])
    other = iiwa(leak, gain, offset).predict(motion)
    np.testing.assert_allclose(other[:, 3], plain[:, 3] + 0.5 * (plain[:, 1] + 3.0))


def test_the_nominal_body_stays_what_it_is():
    simulation = iiwa(Payload(mass=2.0, com=(0.0, 0.0, 0.1)))
    last = simulation.model.link_names[-1]
    assert simulation.body.inertials[last].mass == simulation.model.inertials[last].mass + 2.0
    assert simulation.model.inertials == RobotModel.load("iiwa14").inertials
    assert simulation.model.with_gravity((0, 9.81, 0)).with_inertials({}).gravity == (0, 9.81, 0)


def test_the_temperature_of_a_recording_reaches_the_friction(motion):
    warm = iiwa(TemperatureDependentFriction(joint=3, per_kelvin=-0.1, reference=20.0))
    temperature = np.tile(np.linspace(20.0, 40.0, T.size)[:, None], (1, 7))
    holes = temperature.copy()
    holes[100:200] = np.nan
    recording = Recording(
        T, motion.position, np.zeros_like(motion.position), extras={"temperature": holes}
    )
    added = warm.predict(recording) - iiwa().predict(recording)
    sliding = np.abs(recording.motion(10.0).velocity[:, 2]) > 0.05
    expected = 0.1 * (temperature[:, 2] - 20.0)
    np.testing.assert_allclose(np.abs(added[sliding, 2]), expected[sliding], atol=1e-9)
