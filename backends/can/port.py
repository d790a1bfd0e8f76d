"""The bus as this backend uses it: an adapter to python-can.

Frames that arrive broken, are of another kind (extended, remote, error) or are this port's own are
not for the driver; they are counted, since a bus full of them is worth knowing of. On some buses a
program hears itself (udp_multicast): that is noticed while drives are set up, and each own frame is
passed over once, so that the very same frame of somebody else is heard.
"""

# python-can's messages and buses are typed in parts only.
# pyright: reportUnknownMemberType=false, reportUnknownVariableType=false

from __future__ import annotations

import logging
import select
import time
from collections import Counter
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final, NamedTuple

import can

from limo_driver.errors import BackendError, ConnectionLostError
from limo_driver.runtime.processes.closing import Closing

if TYPE_CHECKING:
    from collections.abc import Callable

    from backends.can.config import Bus

BUS_OFF: Final = 0x40  # class of error frames, as SocketCAN numbers them
MOST_USELESS: Final = 256  # that are passed over at once, when no time is left to wait
MOST_ECHOES: Final = 4096  # own frames that are waited for; more were lost
UNBUFFERED: Final = {"socketcan", "udp_multicast"}  # what has arrived is to be seen from outside
# Frames of a simulated bus stay on this machine, unless told otherwise.
_DEFAULTS: Final[dict[str, dict[str, Any]]] = {"udp_multicast": {"hop_limit": 0}}


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
