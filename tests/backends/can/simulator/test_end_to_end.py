"""The driver and simulated drives: on a real bus with another process, and within this one.

Nothing here depends on time: on the real bus joints may be silent for long, and cycles come when
they come; the bus within this process has a time of its own. Arms that give way are driven there:
they are braked within 10 ms of a loss, whatever the configuration forgives.
"""

import json
import time
from contextlib import contextmanager, suppress
from dataclasses import replace

import numpy as np
import pytest
from bus_master import GROUP, DrivesBus
from lanes import later
from ports import free_port

from backends.can import ArmConfig, CanRobot
from backends.can.simulator import SimulatedDrives
from backends.can.simulator.scenario import BusScenario
from limo_driver.errors import BackendError, CycleTimeoutError, HoldingError
from limo_driver.trajectory import Trajectory
from limo_driver.types import ImpedanceCommand, PositionCommand, TorqueCommand

pytestmark = pytest.mark.waits

JOINTS = {
    "cia402": """
  - {node: 11, counts_per_turn: 65536, gear: 160, rated_torque: 50, serial: 7001}
  - {node: 12, counts_per_turn: 65536, gear: 100, rated_torque: 50, direction: -1, offset: 0.1,
     serial: 7002}
""",
    "damiao": """
  - {node: 1, stiffness: 500, damping: 5}
  - {node: 2, stiffness: 500, damping: 5, direction: -1, offset: 0.25}
""",
}
CONVENTIONS = tuple(JOINTS)


def write_arm(folder, robot, convention):
    """Write the configuration of an arm that forgives slow machines."""
    path = folder / f"{convention}.yaml"
    path.write_text(
        f"bus: {{interface: udp_multicast, channel: {GROUP}, "
        f"options: {{port: {free_port()}}}}}\nconvention: {convention}\n"
        f"robot: {robot}\nrate: 200\nhold_after: 200\nwatchdog: 2.0\n"
        f"answer_timeout: 5.0\njoints:{JOINTS[convention]}"
    )
    return path


@pytest.fixture
def arm(tmp_path, two_links_urdf):
    return lambda convention: write_arm(tmp_path, two_links_urdf, convention)


@pytest.fixture(scope="module", params=later(CONVENTIONS, "starts processes"))
def flawless(request, tmp_path_factory, two_links_urdf):
    """Drives with which nothing goes wrong: their configuration."""
    path = write_arm(tmp_path_factory.mktemp("arm"), two_links_urdf, request.param)
    with SimulatedDrives(path) as drives:
        yield path
    assert drives.summary["lost"] == 0


@pytest.fixture
def scenario(tmp_path):
    def write(text):
        path = tmp_path / "scenario.yaml"
        path.write_text(f"faults:\n- {text}\n")
        return path

    return write


@contextmanager
def driven(path, faults=None, **changes):
    """Open a driver on a bus within this process, with drives that may have faults."""
    config = replace(ArmConfig.load(path), **changes)
    bus = DrivesBus(config, scenario=faults and BusScenario.load(faults, config.joints))
    with CanRobot(config, bus=bus, clock=bus.now) as robot:
        yield robot


def fresh(robot):
    """Return the next state that was measured."""
    ends = time.monotonic() + 120
    while time.monotonic() < ends:
        with suppress(CycleTimeoutError):  # before the first one
            if not (state := robot.receive()).stale:
                return state
    raise AssertionError("no state was measured in 120 s")


def cycle_until_held(robot):
    """Command the pose until the arm holds; return why."""
    ends = time.monotonic() + 120
    state = fresh(robot)
    target = state.position
    while time.monotonic() < ends:
        try:
            robot.send(PositionCommand(valid_for=1.0, position=target))
        except HoldingError as held:
            return str(held)
        robot.receive()
    raise AssertionError("the arm does not hold")


def test_a_motion_is_followed_over_the_bus(flawless):
    with CanRobot(flawless) as robot:
        first, has_servo = fresh(robot), robot.config.convention == "cia402"
        for k in range(1, 141):
            away = 0.1 * (1 - np.cos(np.pi * min(k / 100, 1.0)))
            robot.send(PositionCommand(valid_for=1.0, position=first.position + away))
            robot.receive()
        state = fresh(robot)
        assert not state.holding
        tolerance = 2e-3 if has_servo else 2e-2  # a spring of 500 N m/rad, no more
        assert state.position == pytest.approx(first.position + 0.2, abs=tolerance)
        load = robot.config.model.gravity_torque(state.position)[0]
        assert state.torque == pytest.approx(load, abs=1.0 if has_servo else 4.0)
        assert all(drive.enabled and not drive.error for drive in robot.drives)


@pytest.mark.parametrize("convention", CONVENTIONS)
def test_torque_mode_is_on_top_of_gravity(arm, convention):
    with driven(arm(convention)) as robot:
        first = fresh(robot)
        for k in range(80):
            robot.send(TorqueCommand(valid_for=1.0, torque=np.array([2.0 * min(k / 10, 1.0), 0.0])))
            state = robot.receive()
        assert fresh(robot).position[0] > first.position[0] + 1e-3
        assert not state.holding


@pytest.mark.parametrize("convention", CONVENTIONS)
def test_an_impedance_is_damiaos_own(arm, convention):
    stiff = {"stiffness": np.full(2, 300.0), "damping": np.full(2, 5.0), "torque": np.zeros(2)}
    with driven(arm(convention)) as robot:
        first = fresh(robot)
        if robot.config.convention == "cia402":
            with pytest.raises(BackendError, match="positions \\(CSP\\) or torques \\(CST\\)"):
                robot.send(ImpedanceCommand(valid_for=1.0, position=first.position, **stiff))
            return
        for k in range(150):
            target = first.position + 0.05 * min(k / 100, 1.0)
            robot.send(ImpedanceCommand(valid_for=1.0, position=target, **stiff))
            robot.receive()
        assert fresh(robot).position == pytest.approx(first.position + 0.05, abs=0.02)
        stiff["stiffness"] = np.full(2, 501.0)
        with pytest.raises(BackendError, match=r"stiffness 501 N m/rad is outside \[0, 500\]"):
            robot.send(ImpedanceCommand(valid_for=1.0, position=target, **stiff))


@pytest.mark.parametrize("convention", CONVENTIONS)
def test_a_drive_in_fault_leads_to_hold_and_is_named(arm, scenario, convention):
    path = arm(convention)
    faults = scenario("{fault: drive_fault, joint: 2, at: 0.3, code: 0x4310}")
    with driven(path, faults) as robot:
        reason = cycle_until_held(robot)
        assert "joint 2" in reason
        assert "fault" in reason or "hot winding" in reason
        assert fresh(robot).holding
        with pytest.raises(BackendError, match="joint 2"):
            robot.resume()
        robot.reset_faults()
        robot.resume()
        state = fresh(robot)
        robot.send(PositionCommand(valid_for=1.0, position=state.position))
        assert not robot.receive().holding


@pytest.mark.parametrize("convention", CONVENTIONS)
@pytest.mark.slow("compiles an arm in another process and waits for its silence")
def test_drives_that_vanish_are_stale_then_hold(arm, convention):
    path = arm(convention)
    with SimulatedDrives(path) as drives:
        config = replace(ArmConfig.load(path), hold_after=2)
        with CanRobot(config) as robot:
            state = fresh(robot)
            drives.kill()
            states = [robot.receive() for _ in range(4)]
            assert all(each.stale for each in states[2:])
            assert states[-1].position == pytest.approx(state.position, abs=1e-2)  # never zero
            with pytest.raises(HoldingError, match="silent"):
                robot.send(PositionCommand(valid_for=1.0, position=state.position))


@pytest.mark.slow("moves for seconds, in real time")
def test_lost_frames_are_lived_through(arm, scenario):
    path = arm("cia402")
    faults = scenario("{fault: lose_frames, probability: 0.05, at: 0.2}")
    with SimulatedDrives(path, scenario=faults) as drives:
        with CanRobot(path) as robot:
            first = fresh(robot)
            for k in range(1, 151):
                away = 0.05 * (1 - np.cos(np.pi * min(k / 100, 1.0)))
                robot.send(PositionCommand(valid_for=1.0, position=first.position + away))
                robot.receive()
            assert fresh(robot).position == pytest.approx(first.position + 0.1, abs=5e-3)
        drives.close()
        assert drives.summary["lost"] > 0


@pytest.mark.parametrize("convention", CONVENTIONS)
def test_a_wrong_node_id_is_named_at_opening(arm, scenario, convention):
    path = arm(convention)
    faults = scenario("{fault: wrong_node, joint: 2, node: 40}")
    with pytest.raises(BackendError) as refused, driven(path, faults):
        pass
    assert "joint 2" in str(refused.value)
    assert "does not answer" in str(refused.value)
    assert "40" in str(refused.value) or "56" in str(refused.value)  # replies come on 40 + 0x10


def test_swapped_joints_are_found_by_their_serial_numbers(arm, scenario):
    path = arm("cia402")
    faults = scenario("{fault: swap_joints, joint: 1, other: 2}")
    with pytest.raises(BackendError) as refused, driven(path, faults):
        pass
    assert "which is the drive of joint 2: swapped?" in str(refused.value)


def test_a_babbling_node_does_not_keep_the_arm_from_moving(arm, scenario):
    path = arm("cia402")
    faults = scenario("{fault: babble, id: 0x181, rate: 500}")
    with driven(path, faults) as robot:
        first = fresh(robot)
        for k in range(1, 61):
            robot.send(PositionCommand(valid_for=1.0, position=first.position + 0.001 * k))
            robot.receive()
        assert fresh(robot).position == pytest.approx(first.position + 0.06, abs=5e-3)


def test_drives_of_another_robot_are_refused(arm, limo, tmp_path):
    sim = tmp_path / "sim.yaml"
    sim.write_text("robot: iiwa14\n")
    refused = limo("drives", "--config", arm("cia402"), "--sim", sim)
    assert refused.returncode == 2
    assert "limo: the simulation is of iiwa14, but the drives are of " in refused.stderr


def test_a_trajectory_of_another_robot_is_refused(arm, limo, tmp_path):
    path = tmp_path / "other.traj.parquet"
    still = np.zeros((11, 3))
    Trajectory(np.linspace(0, 1, 11), still, still, still, robot="other").save(path)
    refused = limo("drives", "--config", arm("cia402"), "--trajectory", path)
    assert refused.returncode == 2
    assert "other.traj.parquet: the trajectory was planned for other, but the" in refused.stderr


def test_the_command_says_that_it_is_ready_and_what_happened(arm, commanded):
    from limo_driver.app.cli.drives import command

    said = commanded(command)("--config", arm("cia402"), "--duration", "0.1", "--json")
    ready, summary = map(json.loads, said.stdout.splitlines())
    assert ready["nodes"] == [11, 12]
    assert summary["faults"] == []
    assert "2 damiao drives on udp_multicast" in (
        commanded(command)("--config", arm("damiao"), "--duration", "0.1").stdout
    )


@pytest.mark.slow("starts a process")
def test_drives_that_cannot_start_say_why(tmp_path):
    with pytest.raises(BackendError, match=r"did not start: limo: .*nowhere\.yaml: cannot be read"):
        SimulatedDrives(tmp_path / "nowhere.yaml")


@pytest.mark.slow("starts the drives of an arm twice")
def test_drives_do_not_join_a_bus_that_has_them(flawless):
    with pytest.raises(BackendError, match=r"node \d+ answers on udp_multicast .* already"):
        SimulatedDrives(flawless)


@pytest.mark.slow("waits until the watchdog of the drives has run out")
def test_drives_that_stopped_since_a_program_was_killed_are_enabled_by_the_next(arm):
    config = ArmConfig.load(arm("cia402"))
    bus = DrivesBus(config)
    first = CanRobot(config, bus=bus, clock=bus.now)
    fresh(first)
    until = bus.time + 2 * config.watchdog  # it was killed: nothing comes any more
    while bus.time < until:
        bus.recv(0.01)
    assert {drive.drive_state.name for drive in bus.station.drives} == {"QUICK_STOP"}
    with CanRobot(config, bus=bus, clock=bus.now) as second:
        state = fresh(second)
        second.send(PositionCommand(valid_for=1.0, position=state.position))
        assert not fresh(second).holding
