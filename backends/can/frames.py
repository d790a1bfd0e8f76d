"""CANopen arbitration ids, and the bus load of the frames sent.

Source: CiA 301, "CANopen application layer and communication profile", section 7.3.3 (predefined
connection set); ISO 11898-1, section 10.4 (frames and bit stuffing); Davis, Burns, Bril and
Lukkien, "Controller Area Network (CAN) schedulability analysis", 2007, eq. (1).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

from limo_driver.errors import ConfigError

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
