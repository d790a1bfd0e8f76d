"""What the driver takes for a robot, and how long it waits, held from both sides of each number."""

from __future__ import annotations

import socket
from contextlib import closing
from types import SimpleNamespace

import numpy as np
import pytest
from fri_messages import monitoring
from stepped_arm import stepped

from backends.fri import connection
from backends.fri.codec import messages
from backends.fri.codec.codec import encode_monitoring
from backends.fri.codec.messages import CommandMode, FriVersion, Generation
from backends.fri.connection import Connection, Datagram, pace, unusable
from backends.fri.wire_limits import VelocityFilter
from limo_driver.errors import BackendError, ConnectionLostError, HoldingError
from limo_driver.types import PositionCommand, TorqueCommand, readonly

each_way = pytest.mark.parametrize("sign", [-1.0, 1.0])


def with_connection(**changes):
    message = monitoring()
    return message._replace(connection=message.connection._replace(**changes))


def with_data(**changes):
    message = monitoring()
    return message._replace(data=message.data._replace(**changes))


class TestUsableMessages:
    @pytest.mark.parametrize(
        ("period", "fine"),
        [(None, 0), (0, 0), (1, 1), (5, 1), (100, 1), (101, 0), (105, 0), (2**32 - 1, 0)],
    )
    def test_have_a_send_period_of_1_to_100_ms(self, period, fine):
        problem = unusable(with_connection(send_period=period))
        assert (
            problem == "" if fine else f"send period of {period} ms, expected 1 to 100" in problem
        )

    @pytest.mark.parametrize(
        ("period", "multiplier", "fine"),
        [
            (100, None, 1), (100, 0, 1), (100, 1, 1), (100, 10, 1), (100, 11, 0), (10, 100, 1),
            (10, 101, 0), (1, 1000, 1), (1, 1001, 0), (1, 1050, 0),
        ],
    )  # fmt: skip
    def test_ask_for_an_answer_within_a_second(self, period, multiplier, fine):
        problem = unusable(with_connection(send_period=period, receive_multiplier=multiplier))
        assert problem == ("" if fine else f"a receive multiplier of {multiplier}")

    @pytest.mark.parametrize(
        ("name", "most"), [("measured_position", 10.0), ("measured_torque", 1e4)]
    )
    @pytest.mark.parametrize("j", [0, 3, 6])
    @each_way
    def test_have_values_that_an_arm_can_have(self, name, most, j, sign):
        for value, fine in (
            (0.96 * most, True), (most, True), (1.04 * most, False), (np.inf, False),
            (np.nan, False),
        ):  # fmt: skip
            values = [0.0] * 7
            values[j] = sign * value
            problem = unusable(with_data(**{name: tuple(values)}))
            said = f"a {name.replace('_', ' ')} that no arm has"
            assert problem == ("" if fine else said), value

    def test_say_all_that_is_needed(self):
        assert unusable(monitoring()) == ""
        assert "session stands" in unusable(monitoring()._replace(connection=None))
        assert unusable(monitoring()._replace(data=None)) == "no measurements"
        assert unusable(with_data(measured_position=None)) == "no measured position"
        assert unusable(with_data(measured_torque=None)) == "no measured torque"

    def test_have_a_pace(self):
        assert pace(monitoring()._replace(connection=None)) == (0, 1)
        assert pace(with_connection(send_period=None, receive_multiplier=None)) == (0, 1)
        assert pace(with_connection(send_period=4, receive_multiplier=0)) == (4, 1)
        assert pace(with_connection(send_period=4, receive_multiplier=3)) == (4, 3)
        link = Connection(SimpleNamespace(), Generation.ONE, 4, 3)
        assert link.period == pytest.approx(0.012, rel=1e-12)
        assert link.fits(with_connection(send_period=4, receive_multiplier=3))
        assert not link.fits(with_connection(send_period=4, receive_multiplier=2))
        assert not link.fits(with_connection(send_period=3, receive_multiplier=3))


class Waiting:
    """Stands for the port: hands out datagrams as if they had come."""

    port, robot, last_foreign = 30200, "192.0.2.1", "192.0.2.2"

    def __init__(self, *data, foreign=0):
        self.data, self.foreign = list(data), foreign
        self.settled, self.closed = "", False

    def receive(self, timeout):
        assert 0.0 < timeout <= 0.05
        return Datagram(self.data.pop(0), ("192.0.2.1", 1), 0.0) if self.data else None

    def settle(self, sender):
        self.settled = sender[0]

    def close(self):
        self.closed = True


def connected(monkeypatch, port, version=None):
    monkeypatch.setattr(connection, "Endpoint", lambda *_: port)
    return connection.connect(None, 30200, version, 0.05)


def told(generation=Generation.ONE, **data):
    message = monitoring(generation)
    return encode_monitoring(message._replace(data=message.data._replace(**data)), generation)


UNTOLD = {"measured_pose": None, "commanded_position": None}


class TestConnecting:
    def test_takes_20_messages_that_do_not_tell_their_version_for_one(self, monkeypatch):
        bare = told(**UNTOLD)
        port = Waiting(*[bare] * 20, told(Generation.TWO_FIVE))
        found = connected(monkeypatch, port)
        assert (found.generation, len(port.data), port.settled) == (Generation.ONE, 1, "192.0.2.1")
        port = Waiting(*[bare] * 19, told(Generation.TWO_FIVE))
        assert connected(monkeypatch, port).generation is Generation.TWO_FIVE
        port = Waiting(*[bare] * 19)
        with pytest.raises(ConnectionLostError, match=r"^19 datagrams came"):
            connected(monkeypatch, port)
        assert port.closed

    def test_believes_a_version_that_is_not_denied(self, monkeypatch):
        found = connected(monkeypatch, Waiting(told(**UNTOLD)), FriVersion.V2_5)
        assert found.generation is Generation.TWO_FIVE
        port = Waiting(told(Generation.TWO_FIVE))
        with pytest.raises(BackendError, match=r"speaks FRI 2\.5, but 1\.15"):
            connected(monkeypatch, port, FriVersion.V1_15)
        assert port.closed

    def test_passes_over_what_cannot_be_used(self, monkeypatch):
        port = Waiting(b"nothing", told(measured_position=None), told())
        assert connected(monkeypatch, port).send_period == 1
        with pytest.raises(ConnectionLostError, match=r"^2 datagrams.*: no measured position"):
            connected(monkeypatch, Waiting(b"nothing", told(measured_position=None)))

    def test_says_who_came_instead(self, monkeypatch):
        with pytest.raises(ConnectionLostError, match=r"but 3 datagrams from 192\.0\.2\.2"):
            connected(monkeypatch, Waiting(foreign=3))
        with pytest.raises(ConnectionLostError, match="nobody sent to UDP port 30200"):
            connected(monkeypatch, Waiting())


class TestDatagrams:
    @pytest.mark.parametrize(
        ("waited", "age"), [(0.0, 0.0), (5.0, 5.0), (10.0, 10.0), (10.001, 0.0), (-1.0, 0.0)]
    )
    def test_have_waited_since_the_kernel_took_them_for_ten_seconds_at_most(
        self, waited, age, monkeypatch
    ):
        """A greater age is a step of the clock."""
        taken, later = 1_700_000_000_000_000_123, round(1e9 * waited)
        clock = SimpleNamespace(time_ns=lambda: taken + later)
        monkeypatch.setattr(connection, "time", clock)
        stamp = connection._TIMESPEC.pack(*divmod(taken, 10**9))
        kind = (socket.SOL_SOCKET, connection._KERNEL_TIME)
        assert connection._age([(*kind, stamp)]) == pytest.approx(age, abs=1e-12)

    def test_come_whole_up_to_one_byte_too_many(self):
        """So that what is too long is told from what is just as long as it may be."""
        endpoint = connection.Endpoint("127.0.0.1", 0)
        with closing(endpoint), socket.socket(type=socket.SOCK_DGRAM) as sender:
            for size in (messages.MAX_DATAGRAM, messages.MAX_DATAGRAM + 1):
                sender.sendto(bytes(size), ("127.0.0.1", endpoint.port))
                assert len(endpoint.receive(60.0).data) == size


class TestVelocityFilter:
    """A low-pass of 5 ms; a pause of more than 0.1 s begins it anew."""

    def filtered(self, step):
        velocity = VelocityFilter(2)
        velocity.update(1.0, readonly(np.array([0.0, 1.0])))
        assert not velocity.velocity.any()
        velocity.update(1.0 + step, readonly(np.array([0.5 * step, 1.0 - step])))
        return velocity

    @pytest.mark.parametrize("step", [1e-3, 5e-3, 0.02, 0.0995])
    def test_has_its_time_constant(self, step):
        share = step / (step + 0.005)
        velocity = self.filtered(step)
        assert velocity.velocity == pytest.approx([0.5 * share, -share], rel=1e-9)
        velocity.update(1.0 + 2 * step, readonly(np.array([step, 1.0 - 2 * step])))
        settled = 1 - (1 - share) ** 2
        assert velocity.velocity == pytest.approx([0.5 * settled, -settled], rel=1e-9)

    def test_begins_anew_after_a_pause_and_waits_for_time_to_pass(self):
        assert self.filtered(0.0995).velocity.any()
        assert not self.filtered(0.1005).velocity.any()
        velocity = self.filtered(0.001)
        before = velocity.velocity
        velocity.update(1.001, readonly(np.ones(2)))
        assert np.array_equal(velocity.velocity, before)


class TestRobot:
    """10 ms of patience, 5 ms of age, 10 ms or three periods without a confirmation."""

    @pytest.mark.parametrize(("period_ms", "most"), [(1, 10), (4, 3), (20, 3), (50, 3)])
    def test_holds_where_commands_are_not_confirmed(self, period_ms, most):
        with stepped(period_ms=period_ms) as robot:
            position = robot.receive().position
            robot.send(PositionCommand(position=position, valid_for=1.0))
            robot.receive()
            robot.arm.deaf = 10**6
            unconfirmed = []
            for _ in range(2 * most + 5):
                robot.send(PositionCommand(position=position, valid_for=1.0))
                state = robot.receive()
                if state.holding:
                    break
                unconfirmed.append(robot._session.unconfirmed)
            assert state.holding
            assert max(unconfirmed) == most - 1
            assert f"none of the last {most} commands" in robot._contract.save().reason

    @pytest.mark.parametrize("period_ms", [1, 4, 20])
    def test_passes_over_old_packets_for_those_behind_them(self, period_ms, monkeypatch):
        oldest = 1e-3 * period_ms
        for age, behind, outdated in (
            (0.96 * oldest, True, 0), (1.04 * oldest, True, 1), (1.04 * oldest, False, 0),
        ):  # fmt: skip
            with stepped(period_ms=period_ms) as robot:
                position = robot.receive().position
                robot.send(PositionCommand(position=position))
                endpoint, found = robot._link.endpoint, robot._link.endpoint.receive
                ages = iter([age, 0.0])
                if behind:
                    robot.arm.cycle()

                def aged(timeout, found=found, ages=ages):
                    datagram = found(timeout)
                    return None if datagram is None else datagram._replace(age=next(ages))

                with monkeypatch.context() as patch:
                    patch.setattr(endpoint, "receive", aged)
                    robot.receive()
                assert robot.figures.outdated == outdated, (age, behind)

    @pytest.mark.parametrize("period_ms", [1, 20])
    def test_waits_for_a_late_packet_once(self, period_ms, monkeypatch):
        with stepped(period_ms=period_ms) as robot:
            robot.receive()
            waited = []
            monkeypatch.setattr(robot._link.endpoint, "receive", waited.append)
            arm, robot.arm = robot.arm, None  # so that the driver waits as it does for any arm
            for _ in range(3):
                assert robot.receive().stale
            robot.arm = arm
        period = 1e-3 * period_ms
        assert waited == pytest.approx([period + 0.01, period, period])

    def test_reads_2000_useless_datagrams_in_a_cycle(self, monkeypatch):
        with stepped() as robot:
            robot.receive()
            read = []

            def useless(timeout):
                read.append(timeout)
                return Datagram(b"nothing", ("127.0.0.2", 1), 0.0)

            monkeypatch.setattr(robot._link.endpoint, "receive", useless)
            assert robot.receive(timeout=60.0).stale
            assert robot.figures.malformed == len(read) == 2000

    def test_limits_wrenches_to_50_newtons(self):
        with stepped(mode=messages.CommandMode.WRENCH) as robot:
            limits = robot.spec.wrench_limits
        assert limits.wrench.tolist() == [50.0, 50.0, 50.0, 10.0, 10.0, 10.0]
        assert limits.rate.tolist() == [500.0, 500.0, 500.0, 100.0, 100.0, 100.0]


def test_a_hold_says_that_commands_had_come_late():
    with stepped(mode=CommandMode.TORQUE) as robot:
        robot.receive()
        push = np.zeros(7)
        push[6] = 30.0
        for k in range(2000):
            robot.arm.deaf = int(k % 10 == 0)
            robot.send(TorqueCommand(torque=push))
            if robot.receive().holding:
                break
        late = "joint 7 leaves its range or its velocity limit; commands had just come to it late"
        with pytest.raises(HoldingError, match=late):
            robot.send(TorqueCommand(torque=push))
