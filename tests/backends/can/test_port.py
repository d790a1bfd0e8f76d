"""The bus itself: real UDP, frames of every kind, and buses that are not there."""

import socket
import time

import can
import pytest
from ports import free_port

from backends.can.config import Bus
from backends.can.port import BusPort
from limo_driver.errors import BackendError, ConnectionLostError

pytestmark = pytest.mark.waits

GROUP = "239.74.164.9"


@pytest.fixture
def address():
    return GROUP, free_port()


@pytest.fixture
def port(address):
    group, number = address
    bus = Bus(interface="udp_multicast", channel=group, options={"port": number})
    with BusPort(bus) as opened:
        yield opened


def soon(port):
    return port.now() + 60.0


def test_frames_travel(port, address):
    with can.Bus(
        interface="udp_multicast", channel=address[0], port=address[1], hop_limit=0
    ) as other:
        other.send(can.Message(arbitration_id=0x18B, data=b"abc", is_extended_id=False))
        assert port.receive(soon(port)) == (0x18B, b"abc")
        port.send(0x20B, b"de")
        message = other.recv(60.0)
        while message.arbitration_id != 0x20B:  # it hears itself
            message = other.recv(60.0)
        assert (bytes(message.data), message.is_fd, message.is_extended_id) == (b"de", False, False)


def test_what_is_no_frame_for_a_driver_is_counted(port, address):
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:
        sender.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_TTL, 0)
        for garbage in (b"", b"\x00", b"\xff" * 100, b"\x81\xa2id\x01"):
            sender.sendto(garbage, address)
    with can.Bus(
        interface="udp_multicast", channel=address[0], port=address[1], hop_limit=0
    ) as other:
        other.send(can.Message(arbitration_id=0x18B, is_extended_id=True))
        other.send(can.Message(arbitration_id=0x18B, is_extended_id=False, is_remote_frame=True))
        other.send(can.Message(arbitration_id=0x40, is_error_frame=True))
        other.send(can.Message(arbitration_id=0x18C, data=b"x", is_extended_id=False))
        assert port.receive(soon(port)) == (0x18C, b"x")
    assert (port.counts.broken, port.counts.foreign, port.counts.errors) == (4, 2, 1)
    assert port.bus_off


class FullBus(can.BusABC):
    """Has frames waiting, first some that are not for a driver."""

    def __init__(self, useless):
        super().__init__(channel="full")
        foreign = can.Message(arbitration_id=0x18B, is_extended_id=False, is_remote_frame=True)
        good = can.Message(arbitration_id=0x18B, data=b"x", is_extended_id=False)
        self.waiting = [foreign] * useless + [good]

    def send(self, msg, timeout=None):  # noqa: ARG002  # of python-can
        raise AssertionError("nothing is to be sent")

    def _recv_internal(self, timeout):  # noqa: ARG002  # of python-can
        return (self.waiting.pop(0) if self.waiting else None), True


def test_what_waits_behind_other_frames_is_taken_when_no_time_is_left():
    with BusPort(Bus(interface="virtual", channel="full"), FullBus(20)) as port:
        assert port.receive(port.now() - 1.0) == (0x18B, b"x")
        assert port.receive(port.now() - 1.0) is None
    with BusPort(Bus(interface="virtual", channel="full"), FullBus(10_000)) as port:
        assert port.receive(port.now() - 1.0) is None  # not for ever


def test_waiting_ends(port):
    began = time.monotonic()
    assert port.receive(port.now() + 0.02) is None
    assert time.monotonic() - began >= 0.02
    assert port.receive(port.now() - 1.0) is None


def test_waiting_ends_also_when_the_clock_on_the_wall_is_set_back(port, monkeypatch):
    hours = iter(range(1_000_000_000, 0, -3600))
    monkeypatch.setattr("can.bus.time", lambda: next(hours))
    began = time.monotonic()
    assert port.receive(port.now() + 0.02) is None
    assert time.monotonic() - began < 600.0


def test_closed_bus_is_lost(address):
    bus = Bus(interface="virtual", channel=f"closed-{address[1]}")
    port = BusPort(bus)
    port.close()
    with pytest.raises(ConnectionLostError, match="is gone"):
        port.receive(port.now() + 0.1)
    with pytest.raises(ConnectionLostError, match="takes no frame"):
        port.send(0x80, b"")


@pytest.mark.parametrize(
    ("bus", "message"),
    [
        (Bus(interface="socketcan", channel="can97"), "CAN bus socketcan can97 cannot be opened"),
        (Bus(interface="nosuch", channel="x"), "CAN bus nosuch x cannot be opened: .*nosuch"),
        (Bus(interface="udp_multicast", channel="10.0.0.1"), "cannot be opened"),
    ],
)
def test_absent_bus_is_named(bus, message):
    with pytest.raises(BackendError, match=message):
        BusPort(bus)
