"""Torques, wrenches and gains from one cycle to the next, each limit from both sides."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from limo_driver.robot.efforts import EffortLimits, GainLimits
from limo_driver.robot.setpoints import TORQUE, WRENCH, names_of
from limo_driver.types import JointLimits

PERIOD = 0.004  # [s]
ZERO = np.zeros(3)
LIMITS = JointLimits(*[np.ones(3)] * 5, np.array([100.0, 20.0, 4.0]), np.array([1e3, 2e2, 40.0]))
STEP = LIMITS.torque_rate * PERIOD
each_way = pytest.mark.parametrize("sign", [-1.0, 1.0])


def only(j, value, others=ZERO):
    return np.where(np.arange(3) == j, value, others)


class TestEfforts:
    MOST, RATE = np.array([10.0, 0.0, 3.0]), np.array([500.0, 100.0, 25.0])

    def follow(self, target, effort, bit=TORQUE):
        reached, hit = EffortLimits(self.MOST, self.RATE, PERIOD, bit).follow(target, effort)
        return reached, names_of(hit)

    @each_way
    def test_size_is_limited(self, sign):
        most = sign * self.MOST
        assert self.follow(most, most) == (pytest.approx(most), ())
        for j in (0, 2):
            over = only(j, most[j] * (1 + 1e-12), most)
            assert self.follow(over, most) == (pytest.approx(most), ("torque",))
        assert self.follow(only(1, sign * 1e-300, most), most)[1] == ("torque",)

    @each_way
    @pytest.mark.parametrize("j", [0, 2])
    def test_rate_is_limited(self, sign, j):
        step = sign * self.RATE[j] * PERIOD
        for effort in (ZERO, only(j, 0.4 * sign * self.MOST[j]), only(j, -sign * self.MOST[j])):
            within = only(j, effort[j] + step * (1 - 1e-9))
            reached, met = self.follow(within, effort)
            assert np.array_equal(reached, within)
            assert met == ()
            reached, met = self.follow(only(j, effort[j] + step * (1 + 1e-9)), effort)
            assert reached[j] == pytest.approx(effort[j] + step, rel=1e-12)
            assert met == ("torque_rate",)

    def test_both_are_named_each_after_its_kind(self):
        far = 2 * self.MOST
        assert self.follow(far, ZERO)[1] == ("torque", "torque_rate")
        assert self.follow(far, ZERO, WRENCH)[1] == ("wrench", "wrench_rate")
        assert self.follow(far, self.MOST, WRENCH)[1] == ("wrench",)
        assert self.follow(only(0, 9.0), ZERO, WRENCH)[1] == ("wrench_rate",)
        mixed = only(0, 20.0, only(2, 3.0))  # joint 1 is too high, joint 3 too quick
        assert self.follow(mixed, only(0, 10.0))[1] == ("torque", "torque_rate")

    @each_way
    @pytest.mark.parametrize("carried", [4.0, -4.0])
    def test_what_is_carried_along_counts(self, sign, carried):
        """The drive makes 10 N m at most: of what it is told less, or more the other way."""
        limits = EffortLimits(self.MOST, self.RATE, PERIOD, TORQUE)
        for over, met in ((1e-9, ("torque",)), (-1e-9, ())):
            most = sign * 10.0 - carried
            reached, hit = limits.follow(
                only(0, most + sign * over), only(0, most - sign), only(0, carried)
            )
            assert reached[0] == pytest.approx(most)
            assert names_of(hit) == met
        far = limits.follow(only(0, sign * 10.0), only(0, sign * 9.0), only(0, sign * 4.0))[0]
        assert far[0] == pytest.approx(sign * (10.0 - 4.0 + 1.0))  # as far as the rate allows

    def test_what_nobody_wants_fades_at_its_rate(self):
        limits = EffortLimits(self.MOST, self.RATE, PERIOD, TORQUE)
        assert limits.fade(np.array([5.0, 0.0, -0.05])) == pytest.approx([3.0, 0.0, 0.0])
        assert limits.fade(np.array([-5.0, 0.0, 3.0]), 2) == pytest.approx([-1.0, 0.0, 2.8])


class TestGains:
    limits = GainLimits(LIMITS, PERIOD)

    def follow(self, wanted, before, away=ZERO, velocity=ZERO):
        gains, hit = self.limits.follow(wanted, before, away, velocity, ZERO)
        return gains, names_of(hit)

    def test_are_as_commanded_where_they_make_no_torque(self):
        wanted = (np.full(3, 100.0), np.full(3, 10.0), ZERO)
        gains, met = self.follow(wanted, (ZERO, ZERO, ZERO))
        assert met == ()
        assert np.array_equal(gains, wanted)

    def test_have_rates_of_their_own(self):
        """From nothing to a full torque at 1 mrad, or 10 mrad/s, in 0.1 s."""
        wanted = (np.full(3, 1e9), np.full(3, 1e9), ZERO)
        gains, met = self.follow(wanted, (ZERO, ZERO, ZERO))
        assert met == ("gain_rate",)
        assert gains[0] == pytest.approx(0.04 * LIMITS.torque / 1e-3)
        assert gains[1] == pytest.approx(0.04 * LIMITS.torque / 1e-2)

    @each_way
    def test_change_torques_at_their_rate(self, sign):
        """On and off, far from the set-point."""
        away, gains = only(0, sign * 0.3), (ZERO, ZERO, ZERO)
        for k in range(40):
            wanted = (only(0, 300.0), ZERO, ZERO)
            gains, met = self.follow(wanted, gains, away)
            assert gains[0][0] * 0.3 == pytest.approx(min(90.0, (k + 1) * STEP[0]))
            assert met == (("torque_rate",) if (k + 1) * STEP[0] < 90.0 else ())
        gains, met = self.follow((ZERO, ZERO, ZERO), gains, away)
        assert gains[0][0] * 0.3 == pytest.approx(90.0 - STEP[0])

    def test_of_saturated_drives_go_down_without_waiting_for_what_was_never_there(self):
        """A drive makes no more than its torque, and what it compensates is no more than that."""
        gains, _ = self.follow((ZERO, ZERO, ZERO), (np.full(3, 1e3), ZERO, ZERO), only(0, 1.0))
        assert gains[0][0] == pytest.approx(200.0 - STEP[0])

    def test_keep_the_feed_forward_within_its_limits_alone(self):
        far = (ZERO, ZERO, 2 * LIMITS.torque)
        gains, met = self.follow(far, (ZERO, ZERO, ZERO))
        assert met == ("torque", "torque_rate")
        assert gains[2] == pytest.approx(STEP)

    @each_way
    def test_are_less_where_the_feed_forward_would_be_more_than_a_drive_can_be_told(self, sign):
        """A spring that begins anew, in motion: its damping is made up for by a torque."""
        damping, velocity, torque = only(0, 10.0), only(0, sign * 2.0), only(0, sign * 115.0)
        before = ZERO, damping, torque  # 95 N m in all
        gains, _ = self.follow(before, before, velocity=velocity)
        assert gains[2][0] == pytest.approx(sign * 100.0)
        assert gains[2][0] - gains[1][0] * velocity[0] == pytest.approx(sign * 95.0, abs=STEP[0])

    @settings(max_examples=60)
    @given(st.lists(st.floats(-1.0, 1.0), min_size=24, max_size=24))
    def test_never_step(self, drawn):
        draw = np.array(drawn).reshape(8, 3)
        before = np.abs(draw[0]) * 1e4, np.abs(draw[1]) * 1e2, draw[2] * LIMITS.torque
        wanted = np.abs(draw[3]) * 1e4, np.abs(draw[4]) * 1e2, draw[5] * 2 * LIMITS.torque
        away, velocity = draw[6], draw[7]
        gains, met = self.follow(wanted, before, away, velocity)
        kept = all(np.allclose(a, b, 1e-12, 1e-12) for a, b in zip(gains, wanted, strict=True))
        assert (met == ()) == kept  # what changed a command is told
        torques = [k * away - d * velocity + t for k, d, t in (before, gains)]
        most = 2 * LIMITS.torque
        change = np.abs(np.diff(np.clip(torques, -most, most), axis=0))
        assert (change <= STEP * (1 + 1e-6)).all()
        for one, other, goal in zip(before, gains, wanted, strict=True):  # and no way back
            low, high = np.minimum(one, goal), np.maximum(one, goal)
            assert (other >= low - 1e-9 * (1 + abs(low))).all()
            assert (other <= high + 1e-9 * (1 + abs(high))).all()
