"""The bus as this backend uses it: an adapter to python-can.

Frames that arrive broken, are of another kind (extended, remote, error) or are this port's own are
not for the driver; they are counted, since a bus full of them is worth knowing of. On some buses a
program hears itself (udp_multicast): that is noticed while drives are set up, and each own frame is
passed over once, so that the very same frame of somebody else is heard.

CANopen arbitration ids, and the bus load of the frames sent.

Source: CiA 301, "CANopen application layer and communication profile", section 7.3.3 (predefined
connection set); ISO 11898-1, section 10.4 (frames and bit stuffing); Davis, Burns, Bril and
Lukkien, "Controller Area Network (CAN) schedulability analysis", 2007, eq. (1).
"""

from __future__ import annotations

import logging
import select
import time
from collections import Counter
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final, NamedTuple

import can

from limo_driver.errors import BackendError, ConfigError, ConnectionLostError
from limo_driver.runtime.processes import Closing

if TYPE_CHECKING:
    from collections.abc import Callable

    from backends.can.config import Bus

# python-can's messages and buses are typed in parts only.
# pyright: reportUnknownMemberType=false, reportUnknownVariableType=false
BUS_OFF: Final = 0x40  # class of error frames, as SocketCAN numbers them
MOST_USELESS: Final = 256  # that are passed over at once, when no time is left to wait
MOST_ECHOES: Final = 4096  # own frames that are waited for; more were lost
UNBUFFERED: Final = {"socketcan", "udp_multicast"}  # what has arrived is to be seen from outside
# Frames of a simulated bus stay on this machine, unless told otherwise.
_DEFAULTS: Final[dict[str, dict[str, Any]]] = {"udp_multicast": {"hop_limit": 0}}
NMT: Final = 0x000
SYNC: Final = 0x080
EMERGENCY: Final = 0x080  # + node
TPDO1: Final = 0x180
RPDO1: Final = 0x200
TPDO2: Final = 0x280
RPDO2: Final = 0x300
TPDO3: Final = 0x380
RPDO3: Final = 0x400
RPDO4: Final = 0x500
SDO_REPLY: Final = 0x580
SDO_REQUEST: Final = 0x600
HEARTBEAT: Final = 0x700

FULLEST: Final = 0.95  # of the bus; the rest is for emergencies, SDO, and what errors make repeat


class Frame(NamedTuple):
    """A data frame with an 11-bit id."""

    id: int
    data: bytes


@dataclass
class PortCounts:
    """Counts of frames that were not for the driver, and of those that could not be read."""

    broken: int = 0
    foreign: int = 0  # extended or remote frames
    errors: int = 0  # error frames


class BusPort(Closing):
    """An open bus.

    Args:
        config: Which one.
        bus: An open python-can bus instead; it is closed with the port.
        clock: Tells the time [s]; a bus that is simulated with its drives has its own.

    Raises:
        BackendError: It cannot be opened; says what was tried.
    """

    def __init__(
        self,
        config: Bus,
        bus: can.BusABC | None = None,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self.name = f"{config.interface} {config.channel}"
        self.counts = PortCounts()
        self.bus_off = False
        self.now = clock
        self._fd = config.fd
        self._echoes: Counter[Frame] = Counter()  # own frames that will be heard
        self._awaits_echoes, self._echoing = True, False  # until it is known that there are none
        self._bus = _open(config) if bus is None else bus
        # python-can waits by the wall clock: set back meanwhile, it would wait for as long again.
        self._waits_by_select = config.interface in UNBUFFERED and _has_descriptor(self._bus)

    def send(self, frame_id: int, data: bytes) -> None:
        """Put a frame on the bus; on an FD bus with its data at the fast bit rate.

        Raises:
            ConnectionLostError: The bus takes no frame.
        """
        message = can.Message(
            arbitration_id=frame_id,
            data=data,
            is_extended_id=False,
            is_rx=False,
            is_fd=self._fd,
            bitrate_switch=self._fd,
        )
        try:
            self._bus.send(message)
        except (can.CanError, OSError) as error:
            raise ConnectionLostError(f"{self.name} takes no frame: {_cause(error)}") from None
        if self._awaits_echoes:
            self._echoes[Frame(frame_id, bytes(data))] += 1
            if len(self._echoes) > MOST_ECHOES:
                self._echoes.clear()

    def receive(self, until: float) -> Frame | None:
        """Return the next frame; None if none came until then.

        Args:
            until: When to give up [s], of `now`; a frame that waits is still taken.

        Raises:
            ConnectionLostError: The bus is gone.
        """
        useless = 0
        while useless < MOST_USELESS:
            remaining = until - self.now()
            arrived, frame = self._read(max(remaining, 0.0))
            if frame is not None:
                return frame
            if remaining <= 0.0:
                if not arrived:
                    return None
                useless += 1  # one for the driver may wait behind it
        return None

    def settle(self) -> None:
        """Know from now on whether this program hears itself: frames went to and fro by now."""
        self._awaits_echoes = self._echoing
        if not self._echoing:
            self._echoes.clear()

    def close(self) -> None:
        """Let go of the bus."""
        self._bus.shutdown()

    def _read(self, timeout: float) -> tuple[bool, Frame | None]:
        """Return whether anything arrived within the time [s], and the frame if it was one."""
        try:
            if self._waits_by_select:
                if not select.select([self._bus], [], [], timeout)[0]:
                    return False, None
                timeout = 0.0
            message = self._bus.recv(timeout)
        except (can.CanOperationError, ValueError) as error:
            if isinstance(error.__cause__, OSError) or _is_gone(self._bus):
                raise ConnectionLostError(f"{self.name} is gone: {_cause(error)}") from None
            self.counts.broken += 1  # bytes that are no frame
            return True, None
        except OSError as error:
            raise ConnectionLostError(f"{self.name} is gone: {_cause(error)}") from None
        return message is not None, None if message is None else self._frame(message)

    def _frame(self, message: can.Message) -> Frame | None:
        if message.is_error_frame:
            self.counts.errors += 1
            self.bus_off |= bool(message.arbitration_id & BUS_OFF)
            return None
        if message.is_extended_id or message.is_remote_frame or not message.is_rx:
            self.counts.foreign += 1
            return None
        frame = Frame(message.arbitration_id, bytes(message.data))
        return None if self._echoes and self._is_echo(frame) else frame

    def _is_echo(self, frame: Frame) -> bool:
        """Say whether a frame is one of its own that comes back."""
        if frame not in self._echoes:
            return False
        self._echoing = True
        self._echoes[frame] -= 1
        if not self._echoes[frame]:
            del self._echoes[frame]
        return True


def _open(config: Bus) -> can.BusABC:
    options: dict[str, Any] = {**_DEFAULTS.get(config.interface, {}), **config.options}
    if config.fd:
        options |= {"fd": True, "data_bitrate": config.data_bitrate}
    elif config.interface in {"udp_multicast", "socketcan"}:
        options |= {"fd": False}
    # Cyclic senders and the like report themselves on this logger, of no use to who runs an arm.
    logging.getLogger("can").setLevel(logging.ERROR)
    try:
        return can.Bus(
            interface=config.interface,
            channel=config.channel,
            bitrate=config.bitrate,
            ignore_config=True,  # nothing but arm.yaml says which bus an arm is on
            **options,
        )
    except Exception as error:  # noqa: BLE001  # each interface raises its own
        raise BackendError(
            f"CAN bus {config.interface} {config.channel} cannot be opened: {_cause(error)}"
        ) from None


def _cause(error: BaseException) -> str:
    """Return the last cause, which says most."""
    while (inner := error.__cause__) is not None:
        error = inner
    return str(error) or type(error).__name__


def _has_descriptor(bus: can.BusABC) -> bool:
    try:
        return bus.fileno() >= 0
    except NotImplementedError:
        return False


def _is_gone(bus: can.BusABC) -> bool:
    return bool(getattr(bus, "_is_shutdown", False))


@dataclass(frozen=True)
class Traffic:
    """Frames of one kind."""

    what: str
    count: int  # each time
    data: int  # bytes in each
    rate: float  # times a second [Hz]
    cyclic: bool = True  # it grows with the rate of the cycles


@dataclass(frozen=True)
class BusLoad:
    """The share of a bus that its traffic takes at most, with worst stuffing.

    Args:
        traffic: All that is sent on purpose.
        bitrate: [bit/s].
        data_bitrate: Of the data of CAN FD frames [bit/s]; None for classic frames.
    """

    traffic: tuple[Traffic, ...]
    bitrate: int
    data_bitrate: int | None = None

    def duration(self, data: int) -> float:
        """Return how long a frame of so many bytes takes [s]."""
        if self.data_bitrate is None:
            return classic_bits(data) / self.bitrate
        slow, fast = fd_bits(data)
        return slow / self.bitrate + fast / self.data_bitrate

    @property
    def share(self) -> float:
        """Share of the bus: 1 is full."""
        return sum(self._share_of(item) for item in self.traffic)

    def arithmetic(self) -> str:
        """Return the sum, term by term."""
        terms = [
            f"{item.count} {item.what} x {1e6 * self.duration(item.data):.4g} us x "
            f"{item.rate:g} Hz = {100 * self._share_of(item):.1f} %"
            for item in self.traffic
        ]
        return " + ".join(terms) + f"; together {100 * self.share:.1f} %"

    def most(self, rate: float) -> float:
        """Return the highest rate of cycles [Hz] that fits, of a load that is for `rate`."""
        cyclic = sum(self._share_of(item) for item in self.traffic if item.cyclic)
        return max(rate * (FULLEST - (self.share - cyclic)) / cyclic, 0.0)

    def require(self, rate: float) -> None:
        """Refuse what does not fit, with the arithmetic.

        Raises:
            ConfigError: More than the bus carries.
        """
        if self.share <= FULLEST:
            return
        speed = f"{self.bitrate} bit/s" + (
            "" if self.data_bitrate is None else f" and {self.data_bitrate} bit/s (FD)"
        )
        raise ConfigError(
            f"rate {rate:g} Hz does not fit on a bus of {speed}: {self.arithmetic()}, "
            f"of which {100 * FULLEST:g} % may be used; at most {self.most(rate):.0f} Hz"
            + ("" if self.data_bitrate else ", or CAN FD (bus: fd: true)")
        )

    def _share_of(self, item: Traffic) -> float:
        return item.count * item.rate * self.duration(item.data)


def classic_bits(data: int) -> int:
    """Return the bits of a classic frame with an 11-bit id and worst stuffing, with its gap.

    34 bits of head and checksum and the data can be stuffed, one bit after each four; 13 bits of
    delimiters, acknowledgement, end and gap can't.
    """
    stuffed = 34 + 8 * data
    return stuffed + (stuffed - 1) // 4 + 13


def fd_bits(data: int) -> tuple[int, int]:
    """Return the bits of an FD frame of up to 16 bytes at the slow and at the fast bit rate."""
    head, tail = 17, 13  # up to and with the switch of the bit rate; from the checksum's end on
    body = 5 + 8 * data  # error state, length, data
    stuffing = (head + body - 1) // 4
    in_head = (head - 1) // 4
    checksum = 4 + 17 + 6  # stuff count, checksum, its fixed stuff bits
    return head + in_head + tail, body + stuffing - in_head + checksum
