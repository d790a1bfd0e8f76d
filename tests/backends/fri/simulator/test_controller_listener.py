"""What the simulated controller makes of answers that come late, at once, or in another state."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pytest

from backends.fri.codec.codec import encode_command
from backends.fri.codec.messages import Command, CommandData, CommandMode, Header, SessionState
from backends.fri.simulator.connection.port import UNDISTURBED, Address, ClientDatagram, Disturbance
from backends.fri.simulator.judge import Wanted
from backends.fri.simulator.listener import CommandedArm, Listener
from backends.fri.simulator.report import ClientObservations
from backends.fri.simulator.scenario import Now
from backends.fri.simulator.session import POSE, ControllerSession, ControllerSettings, SessionTimes

if TYPE_CHECKING:
    from collections.abc import Iterator

CLIENT = Address("127.0.0.1", 30200)
PERIOD = 1_000_000  # [ns]


class Mailbox:
    """A port at which everything is there already."""

    def __init__(self, *answers: bytes) -> None:
        self.answers = answers

    def received(self) -> Iterator[ClientDatagram]:
        for data in self.answers:
            yield ClientDatagram(data, 0, CLIENT)


class Bench:
    """A listener in an active session, interval by interval."""

    def __init__(self) -> None:
        self.settings = ControllerSettings(CLIENT, period_ms=1)
        self.motion = CommandedArm(self.settings, None)
        self.findings = ClientObservations()
        self.listener = Listener(self.settings, CLIENT, 0, self.findings, self.motion)
        self.session = ControllerSession(SessionTimes())
        self.session.state = SessionState.COMMANDING_ACTIVE
        self.motion.begin()
        self.listener.begin()
        self.intervals = 0

    def interval(self, *answers: bytes, network: Disturbance = UNDISTURBED) -> None:
        """Send a packet, and take what has come before the next one."""
        self.listener.ledger.send(self.intervals * PERIOD, expects_answer=True)
        self.intervals += 1
        self.listener.listen(Mailbox(*answers), 1e-3 * self.intervals, network, self.session)  # type: ignore[arg-type]  # all that it reads of a port
        self.listener.close_interval(self.intervals * PERIOD)

    def answer(self, packet: int, steps: float) -> bytes:
        """Answer a packet with a position some cycles of full speed away."""
        position = np.array(POSE) + steps * 1e-3 * self.motion.limits.velocity
        data = CommandData(tuple(position.tolist()))
        return encode_command(Command(Header(packet, packet), data), self.settings.version)


@pytest.fixture
def bench() -> Bench:
    return Bench()


def test_answers_of_the_intervals_that_were_missed_may_come_together(bench: Bench) -> None:
    bench.interval()
    bench.interval()
    bench.interval(*(bench.answer(k, 0.9 * (k + 1)) for k in range(3)))
    bench.interval(bench.answer(3, 3.6))
    assert bench.listener.stop == ""
    assert bench.findings.largest_step == pytest.approx(0.9)


def test_answers_that_piled_up_are_a_jump(bench: Bench) -> None:
    for _ in range(49):
        bench.interval()
    bench.interval(*(bench.answer(k, 0.9 * (k + 1)) for k in range(50)))
    assert "illegal axis delta" in bench.listener.stop


def test_two_answers_in_one_interval_have_the_time_of_one(bench: Bench) -> None:
    bench.interval()
    bench.interval(bench.answer(1, 0.9))
    bench.interval(bench.answer(0, 1.5), bench.answer(2, 2.4))
    assert "illegal axis delta" in bench.listener.stop


def cases(bench: Bench, text: str) -> tuple[int, int]:
    """Return how often a complaint was made, and how often the scenario may have caused it."""
    return next(
        (one.count, one.by_scenario)
        for said, one in bench.findings.complaints.items()
        if text in said
    )


def test_what_the_scenarios_network_doubles_is_not_the_clients_fault(bench: Bench) -> None:
    bench.interval(bench.answer(0, 0.0), network=Disturbance(duplicate=1.0))
    assert cases(bench, "answered before") == (1, 1)
    bench.interval(bench.answer(1, 0.0), bench.answer(1, 0.0))  # and now the client does
    assert cases(bench, "answered before") == (2, 1)


def test_packets_that_come_twice_may_be_answered_twice(bench: Bench) -> None:
    bench.interval()
    bench.listener.ledger.disturb()
    bench.interval(bench.answer(0, 0.0), bench.answer(0, 0.0))
    assert cases(bench, "answered before") == (1, 1)


@pytest.mark.parametrize(("later", "by_scenario"), [(1, 1), (12, 0)])
def test_jumps_after_losses_of_the_scenario_are_marked(
    bench: Bench, later: int, by_scenario: int
) -> None:
    bench.interval(bench.answer(0, 0.0), network=Disturbance(loss=1.0))
    for k in range(1, later):
        bench.interval(bench.answer(k, 0.0))
    bench.interval(bench.answer(later, 50.0))
    assert cases(bench, "illegal axis delta") == (1, by_scenario)


def test_what_no_network_does_is_the_clients_fault_in_a_scenario_too(bench: Bench) -> None:
    bench.interval(network=Disturbance(loss=1.0))
    empty = encode_command(Command(Header(1, 1), CommandData()), bench.settings.version)
    bench.interval(empty)
    assert cases(bench, "without position") == (1, 0)


def test_waiting_again_ends_the_commands_and_tells_where_the_arm_brakes() -> None:
    settings = ControllerSettings(CLIENT, mode=CommandMode.TORQUE, period_ms=5)
    motion = CommandedArm(settings, None)
    motion.ask()
    motion.begin()
    for k in range(40):
        wanted = motion.path.position + 2e-3 * min(k, 10) / 10
        motion.take(Wanted(position=wanted, torque=np.full(7, 3.0)))
        motion.move(Now(), 5e-3 * k, 5, active=True)
    assert motion.path.velocity.any()
    resting = motion.state.model_torque
    motion.ask()  # a session that goes back to COMMANDING_WAIT
    assert motion.commanded_torque == pytest.approx(resting)
    for k in range(40, 80):
        motion.move(Now(), 5e-3 * k, 5, active=False)
        assert motion.ipo == pytest.approx(motion.path.position)
    assert not motion.path.velocity.any()
