"""A joint at rest that bears more than its friction holds is held by something outside."""

import numpy as np
import pytest

from estimators.diagnosis.from_torque.residuals.jolts import holds
from estimators.diagnosis.from_torque.residuals.observations import Observations
from limo_driver.app.library.diagnosing import diagnose
from limo_driver.physics import CoulombFriction, Simulation
from limo_driver.recordings.recording import Recording
from limo_driver.types.motion import Motion

RATE, MOVES, RESTS = 100.0, 24.0, 4.0  # [Hz], [s], [s]
FRICTION = 6.0  # [N m]
LINKS = """<mujoco><compiler angle="radian" autolimits="true"/><option gravity="0 0 0"/><worldbody>
<body><joint name="shoulder" axis="0 1 0" range="-3 3"/>
<geom type="capsule" fromto="0 0 0 0 0 0.5" size="0.06" mass="8"/>
<body pos="0 0 0.5"><joint name="elbow" axis="0 1 0" range="-3 3"/>
<geom type="capsule" fromto="0 0 0 0 0 0.4" size="0.05" mass="5"/>
</body></body></worldbody></mujoco>"""


@pytest.fixture(scope="module")
def arm(tmp_path_factory):
    path = tmp_path_factory.mktemp("arm") / "arm.xml"
    path.write_text(LINKS)
    friction = [CoulombFriction(joint=j, tau_c=FRICTION, v_eps=0.005) for j in (1, 2)]
    return Simulation(path, tuple(friction))


def recorded(arm, *pressed, turns=1, far=0.0):
    """Return motion and rest in turns; at each rest, joint 1 bears what is given [N m].

    Args:
        arm: Its simulation.
        pressed: Torque in each of the rests.
        turns: How often it moves and rests.
        far: How far joint 1 has gone beyond its motion as it rests [rad].
    """
    moves, rests = (round(x * RATE) for x in (MOVES, RESTS))
    one = np.concatenate([np.arange(moves) / RATE, np.full(rests, MOVES)])
    course = 0.5 - 0.5 * np.cos(2 * np.pi * np.outer(one / MOVES, (3.0, 5.0)))
    ramp = np.clip(1.5 * one / MOVES - 0.5, 0.0, 1.0)
    course[:, 0] += far * (10 * ramp**3 - 15 * ramp**4 + 6 * ramp**5)
    course += 0.1 * np.sin(2 * np.pi * one / MOVES)[:, None]  # past where it rests, on both sides
    position = np.tile(course, (turns, 1))
    time = np.arange(len(position)) / RATE
    velocity = np.gradient(position, 1 / RATE, axis=0)
    torque = arm.predict(Motion(time, position, velocity, np.gradient(velocity, 1 / RATE, axis=0)))
    for turn, size in enumerate(pressed):
        begin = turn * (moves + rests) + moves
        torque[begin : begin + rests, 0] += size
    torque += np.random.default_rng(4).normal(0.0, 0.05, torque.shape)
    return Recording.from_arrays(time, position, torque)


def found(arm, recording):
    return [(x.start, x.end, x.joints) for x in holds(Observations.of(arm, [recording], 10.0))]


def test_a_wall_is_found_from_the_beginning_of_the_rest_to_its_end(arm):
    for size in (20.0, -20.0):
        ((start, end, joints),) = found(arm, recorded(arm, size))
        assert joints == (0,)
        assert start == pytest.approx(MOVES, abs=0.2)
        assert end == pytest.approx(MOVES + RESTS, abs=0.2)


def test_what_friction_can_hold_is_no_wall(arm):
    assert found(arm, recorded(arm, 1.6 * FRICTION)) == []
    assert found(arm, recorded(arm)) == []


def test_one_rest_of_several_is_found_and_none_where_most_are_alike(arm):
    several = found(arm, recorded(arm, 0.0, 20.0, 0.0, turns=3))
    assert [round(start / (MOVES + RESTS)) for start, _, _ in several] == [2]
    assert found(arm, recorded(arm, 20.0, 20.0, 0.0, turns=3)) == []


def test_where_no_motion_passed_nobody_knows_the_load(arm):
    assert found(arm, recorded(arm, 20.0, far=-1.0)) == []


def test_a_brake_that_holds_a_load_is_no_wall(arm):
    """Drives without current bear nothing of it."""
    recording = recorded(arm)
    loaded = arm.predict(recording.motion(10.0))
    loaded[:, 0] += 30.0  # of a weight that another simulation knows
    rest = recording.time >= MOVES
    torque = np.where(rest[:, None], 0.0, loaded)
    braked = Recording.from_arrays(recording.time, recording.position, torque)
    observed = Observations.of(arm, [braked], 10.0)
    vars(observed)["simulated"] = loaded[observed.kept]
    assert holds(observed) == ()


@pytest.mark.slow("a whole diagnosis")
def test_a_diagnosis_names_the_contact_and_fits_nothing_to_it(arm):
    (finding,) = diagnose(arm, recorded(arm, 20.0)).verdict.findings
    assert (finding.effect, finding.joints) == ("external_contact", (1,))
    assert finding.confidence > 0.95
    # 20 N m at an arm of 0.9 m that hangs from joint 1, which friction may bear a third of
    (wrench,), (ends,) = (getattr(finding.parameters["wrench"], x) for x in ("value", "ci95"))
    assert 5.0 < np.linalg.norm(wrench[:3]) < 60.0
    low, high = np.array(ends).T
    assert (low <= wrench).all()
    assert (wrench <= high).all()
