"""Pushes: found when and where something acts on the arm, and nowhere else."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from noisy_recordings import DURATION, NOISE, RATE, WINDOWS, WRENCHES, half_sines, motion, observed
from scipy.interpolate import CubicSpline

import limo_driver as limo
from estimators.diagnosis.from_torque.contact import ContactIn, wrench_of
from estimators.diagnosis.from_torque.hypotheses.responses import response
from estimators.diagnosis.from_torque.residuals.observations import Observations
from estimators.diagnosis.from_torque.residuals.pushes import Push, covered, pushes
from estimators.diagnosis.from_torque.residuals.reversals import steadily_moving
from limo_driver.physics import CoulombFriction, ExternalContact, Payload, Sensors, Simulation
from limo_driver.recordings.recording import Recording
from limo_driver.types import Motion

BARE = Simulation("iiwa14")


@cache
def paused(start: float = 15.0, seconds: float = 15.0, load: float = 0.0) -> Observations:
    """Record the same motion with the whole arm at rest for a while, by default from 15 to 30 s.

    A load [kg] hangs on it that the simulation does not know.
    """
    true = Simulation("iiwa14", (Payload(mass=load, com=(0.0, 0.02, 0.1)),)) if load else BARE
    time, half = np.arange(0.0, DURATION, 1.0 / RATE), seconds / 2
    pace = np.clip(np.abs(time - start - half) - half, 0.0, 1.0)
    pace = pace**2 * (3 - 2 * pace)
    path = CubicSpline(time, motion(1).position)
    position = path(np.cumsum(pace) / RATE)
    velocity = np.gradient(position, time, axis=0)
    moved = Motion(time, position, velocity, np.gradient(velocity, time, axis=0))
    noise = NOISE * np.random.default_rng(9).standard_normal(position.shape)
    torque = true.predict(moved) + noise
    return Observations.of(BARE, [Recording.from_arrays(time, position, torque)], 10.0)


def test_a_push_is_found_in_its_recording_and_its_seconds() -> None:
    o = observed(half_sines(), seeds=(1, 2), affected=1)

    found = sorted(pushes(o, o.residual), key=lambda push: push.start)

    assert [push.recording for push in found] == [1, 1]
    for push, (start, end) in zip(found, WINDOWS, strict=True):
        assert push.start == pytest.approx(start, abs=0.05)
        assert push.end == pytest.approx(end, abs=0.05)
    rows = covered(o, found)
    assert 0.005 < rows.mean() < 0.05
    assert not rows[o.recording == 0].any()


def test_a_push_that_one_joint_alone_feels_is_found_there() -> None:
    o = observed()
    residual = o.residual.copy()
    time = o.slow.time
    residual[(time > 20) & (time < 20.8), 3] += 0.5

    (found,) = pushes(o, residual)

    assert found.joints == (3,)
    assert (found.start, found.end) == pytest.approx((20.0, 20.8), abs=0.1)


def test_a_push_is_found_though_a_joint_that_feels_it_turns_meanwhile() -> None:
    o = observed()
    residual, time, velocity = o.residual.copy(), o.slow.time, o.slow.velocity
    turns = time[1:][(np.diff(np.sign(velocity[:, 2])) != 0) & (time[1:] > 10) & (time[1:] < 50)]
    away = [np.abs(velocity[np.abs(time - turn) < 1.5, 0]).min() for turn in turns]
    turn = float(turns[int(np.argmax(away))])  # while joint 1 moves on
    start, end = turn - 1.2, turn + 0.5
    within = np.clip((time - start) / (end - start), 0.0, 1.0)
    residual[:, [0, 2]] += 2.0 * np.sin(np.pi * within)[:, None]

    (found,) = pushes(o, residual)

    assert set(found.joints) == {0, 2}
    assert (found.start, found.end) == pytest.approx((start, end), abs=0.1)


@pytest.mark.parametrize("joints", [(0, 1, 3), (0, 3)])
def test_a_push_while_an_arm_comes_to_rest_is_one_if_many_joints_feel_it(joints) -> None:
    """Friction does as much to one joint or two there."""
    o = paused()
    residual, time = o.residual.copy(), o.slow.time
    within = np.clip((time - 13.4) / 1.8, 0.0, 1.0)
    residual[:, list(joints)] += 2.0 * np.sin(np.pi * within)[:, None]

    found = [(push.joints, push.start, push.end) for push in pushes(o, residual)]

    if len(joints) > 2:
        assert found == [(joints, pytest.approx(13.4, abs=0.1), pytest.approx(15.2, abs=0.1))]
    else:
        assert found == []


def test_all_of_many_hits_are_found() -> None:
    o = observed()
    residual, time, random = o.residual.copy(), o.slow.time, np.random.default_rng(3)
    starts = np.linspace(4.0, 56.0, 11) + random.uniform(-1.0, 1.0, 11)
    for start in starts:
        felt = random.choice(o.n, 3, replace=False)
        course = np.sin(np.pi * np.clip((time - start) / 0.3, 0.0, 1.0))
        residual[:, felt] += course[:, None] * random.choice((-1.0, 1.0), 3)

    found = sorted((push.start, push.end) for push in pushes(o, residual))

    assert found == [(pytest.approx(x, abs=0.2), pytest.approx(x + 0.3, abs=0.2)) for x in starts]


def test_what_recurs_is_no_push() -> None:
    """It is as large in a third of all stretches, so it is not rare."""
    o = observed()
    residual, time = o.residual.copy(), o.slow.time
    residual[time % 1.5 < 0.5, 3] += 0.5

    assert pushes(o, residual) == ()


def test_a_push_at_rest_is_found() -> None:
    o = paused()
    residual = o.residual.copy()
    time = o.slow.time
    residual[(time > 15) & (time < 30)] += 0.3  # what friction holds
    residual[(time > 22) & (time < 22.5), :3] += 0.4

    (found,) = pushes(o, residual)

    assert found.joints == (0, 1, 2)
    assert (found.start, found.end) == pytest.approx((22.0, 22.5), abs=0.1)


def test_what_an_arm_does_that_settles_after_its_motion_is_no_push() -> None:
    """All of its joints creep to rest within their friction, and in one course."""
    o = paused()
    time, moves = o.slow.time, o.moving.any(axis=1)
    stop = float(time[(time < 20.0) & moves][-1])

    def found(start: float) -> int:
        residual, since = o.residual.copy(), time - start
        creeping = (since > 0) & (time < 30.0)
        residual[creeping, :5] += 0.3 * np.exp(-since[creeping, None])
        return len(pushes(o, residual))

    assert found(stop + 0.2) == 0
    assert found(stop + 3.0) == 1


@pytest.mark.parametrize("mass", [0.1, 1.0])
def test_what_an_arm_that_rested_long_does_in_motion_is_no_push(mass: float) -> None:
    """At rest physics that is left out changes nothing: that is not what is usual in motion."""
    o = paused(0.0, 42.0, load=mass)

    assert pushes(o, o.residual) == ()


def test_what_an_arm_at_rest_does_as_the_recording_ends_is_no_push() -> None:
    """It may be about to move: the torque that friction holds then changes at all joints."""
    o = paused(DURATION - 15.0)
    residual = o.residual.copy()
    residual[o.slow.time > DURATION - 0.5, :3] += 0.4

    assert pushes(o, residual) == ()
    residual[o.slow.time > DURATION - 0.9, :3] = o.residual[o.slow.time > DURATION - 0.9, :3] + 0.4
    assert pushes(o, residual) != ()


def test_the_column_of_a_push_is_what_the_contact_adds_there_and_nothing_elsewhere() -> None:
    o = observed(seeds=(1, 2))
    window, wrench = (WINDOWS[0],), (WRENCHES[0],)
    everywhere = response(ExternalContact(windows=window, wrench=wrench), o).values

    own = response(ContactIn(windows=window, wrench=wrench, recording=1), o).values

    there = o.recording == 1
    assert own[:, there] == pytest.approx(everywhere[:, there], abs=0.02)  # of 15 N m
    assert not own[:, ~there].any()


def test_a_wrench_is_made_of_unit_half_sines() -> None:
    units = wrench_of(Push(0, 2.0, 3.0, 1.0, (0,)))

    for axis, unit in enumerate(units):
        assert isinstance(unit, ExternalContact)
        assert (unit.windows[0][0], unit.windows[-1][1]) == pytest.approx((2.0, 3.0))
        course = np.array(unit.wrench)
        assert course[:, axis].max() == pytest.approx(1.0, abs=0.02)
        assert not np.delete(course, axis, axis=1).any()


def test_half_a_second_of_motion_has_no_pushes() -> None:
    o = observed()

    assert pushes(o, np.zeros_like(o.residual)) == ()
    assert covered(o, [Push(0, 1.0, 2.0, 1.0, (0,))]).sum() == pytest.approx(1.6 * 25, abs=2)


@pytest.mark.slow("looks for pushes in a minute twice")
def test_what_one_joint_does_at_times_more_and_at_times_less_is_no_push() -> None:
    o = observed()
    residual = o.residual.copy()
    time = o.slow.time
    for start, size in ((20.0, 0.2), (31.0, 0.11), (45.0, 0.11)):
        residual[(time > start) & (time < start + 0.4), 3] += size

    assert pushes(o, residual) == ()
    residual[time > 25.0] = o.residual[time > 25.0]
    assert [push.joints for push in pushes(o, residual)] == [(3,)]


def test_what_one_joint_does_more_of_where_that_is_no_push_is_none() -> None:
    """As a sensor does that jumps, whatever the arm does meanwhile."""
    o = observed()
    time, turn = o.slow.time, turn_after(o, 3, 40.0)

    def found(size: float) -> list[tuple[int, ...]]:
        residual = o.residual.copy()
        residual[(time > 20.0) & (time < 20.8), 3] += 0.3
        residual[np.abs(time - turn) < 0.8, 3] += size
        return [push.joints for push in pushes(o, residual)]

    assert found(0.0) == [(3,)]
    assert found(0.6) == []


def test_what_one_joint_does_as_it_turns_is_no_push() -> None:
    o = observed()
    residual = o.residual.copy()
    time, turns = o.slow.time, np.flatnonzero(np.diff(np.sign(o.slow.velocity[:, 3])))
    start = time[turns[np.searchsorted(time[turns], 20.0)]] + 0.35
    residual[(time > start) & (time < start + 0.3), 3] += 0.3

    assert pushes(o, residual) == ()
    residual[(time > start) & (time < start + 0.3), 1] += 0.3
    assert len(pushes(o, residual)) == 1


def test_what_one_joint_does_as_it_vibrates_is_no_push() -> None:
    o = observed()
    residual = o.residual.copy()
    time = o.slow.time
    shaking = (time > 30.0) & (time < 32.0)
    residual[shaking, 3] += 0.12 * np.sin(2 * np.pi * 2.5 * (time[shaking] - 30.0))

    assert pushes(o, residual) == ()


def test_noise_beside_fast_travel_is_no_push() -> None:
    """Where the arm accelerates much, noise is no smaller for it."""
    arm = limo.Simulation(
        "iiwa14",
        (*(CoulombFriction(joint=j, tau_c=1.0, v_eps=0.002) for j in range(1, 8)),),
        sensors=Sensors(torque_noise=(0.05, 0.05, 0.04, 0.04, 0.03, 0.02, 0.02)),
    )
    trajectory = limo.plan("iiwa14", limo.PlanRequest(scaffolds=4), seed=5)
    o = Observations.of(arm, [limo.run("mujoco", trajectory, simulation=arm)], 10.0)

    assert pushes(o, o.residual) == ()


@cache
def swinging() -> Observations:
    """Record joints that swing at about a third of a hertz, 100 times a second."""
    random, time = np.random.default_rng(4), np.arange(0.0, 30.0, 0.01)
    rate = 2 * np.pi * np.array([0.31, 0.37, 0.43, 0.29, 0.35, 0.41, 0.33])
    phase = rate * time[:, None] + random.uniform(0.0, 6.0, 7)
    position, velocity = 0.6 * np.sin(phase), 0.6 * rate * np.cos(phase)
    moved = Motion(time, position, velocity, -(rate**2) * position)
    torque = Simulation("iiwa14").predict(moved) + NOISE * random.standard_normal(position.shape)
    return Observations.of(
        Simulation("iiwa14"), [Recording.from_arrays(time, position, torque)], 10.0
    )


def test_what_one_joint_does_as_it_turns_at_speed_is_no_push() -> None:
    o = swinging()
    time, velocity = o.slow.time, o.slow.velocity[:, 3]
    turns = time[np.flatnonzero(np.diff(np.sign(velocity)))]
    turn = float(turns[np.searchsorted(turns, 12.0)])
    assert o.moving[np.abs(time - turn) < 0.5, 3].all()  # it passes through rest between rows

    def found(start: float) -> list[tuple[int, ...]]:
        residual = o.residual.copy()
        residual[(time > start) & (time < start + 0.3), 3] += 0.3
        return [push.joints for push in pushes(o, residual)]

    assert found(turn - 0.15) == []
    assert found(turn + 0.6) == [(3,)]


def turn_after(o: Observations, joint: int, start: float) -> float:
    """Return when a joint (0-based) turns first after some time [s]."""
    time, velocity = o.slow.time, o.slow.velocity[:, joint]
    turns = time[np.flatnonzero(np.diff(np.sign(velocity)))]
    return float(turns[np.searchsorted(turns, start)])


def test_what_joints_do_whenever_they_turn_is_no_push() -> None:
    o = swinging()
    residual, time = o.residual.copy(), o.slow.time
    random = np.random.default_rng(3)
    for joint in range(7):
        turn = turn_after(o, joint, 0.0)
        while turn < 28.0:
            residual[np.abs(time - turn) < 0.15, joint] += 0.5 * random.uniform(0.5, 1.5)
            turn = turn_after(o, joint, turn + 0.1)

    assert pushes(o, residual) == ()


def test_a_push_over_reversals_of_all_joints_that_feel_it_is_found_beyond_what_they_do_there() -> (
    None
):
    """Errors about reversals are held against those of the same joint at its other reversals."""
    o = swinging()
    random, residual, time = np.random.default_rng(3), o.residual.copy(), o.slow.time
    for joint in (1, 3):
        turn = turn_after(o, joint, 0.0)
        while turn < 27.0:
            residual[np.abs(time - turn) < 0.15, joint] += 0.2 * random.uniform(0.5, 1.5)
            turn = turn_after(o, joint, turn + 0.1)
    starts = np.arange(5.0, 24.0, 0.1)
    apart = [turn_after(o, 1, start) - turn_after(o, 3, start) for start in starts]
    turn = turn_after(o, 1, float(starts[int(np.argmin(np.abs(apart)))]))
    near = np.abs(time - turn) < 0.25
    assert not steadily_moving(o)[near][:, [1, 3]].any()
    course = np.cos(np.pi * np.clip((time - turn) / 0.6, -0.5, 0.5))

    assert pushes(o, residual) == ()
    residual[:, [1, 3]] += 2.0 * course[:, None]
    (found,) = pushes(o, residual)

    assert set(found.joints) == {1, 3}
    assert (found.start, found.end) == pytest.approx((turn - 0.3, turn + 0.3), abs=0.2)


def test_what_decays_from_the_start_of_the_motion_is_no_push() -> None:
    o = swinging()
    time = o.slow.time

    def found(start: float) -> int:
        residual, since = o.residual.copy(), np.clip(time - start, 0.0, None)
        decay = (since > 0) * np.exp(-since / 0.6) * np.sin(2 * np.pi * 1.2 * since)
        residual[:, :3] += 2.0 * decay[:, None]
        return len(pushes(o, residual))

    assert found(0.0) == 0
    assert found(10.0) > 0


def test_a_push_whose_lever_changes_meanwhile_keeps_its_times() -> None:
    o = swinging()
    residual, time = o.residual.copy(), o.slow.time
    within = np.clip((time - 12.8) / 1.0, 0.0, 1.0)
    residual[:, :3] += (np.sin(np.pi * within) * (1.0 - 0.9 * within))[:, None]

    (found,) = pushes(o, residual)

    assert (found.start, found.end) == pytest.approx((12.8, 13.8), abs=0.1)


@cache
def held(pushed: tuple[tuple[float, float], ...]) -> Observations:
    """Record an arm that holds still for 30 s, while one joint feels pushes of 0.5 N m."""
    random, time = np.random.default_rng(11), np.arange(0.0, 30.0, 1.0 / RATE)
    position = motion(1).position[0] + 1e-5 * random.standard_normal((time.size, 7))
    torque = Simulation("iiwa14").predict(
        Motion(time, position, 0 * position, 0 * position)
    ) + NOISE * random.standard_normal(position.shape)
    for start, end in pushed:
        torque[(time > start) & (time < end), 0] += 0.5
    return Observations.of(
        Simulation("iiwa14"), [Recording.from_arrays(time, position, torque)], 10.0
    )


def test_several_pushes_that_one_joint_alone_feels_are_found_at_rest() -> None:
    times = ((5.0, 5.6), (11.0, 12.0), (20.0, 20.8))
    o = held(times)

    found = sorted(pushes(o, o.residual), key=lambda push: push.start)

    assert [push.joints for push in found] == [(0,)] * 3
    for push, (start, end) in zip(found, times, strict=True):
        assert (push.start, push.end) == pytest.approx((start, end), abs=0.1)


def test_nothing_is_found_where_nothing_pushes_an_arm_at_rest() -> None:
    o = held(())

    assert pushes(o, o.residual) == ()
