"""What touches an arm: the force in a recording, and from which torque on it is a contact."""

import numpy as np
import pytest

import limo_driver as limo
from limo_driver.errors import ConfigError, RecordingError

FORCE = np.array([3.0, -4.0, 12.0])  # [N] on the flange, in the axes of the base
PUSHED = (3.0, 4.0)  # [s]
BIAS = np.linspace(-0.3, 0.3, 7)  # [N m] of sensors


def moving(seconds, rate=250.0):
    t = np.arange(0.0, seconds, 1.0 / rate)
    swing = 0.2 * np.sin(np.outer(t, np.linspace(0.7, 1.9, 7)) + np.arange(7))
    return t, np.array([0.0, 0.6, 0.0, -1.2, 0.0, 0.9, 0.0]) + swing


@pytest.fixture(scope="module")
def arm(hysteretic):
    return hysteretic.without_effects()


@pytest.fixture(scope="module")
def scan(arm):
    """A recording of an arm that is pushed for a second, whose sensors are biased."""
    t, position = moving(5.0)
    torque = arm.predict(limo.Motion.from_positions(t, position)) + BIAS
    pushed = (t > PUSHED[0]) & (t < PUSHED[1])
    torque[pushed] -= [arm.model.flange_jacobian(q)[:3].T @ FORCE for q in position[pushed]]
    return limo.Recording.from_arrays(t, position, torque)


def within(found, begin, end):
    return (found.time > begin) & (found.time < end)


class TestWrench:
    def test_is_that_of_the_push_less_what_there_is_without(self, arm, scan):
        found = limo.external_wrench(arm, scan, untouched=(0.5, 2.5))
        assert found.bias == pytest.approx(BIAS, abs=0.02)
        assert found.force[within(found, 3.3, 3.7)] == pytest.approx(13.0, rel=0.03)
        assert found.force[within(found, 1.0, 2.0)].max() < 0.5
        assert np.isfinite(found.std).all()
        assert "force at" in str(found)
        assert "95 % of its errors within" in found.headline()

    def test_has_the_axes_of_its_frame(self, arm, scan):
        found = limo.external_wrench(arm, scan, untouched=(0.5, 2.5))
        k = int(np.flatnonzero(within(found, 3.49, 3.51))[0])
        axes = arm.model.flange_pose(scan.position[k])[:3, :3]
        assert axes @ found.value[k, :3] == pytest.approx(FORCE, abs=0.4)

    def test_may_have_the_axes_of_the_base(self, arm, scan):
        found = limo.external_wrench(arm, scan, untouched=(0.5, 2.5), in_base=True)
        during = within(found, 3.3, 3.7)
        assert found.value[during, :3].mean(axis=0) == pytest.approx(FORCE, abs=0.4)
        own = limo.external_wrench(arm, scan, untouched=(0.5, 2.5))
        assert found.force == pytest.approx(own.force, rel=1e-6)

    def test_is_surest_at_the_push_and_not_in_a_singular_pose(self, arm):
        """The arm passes through a stretched elbow, where errors of torque look like 100 N."""
        t, position = moving(5.0)
        position[:, 3] = np.where(t < PUSHED[0], 0.9 * np.sin(2.0 * t), position[:, 3])
        torque = arm.predict(limo.Motion.from_positions(t, position))
        torque += np.random.default_rng(2).normal(0.0, 0.5, torque.shape)
        pushed = (t > PUSHED[0] + 0.3) & (t < PUSHED[1])
        torque[pushed] -= [arm.model.flange_jacobian(q)[:3].T @ FORCE for q in position[pushed]]
        recording = limo.Recording.from_arrays(t, position, torque)
        found = limo.external_wrench(arm, recording, untouched=(0.1, 2.5), in_base=True)
        assert found.time[found.force.argmax()] < PUSHED[0] < found.time[found.certainty.argmax()]

    def test_of_a_simulation_has_no_interval_where_nothing_says_its_errors(self, arm, scan):
        found = limo.external_wrench(arm, scan)
        assert np.isnan(found.std).all()
        assert found.bias == pytest.approx(np.zeros(7), abs=0)
        assert "95 % of its errors" not in found.headline()

    @pytest.mark.parametrize(
        ("changes", "said"),
        [
            ({"untouched": (7.0, 9.0)}, "0 samples are untouched, from 7 to 9 s"),
            ({"frame": "probe"}, "no frame 'probe'"),
        ],
    )
    def test_that_cannot_be_found_says_why(self, arm, scan, changes, said):
        with pytest.raises((ConfigError, RecordingError), match=said):
            limo.external_wrench(arm, scan, **changes)

    def test_takes_torque_of_every_joint(self, arm, scan):
        torque = scan.torque.copy()
        torque[:, 2] = np.nan
        partial = limo.Recording.from_arrays(scan.time, scan.position, torque)
        with pytest.raises(RecordingError, match="no torque of joint 3"):
            limo.external_wrench(arm, partial)


@pytest.fixture(scope="module")
def free(arm):
    t, position = moving(60.0)
    torque = arm.predict(limo.Motion.from_positions(t, position))
    torque += 0.2 * np.random.default_rng(1).standard_normal(torque.shape)
    return limo.Recording.from_arrays(t, position, torque)


class TestThresholds:
    def test_are_above_the_errors_and_rise_as_alarms_are_to_be_rarer(self, arm, free):
        often, seldom = (
            np.array(limo.contact_thresholds(arm, free, false_alarms=rate)) for rate in (60.0, 1.0)
        )
        assert often.shape == (7,)
        assert (seldom > often).all()
        error = free.filtered_torque(10.0) - arm.predict(free, 10.0)
        assert (often > 2.0 * error.std(axis=0)).all()
        assert (seldom < 12.0 * error.std(axis=0)).all()

    def test_hold_where_motion_is_unlike_what_was_learned(self, arm, free):
        model = limo.train(arm, free[: len(free) // 2], "joint-physics", bandwidth=10.0)
        moved = limo.Recording.from_arrays(free.time, free.position + 0.3, free.torque)
        far = np.array(limo.contact_thresholds(model, moved))
        near = np.array(limo.contact_thresholds(model, free))
        assert min(far[1], far[3]) > 3.0  # gravity is another one there
        assert (near < 2.0).all()

    def test_take_longer_motion_than_a_moment(self, arm, free):
        first = free[:500]
        with pytest.raises(RecordingError, match="record"):
            limo.contact_thresholds(arm, first)

    @pytest.mark.parametrize("rate", [0.0, -1.0, np.inf])
    def test_of_an_impossible_rate_are_refused(self, arm, free, rate):
        with pytest.raises(ConfigError, match="false alarms an hour"):
            limo.contact_thresholds(arm, free, false_alarms=rate)
