"""A bus for each test, and a master of few words."""

import struct
import time

from sync_bus import SyncBus

from backends.can.simulator.session import Station
from limo_driver.physics import Simulation

GROUP = "239.74.163.45"


class Master:
    """A master of few words in the process of the drives, so that nothing depends on time.

    Time stands still for the drives but for `wait`.
    """

    def __init__(self, config, scenario=None, position=None):
        self.heard = []
        simulation = Simulation(robot=config.robot)
        self.now = 100.0
        self.station = Station(
            config, self, simulation, position, scenario=scenario, clock=lambda: self.now
        )
        self.station.start()

    # The station's port.
    def send(self, frame_id, data):
        self.heard.append((frame_id, bytes(data)))

    def receive(self, until):
        self.now = until

    def close(self):
        pass

    # The master.
    def say(self, frame_id, data=b""):
        """Put a frame on the bus and return what is answered at once."""
        seen = len(self.heard)
        self.station.hear(frame_id, bytes(data))
        return self.heard[seen:]

    def wait(self, duration):
        """Let time pass [s] and return what is said meanwhile."""
        seen, until = len(self.heard), self.now + duration
        while self.now < until:
            self.station.turn()
        return self.heard[seen:]

    def write(self, node, index, subindex, data):
        """Write an object; return the abort code, 0 if there was none."""
        head = 0x23 | (4 - len(data)) << 2
        request = bytes([head, index & 0xFF, index >> 8, subindex]) + data.ljust(4, b"\0")
        said = self.say(0x600 + node, request)  # an emergency may come first
        [answer] = [data for reply, data in said if reply == 0x580 + node]
        return int.from_bytes(answer[4:], "little") if answer[0] == 0x80 else 0

    def read(self, node, index, subindex=0, signed=False):
        """Read a number; an abort is an error."""
        request = bytes([0x40, index & 0xFF, index >> 8, subindex, 0, 0, 0, 0])
        [(_, answer)] = self.say(0x600 + node, request)
        assert answer[0] & 0xE3 == 0x43, answer.hex()
        size = 4 - (answer[0] >> 2 & 3)
        return int.from_bytes(answer[4 : 4 + size], "little", signed=signed)

    def cycle(self, period=0.004):
        """Say SYNC, then let its period pass."""
        answers = self.say(0x080)
        return answers + self.wait(period)


POSE = [0.4, -0.3]  # [rad], in which simulated motors begin


class DrivesBus(SyncBus):
    """The driver's end of a bus with simulated drives; time passes where the driver waits."""

    def __init__(self, config, position=None, scenario=None, simulation=None):
        super().__init__()
        simulation = simulation or Simulation(robot=config.robot)
        self.station = Station(
            config, _DrivesEnd(self), simulation, position, scenario=scenario, clock=self.now
        )
        self.listener = self.station.hear
        self.station.start()

    def recv(self, timeout=None):
        if not self.queue:
            self.time += timeout or 0.0
            while self.station.due <= self.time:
                self.station.turn()
        return self.queue.popleft() if self.queue else None


class _DrivesEnd:
    def __init__(self, bus):
        self.send = bus.deliver

    def receive(self, until):
        """Hear nothing: frames are heard as they are sent."""

    def close(self):
        pass


def map_position(drives, node):
    """Map controlword, position and offset one way, statusword, position and torque the other."""
    for communication, mapping, cob, objects in (
        (0x1400, 0x1600, 0x200, (0x60400010, 0x607A0020, 0x60B20010)),
        (0x1800, 0x1A00, 0x180, (0x60410010, 0x60640020, 0x60770010)),
    ):
        entries = [(mapping, k, entry, 4) for k, entry in enumerate(objects, start=1)]
        for index, subindex, value, size in (
            (communication, 1, 1 << 31 | cob + node, 4),
            (mapping, 0, 0, 1),
            *entries,
            (mapping, 0, len(objects), 1),
            (communication, 2, 1, 1),
            (communication, 1, cob + node, 4),
        ):
            assert drives.write(node, index, subindex, value.to_bytes(size, "little")) == 0
    drives.write(node, 0x1006, 0, (4000).to_bytes(4, "little"))  # [µs]


def enable(drives, node):
    """Enable one drive in step with SYNC, where it stands; return its count."""
    map_position(drives, node)
    drives.say(0x000, bytes([1, node]))
    where = drives.read(node, 0x6064, signed=True)
    for word in (0x06, 0x07, 0x0F):
        drives.say(0x200 + node, struct.pack("<Hih", word, where, 0))
        drives.cycle()
    assert drives.read(node, 0x6041) & 0x6F == 0x27
    return where


def words(drives, node, index, count):
    """Read the first values of an array."""
    return [drives.read(node, index, k) for k in range(count)]


def wait_until(found, timeout=120.0):
    """Wait for something to become true."""
    ends = time.monotonic() + timeout
    while not found():
        assert time.monotonic() < ends, "it did not come about"
        time.sleep(0.001)
