"""Order of packets, the robot's time and its answers, held from both sides of each number."""

from __future__ import annotations

import pytest
from fri_messages import monitoring
from hypothesis import given, settings
from hypothesis import strategies as st

from backends.fri.codec import messages
from backends.fri.session import Order, RobotSession

some = settings(max_examples=50)
MODULUS = 2**32
BEGAN = 1_700_000_000 * 10**9  # [ns]


def packet(sequence, stamp=None, reflected=0, state=messages.SessionState.MONITORING_READY):
    """Return a message with a sequence, and a time [ns] where it is told."""
    message = monitoring(sequence=sequence % MODULUS, state=state)
    told = None if stamp is None else messages.Timestamp(*divmod(stamp, 10**9))
    return message._replace(
        header=messages.Header(sequence % MODULUS, reflected),
        data=message.data._replace(timestamp=told),
    )


def begun(sequence, stamp=None, period=0.01):
    session = RobotSession(period)
    assert session.take(packet(sequence, stamp)) is Order.NEXT
    return session


class TestOrder:
    """1000 packets back is overtaken, 100 000 ahead is a gap; beyond, a session began anew."""

    @some
    @given(st.integers(0, MODULUS - 1))
    def test_without_time_stamps(self, last):
        for ahead, order in (
            (1, Order.NEXT), (95_001, Order.NEXT), (100_000, Order.NEXT),
            (100_001, Order.RESTARTED), (105_000, Order.RESTARTED), (2**31, Order.RESTARTED),
            (0, Order.OLD), (-1, Order.OLD), (-955, Order.OLD), (-1000, Order.OLD),
            (-1001, Order.RESTARTED), (-1050, Order.RESTARTED), (-3000, Order.RESTARTED),
        ):  # fmt: skip
            session = begun(last)
            assert session.take(packet(last + ahead)) is order, ahead
            assert session.figures.restarts == (order is Order.RESTARTED)
            assert session.figures.old == (order is Order.OLD)
            assert session.figures.received == 1 + (order is not Order.OLD)
            assert session.figures.lost == (ahead - 1 if order is Order.NEXT else 0)

    @pytest.mark.parametrize("back", [0, 1, 999, 5000])
    def test_by_time_stamps_where_they_are_told(self, back):
        for later, order in ((-1, Order.OLD), (0, Order.OLD), (1, Order.RESTARTED)):
            session = begun(9000, BEGAN)
            assert session.take(packet(9000 - back, BEGAN + later)) is order

    def test_by_sequence_where_one_tells_no_time(self):
        for first, second in ((None, BEGAN), (BEGAN, None)):
            session = begun(9000, first)
            assert session.take(packet(8001, second)) is Order.OLD
            session = begun(9000, first)
            assert session.take(packet(7000, second)) is Order.RESTARTED

    @pytest.mark.parametrize(("pace", "strays"), [(1, 21), (1000, 21), (1001, 0), (0, 0)])
    def test_of_what_goes_on_behind_is_a_new_session_after_20_packets(self, pace, strays):
        """The robot's clock was set back, else its time stamps would tell."""
        session = begun(10**6, BEGAN)
        orders = [session.take(packet(5000 + k * pace, BEGAN - 10**9)) for k in range(strays or 40)]
        if strays:
            assert orders == [Order.OLD] * (strays - 1) + [Order.RESTARTED]
            late = BEGAN - 10**9 + round(1e9 * session.period * pace)
            assert session.take(packet(5000 + strays * pace, late)) is Order.NEXT
        else:
            assert set(orders) == {Order.OLD}

    def test_of_strays_is_forgotten_with_a_packet_that_follows(self):
        session = begun(10**6, BEGAN)
        for k in range(60):
            if k % 20 == 0:
                assert session.take(packet(10**6 + 1 + k, BEGAN + k * 10**7)) is Order.NEXT
            assert session.take(packet(5000 + k, BEGAN - 10**9)) is Order.OLD

    def test_of_strays_counts_from_the_first_after_that(self):
        session = begun(10**6, BEGAN)
        for k in range(5):
            session.take(packet(5000 + k, BEGAN - 10**9))
        assert session.take(packet(10**6 + 1, BEGAN)) is Order.NEXT
        orders = [session.take(packet(5005 + k, BEGAN - 10**9)) for k in range(21)]
        assert orders == [Order.OLD] * 20 + [Order.RESTARTED]

    def test_of_strays_counts_anew_where_they_do_not_follow_each_other(self):
        session = begun(10**6, BEGAN)
        for jump in (0, 50_000):
            for k in range(20):
                assert session.take(packet(5000 + jump + k, BEGAN - 10**9)) is Order.OLD
        assert session.take(packet(55_020, BEGAN - 10**9)) is Order.RESTARTED


class TestLeaps:
    """20 ms, or three periods, of packets may be lost beyond the time that went by."""

    @pytest.mark.parametrize(("period", "lost"), [(0.001, 20), (0.005, 4), (0.02, 3)])
    @pytest.mark.parametrize("passed", [0.0, 0.5])
    @pytest.mark.parametrize("clock", ["the robot's", "this machine's"])
    def test_are_those_of_more_packets_than_time(self, period, lost, passed, clock):
        own = clock == "this machine's"
        usual = round(passed / period)
        for ahead, order in ((usual + lost, Order.NEXT), (usual + lost + 1, Order.RESTARTED)):
            session = RobotSession(period)
            session.take(packet(7, BEGAN), 100.0)
            stamp = BEGAN + (1 if own else round(1e9 * passed) + 1)
            arrived = 100.0 + (passed + 1e-9 if own else 0.0)
            assert session.take(packet(7 + ahead, stamp), arrived) is order
        assert session.before_restart == 7

    def test_are_none_where_no_clock_tells(self):
        session = begun(7)
        assert session.take(packet(90_000)) is Order.NEXT


class TestEffects:
    """A command has effect once it is confirmed, for which the robot has 10 ms or three periods."""

    @pytest.mark.parametrize(
        ("period", "multiplier", "patience"),
        [(0.001, 1, 10), (0.002, 1, 5), (0.004, 1, 3), (0.1, 1, 3), (0.002, 3, 5), (0.001, 10, 11)],
    )
    @pytest.mark.parametrize("what", ["overdue", "refused"])
    def test_are_missed_after(self, period, multiplier, patience, what):
        session = RobotSession(period, multiplier)
        session.take(packet(0))
        session.note_answer() if what == "overdue" else session.note_refusal()
        for k in range(1, patience + 1):
            assert not getattr(session, what)
            session.take(packet(k, reflected=99))
            if what == "refused":
                session.note_refusal()
        assert getattr(session, what)
        session.note_answer()
        session.take(packet(patience + 1, reflected=session.next_sequence() - 1))
        assert not session.overdue
        assert not session.refused

    def test_are_those_of_the_last_that_was_confirmed(self):
        session = RobotSession(0.001)
        session.take(packet(0))
        session.begin("stands")
        for k in range(4):
            session.note_answer(f"step {k}")
            assert session.confirmed == "stands"
        session.take(packet(1, reflected=2))
        assert (session.confirmed, session.unconfirmed) == ("step 2", 1)
        session.take(packet(2, reflected=1))  # it goes back: that is no news
        assert session.confirmed == "step 2"
        session.note_answer("step 4")
        session.take(packet(90_000_000))  # it counts anew
        assert (session.confirmed, session.unconfirmed) == ("step 4", 0)

    def test_are_all_missed_once_the_last_one_is(self):
        session, missed = RobotSession(0.1), []
        for k in range(6):
            session.take(packet(k, reflected=99))
            missed.append((session.overdue, session.all_overdue))
            if k < 3:
                session.note_answer()
        assert missed == [(False, False)] * 3 + [(True, False)] * 2 + [(True, True)]


class TestRobotTime:
    @pytest.mark.parametrize("steps", [1, 3])
    def test_is_its_clock_unless_that_leaps_by_more_than_a_second(self, steps):
        expected = 0.01 * steps
        for passed, believed in (
            (1, True), (10**7, True), (10**9, True), (round(1e9 * (expected + 0.999)), True),
            (round(1e9 * (expected + 1.001)), False), (3 * 10**9, False), (0, False),
            (-1, False), (-(10**9), False),
        ):  # fmt: skip
            session = begun(7, BEGAN)
            session.take(packet(7 + steps, BEGAN + passed))
            assert session.time == pytest.approx(1e-9 * passed if believed else expected, rel=1e-9)
            assert session.figures.clock_steps == (not believed)
            assert session.packets == steps

    def test_may_leap_by_just_a_second(self):
        session = begun(7, BEGAN, period=0.25)
        session.take(packet(8, BEGAN + 1_250_000_000))
        assert (session.time, session.figures.clock_steps) == (1.25, 0)

    def test_is_the_send_period_where_it_tells_none(self):
        for first, second in ((None, None), (None, BEGAN), (BEGAN, None)):
            session = begun(7, first)
            session.take(packet(10, second))
            assert (session.time, session.packets) == (pytest.approx(0.03), 3)
            assert (session.figures.clock_steps, session.figures.lost) == (0, 2)

    def test_goes_on_over_a_restart_however_long(self):
        session = begun(7, BEGAN)
        session.take(packet(5, BEGAN + 3 * 10**9))
        assert (session.time, session.packets) == (pytest.approx(3.0), 1)
        assert (session.figures.restarts, session.figures.lost) == (1, 0)
        session = begun(9000)
        session.take(packet(5))
        assert (session.time, session.packets) == (pytest.approx(0.01), 1)

    def test_begins_at_zero(self):
        session = begun(7, BEGAN)
        assert (session.time, session.packets, session.figures.lost) == (0.0, 0, 0)


class TestAnswers:
    def answered(self, count, period=0.01):
        session = RobotSession(period)
        session.take(packet(0))
        for k in range(count):
            assert session.next_sequence() == k
            session.note_answer()
        return session

    def test_are_confirmed_by_what_the_robot_reflects(self):
        for reflected, waiting, unreceived, late in ((4, 0, 4, 0), (3, 1, 3, 1), (0, 4, 0, 1)):
            session = self.answered(5)
            session.take(packet(1, reflected=reflected))
            assert session.unconfirmed == waiting
            assert session.figures.unreceived == unreceived
            assert session.figures.late == late
            assert session.figures.answered == 5

    def test_one_by_one_are_neither_late_nor_lost(self):
        session = RobotSession(0.01)
        for k in range(10):
            session.take(packet(k, reflected=max(k - 1, 0)))
            session.note_answer()
        assert (session.unconfirmed, session.figures.late, session.figures.unreceived) == (1, 0, 0)

    def test_that_are_not_known_confirm_nothing(self):
        session = self.answered(3)
        session.take(packet(1, reflected=77))
        assert (session.unconfirmed, session.figures.late) == (3, 0)

    def test_of_a_session_before_are_forgotten(self):
        session = self.answered(3)
        session.take(packet(90_000))
        session.take(packet(5, reflected=77))
        assert session.unconfirmed == 0

    def test_are_known_still_where_only_the_count_of_packets_leaps(self):
        session = self.answered(3)
        session.take(packet(90_000))
        session.take(packet(5, reflected=1))
        assert session.unconfirmed == 1

    def test_are_counted_in_32_bits(self):
        session = RobotSession(0.01)
        session._sequence = MODULUS - 1
        session.take(packet(0))
        session.note_answer()
        assert session.next_sequence() == 0
        session.take(packet(1, reflected=MODULUS - 1))
        assert (session.unconfirmed, session.figures.late) == (0, 0)

    def test_and_visits_that_are_remembered_are_not_without_number(self):
        session = self.answered(1023)
        assert session.unconfirmed == 1023
        session = self.answered(1100)
        assert session.unconfirmed == 1024
        states = messages.SessionState
        for k in range(300):
            assert len(session.visits) == min(k + 1, 256)
            both = (states.COMMANDING_WAIT, states.MONITORING_READY)
            session.take(packet(k + 1, state=both[k % 2]))


def test_a_state_is_visited_when_it_is_entered_and_said():
    session = begun(7)
    for k in range(8, 11):
        session.take(packet(k))
    session.take(packet(11)._replace(connection=None))
    assert [visit.state for visit in session.visits] == [messages.SessionState.MONITORING_READY]


def test_figures_begin_at_zero():
    session = RobotSession(0.01)
    assert set(session.figures.as_json().values()) == {0}
    assert (session.packets, session.unconfirmed, session.next_sequence()) == (0, 0, 0)
    assert (session.time, session.state) == (0.0, None)
