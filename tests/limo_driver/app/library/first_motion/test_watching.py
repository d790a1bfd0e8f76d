"""What is said of an arm that is only watched, and of one that does something else."""

import numpy as np
import pytest

from limo_driver.app.library.first_motion.gravity import TOLERANCE
from limo_driver.app.library.first_motion.motions import (
    ANGLE,
    JOINT_SPEED,
    UnexpectedMotionError,
    Watchman,
    one_joint,
    slow_limopa,
)
from limo_driver.app.library.first_motion.watching import Watch, WatchSettings
from limo_driver.errors import ConfigError, PathError
from limo_driver.model import RobotModel
from limo_driver.robot.registry import Examination
from limo_driver.types import JointState, RobotSpec
from limopa import Exploring, Surroundings

ARM = RobotModel.load("iiwa14")
START = np.array([0.0, 0.5, 0.0, -1.2, 0.0, 0.9, 0.0])
PERIOD = 0.002


class Played:
    """A robot that plays rows: a state, None for a lost one, or a number of lost packets."""

    silent_joints = (3,)

    def __init__(self, rows):
        self.spec = RobotSpec(ARM.name, ARM.joint_names, ARM.limits, PERIOD)
        self._rows, self._time, self._last, self.lost = iter(rows), 0.0, None, 0

    def now(self):
        return self._time

    def receive(self):
        row = next(self._rows)
        self._time += PERIOD
        if row is None:
            self.lost += 1
            return JointState(*self._last, stale=True)
        if isinstance(row, tuple):  # after so much time, and so many lost
            pause, lost, row = row
            self._time += pause
            self.lost += lost
        self._last = (self._time, row, np.zeros(7), ARM.gravity_torque(row[None])[0], 0)
        return JointState(*self._last)


def codes(rows, **settings):
    time = sum(PERIOD + (row[0] if isinstance(row, tuple) else 0.0) for row in rows)
    given = {"duration": time - 0.5 * PERIOD, "poses": 0, "still": 0.02} | settings
    watch = Watch(Played(rows), WatchSettings(**given), TOLERANCE * ARM.limits.torque)
    watch.run(lambda *_: None)
    found = Examination()
    watch.judge(found)
    return {each.code: each.text for each in found.findings if each.problem}, watch


@pytest.mark.parametrize(
    ("lost", "named"), [(0, None), (4, None), (5, "loose-cable"), (50, "loose-cable")]
)
def test_a_time_without_measurements_is_a_loose_cable_from_10_ms_on(lost, named):
    found, watch = codes([*[START] * 5000, *[None] * lost, *[START] * 10])
    assert set(found) == ({named} if named else set())
    if named:
        assert watch.interruptions[0].length == pytest.approx(lost * PERIOD)
        assert "joint 3" in found[named]


def test_single_losses_are_told_from_a_loose_cable():
    found, _ = codes([START, START, None] * 300)
    assert set(found) == {"loss"}


def test_measurements_that_come_late_are_jitter_and_no_loss():
    found, _ = codes([START, START, (0.02, 0, START)] * 100)
    assert set(found) == {"jitter"}


@pytest.mark.parametrize(("over", "named"), [(0.009, False), (0.011, True)])
def test_poses_beyond_the_ranges_of_the_description_are_named(over, named):
    pose = START.copy()
    pose[3] = ARM.limits.position_max[3] + over
    found, _ = codes([pose] * 5)
    assert ("range" in found) is named
    if named:
        assert found["range"].startswith("joint 4 was measured at 2.1")


def test_poses_count_once_and_only_at_rest():
    other = START + 0.31
    moving = list(np.linspace(START, other, 200))
    found, watch = codes(
        [*[START] * 30, *moving, *[other] * 30, *moving[::-1], *[START] * 30], poses=3
    )
    assert len(watch.poses) == 2
    assert set(found) == {"poses"}


def test_one_joint_goes_two_degrees_to_the_middle_of_its_range_and_back():
    at = START.copy()
    at[6] = 1.0
    motion = one_joint(ARM, at, 7)
    way = motion.position - at
    assert way[:, 6].min() == pytest.approx(-ANGLE)
    assert np.abs(way[:, :6]).max() == 0.0
    assert way[-1] == pytest.approx(np.zeros(7))
    share = motion.peaks().over(ARM.limits).velocity.max()
    assert 0.5 * JOINT_SPEED < share <= JOINT_SPEED * 1.001


@pytest.mark.parametrize(("joint", "error"), [(0, ConfigError), (8, ConfigError)])
def test_a_joint_that_is_not_there_is_refused(joint, error):
    with pytest.raises(error, match="expected 1 to 7"):
        one_joint(ARM, START, joint)


def test_a_joint_beyond_its_range_is_not_moved():
    at = START.copy()
    at[6] = ARM.limits.position_max[6] + 0.1
    with pytest.raises(PathError, match="beyond its range"):
        one_joint(ARM, at, 7)


def test_limopa_starts_where_the_arm_stands_at_a_tenth_of_the_speed():
    quick = Exploring(velocity=(0.05, 0.1), waypoints=(100, 110))
    motion = slow_limopa(ARM, START, 1, 0, Surroundings(), quick)
    assert motion.position[0] == pytest.approx(START)
    assert motion.peaks().over(ARM.limits).velocity.max() <= 0.1001
    assert [each.kind for each in motion.segments] == ["approach", "exploring"]


def test_a_motion_that_would_be_faster_is_refused():
    quick = Exploring(velocity=(0.5, 0.6), waypoints=(2000, 2100))
    with pytest.raises(PathError, match="expected at most 10%"):
        slow_limopa(ARM, START, 1, 0, Surroundings(), quick)


def test_an_arm_that_stands_in_the_table_is_told_so():
    with pytest.raises(PathError, match="where the arm stands"):
        slow_limopa(ARM, START, 1, 0, Surroundings(table_height=0.9), Exploring())


@pytest.mark.parametrize(
    ("change", "kind"),
    [
        ({"position": (3, 0.0089)}, "wrong-joint"),
        ({"position": (6, -0.03)}, "not-following"),
        ({"torque": (3, 18.0)}, "contact"),
        ({}, None),
    ],
)
def test_an_arm_that_does_something_else_is_stopped_by_what_it_does(change, kind):
    moving = np.arange(7) == 6
    watchman = Watchman(ARM, START, moving, lambda: START, ANGLE / 2)
    values = {"position": START.copy(), "torque": ARM.gravity_torque(START[None])[0].copy()}
    for name, (j, by) in change.items():
        values[name][j] += by
    state = JointState(0.0, values["position"], np.zeros(7), values["torque"], 0)
    if kind is None:
        watchman.look(state)
        return
    with pytest.raises(UnexpectedMotionError) as ended:
        watchman.look(state)
    assert ended.value.kind == kind
