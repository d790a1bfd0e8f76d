"""CiA 402 drives that are local nodes of the `canopen` package: an oracle that shares no code.

SDO server, object dictionary, PDO mapping, NMT and heartbeats are canopen's own; here is only the
state machine of CiA 402 and a motor that is where it is told to be.
"""

import can
import canopen
from canopen.objectdictionary import (
    INTEGER8,
    INTEGER16,
    INTEGER32,
    UNSIGNED8,
    UNSIGNED16,
    UNSIGNED32,
    ObjectDictionary,
    ODRecord,
    ODVariable,
)
from sync_bus import NetworkEnd, SyncBus

PLAIN = {
    0x1000: (UNSIGNED32, 402),
    0x1001: (UNSIGNED8, 0),
    0x1005: (UNSIGNED32, 0x80),
    0x1006: (UNSIGNED32, 0),
    0x1017: (UNSIGNED16, 0),
    0x2031: (INTEGER16, 300),
    0x603F: (UNSIGNED16, 0),
    0x6007: (INTEGER16, 0),
    0x6040: (UNSIGNED16, 0),
    0x6041: (UNSIGNED16, 0x40),
    0x605A: (INTEGER16, 2),
    0x605E: (INTEGER16, 2),
    0x6060: (INTEGER8, 0),
    0x6061: (INTEGER8, 0),
    0x6064: (INTEGER32, 0),
    0x606C: (INTEGER32, 0),
    0x6071: (INTEGER16, 0),
    0x6076: (UNSIGNED32, 100_000),
    0x6077: (INTEGER16, 0),
    0x607A: (INTEGER32, 0),
    0x60B2: (INTEGER16, 0),
}
RECORDS = {
    0x1016: [UNSIGNED32],
    0x1018: [UNSIGNED32] * 4,
    0x60C2: [UNSIGNED8, INTEGER8],
    **{i: [UNSIGNED32, UNSIGNED8, UNSIGNED16, UNSIGNED8, UNSIGNED16] for i in (0x1400, 0x1401)},
    **{
        i: [UNSIGNED32, UNSIGNED8, UNSIGNED16, UNSIGNED8, UNSIGNED16] for i in range(0x1800, 0x1803)
    },
    **{i: [UNSIGNED32] * 4 for i in (0x1600, 0x1601, 0x1A00, 0x1A01, 0x1A02)},
}


def dictionary(node, serial):
    od = ObjectDictionary()
    for index, (kind, default) in PLAIN.items():
        od.add_object(_variable(index, 0, kind, default))
    for index, kinds in RECORDS.items():
        record = ODRecord(f"record {index:04X}", index)
        record.add_member(_variable(index, 0, UNSIGNED8, 0))
        for subindex, kind in enumerate(kinds, start=1):
            record.add_member(_variable(index, subindex, kind, 0))
        od.add_object(record)
    for index in (0x1400, 0x1401, 0x1800, 0x1801, 0x1802):
        od[index][1].default = 0x8000_0000
    od[0x1018][4].default = serial
    od.node_id = node
    return od


def _variable(index, subindex, kind, default):
    variable = ODVariable(f"object {index:04X}:{subindex:02X}", index, subindex)
    variable.data_type, variable.default = kind, default
    return variable


class CanopenDrive:
    """A drive whose motor jumps to its target at each SYNC while it is enabled."""

    def __init__(self, network, node, serial=0, count=0):
        self.node = network.create_node(node, dictionary(node, serial))
        self.state, self.word, self.count, self.torque, self.speed = 0x40, 0, count, 0, 0
        self.mode, self.fault, self.mute = 8, 0, False
        self.received = []  # controlwords, targets
        self.cycles = self.lag = 0
        self.node.nmt.state = "PRE-OPERATIONAL"
        self.node.add_read_callback(self._read)
        network.subscribe(0x000, self._on_nmt)
        network.subscribe(0x080, self._on_sync)

    def trip(self, code):
        self.fault, self.state = code, 0x08
        self.node.emcy.send(code)

    def _read(self, index, **_):
        values = {
            0x6041: self.state,
            0x6064: self.count,
            0x603F: self.fault,
            0x606C: self.speed,
            0x6061: self.mode,
        }
        return values.get(index)

    def _on_nmt(self, _id, data, _time):
        command, node = data
        if command == 0x01 and node == self.node.id:
            self.node.rpdo.read()
            self.node.tpdo.read()
            self.node.rpdo[1].callbacks[:] = [self._on_targets]
            self.node.rpdo[2].callbacks[:] = [self._on_torque]

    def _on_targets(self, pdo):
        self.word, self.target, _ = (entry.raw for entry in pdo)
        self.received.append((self.word, self.target))

    def _on_torque(self, pdo):
        self.torque_target, self.mode = (entry.raw for entry in pdo)

    def _on_sync(self, *_):
        if self.node.nmt.state != "OPERATIONAL" or self.mute:
            return
        self._step_state()
        if self.state == 0x27:
            if self.mode == 8:
                aim = self.target - self.lag
                self.speed, self.count = aim - self.count, aim
            else:
                self.torque = self.torque_target
        self._transmit(1, self.state, self.count, self.torque)
        self.cycles += 1
        if self.cycles % self.node.tpdo[2].trans_type == 0:
            self._transmit(2, self.speed, self.fault, self.mode)
            if self.node.tpdo[3].enabled:
                self._transmit(3, 305)

    def _transmit(self, number, *values):
        pdo = self.node.tpdo[number]
        for entry, value in zip(pdo, values, strict=True):
            entry.raw = value
        pdo.transmit()

    def _step_state(self):
        word, state = self.word & 0x8F, self.state
        if state == 0x08:
            if word & 0x80:
                self.state, self.fault = 0x40, 0
            return
        if not word & 0x02:
            self.state = 0x40
        elif not word & 0x04:
            self.state = 0x07 if state == 0x27 else 0x40 if state != 0x07 else state
        elif word & 0x0F == 0x06:
            self.state = 0x21
        elif word & 0x0F == 0x07:
            self.state = 0x23 if state in {0x21, 0x23, 0x27} else state
        elif word & 0x0F == 0x0F:
            self.state = 0x27 if state in {0x23, 0x27, 0x07} else state


class CanopenArm:
    """Such drives on a bus: a virtual one with threads, or a `SyncBus` without."""

    def __init__(self, bus, nodes, counts=None, serials=None):
        self.network = canopen.Network()
        if isinstance(bus, SyncBus):
            self.network.bus = NetworkEnd(bus)
            bus.listener = lambda frame_id, data: self.network.notify(frame_id, data, 0.0)
        else:
            self.network.bus = can.Bus(interface="virtual", channel=bus)
            self.network.NOTIFIER_CYCLE = 0.05
            self.network.connect()
        counts = counts or [0] * len(nodes)
        serials = serials or list(nodes)
        self.drives = [
            CanopenDrive(self.network, node, serial, count)
            for node, serial, count in zip(nodes, serials, counts, strict=True)
        ]
        if isinstance(bus, SyncBus):
            bus.queue.clear()  # of their boot-up

    def __enter__(self):
        return self

    def __exit__(self, *_):
        for drive in self.drives:
            drive.node.nmt.stop_heartbeat()
        if not isinstance(self.network.bus, NetworkEnd):
            self.network.disconnect()
