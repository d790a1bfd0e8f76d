"""The last guard before the wire, held from both sides of each number."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from backends.fri.wire_limits import WireLimits, numbers
from limo_driver.types import JointLimits, RobotSpec, WrenchLimits

some = settings(max_examples=50)
each_way = pytest.mark.parametrize("sign", [-1.0, 1.0])
PERIOD = 0.004  # [s]
LIMITS = JointLimits(
    position_min=np.array([-1.0, 0.5]),
    position_max=np.array([1.0, 2.0]),
    velocity=np.array([0.5, 2.0]),
    acceleration=np.ones(2),
    jerk=np.ones(2),
    torque=np.array([100.0, 10.0]),
    torque_rate=np.array([1000.0, 500.0]),
)
WRENCH = WrenchLimits(wrench=np.arange(10.0, 70.0, 10.0), rate=np.arange(100.0, 700.0, 100.0))
SPEC = RobotSpec("arm", ("a", "b"), LIMITS, PERIOD, WRENCH)
POSE = (0.25, 1.0)


def only(j, value, others=(0.0, 0.0)):
    """Return `others` with one joint changed."""
    return tuple(value if k == j else other for k, other in enumerate(others))


def anchored(position=POSE, spec=SPEC):
    wire = WireLimits(spec)
    wire.begin(position)
    return wire


@some
@given(st.lists(st.tuples(st.floats(-0.05, 0.05), st.floats(-0.02, 0.02)), max_size=30))
def test_what_is_sent_as_it_is_without_a_look_at_each_joint_is_what_would_be_sent(steps):
    """Near the end of the range of the first joint, which the others can cross."""
    near = (LIMITS.position_max[0] - 0.005, LIMITS.position_min[1] + 0.005)
    quick, slow, wanted = anchored(near), anchored(near), np.array(near)
    for step in steps:
        wanted = wanted + step
        assert quick.setpoint(wanted) == slow.position(numbers(wanted))
        assert quick.changed == slow.changed


@pytest.mark.parametrize("j", [0, 1])
@each_way
class TestPositionAtTheWire:
    def test_moves_by_the_velocity_limit_at_most(self, j, sign):
        """But for two millionths of it, which is rounding."""
        step = sign * LIMITS.velocity[j] * PERIOD
        for factor, changed in (
            (0.95, 0), (1.0, 0), (1 + 1.7e-6, 0), (1 + 2.4e-6, 1), (1.05, 1), (3.0, 1),
        ):  # fmt: skip
            wire = anchored()
            wanted = only(j, POSE[j] + step * factor, POSE)
            sent = wire.position(wanted)
            assert wire.changed == changed, factor
            assert (sent is wanted) == (not changed)
            if changed:
                assert sent == pytest.approx(only(j, POSE[j] + step, POSE), rel=3e-6)
                assert abs(sent[j] - POSE[j]) <= abs(step) * (1 + 2.4e-6)

    def test_is_compared_with_the_one_before(self, j, sign):
        wire, step = anchored(), sign * LIMITS.velocity[j] * PERIOD
        for cycle in range(1, 30):
            assert wire.position(only(j, POSE[j] + 40 * step, POSE))[j] == pytest.approx(
                POSE[j] + cycle * step, rel=1e-5
            )
            assert wire.changed == cycle

    def test_may_be_just_outside_the_range(self, j, sign):
        end = (LIMITS.position_max if sign > 0 else LIMITS.position_min)[j]
        wire = anchored()
        for beyond, fine in ((-0.1, 1), (0.0095, 1), (0.01, 1), (0.0105, 0), (0.1, 0)):
            assert wire.usable(only(j, end + sign * beyond, POSE)) == bool(fine), beyond

    def test_beyond_that_is_not_sent(self, j, sign):
        end = (LIMITS.position_max if sign > 0 else LIMITS.position_min)[j]
        inside = only(j, end + sign * 0.0095, POSE)
        wire = anchored(inside)
        assert wire.position(only(j, end + sign * 0.0105, POSE)) == inside
        assert wire.changed == 1
        assert wire.position(inside) is inside
        assert wire.changed == 1

    @pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
    def test_that_is_none_leaves_the_joint_where_it_is(self, j, sign, bad):
        wire, other = anchored(), 1 - j
        assert not wire.usable(only(j, bad, POSE))
        moved = only(other, POSE[other] + sign * 1e-4, only(j, bad, POSE))
        assert wire.position(moved) == only(other, moved[other], POSE)
        assert wire.changed == 1


class TestWire:
    def test_sends_nothing_where_nobody_knows_where_the_arm_stands(self):
        wire = WireLimits(SPEC)
        assert not wire.anchored
        assert wire.position(POSE) is None
        assert wire.reachable((9.0, 9.0)) == (9.0, 9.0)
        assert wire.changed == 0
        wire.begin(POSE)
        assert wire.anchored
        assert wire.reachable((9.0, 9.0)) != (9.0, 9.0)
        assert wire.position(POSE) is POSE

    def test_begins_anew_without_effort(self):
        wire = anchored()
        wire.torque((4.0, 2.0))
        wire.begin(POSE)
        assert wire.torque((8.0, 2.0)) == pytest.approx((4.0, 2.0))

    @pytest.mark.parametrize("kind", ["torque", "wrench"])
    @each_way
    def test_effort_changes_by_its_rate_at_most(self, kind, sign):
        """But for a billionth of it, which is rounding."""
        rate = LIMITS.torque_rate if kind == "torque" else WRENCH.rate
        step = sign * rate * PERIOD
        for factor, changed in (
            (0.95, 0), (1.0, 0), (1 + 0.8e-9, 0), (1 + 1.3e-9, 1), (1.05, 1), (3.0, 1),
        ):  # fmt: skip
            for j in range(step.size):
                wire, wanted = anchored(), np.zeros(step.size)
                wanted[j] = step[j] * factor
                sent = getattr(wire, kind)(tuple(wanted))
                assert wire.changed == changed, factor
                wanted[j] = step[j] * min(factor, 1 + 1e-9)
                assert sent == pytest.approx(tuple(wanted), rel=1e-12)

    @pytest.mark.parametrize("kind", ["torque", "wrench"])
    @each_way
    def test_effort_has_a_limit(self, kind, sign):
        most = sign * (LIMITS.torque if kind == "torque" else WRENCH.wrench)
        wire = anchored()
        limit = getattr(wire, kind)
        for _ in range(60):
            limit(tuple(most))
        before = wire.changed
        assert limit(tuple(most)) == tuple(most)
        assert wire.changed == before
        assert limit(tuple(most * (1 + 1e-9))) == pytest.approx(tuple(most), rel=1e-15)
        assert wire.changed == before + 1
        assert limit(tuple(0.999 * most)) == pytest.approx(tuple(0.999 * most), rel=1e-15)
        assert wire.changed == before + 1

    def test_effort_that_nobody_wants_goes_to_zero_at_its_rate(self):
        wire = anchored()
        for _ in range(5):
            wire.torque((8.0, -4.0))
        changed = wire.changed
        sent = [wire.torque(None) for _ in range(4)]
        assert np.array(sent) == pytest.approx(
            np.array([[4.0, -2.0], [0.0, 0.0], [0.0, 0.0], [0.0, 0.0]]), abs=2e-8
        )
        assert sent[-1] == (0.0, 0.0)
        assert wire.changed == changed  # nobody's command was changed

    @pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
    def test_effort_that_is_none_is_zero(self, bad):
        assert anchored().torque((bad, 1.0)) == (0.0, 1.0)

    def test_wrench_of_a_robot_that_takes_none_is_zero(self):
        wire = anchored(spec=replace(SPEC, wrench_limits=None))
        assert wire.wrench((1.0,) * 6) == (0.0,) * 6
        assert wire.changed == 1

    @some
    @given(st.lists(st.tuples(st.floats(), st.floats()), max_size=30))
    def test_whatever_is_wanted_never_jumps_nor_leaves(self, wanted):
        wire, before = anchored(), POSE
        for values in wanted:
            sent = wire.position(values)
            for j in (0, 1):
                assert abs(sent[j] - before[j]) <= LIMITS.velocity[j] * PERIOD * (1 + 3e-6)
            assert wire.usable(sent)
            before = sent

    @pytest.mark.parametrize("values", [(0.25,), (9.0,), (0.25, 0.9, 0.0), (9.0,) * 3])
    def test_takes_as_many_numbers_as_the_arm_has_joints(self, values):
        fits = all(abs(value) < 1.0 for value in values)
        for call in (anchored().position, anchored().torque, *[anchored().usable] * fits):
            with pytest.raises(ValueError, match="zip"):
                call(values)

    def test_takes_plain_numbers(self):
        assert numbers(np.array([1.0, 2.5])) == (1.0, 2.5)
