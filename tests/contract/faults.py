"""Faults of networks, drives and computers: how each begins at a wire, and when it has to be held.

A rig begins a fault, which lasts for some cycles, and says within which time it has to be held. All
time is that of the simulated wire.
"""

import errno
import select
import struct
from collections import deque
from contextlib import suppress
from types import SimpleNamespace

import can
from arms import NODES
from stepped_arm import HOST, SteppedArm

import backends.fri
from backends.fri.codec import messages as m

FRI_FAULTS = (
    "send fails", "answers lost", "answers kept", "false replies", "duplicates",
    "foreign datagrams", "counter flips", "mode flips", "stalls",
)  # fmt: skip
CAN_FAULTS = (
    "send fails", "answers lost", "false replies", "duplicates", "foreign frames", "mode flips",
    "stalls", "foreign set-points",
)  # fmt: skip
UNCONFIRMED, UNMEASURED, COMPLIANT = 0.01, 0.1, 0.01  # [s] as docs/safety.md states them
EXPIRED = 0.1  # [s] that a command is valid
BUS = 0.02  # [s] in which others on a bus, and a bus that takes no frame, are noticed
LONGEST_WAIT = 5000  # packets of which it is known when they came
LOST_STEPS = 10  # cycles that commands which are lost may count for


class FaultyClient:
    """The driver's socket: its sends fail at times, and what it hears is as old as it is."""

    def __init__(self, endpoint, now):
        self.plain, self.now, self.refusing = endpoint._socket, now, deque()
        self.came, self.receive = {}, endpoint.receive
        endpoint._socket, endpoint.receive = self, self.aged

    def __getattr__(self, name):
        return getattr(self.plain, name)

    def sendto(self, data, peer):
        if self.refusing and self.refusing.popleft():
            raise OSError(errno.ENOBUFS, "No buffer space available")
        return self.plain.sendto(data, peer)

    def aged(self, timeout):
        datagram = self.receive(timeout)
        if datagram is None:
            return None
        now = self.now()
        return datagram._replace(age=now - self.came.get(datagram.data, now))


class FaultyArm:
    """The arm's socket: what it hears is kept, late, or lost on its way; notes when it sends."""

    def __init__(self, plain, now):
        self.plain, self.now, self.came = plain, now, {}
        self.heard, self.lost, self.losing = [], 0, deque()  # heard: and how many were lost before
        self.delay, self.kept_until, self.on_its_way = 0.0, 0.0, deque()  # of what it hears [s]

    def __getattr__(self, name):
        return getattr(self.plain, name)

    def recv(self, size):
        with suppress(BlockingIOError):
            while True:
                comes = max(self.now() + self.delay, self.kept_until)
                self.on_its_way.append((comes, self.plain.recv(size)))
        while True:
            if not self.on_its_way or self.on_its_way[0][0] > self.now() + 1e-9:
                raise BlockingIOError
            _, data = self.on_its_way.popleft()
            if not (self.losing and self.losing.popleft()):
                break
            self.lost += 1
        self.heard.append((data, self.lost))
        self.lost = 0
        return data

    def sendto(self, data, peer):
        if len(self.came) > LONGEST_WAIT:
            del self.came[next(iter(self.came))]
        self.came[data] = self.now()
        return self.plain.sendto(data, peer)


class FriFaults:
    """What goes wrong between a FRI driver and its robot."""

    faults = FRI_FAULTS

    def equip(self):
        """Put the faults between both; return what undoes it."""
        self.cycles, self.late = 0, False
        cycle = self.arm.cycle

        def counted():
            self.late = self.late and bool(select.select([self.client.plain], [], [], 0.0)[0])
            if not self.late:  # a driver that reads what has piled up does not wait for it
                self.cycles += 1
                cycle()

        self.arm.cycle = counted
        self.arm.socket = FaultyArm(self.arm.socket, self.now)
        self.client = FaultyClient(self.robot._link.endpoint, self.now)
        self.client.came = self.arm.socket.came
        self.other = SteppedArm(port=self.arm.port, host=HOST)
        # Time goes by on the wire alone.
        names = [name for name in ("robot", "replies") if hasattr(backends.fri, name)]
        clocks = [(module := getattr(backends.fri, name), module.time) for name in names]
        for module, _ in clocks:
            module.time = SimpleNamespace(monotonic=self.now)

        def undo():
            for module, clock in clocks:
                module.time = clock
            self.other.close()

        return undo

    def now(self):
        return self.cycles * self.robot.spec.period

    @property
    def delayed(self):
        return self.arm.socket.delay > 0.0 or len(self.arm.socket.on_its_way) > 0

    def begin(self, fault, random, rigid):
        """Begin a fault; return for how many cycles it lasts, and in which it is held [s]."""
        self.rigid = rigid
        return getattr(self, "fri_" + fault.replace(" ", "_"))(random)

    def end(self):
        """End all faults."""
        self.client.refusing.clear()
        self.arm.socket.losing.clear()
        self.arm.socket.delay = 0.0
        self.arm.__dict__.pop("message", None)
        self.arm.__dict__.pop("throw", None)

    def mend(self):
        """Do what a hold asks for before commands are taken again."""

    def pattern(self, random):
        """Return which of some cycles fail, and within which time that is held [s]."""
        if random.random() < 0.5:
            cycles = int(random.integers(1, 40))
            held = UNCONFIRMED if cycles > LOST_STEPS else None
            return deque([True] * cycles), held
        return deque((random.random(20) < random.choice([0.3, 0.8])).tolist()), None

    def fri_send_fails(self, random):
        self.client.refusing, held = self.pattern(random)
        return len(self.client.refusing), held

    def fri_answers_lost(self, random):
        self.arm.socket.losing, held = self.pattern(random)
        late = int(random.choice([0, 0, 1, 2, 4]))
        self.arm.socket.delay = late * self.robot.spec.period
        return len(self.arm.socket.losing) + 15, held and held + late * self.robot.spec.period

    def fri_answers_kept(self, random):
        cycles = int(random.choice([2, 5, 9, 11, 12, 15, 19]))
        self.arm.socket.kept_until = self.now() + cycles * self.robot.spec.period
        return cycles + 15, UNCONFIRMED if cycles > LOST_STEPS + 1 else None

    def fri_false_replies(self, random):
        cycles = int(random.integers(1, 20))
        away = random.choice([0.05, 0.5, 3.0]) * (random.random(7) < 0.3)
        away[random.integers(7)] = 0.3
        self.spoil(cycles, position=away)
        return cycles, COMPLIANT if cycles > LOST_STEPS and not self.rigid else None

    def fri_duplicates(self, random):
        throw, copies = self.arm.throw, int(random.integers(1, 4))

        def several(data):
            for _ in range(1 + copies):
                throw(data)

        self.arm.throw = several
        return 15, None

    def fri_foreign_datagrams(self, random):
        throw = self.arm.throw

        def beside(data):
            for _ in range(int(random.integers(1, 4))):
                self.other.sequence, self.other.ns = self.arm.sequence, self.arm.ns
                self.other.ipo = self.other.position = random.uniform(-1.0, 1.0, 7)
                self.other.state = random.choice(list(m.SessionState))
                self.other.send()
            throw(data)

        self.arm.throw = beside
        return 15, None

    def fri_counter_flips(self, random):
        kind, h = random.random(), self.robot.spec.period
        if kind < 0.2:
            self.arm.sequence = int(random.integers(100))  # begins anew
        elif kind < 0.4:
            self.arm.sequence = (self.arm.sequence + int(random.integers(50, 10**6))) % 2**32
        else:
            bit = 1 << int(random.integers(32))
            flipped = lambda header: header._replace(sequence=header.sequence ^ bit)  # noqa: E731
            self.change(1, lambda made: made._replace(header=flipped(made.header)))
        return 4, 2 * h  # it may show with the next packet only

    def fri_mode_flips(self, random):
        cycles = int(random.choice([1, 1, 5, 12, 60]))
        modes = [mode for mode in m.CommandMode if mode is not self.arm.mode]
        mode, state = random.choice(modes), random.choice(list(m.SessionState)[:4])
        off = (m.DriveState.ACTIVE,) * 6 + (m.DriveState.OFF,)
        change = [
            lambda made: made._replace(ipo=made.ipo._replace(command_mode=mode)),
            lambda made: made._replace(connection=made.connection._replace(quality=m.Quality.POOR)
            ),
            lambda made: made._replace(
                robot=made.robot._replace(safety_state=m.SafetyState.STOP0_OR_1)
            ),
            lambda made: made._replace(robot=made.robot._replace(drive_states=off)),
            lambda made: made._replace(connection=made.connection._replace(session_state=state)
            ),
        ][random.choice(5, p=[0.15, 0.15, 0.15, 0.15, 0.4])]  # fmt: skip
        self.change(cycles, change, resumes=int(random.integers(-1, 2)))
        return cycles + 2, self.robot.spec.period

    def fri_stalls(self, random):
        stall = int(random.choice([5, 6, 8, 20, 50, 100, 120, 150, 500]))
        for _ in range(stall):
            self.arm.cycle()
        self.late = True
        return 10, 2 * self.robot.spec.period if 1e-3 * stall > 1.2 * EXPIRED else None

    def change(self, cycles, change, resumes=-1):
        """Let the arm's next messages be others; a program resumes when so many are left."""
        left = [cycles]

        def message(**changes):
            made = SteppedArm.message(self.arm, **changes)
            if not left[0]:
                return made
            left[0] -= 1
            if left[0] == resumes:
                self.robot.resume()
            return change(made)

        self.arm.message = message


class CanFaults:
    """What goes wrong on the bus of an arm of drives; a subclass knows its frames."""

    faults = CAN_FAULTS

    def equip(self):
        """Put the faults on the bus."""
        self.filters, self.plain_send, self.refusing = [], self.bus.send, deque()
        self.bus.send = self.send

    def now(self):
        return self.bus.time

    def begin(self, fault, random, rigid):
        self.rigid = rigid
        return getattr(self, "can_" + fault.replace(" ", "_").replace("-", "_"))(random)

    def end(self):
        self.other_speed = 0
        self.filters.clear()
        self.refusing.clear()

    def send(self, msg, timeout=None):
        if self.refusing:
            self.refusing[0] -= 1  # frames that still pass
            if self.refusing[0] < 0:
                self.refusing.popleft()
                self.bus.time += self.robot.spec.period  # in which the program comes back
                raise can.CanOperationError("No buffer space available", errno.ENOBUFS)
        self.plain_send(msg, timeout)

    def can_send_fails(self, random):
        cycles = int(random.integers(1, 15))
        frames = [int(random.integers(0, 8))] + [0] * (cycles - 1)
        self.refusing = deque(frames)
        lasts = (cycles + 1) * self.robot.spec.period  # and then it takes them
        return cycles, lasts if lasts > BUS + 2 * self.robot.spec.period else None

    def can_answers_lost(self, random):
        cycles = int(random.integers(1, 40))
        lost = self.answers(random.choice(NODES, random.integers(1, 8), replace=False))
        self.filters.append(lambda k, data: [] if k in lost else [(k, data)])
        h = self.robot.spec.period
        patience = (
            UNMEASURED if self.rigid else COMPLIANT
        ) + h  # one answer may be late by so much
        return cycles, patience if cycles * h > patience + 3 * h else None

    def can_false_replies(self, random):
        cycles, node = int(random.choice([1, 2, 3, 4, 6, 15, 40])), random.choice(NODES)
        away = random.choice([-1, 1]) * random.choice([0.05, 0.3, 1.0])
        self.other_speed = int(random.choice([0, 0, 0x40, 0x80]))
        false = self.answers([node])
        self.filters.append(
            lambda k, data: [(k, self.moved(data, away)) if k in false else (k, data)]
        )
        return cycles, self.believed_after(cycles) if abs(away) > 0.1 else None

    def can_duplicates(self, random):
        cycles, twice = int(random.integers(1, 8)), self.answers([random.choice(NODES)])
        away = random.choice([0.0, 1e-4])
        self.filters.append(
            lambda k, data: [(k, data), (k, self.moved(data, away))] if k in twice else [(k, data)]
        )
        return cycles, BUS if cycles > 3 else None

    def can_foreign_frames(self, random):
        for _ in range(int(random.integers(1, 20))):
            frame = int(random.choice([0x063, 0x100, 0x77E, 0x263, 0x6C0]))
            self.delivered(frame, random.bytes(int(random.integers(9))))
        return 8, None

    def can_mode_flips(self, random):
        cycles, flipped = int(random.integers(1, 4)), self.answers([random.choice(NODES)])
        status = random.choice(self.other_statuses)
        self.filters.append(
            lambda k, data: [(k, self.in_status(data, status)) if k in flipped else (k, data)]
        )
        return cycles, 0.0

    def can_stalls(self, random):
        stall = 1e-3 * random.choice([5, 8, 20, 50, 100, 120, 150, 500])
        self.bus.time += stall
        return 3, 2 * self.robot.spec.period if stall > 1.2 * EXPIRED else None

    def can_foreign_set_points(self, random):
        self.intrude(random)
        return 6, BUS

    def mend(self):
        """Reset what tripped, and forget what was told meanwhile."""
        self.robot.reset_faults()
        self.robot.resume()
        self.bus.sent.clear()


class Cia402Faults(CanFaults):
    other_statuses = (0x23, 0x08, 0x40, 0x07)

    def answers(self, nodes):
        return {0x180 + int(node) for node in nodes}

    def moved(self, data, away):
        word, count, torque = struct.unpack("<Hih", data)
        return struct.pack("<Hih", word, count + round(away / 6.283185307 * 524288), torque)

    def in_status(self, data, status):
        return struct.pack("<H", status) + data[2:]

    def believed_after(self, cycles):
        """Say nothing: a drive out of reach counts as one that is not heard."""

    def intrude(self, random):
        node = int(random.choice(NODES))
        frame = random.choice([0x080, 0x200 + node, 0x300 + node])
        self.delivered(int(frame), random.bytes(8) if frame > 0x080 else b"")
        if frame == 0x080:
            self.bus.station.hear(0x080, b"")


class DamiaoFaults(CanFaults):
    other_speed = 0  # bits of a velocity that are flipped where a reply is false
    other_statuses = (0x0, 0x8, 0xB, 0xE)

    def answers(self, nodes):
        return {0x10 + int(node) - NODES[0] + 1 for node in nodes}

    def moved(self, data, away):
        code = int.from_bytes(data[1:3], "big") + round(away / 25.0 * 65535)
        speed = int.from_bytes(data[3:5], "big") ^ (self.other_speed << 4)
        return data[:1] + (min(max(code, 0), 65535) << 16 | speed).to_bytes(4, "big") + data[5:]

    def in_status(self, data, status):
        return bytes([data[0] & 0x0F | status << 4]) + data[1:]

    def believed_after(self, cycles):
        """Three that agree are believed."""
        return 2 * self.robot.spec.period if cycles >= 3 else None

    def intrude(self, random):
        frame = int(random.choice([*range(1, 8), 0x7FF]))
        self.delivered(frame, random.bytes(8))
