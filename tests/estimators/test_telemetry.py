import re

import numpy as np
import pytest
from lanes import sampled

from estimators.telemetry import (
    channels_of,
    friction_share,
    gear_side,
    resolution,
    sampling_of,
    telemetry_of,
)
from limo_driver.model import RobotModel
from limo_driver.physics import CoulombFriction, PreslidingHysteresis, Simulation
from limo_driver.recordings.recording import Recording

RATE = 200.0


@pytest.fixture(scope="module")
def arm():
    return RobotModel.load("iiwa14")


def motion(duration=20.0, still=()):
    time = np.arange(0, duration, 1 / RATE)
    rate = 2 * np.pi * (0.1 + 0.05 * np.arange(7))
    phase = np.outer(time, rate) + np.arange(7)
    q, v, a = np.sin(phase), rate * np.cos(phase), -(rate**2) * np.sin(phase)
    for j in still:
        q[:, j], v[:, j], a[:, j] = 0.3, 0.0, 0.0
    return time, q, v, a


def recorded(arm, friction, still=(), noise=0.05):
    time, q, v, a = motion(still=still)
    torque = arm.inverse_dynamics(q, v, a) + friction * np.tanh(v / 0.01)
    torque += np.random.default_rng(0).normal(0, noise, q.shape)
    return Recording.from_arrays(time, q, torque)


@sampled(
    ("share", "said"),
    [(0.003, "not to be told"), (0.06, "motor side"), (0.02, "not to be told")],
    "identifies an arm each",
)
def test_friction_says_on_which_side_of_the_gear(arm, share, said):
    found = telemetry_of(recorded(arm, share * arm.limits.torque), arm)
    assert said in found.side
    assert "% of what the drives can do" in found.side


@pytest.mark.parametrize(
    ("share", "stated", "side"),
    [(0.003, 0.02, "link side"), (0.01, 0.01, "not to be told"), (0.003, 0.0, "not to be told")],
)
def test_a_torque_is_of_the_link_side_only_where_it_lacks_friction_that_is_stated(
    share, stated, side
):
    assert side in gear_side(share, stated)


def test_friction_counts_whatever_its_law(arm):
    recording = recorded(arm, 0.06 * arm.limits.torque, still=(6,))
    slides = 0.06 * arm.limits.torque
    effects = [
        CoulombFriction(joint=j, tau_c=most, v_eps=0.01)
        if j % 2
        else PreslidingHysteresis(joint=j, stiffness=(400 * most, 50 * most), width=(1e-3, 0.012))
        for j, most in enumerate(slides.tolist(), start=1)
    ]
    said = gear_side(friction_share(Simulation("iiwa14", tuple(effects)), recording))
    assert "motor side" in said
    (share,) = re.findall(r"friction is ([\d.]+)%", said)
    assert float(share) == pytest.approx(6.0, abs=0.2)  # elements slip a little after reversals


def test_a_joint_that_rests_is_named_and_its_parameters_are_unknown(arm):
    found = telemetry_of(recorded(arm, 1.0, still=(6,)), arm)
    said = found.excitation
    assert any("joint 7 never moves" in line for line in said)
    unknown = next(line for line in said if "says nothing about" in line)
    assert "tau_c_7" in unknown or "_7" in unknown
    friction = next(item for item in found.parameters if item.name == "tau_c_7")
    assert friction.verdict == "not from this motion"
    assert friction.remedy.startswith("joint 7 ")
    assert {item.verdict for item in found.parameters} >= {"identifiable", friction.verdict}
    assert all(bool(item.remedy) == (item.known_to > 0.1) for item in found.parameters)
    known, rank = map(int, re.match(r"(\d+) of (\d+) base parameters are known", said[0]).groups())
    listed = unknown.partition(";")[0].removeprefix("this motion says nothing about ").split(", ")
    *first, last = listed
    more = int(last.partition(" and ")[2].removesuffix(" more") or 0)
    assert rank - known == len(first) + 1 + more


def test_a_motion_that_excites_everything_has_nothing_unknown(arm):
    said = telemetry_of(recorded(arm, 1.0, noise=1e-4), arm).excitation
    assert not any("never moves" in line for line in said)


@pytest.mark.parametrize("step", [0.25, 1e-3, 2.0**-12])
def test_steps_of_a_grid_are_found(step):
    values = np.round(np.sin(np.linspace(0, 9, 40_000)) / step) * step
    assert resolution(values) == pytest.approx(step, rel=1e-3)


def test_values_beside_a_grid_have_no_step():
    assert resolution(np.sin(np.linspace(0, 9, 4000))) == 0
    assert resolution(np.ones(100)) == 0


def test_sampling_gaps_and_lost_rows_are_told(arm):
    recording = recorded(arm, 1.0)
    keep = np.ones(len(recording), dtype=bool)
    keep[1000:1100] = False
    keep[::50] = False
    said = " ".join(sampling_of(recording[keep]))
    assert "sampled at 200 Hz for" in said
    assert "1 gap; about 177" in said


def test_coarse_and_slow_channels_are_told(arm):
    recording = recorded(arm, 1.0)
    torque = np.array(recording.torque)
    torque[:, 2] = np.round(torque[:, 2] / 2) * 2
    position = np.repeat(recording.position[::4], 4, axis=0)[: len(recording)]
    said = " ".join(channels_of(Recording(recording.time, position, torque)))
    assert "torque comes in steps of 2 (joint 3) N m" in said
    assert "torque of joint 3 is coarse" in said
    assert "position of joints 1, 2, 3, 4, 5, 6, 7 changes in fewer than half" in said


def test_the_position_of_a_joint_at_rest_is_measured_as_often_as_any(arm):
    """It repeats in most rows, but for what its encoder creeps while other joints move."""
    moving = recorded(arm, 1.0)
    position = np.array(moving.position)
    position[:, 2] = 0.3 + 1e-4 * (moving.time > 0.5 * moving.time[-1])
    resting = Recording.from_arrays(moving.time, position, moving.torque)
    assert not any("fewer than half" in line for line in channels_of(resting))


def test_a_torque_that_swings_at_one_frequency_chatters(arm):
    quiet = recorded(arm, 1.0)
    assert not any("chatters" in line for line in channels_of(quiet))
    torque = np.array(quiet.torque)
    torque[:, 2] += 3.0 * np.sign(np.sin(2 * np.pi * 37.0 * quiet.time))
    loud = Recording.from_arrays(quiet.time, quiet.position, torque)
    (said,) = [line for line in channels_of(loud) if "chatters" in line]
    (joint, rms, frequency) = re.match(
        r"torque chatters: joint (\d) by ([\d.]+) N m RMS at ([\d.]+) Hz; ", said
    ).groups()
    assert joint == "3"
    assert float(rms) == pytest.approx(4 / np.pi * 3.0 / np.sqrt(2), rel=0.1)
    assert float(frequency) == pytest.approx(37.0, abs=0.5)


def test_noise_alone_is_no_chatter(arm):
    loud = recorded(arm, 1.0, noise=20.0)
    assert not any("chatters" in line for line in channels_of(loud))


LINK = (
    '<link name="l{}"><inertial><origin xyz=".01 .02 .2"/><mass value="2"/><inertia ixx=".03" '
    'ixy="0" ixz="0" iyy=".03" iyz="0" izz=".01"/></inertial></link>'
)
HINGE = (
    '<joint name="j{}" type="revolute"><parent link="l{}"/><child link="l{}"/><origin '
    'xyz="0 0 .4"/><axis xyz="0 1 0"/><limit lower="-{}" upper="{}" effort="80" '
    'velocity="2"/></joint>'
)


@pytest.mark.parametrize(("end", "planned"), [(0, False), (2, True)])
def test_a_motion_is_advised_that_can_be_planned(tmp_path, end, planned):
    parts = [LINK.format(j) for j in range(3)]
    parts += [HINGE.format(j, j, j + 1, end, end) for j in range(2)]
    path = tmp_path / "cad.urdf"
    path.write_text(f'<robot name="cad">{"".join(parts)}</robot>', encoding="utf-8")
    model = RobotModel(path)
    time = np.arange(0, 10, 1 / RATE)
    q = 0.02 * np.sin(np.outer(time, [1.0, 1.3]))
    torque = model.gravity_torque(q) + np.random.default_rng(0).normal(0, 0.3, q.shape)
    said = telemetry_of(Recording.from_arrays(time, q, torque), model).excitation
    (advice,) = [line for line in said if "limo excite" in line]
    assert ("where ranges and limits of all joints are stated" in advice) != planned
