"""Recordings whose torque cannot be that of their motion, and those that only look odd."""

from __future__ import annotations

import re
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from lanes import sampled
from scipy.linalg import eigh
from wandering import wander

from estimators.diagnosis.from_torque.fitting.problem import impossible, improve
from estimators.diagnosis.from_torque.pipeline import observe
from estimators.diagnosis.from_torque.residuals.mistakes import RowSample
from estimators.diagnosis.from_torque.residuals.observations import Observations
from estimators.diagnosis.from_torque.residuals.plausibility import (
    doubts_on,
    foreign_bodies,
    found_in,
    notes_on,
)
from estimators.diagnosis.from_torque.residuals.usable_joints import doubtful_encoders, without_load
from estimators.regression.evidence import Prior
from estimators.rigid_body.fitting.extent import Extents
from estimators.rigid_body.regressor import PER_LINK
from limo_driver.errors import RecordingError
from limo_driver.model import RobotModel
from limo_driver.physics import (
    CoulombFriction,
    EncoderOffset,
    ExternalContact,
    GravityDirection,
    JointElasticity,
    LoadDependentFriction,
    Payload,
    Simulation,
    SpringLoad,
    TorqueGain,
    ViscousFriction,
)
from limo_driver.recordings.recording import Recording
from limo_driver.types import Motion

RATE, DURATION = 50.0, 40.0  # [Hz], [s]
BANDWIDTH = 5.0  # [Hz]
FRICTION = (2.5, 3.7, 1.3, 3.1, 0.7, 0.6, 0.5)  # [N m]
GIVEN = Simulation(
    "iiwa14",
    tuple(CoulombFriction(joint=j + 1, tau_c=tau) for j, tau in enumerate(FRICTION))
    + tuple(ViscousFriction(joint=j + 1, f_v=tau) for j, tau in enumerate(FRICTION)),
)
LIMITS = RobotModel.load("iiwa14").limits
HARMONICS = np.arange(1, 6)
ONE = np.eye(7)


def motion_of(amplitude=0.5):
    """Return a Fourier motion of all joints within a part of their ranges."""
    random = np.random.default_rng(3)
    t = np.arange(int(DURATION * RATE)) / RATE
    w = 2 * np.pi * 0.05 * HARMONICS
    c, d = random.normal(size=(2, w.size, 7)) / HARMONICS[:, None]
    sin, cos = np.sin(np.outer(t, w)), np.cos(np.outer(t, w))
    position = sin @ c + cos @ d
    scale = amplitude * LIMITS.position_max / np.abs(position).max(axis=0)
    velocity, acceleration = (cos * w) @ c - (sin * w) @ d, -(sin * w**2) @ c - (cos * w**2) @ d
    return Motion(t, scale * position, scale * velocity, scale * acceleration)


def record(true=GIVEN, motion=None, amplitude=0.5):
    """Measure a motion with noise."""
    motion = motion_of(amplitude) if motion is None else motion
    noise = 0.02 * np.random.default_rng(0).standard_normal(motion.position.shape)
    return Recording(motion.time, motion.position, true.predict(motion) + noise, source="run")


@pytest.fixture(scope="module")
def recording():
    return record()


def exchange(i, j):
    return ONE[[j if k == i else i if k == j else k for k in range(7)]]


def invert(*joints):
    return ONE - 2 * np.diag(ONE[list(joints)].sum(axis=0))


def scale(factor, *joints):
    return ONE + (factor - 1) * np.diag(ONE[list(joints)].sum(axis=0))


ALL = tuple(range(7))


@sampled(
    ("matrix", "said"),
    [
        (exchange(1, 3), "torque_2 belongs to joint 4 and torque_4 to joint 2"),
        (exchange(0, 6), "torque_1 belongs to joint 7 and torque_7 to joint 1"),
        (exchange(5, 6), "torque_6 belongs to joint 7 and torque_7 to joint 6"),
        (invert(3), "torque_4 has the other sign than expected"),
        (invert(6), "torque_7 has the other sign than expected"),
        (invert(*ALL), "all torques have the other sign than expected"),
        (invert(5) @ exchange(1, 3), "belongs to joint 4.*; torque_6 has the other sign"),
        (scale(1000.0, 6), r"torque_7 is .* times what joint 7 of iiwa14 can do .*; expected N m"),
        (scale(30.0, 6), r"torque_7 is .* times what its motion makes of it; .*in N mm or mA"),
        (scale(0.001, 1), r"torque_2 is 0.001 times what its motion makes of it; .*in kN m or A"),
        (scale(0.001, *ALL), r"the torques are 0.001 times .*in kN m or A, or is it another robot"),
        (scale(1 / 12.0, *ALL), r"the torques are 0.083\d times .*in kN m or A"),
        (scale(5.0, *ALL), r"the torques are 5 times .*in N mm or mA, or is it another robot"),
        (ONE[[1, 2, 3, 4, 5, 6, 0]], "torque_1 belongs to joint"),
    ],
    "each looks where a recording belongs",
    first=6,
)
def test_torques_in_the_wrong_place_sign_or_unit_are_named(recording, matrix, said):
    refused(replace(recording, torque=recording.torque @ matrix.T), said)


@sampled(
    ("matrix", "turn", "said"),
    [
        (exchange(1, 3), 0, "position_2 belongs to joint 4 and position_4 to joint 2"),
        (exchange(2, 4), 0, "position_3 belongs to joint 5 and position_5 to joint 3"),
        (invert(1), 0, "position_2 has the other sign than the axis of joint 2"),
        (scale(np.pi / 180, *ALL), 0, "positions of all joints are 57.3 times too small"),
        (ONE, np.pi / 2 * ONE[1], "the zero of position_2 is 90° away"),
    ],
    "each looks where a recording belongs",
    first=3,
)
def test_positions_in_the_wrong_place_sign_or_unit_are_named(recording, matrix, turn, said):
    position = recording.position @ matrix.T + turn
    refused(replace(recording, position=np.clip(position, -2.0, 2.0)), said)


def test_an_axis_of_the_other_direction_is_named(recording):
    turned = invert(1)
    torque, position = recording.torque @ turned, recording.position @ turned
    said = "position_2 and torque_2 have the other sign than the axis of joint 2"
    refused(replace(recording, position=position, torque=torque), said)


def laden(mass):
    """Return the arm with a load on the axis of its flange."""
    load = Payload(mass=mass, com=(0.0, 0.0, 0.2), inertia=(0.05, 0.0, 0.0, 0.05, 0.0, 0.02))
    return replace(GIVEN, effects=(*GIVEN.effects, load))


def test_a_sign_is_named_beside_a_load_that_says_nothing_of_that_joint():
    given = record(laden(3.0))
    mistaken = replace(given, torque=given.torque @ invert(6))
    observed = Observations.of(Simulation("iiwa14"), [mistaken], BANDWIDTH)

    (found,) = found_in(RowSample.of(observed))

    assert found.message.startswith("torque_7 has the other sign than expected")


@sampled("mass", [8.0, 14.0], "each looks where a recording belongs")
def test_a_load_that_nobody_stated_is_no_other_unit(mass):
    observe(Simulation("iiwa14"), [record(laden(mass))], BANDWIDTH)


def test_another_unit_is_refused_where_a_load_explains_less():
    given = record(laden(3.0))
    refused(replace(given, torque=5.0 * given.torque), "are they in N mm or mA")


def test_friction_many_times_that_which_is_known_is_no_other_unit():
    load = Payload(mass=0.3, com=(0.05, 0.0, 0.05), inertia=(1e-3, 0.0, 0.0, 1e-3, 0.0, 1e-3))
    known = Simulation("iiwa14", (*GIVEN.effects, load))
    is_friction = tuple(
        CoulombFriction(joint=7, tau_c=20.0 * effect.tau_c)
        if isinstance(effect, CoulombFriction) and effect.joint == 7
        else effect
        for effect in known.effects
    )
    rubbing = record(Simulation("iiwa14", is_friction))
    observe(known, [rubbing], BANDWIDTH)
    torque = record(known).torque @ scale(20.0, 6)
    with pytest.raises(RecordingError, match=r"torque_7 is .* times .*in N mm or mA"):
        observe(known, [replace(rubbing, torque=torque)], BANDWIDTH)


def test_a_joint_that_shows_little_but_its_errors_is_in_no_other_unit():
    """It turned one way, under a load that hardly changed."""
    usual = motion_of()
    position, velocity = usual.position.copy(), usual.velocity.copy()
    acceleration = usual.acceleration.copy()
    position[:, 6], velocity[:, 6], acceleration[:, 6] = 0.03 * usual.time, 0.03, 0.0
    given = record(motion=Motion(usual.time, position, velocity, acceleration))
    simulated = GIVEN.predict(given)[:, 6]
    errors = 15.0 * (simulated - simulated.mean())
    assert 0.0 < errors.std() < np.abs(simulated).mean()
    torque = given.torque.copy()
    torque[:, 6] = simulated.mean() + errors
    observe(GIVEN, [replace(given, torque=torque)], BANDWIDTH)
    torque[:, 6] = 1000.0 * simulated
    with pytest.raises(RecordingError, match=r"torque_7 is .* times .*; expected N m"):
        observe(GIVEN, [replace(given, torque=torque)], BANDWIDTH)


def test_torque_of_another_motion_is_refused(recording):
    torque = np.roll(recording.torque, len(recording) // 6, axis=0)
    refused(replace(recording, torque=torque), "are not the load of iiwa14 on this motion")


def test_two_torque_sensors_that_are_off_are_doubted_not_refused(recording):
    """Most of the arm carries its load, and what is wrong with the others can be found."""
    torque = recording.torque.copy()
    torque[:, 3] += 0.6 * np.ptp(torque[:, 3]) * np.sin(40 * recording.position[:, 3])
    torque[:, 5] += 0.6 * np.ptp(torque[:, 5]) * np.sin(40 * recording.position[:, 5])
    notes = notes_on(observe(GIVEN, [replace(recording, torque=torque)], BANDWIDTH))
    (doubt,) = [note for note in notes if "the load of" in note]
    assert doubt.startswith("The torques of joints 4, 6 are not the load of iiwa14 on this motion")
    assert not any(
        "the load of" in note for note in notes_on(observe(GIVEN, [recording], BANDWIDTH))
    )


def test_of_sensors_that_are_off_by_a_factor_the_factor_is_told(recording):
    torque = recording.torque * np.array([1, 1, 1, 0.3, 1, 0.35, 1])
    (doubt,) = doubts_on(observe(GIVEN, [replace(recording, torque=torque)], BANDWIDTH))
    told = re.search(r"follow (0\.\d\d) of it at joint 4 and (0\.\d\d) of it at joint 6", doubt)
    assert told is not None
    assert [float(part) for part in told.groups()] == pytest.approx([0.3, 0.35], abs=0.02)
    assert doubts_on(observe(GIVEN, [recording], BANDWIDTH)) == ()


def test_gears_that_hold_their_load_by_friction_are_doubted_not_refused(recording):
    """Of a wrist's currents gravity seems taken out; shoulder and elbow show that it is not."""
    wrist, torque = [4, 5, 6], recording.torque.copy()
    torque[:, wrist] = 0.1 * np.sign(recording.motion(BANDWIDTH).velocity[:, wrist])
    notes = notes_on(observe(GIVEN, [replace(recording, torque=torque)], BANDWIDTH))
    (doubt,) = [note for note in notes if "the load of" in note]
    assert doubt.startswith("The torques of joints 5, 6 are not the load of iiwa14")


def test_a_shoulder_that_mostly_rubs_speaks_against_gravity_taken_out(recording):
    """Its gravity is small beside its friction, so a second time it only doubles the misfit."""
    sample = RowSample.of(observe(GIVEN, [recording], BANDWIDTH))
    torque, wrist, shoulder = sample.torque.copy(), [4, 5, 6], [0, 1, 2, 3]
    gravity, direction = sample.load.std(axis=0), np.sign(sample.motion.velocity)
    error = np.random.default_rng(0).standard_normal(torque.shape)
    rubbing = sample.load + gravity * (3.0 * direction + 0.6 * error)
    torque[:, shoulder] = rubbing[:, shoulder]
    torque[:, wrist] = 0.02 * gravity[wrist] * direction[:, wrist]
    assert found_in(replace(sample, torque=torque)) == []


def test_noise_instead_of_torque_is_no_torque_without_gravity(recording):
    """Gravity that is put back would fit by itself, being far larger than the noise."""
    noise = np.random.default_rng(0).standard_normal(recording.torque.shape)
    refused(replace(recording, torque=noise), "are not the load of iiwa14 on this motion")


def test_a_recording_given_twice_is_refused(recording):
    later = replace(recording, time=recording.time + 5.0, source="later")
    for again in (recording, later):
        with pytest.raises(RecordingError, match="holds the same samples as run, and would count"):
            observe(GIVEN, [recording, again], 10.0)


@pytest.mark.parametrize("bandwidth", [1e-9, 1e-3])
def test_a_bandwidth_far_below_the_recording_is_refused(recording, bandwidth):
    with pytest.raises(RecordingError, match="is too low for a recording of"):
        observe(GIVEN, [recording], bandwidth)


def test_torque_without_gravity_is_refused(recording):
    gravity = GIVEN.model.inverse_dynamics(recording.position, *2 * [0 * recording.position])
    refused(
        replace(recording, torque=recording.torque - gravity), "gravity is taken out of the torques"
    )


def test_rest_is_refused(recording):
    still = np.tile(recording.position[:1], (len(recording), 1))
    refused(
        replace(recording, position=still), "no joint keeps moving for long enough to learn from"
    )


def test_a_mistake_in_one_recording_is_named_beside_good_ones(recording):
    mixed = replace(recording, torque=recording.torque @ exchange(1, 3).T, source="second")
    with pytest.raises(RecordingError, match="second: torque_2 belongs to joint 4"):
        observe(GIVEN, [recording, mixed], BANDWIDTH)


@pytest.mark.parametrize("bandwidth", [0.0, -3.0, np.nan, np.inf])
def test_a_bandwidth_that_is_none_is_refused(recording, bandwidth):
    with pytest.raises(RecordingError, match="expected a positive number"):
        observe(GIVEN, [recording], bandwidth)


def test_uneven_slow_recordings_are_used_at_the_bandwidth_they_allow(recording):
    """The rate of an uneven recording is a mean, and so is what the rate allows."""
    uneven = np.sort(recording.time + np.random.default_rng(1).normal(0, 1e-3, len(recording)))
    observed = observe(GIVEN, [replace(recording, time=uneven)], 10.0)
    steps = np.diff(observed.motion.time)
    assert np.ptp(steps) < 1e-9


def refused(recording, said):
    with pytest.raises(RecordingError, match=said) as caught:
        observe(GIVEN, [recording], BANDWIDTH)
    assert str(caught.value).startswith("run: ")
    assert "\n" not in str(caught.value)


FAR_BEYOND = sampled(
    "hidden",
    [
        (Payload(mass=8.0, com=(0.05, 0.0, 0.1), inertia=(0.05, 0.0, 0.0, 0.05, 0.0, 0.05)),),
        (GravityDirection(gravity=(0.0, 0.0, 9.81)),),  # upside down
        (GravityDirection(gravity=(0.0, -9.81, 0.0)),),  # on a wall
        (TorqueGain(joint=2, gain=3.0),),
        (TorqueGain(joint=4, gain=-0.8),),
        (EncoderOffset(joint=2, offset=0.3),),
        (SpringLoad(joint=2, stiffness=80.0, rest=0.0),),
        (JointElasticity(joint=4, stiffness=300.0),),
        (LoadDependentFriction(joint=2, coefficient=0.3),),
        (CoulombFriction(joint=7, tau_c=5.0),),
        (ExternalContact(windows=((10.0, 12.0),), wrench=((60.0, 0.0, 60.0, 0.0, 0.0, 0.0),)),),
    ],
    "each observes a recording of its own",
    first=2,
    ids=lambda hidden: hidden[0].name,
)


@FAR_BEYOND
def test_physics_far_beyond_any_that_is_concealed_is_not_refused(hidden):
    observe(GIVEN, [record(replace(GIVEN, effects=GIVEN.effects + hidden))], BANDWIDTH)


@pytest.mark.parametrize("amplitude", [0.03, 0.2, 0.5])
def test_a_simulation_without_friction_is_enough(amplitude):
    observe(Simulation("iiwa14"), [record(amplitude=amplitude)], BANDWIDTH)


def test_a_simulation_with_friction_that_a_link_side_torque_lacks_is_not_refused():
    observe(GIVEN, [record(Simulation("iiwa14"))], BANDWIDTH)


def locked(joint):
    """Return the motion with one joint (1-based) locked."""
    motion, moves = motion_of(), np.arange(7) != joint - 1
    return replace(
        motion,
        position=motion.position * moves,
        velocity=motion.velocity * moves,
        acceleration=motion.acceleration * moves,
    )


def test_a_joint_that_does_not_move_is_noted():
    notes = notes_on(observe(GIVEN, [record(motion=locked(3))], BANDWIDTH))
    assert notes == (
        "Nothing is said of the torque of joints that move too little to compare it: 3.",
    )


@sampled(
    "simulation",
    [GIVEN, Simulation("iiwa14")],
    "each reads a recording of seven joints",
    ids=["friction", "bare"],
)
@sampled("joint", [2, 3, 4, 5], "each reads a recording of seven joints")
def test_a_stuck_encoder_is_named(recording, joint, simulation):
    position = recording.position.copy()
    position[:, joint - 1] = 0.3
    mixed = replace(recording, position=position, source="second")
    for recordings in ([mixed], [recording, mixed]):
        with pytest.raises(
            RecordingError, match=f"second: position_{joint} is 0.3 rad in all rows"
        ):
            observe(simulation, recordings, BANDWIDTH)


def test_an_encoder_that_may_be_stuck_is_doubted_where_no_other_torque_shows_it(recording):
    position = recording.position.copy()
    position[:, 0] = 0.3  # turning about the vertical changes no load
    observed = observe(GIVEN, [replace(recording, position=position)], BANDWIDTH)
    assert doubtful_encoders(observed) == (0,)
    note, _ = notes_on(observed)
    assert note.startswith("position_1 is 0.3 rad in all rows while torque_1 varies by")


@pytest.mark.parametrize("joint", [1, 3, 7])
def test_a_locked_joint_is_not_doubted(joint):
    assert doubtful_encoders(observe(GIVEN, [record(motion=locked(joint))], BANDWIDTH)) == ()


def heavier(*links):
    """Return the arm with links of half as much mass again, and other centres."""
    known = GIVEN.model.inertials
    changed = {
        link: replace(
            known[link],
            mass=1.5 * known[link].mass,
            com=tuple(x + 0.03 for x in known[link].com),
        )
        for link in links
    }
    return replace(GIVEN, inertials=changed)


@sampled(
    "given",
    [GIVEN, Simulation("iiwa14")],
    "looks for other bodies in a recording each",
    ids=["friction", "bare"],
)
def test_an_arm_of_other_bodies_is_noted(given):
    true = heavier("link2", "link3", "link4", "link5", "link6")
    observed = observe(given, [record(true)], BANDWIDTH)
    assert len(foreign_bodies(observed)) >= 4
    (note,) = notes_on(observed)
    assert "Is it another arm?" in note


PENDULUM = """<robot name="pendulum">
  <link name="base"/>
  <link name="upper"><inertial><origin xyz="0 0 -0.27"/><mass value="0.6"/>
    <inertia ixx="{0}" ixy="0" ixz="0" iyy="{0}" iyz="0" izz="0.005"/></inertial></link>
  <link name="lower"><inertial><origin xyz="0 0 -0.17"/><mass value="0.6"/>
    <inertia ixx="{1}" ixy="0" ixz="0" iyy="{1}" iyz="0" izz="0.005"/></inertial></link>
  <joint name="shoulder" type="continuous"><parent link="base"/><child link="upper"/>
    <axis xyz="1 0 0"/><limit effort="16" velocity="20"/></joint>
  <joint name="elbow" type="continuous"><parent link="upper"/><child link="lower"/>
    <origin xyz="0 0 -0.3"/><axis xyz="1 0 0"/><limit effort="16" velocity="20"/></joint>
</robot>
"""


def test_bodies_that_are_stated_far_off_are_doubted_not_refused(tmp_path):
    """A pendulum that swings by itself, with inertias about its joints stated as of the centres."""
    for name, inertia in (("true", (0.009, 0.008)), ("stated", (0.055, 0.025))):
        (tmp_path / f"{name}.urdf").write_text(PENDULUM.format(*inertia), encoding="utf-8")
    friction = tuple(CoulombFriction(joint=j, tau_c=0.15) for j in (1, 2))
    true = Simulation(str(tmp_path / "true.urdf"), friction)
    hanging, small = np.zeros(2), 1e-4
    stiffness = true.model.gravity_torque(small * np.eye(2)) / small
    squares, modes = eigh(stiffness, true.model.mass_matrix(hanging))
    t, w = np.arange(0, 20, 0.005), np.sqrt(squares)
    wave, size = np.outer(t, w) + np.array([0.0, 1.0]), 0.6 * (modes / np.abs(modes).max(axis=0)).T
    motion = Motion(
        t, np.sin(wave) @ size, (w * np.cos(wave)) @ size, (-(w**2) * np.sin(wave)) @ size
    )
    recorded = record(true, motion)
    stated = Simulation(str(tmp_path / "stated.urdf"))
    (doubt,) = doubts_on(observe(stated, [recorded], 10.0))
    assert "torques of joints 1, 2 are not the load of" in doubt
    torque = np.roll(recorded.torque, len(t) // 3, axis=0)
    with pytest.raises(RecordingError, match="or torque of another motion"):
        observe(stated, [replace(recorded, torque=torque)], 10.0)


@sampled("link", (4, 7, 1, 2, 3, 5, 6), "each looks for other bodies in a recording", first=2)
def test_one_wrong_body_does_not_make_another_arm(link):
    assert foreign_bodies(observe(GIVEN, [record(heavier(f"link{link}"))], BANDWIDTH)) == ()


@FAR_BEYOND
def test_no_other_physics_makes_another_arm(hidden):
    true = replace(GIVEN, effects=GIVEN.effects + hidden)
    assert foreign_bodies(observe(GIVEN, [record(true)], BANDWIDTH)) == ()


@FAR_BEYOND
@sampled("joint", [3, 4], "each looks where a recording belongs")
def test_a_locked_joint_is_not_taken_for_a_stuck_encoder(hidden, joint):
    true = replace(GIVEN, effects=GIVEN.effects + hidden)
    observe(GIVEN, [record(true, motion=locked(joint))], BANDWIDTH)


def test_a_joint_that_moves_by_jerks_is_told_how_little_it_is_away_from_rest():
    t = np.arange(int(DURATION * RATE)) / RATE
    jerks = np.clip(4.0 * (t % 2.0), 0.0, 1.0) + np.floor(t / 2.0)  # of a quarter of a second
    position = 0.3 + 0.03 * jerks[:, None] * (np.arange(7) == 1)
    torque = np.random.default_rng(0).normal(size=position.shape)
    with pytest.raises(RecordingError, match=r"joint 2 goes the farthest, 0\.\d+ rad, and is away"):
        observe(GIVEN, [Recording(t, position, torque)], BANDWIDTH)


def test_a_joint_that_moves_for_a_moment_tells_nothing_of_encoders():
    """Where an encoder may be stuck, few rows are tried, and hardly any of such a joint."""
    motion, turns, t = motion_of(), 2 * np.pi * 0.5, np.arange(int(DURATION * RATE)) / RATE
    moment = (t > 10) & (t < 12.5)  # of one turn and a quarter
    factor = np.where(moment[:, None], np.arange(7) == 0, 0.0)
    angle = turns * (t - 10)[:, None]
    motion = Motion(
        t,
        0.3 + factor * (1 - np.cos(angle)),
        factor * turns * np.sin(angle),
        factor * turns**2 * np.cos(angle),
    )
    run = record(motion=motion)
    torque = run.torque * (np.arange(7) == 0)  # the drives of the others are off
    torque[:, 0] += 5 * np.sin(7 * angle[:, 0])  # nothing that limo could know
    observe(GIVEN, [replace(run, torque=torque + 0.02)], BANDWIDTH)


def test_what_is_odd_about_a_recording_is_noted(recording):
    odd = replace(recording, warnings=("1 gap; the longest, 3 s, after 10 s",))
    observed = observe(GIVEN, [odd], BANDWIDTH)
    assert notes_on(observed) == ("run: 1 gap; the longest, 3 s, after 10 s.",)


def test_an_explanation_out_of_range_is_left_out_and_told():
    bodies = PER_LINK * GIVEN.model.n
    offset = SimpleNamespace(
        effect=EncoderOffset.name,
        prior=Prior.free(np.zeros(1, np.int64), np.ones(1)),
        enter=lambda improvement, c: improvement.add(EncoderOffset(joint=2, offset=float(c[0]))),
    )
    problem = SimpleNamespace(
        observed=SimpleNamespace(simulation=GIVEN, extents=Extents(GIVEN.model)),
        nuisance=SimpleNamespace(
            prior=Prior.free(np.arange(bodies), np.ones(bodies)),
            enter=lambda _improvement, _c: None,
        ),
        candidates=[offset],
    )
    found = SimpleNamespace(mean=1.5 * np.eye(bodies + 1)[-1], covariance=np.eye(bodies + 1))
    solution = SimpleNamespace(problem=problem, members=(0,), fitted=found)
    assert impossible(solution) == (0,)
    assert improve(solution) == GIVEN


@pytest.fixture
def on_a_lift(tmp_path):
    """Two links of 2 kg that a slide of 10 kg lifts."""
    inertia = '<inertia ixx="0.02" iyy="0.02" izz="0.01" ixy="0" ixz="0" iyz="0"/>'
    links = [
        f'<link name="l{k}"><inertial><origin xyz="0 0 0.15"/><mass value="{mass}"/>{inertia}'
        "</inertial></link>"
        for k, mass in enumerate((10, 2, 2), start=1)
    ]
    joints = [
        f'<joint name="j{k}" type="{kind}"><parent link="l{k - 1}"/><child link="l{k}"/>'
        f'<origin xyz="0 0 0.3"/><axis xyz="{axis}"/>'
        '<limit lower="-2" upper="2" effort="300" velocity="2"/></joint>'
        for k, (kind, axis) in enumerate(
            (("prismatic", "0 0 1"), ("revolute", "0 1 0"), ("revolute", "0 1 0")), start=1
        )
    ]
    path = tmp_path / "lift.urdf"
    whole = f'<robot name="lift"><link name="l0"/>{"".join((*links, *joints))}</robot>'
    path.write_text(whole, encoding="utf-8")
    friction = tuple(CoulombFriction(joint=j, tau_c=0.5) for j in (2, 3))
    return Simulation(str(path), (CoulombFriction(joint=1, tau_c=8.0), *friction))


def test_a_lift_in_amperes_is_left_out_and_says_nothing_of_the_bodies(on_a_lift):
    motion = wander(np.arange(0, 40, 0.02), np.zeros(3), 2, (0.05, 0.2), (0.1, 0.3))
    torque = on_a_lift.predict(motion)
    torque += np.random.default_rng(0).normal(0, 0.02, torque.shape)
    own = Recording.from_arrays(motion.time, motion.position, torque)
    assert doubts_on(observe(on_a_lift, [own], BANDWIDTH)) == ()
    torque[:, 0] = 0.02 * np.sign(motion.velocity[:, 0])  # the drive brakes what it lifts by itself
    log = Recording.from_arrays(motion.time, motion.position, torque)
    observed = observe(on_a_lift, [log], BANDWIDTH)
    (doubt,) = doubts_on(observed)
    assert re.match(
        r"Joint 1 is left out: its torque is 0\.0\d+ N where its load asks for 13\d ", doubt
    )
    assert observed.moving.any(axis=0).tolist() == [False, True, True]
    assert not any("too little to compare" in note for note in notes_on(observed))
    torque[:, 0] = 0.1 * own.torque[:, 0]  # too much to be beyond doubt, and still asked about
    log = Recording.from_arrays(motion.time, motion.position, torque)
    observed = observe(on_a_lift, [log], BANDWIDTH)
    doubt = doubts_on(observed)[0]
    assert doubt.startswith("Joint 1: its torque is 13")
    assert doubt.endswith("bends the bodies.")
    assert observed.moving.any(axis=0).all()


def test_drives_without_power_are_left_out_by_name_and_balanced_joints_are_not():
    """Two of seven show noise about an offset while they are moved, of a tenth of their load."""
    free, random = [1, 3], np.random.default_rng(0)
    recorded = record()
    torque, tenth = recorded.torque.copy(), 0.1 * recorded.torque.std(axis=0)[free]
    torque[:, free] = tenth * (1.0 + random.standard_normal((len(torque), 2)))
    unpowered = observe(GIVEN, [replace(recorded, torque=torque)], BANDWIDTH)
    assert not without_load(unpowered)  # their torque is not next to nothing
    doubts = [doubt for doubt in doubts_on(unpowered) if "has the drive no power?" in doubt]
    assert [doubt[:19] for doubt in doubts] == [f"Joint {j + 1} is left out" for j in free]
    assert not any("Taken as it is" in doubt for doubt in doubts)
    assert unpowered.moving.any(axis=0).tolist()[:5] == [True, False, True, False, True]
    v = recorded.motion(BANDWIDTH).velocity
    torque[:, free] = 0.1 * recorded.torque[:, free] + 0.5 * tenth * np.tanh(v[:, free] / 0.01)
    balanced = observe(GIVEN, [replace(recorded, torque=torque)], BANDWIDTH)
    assert len([doubt for doubt in doubts_on(balanced) if "Taken as it is" in doubt]) == len(free)
    assert not any("left out" in doubt for doubt in doubts_on(balanced))
