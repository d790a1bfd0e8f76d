"""What tests of simulated drives share: a bus of their own, an arm of two joints, its drives."""

import can
import pytest
from bus_master import GROUP, POSE, DrivesBus, Master
from ports import free_port

from backends.can.config import ArmConfig
from backends.can.port import BusPort
from backends.can.simulator.scenario import BusScenario

JOINTS = """
  - {node: 11, counts_per_turn: 65536, gear: 160, rated_torque: 50, serial: 7001}
  - {node: 12, counts_per_turn: 65536, gear: 100, rated_torque: 50, direction: -1, offset: 0.1}
"""


@pytest.fixture
def port_number():
    """A port of its own: multicast frames cross groups on the same port."""
    return free_port()


@pytest.fixture
def arm_yaml(tmp_path, two_links_urdf, port_number):
    """Make a function that writes an arm.yaml with further entries, and returns its path."""

    def write(more="", joints=JOINTS):
        path = tmp_path / "arm.yaml"
        path.write_text(
            f"bus: {{interface: udp_multicast, channel: {GROUP}, options: {{port: {port_number}}}}}"
            f"\nrobot: {two_links_urdf}\n{more}\njoints:{joints}"
        )
        return path

    return write


@pytest.fixture
def raw_bus(port_number):
    """The same bus, frame by frame."""
    bus = can.Bus(interface="udp_multicast", channel=GROUP, port=port_number, hop_limit=0)
    yield bus
    bus.shutdown()


@pytest.fixture
def master(arm_yaml, tmp_path):
    """Make a function that opens drives, with a scenario written as text, and their master."""
    opened = []

    def open_(faults="", more="", position=None):
        config = ArmConfig.load(arm_yaml(more))
        scenario = None
        if faults:
            path = tmp_path / "scenario.yaml"
            path.write_text(faults)
            scenario = BusScenario.load(path, config.joints)
        opened.append(Master(config, scenario, position))
        return opened[-1]

    yield open_
    for each in opened:
        each.station.close()


@pytest.fixture
def port(arm_yaml):
    """The bus of the arm, as the backend opens it."""
    with BusPort(ArmConfig.load(arm_yaml()).bus) as port:
        yield port


@pytest.fixture
def config(arm_yaml):
    """Two Damiao motors."""
    joints = """
  - {node: 1, stiffness: 500, damping: 5}
  - {node: 2, stiffness: 500, damping: 5, direction: -1, offset: 0.25}
"""
    return ArmConfig.load(arm_yaml("convention: damiao", joints))


@pytest.fixture
def bus(config):
    """Return a bus with them, on which time passes where a driver waits."""
    return DrivesBus(config, POSE)
