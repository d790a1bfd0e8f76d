"""The `canopen` package, which shares no code with limo, drives the simulated drives."""

import canopen
import pytest
from bus_master import GROUP, wait_until
from canopen.objectdictionary import (
    INTEGER8,
    INTEGER16,
    INTEGER32,
    UNSIGNED8,
    UNSIGNED16,
    UNSIGNED32,
    VISIBLE_STRING,
    ODArray,
    ODRecord,
    ODVariable,
)
from canopen.profiles.p402 import BaseNode402
from canopen.sdo import SdoAbortedError
from ports import free_port

from backends.can.simulator import SimulatedDrives

pytestmark = [pytest.mark.waits, pytest.mark.slow("starts drives in a process of its own")]

NODE = 11
COUNTS_PER_TURN = 65536 * 160
VARIABLES = {
    0x1000: ("device type", UNSIGNED32),
    0x1001: ("error register", UNSIGNED8),
    0x1008: ("device name", VISIBLE_STRING),
    0x1017: ("producer heartbeat time", UNSIGNED16),
    0x1006: ("communication cycle period", UNSIGNED32),
    0x603F: ("error code", UNSIGNED16),
    0x6040: ("controlword", UNSIGNED16),
    0x6041: ("statusword", UNSIGNED16),
    0x6007: ("abort connection option code", INTEGER16),
    0x6060: ("modes of operation", INTEGER8),
    0x6061: ("modes of operation display", INTEGER8),
    0x6064: ("position actual value", INTEGER32),
    0x606C: ("velocity actual value", INTEGER32),
    0x6071: ("target torque", INTEGER16),
    0x6076: ("motor rated torque", UNSIGNED32),
    0x6077: ("torque actual value", INTEGER16),
    0x607A: ("target position", INTEGER32),
    0x60B2: ("torque offset", INTEGER16),
    0x6502: ("supported drive modes", UNSIGNED32),
}


def variable(name, index, subindex, kind):
    made = ODVariable(name, index, subindex)
    made.data_type = kind
    return made


def dictionary():
    """Return an object dictionary as an EDS would give it."""
    objects = canopen.ObjectDictionary()
    for index, (name, kind) in VARIABLES.items():
        objects.add_object(variable(name, index, 0, kind))
    for index, kinds in (
        (0x1016, [UNSIGNED32]),
        (0x1018, [UNSIGNED32] * 4),
    ):
        array = ODArray(f"array {index:X}", index)
        array.add_member(variable("number", index, 0, UNSIGNED8))
        for k, kind in enumerate(kinds, start=1):
            array.add_member(variable(f"value {k}", index, k, kind))
        objects.add_object(array)
    for first in (0x1400, 0x1800):
        for k in range(4):
            record = ODRecord(f"pdo {first + k:X}", first + k)
            kinds = {1: UNSIGNED32, 2: UNSIGNED8, 3: UNSIGNED16, 5: UNSIGNED16}
            record.add_member(variable("number", first + k, 0, UNSIGNED8))
            for sub, kind in kinds.items():
                record.add_member(variable(f"parameter {sub}", first + k, sub, kind))
            objects.add_object(record)
            # As an array, canopen would save it empty: its length is what subindex 0 says by then.
            mapping = ODRecord(f"mapping {first + k:X}", first + 0x200 + k)
            mapping.add_member(variable("number", first + 0x200 + k, 0, UNSIGNED8))
            for sub in range(1, 9):
                mapping.add_member(variable(f"object {sub}", first + 0x200 + k, sub, UNSIGNED32))
            objects.add_object(mapping)
    return objects


@pytest.fixture(scope="module")
def drives(tmp_path_factory, two_links_urdf):
    """Two drives in another process, and the address of their bus."""
    number = free_port()
    path = tmp_path_factory.mktemp("arm") / "arm.yaml"
    path.write_text(
        f"bus: {{interface: udp_multicast, channel: {GROUP}, options: {{port: {number}}}}}\n"
        f"robot: {two_links_urdf}\njoints:\n"
        "  - {node: 11, counts_per_turn: 65536, gear: 160, rated_torque: 50, serial: 7001}\n"
        "  - {node: 12, counts_per_turn: 65536, gear: 100, rated_torque: 50}\n"
    )
    with SimulatedDrives(path):
        yield number


@pytest.fixture
def network(drives):
    network = canopen.Network()
    network.NOTIFIER_CYCLE = 0.05  # [s], which it also takes to end
    network.connect(interface="udp_multicast", channel=GROUP, port=drives, hop_limit=0, fd=False)
    yield network
    network.nmt.state = "RESET"
    network.disconnect()


@pytest.fixture
def node(network):
    node = BaseNode402(NODE, dictionary())
    network.add_node(node)
    node.sdo.RESPONSE_TIMEOUT = 5.0
    said = []  # `wait_for_bootup` would miss a node that boots before it waits
    node.nmt.add_heartbeat_callback(said.append)
    node.nmt.state = "RESET"
    wait_until(lambda: 0 in said)
    return node


def map_cycle(node):
    """Map controlword and position one way, statusword, position and torque the other."""
    node.nmt.state = "PRE-OPERATIONAL"
    node.rpdo.read()
    node.tpdo.read()
    for pdo, names, transmission in (
        (node.rpdo[1], ("controlword", "target position", "torque offset"), 1),
        (node.tpdo[1], ("statusword", "position actual value", "torque actual value"), 1),
        (node.rpdo[2], ("target torque", "modes of operation"), 1),
        (node.tpdo[2], ("velocity actual value", "error code", "modes of operation display"), 2),
    ):
        pdo.clear()
        pdo.received = []  # `wait_for_reception` would miss an answer that is there at once
        pdo.add_callback(pdo.received.append)
        for name in names:
            pdo.add_variable(name)
        pdo.trans_type, pdo.enabled = transmission, True
    node.rpdo.save()
    node.tpdo.save()


def cycles(network, node, count):
    """Run so many cycles, each with its SYNC; return the last TPDO1."""
    for _ in range(count):
        received = len(node.tpdo[1].received)
        network.sync.transmit()
        wait_until(lambda received=received: len(node.tpdo[1].received) > received)
    return node.tpdo[1]


def enable(network, node):
    map_cycle(node)
    node.nmt.state = "OPERATIONAL"
    here = node.sdo["position actual value"].raw
    node.rpdo[1]["target position"].raw = here
    node.rpdo[2]["modes of operation"].raw = 8
    node.rpdo[2].transmit()
    for word in (0x06, 0x07, 0x0F):
        node.rpdo[1]["controlword"].raw = word
        node.rpdo[1].transmit()
        cycles(network, node, 1)
    assert node.tpdo[1]["statusword"].raw & 0x6F == 0x27
    return here


def test_sdo_reads_and_writes_every_kind_of_object(node):
    assert node.sdo["device type"].raw == 0x00020192
    assert node.sdo["device name"].raw == "limo simulated drive, joint 1"  # segmented
    assert node.sdo[0x1018][4].raw == 7001
    assert node.sdo["motor rated torque"].raw == 50_000
    node.sdo["abort connection option code"].raw = 3
    assert node.sdo["abort connection option code"].raw == 3


@pytest.mark.parametrize(
    ("index", "subindex", "data", "code"),
    [
        (0x5000, 0, b"\x01", 0x06020000),  # no such object
        (0x1018, 9, b"\x01", 0x06090011),  # no such subindex
        (0x6041, 0, b"\x01\x00", 0x06010002),  # read-only
        (0x6040, 0, b"\x01", 0x06070010),  # too short
        (0x6060, 0, b"\x09", 0x06090030),  # a mode that it does not have
        (0x1600, 1, b"\x10\x00\x40\x60", 0x08000022),  # mapping, while the PDO is on
    ],
)
def test_what_cannot_be_written_is_aborted_with_the_standard_code(
    node, index, subindex, data, code
):
    with pytest.raises(SdoAbortedError) as aborted:
        node.sdo.download(index, subindex, data)
    assert aborted.value.code == code


def test_nmt_moves_the_node_and_its_heartbeat_says_so(node):
    node.sdo["producer heartbeat time"].raw = 20
    for state in ("OPERATIONAL", "STOPPED", "PRE-OPERATIONAL"):
        node.nmt.state = state
        node.nmt.wait_for_heartbeat(5.0)
        node.nmt.wait_for_heartbeat(5.0)
        assert node.nmt.state == state


def test_the_state_machine_of_another_stack_enables_and_disables(node):
    node.TIMEOUT_SWITCH_STATE_FINAL = node.TIMEOUT_SWITCH_STATE_SINGLE = 5.0
    node.sdo.MAX_RETRIES = 1
    node.state = "OPERATION ENABLED"
    assert node.state == "OPERATION ENABLED"
    node.state = "SWITCHED ON"
    node.state = "SWITCH ON DISABLED"
    assert node.state == "SWITCH ON DISABLED"


def test_positions_are_followed_in_step_with_sync(network, node):
    here = enable(network, node)
    node.sdo["communication cycle period"].raw = 4000
    step, wanted = 400, here
    for _ in range(50):
        wanted += step
        node.rpdo[1]["target position"].raw = wanted
        node.rpdo[1].transmit()
        measured = cycles(network, node, 1)
    assert abs(measured["position actual value"].raw - wanted) < 6 * step
    for _ in range(50):
        node.rpdo[1].transmit()
        measured = cycles(network, node, 1)
    error = measured["position actual value"].raw - wanted
    assert abs(error) < COUNTS_PER_TURN * 1e-3 / 6.28  # 1 mrad


def test_a_set_point_waits_for_the_next_sync(network, node):
    here = enable(network, node)
    node.rpdo[1]["target position"].raw = here + 5000
    node.rpdo[1].transmit()
    assert node.sdo["target position"].raw == here
    cycles(network, node, 1)
    assert node.sdo["target position"].raw == here + 5000


@pytest.mark.parametrize("push", [100, -100])
def test_torque_mode_moves_the_joint_the_way_it_is_pushed(network, node, push):
    here = enable(network, node)
    rest = cycles(network, node, 50)["torque actual value"].raw
    node.rpdo[2]["modes of operation"].raw = 10
    node.rpdo[2]["target torque"].raw = rest + push  # per mille of the rated torque
    node.rpdo[2].transmit()
    moved = cycles(network, node, 20)["position actual value"].raw - here
    assert node.tpdo[2]["modes of operation display"].raw == 10
    assert moved * push > 0


def test_a_lost_heartbeat_is_an_emergency_and_a_fault(network, node):
    enable(network, node)
    node.sdo["abort connection option code"].raw = 1
    node.sdo[0x1016][1].raw = 127 << 16 | 100  # [ms]
    network.send_message(0x700 + 127, [5])
    wait_until(lambda: [error.code for error in node.emcy.log] == [0x8130])
    wait_until(lambda: node.sdo["statusword"].raw & 0x4F == 0x08)
    assert node.sdo["error code"].raw == 0x8130
    node.sdo["controlword"].raw = 0x80
    assert node.sdo["statusword"].raw & 0x4F == 0x40
