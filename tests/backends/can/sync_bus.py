"""A bus without threads or delays, and with a time of its own.

What is sent is answered before `send` returns, and time passes only where the driver waits.
"""

from collections import deque

import can


class SyncBus(can.BusABC):
    """The driver's end; `listener(id, data)` gets its frames, `deliver` puts frames into it."""

    def __init__(self):
        super().__init__(channel="sync")
        self.queue = deque()
        self.listener = lambda *_: None
        self.sent = []  # (id, data), all of them
        self.messages = []  # the same, as python-can has them
        self.echo = False  # whether the driver hears itself, as on udp_multicast
        self.noise = lambda: None  # called before each frame of the driver
        self.losing = 0  # SYNCs whose measurements get lost
        self.time = 100.0  # [s]
        self.later = []  # (time, id, data) of frames that come by themselves

    def now(self):
        return self.time

    def send(self, msg, timeout=None):  # noqa: ARG002  # of python-can
        data = bytes(msg.data)
        self.sent.append((msg.arbitration_id, data))
        self.messages.append(msg)
        self.noise()
        if self.echo:
            self.deliver(msg.arbitration_id, data)
        if msg.arbitration_id == 0x080 and self.losing:
            self.losing -= 1
            queue, self.queue = self.queue, deque()
            self.listener(0x080, data)
            self.queue = queue
        else:
            self.listener(msg.arbitration_id, data)

    def deliver(self, frame_id, data, **kind):
        self.queue.append(
            can.Message(arbitration_id=frame_id, data=data, is_extended_id=False, **kind)
        )

    def recv(self, timeout=None):
        if self.queue:
            return self.queue.popleft()
        until = self.time + (timeout or 0.0)
        if self.later and self.later[0][0] <= until:
            self.time, *frame = self.later.pop(0)
            self.deliver(*frame)
            return self.queue.popleft()
        self.time = until
        return None

    def _recv_internal(self, timeout):
        return self.recv(timeout), True


class NetworkEnd:
    """The drives' end, as canopen's Network takes a bus; it sends no heartbeats by itself."""

    channel_info = "sync"

    def __init__(self, bus):
        self.bus = bus

    def send(self, msg, timeout=None):  # noqa: ARG002  # of python-can
        self.bus.deliver(msg.arbitration_id, bytes(msg.data))

    def send_periodic(self, *_, **__):
        return self

    def modify_data(self, *_):
        pass

    def stop(self):
        pass
