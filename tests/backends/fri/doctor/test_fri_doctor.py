"""`limo doctor fri` names what is wrong with a link."""

import json
import socket
import threading
from contextlib import contextmanager
from ipaddress import IPv4Network

import pytest
from fri_messages import monitoring
from ports import free_port
from stepped_arm import SteppedArm

from backends.fri import doctor
from backends.fri import doctor as network
from backends.fri.codec.messages import (
    PORTS,
    CommandMode,
    ConnectionInfo,
    DriveState,
    Generation,
    IpoData,
    OperationMode,
    Quality,
    RobotInfo,
    SafetyState,
    SessionState,
)
from backends.fri.doctor import examine
from backends.fri.session import advice

pytestmark = pytest.mark.waits


@contextmanager
def sending(arm, **at_cycle):
    """Let an arm run on its own, a packet every 2 ms."""
    done = threading.Event()

    def run():
        while not done.wait(2e-3):
            for change in at_cycle.values():
                change(arm)
            arm.cycle()

    thread = threading.Thread(target=run)
    thread.start()
    try:
        yield arm
    finally:
        done.set()
        thread.join()
        arm.close()


def codes(found):
    return {finding.code for finding in found.findings}


def text_of(found, code):
    return next(finding.text for finding in found.findings if finding.code == code)


@pytest.fixture
def few_ports(monkeypatch):
    """Ports that no other test listens on, in place of FRI's own."""
    ports = tuple(free_port() for _ in range(2))
    monkeypatch.setattr(doctor, "PORTS", ports)
    return ports


def test_nobody_sends(few_ports):
    found = examine(None, few_ports[0], 0.05)
    assert codes(found) == {"nobody"}
    assert not found.healthy
    assert "robot speaks first" in text_of(found, "nobody")


def test_usual_ports_are_listened_to():
    assert list(doctor.PORTS) == list(PORTS) == list(range(30200, 30210))


def test_port_is_taken(few_ports):
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as other:
        other.bind(("0.0.0.0", few_ports[0]))  # noqa: S104
        found = examine(None, few_ports[0], 0.05)
    assert codes(found) == {"port-taken"}
    assert "ss -ulpn" in text_of(found, "port-taken")


def test_robot_sends_to_another_port(few_ports):
    with sending(SteppedArm(port=few_ports[1])):
        found = examine(None, few_ports[0], 0.3)
    assert f"give --port {few_ports[1]}" in text_of(found, "other-port")
    assert "nobody" not in codes(found)


def test_somebody_else_sends(few_ports):
    with sending(SteppedArm(port=few_ports[0], host="127.0.0.7")):
        found = examine("127.0.0.2", few_ports[0], 0.3)
    assert codes(found) == {"other-host"}
    assert "127.0.0.7" in text_of(found, "other-host")


def test_garbage_comes(few_ports):
    arm = SteppedArm(port=few_ports[0])
    arm.cycle = lambda: arm.throw(b"GET / HTTP/1.1")
    with sending(arm):
        found = examine(None, few_ports[0], 0.2)
    assert "neither a bare nor a framed" in text_of(found, "not-fri")


def test_machine_is_in_another_network(few_ports, monkeypatch):
    monkeypatch.setattr(network, "networks", lambda: (IPv4Network("10.1.0.0/16"),))
    monkeypatch.setattr(doctor, "networks", network.networks)
    found = examine("192.0.2.7", few_ports[0], 0.05)
    assert codes(found) == {"nobody", "other-network"}
    assert "10.1.0.0/16" in text_of(found, "other-network")


def test_own_networks_are_read_from_the_table(tmp_path, monkeypatch):
    table = tmp_path / "route"
    table.write_text(
        "Iface Destination Gateway Flags RefCnt Use Metric Mask MTU Window IRTT\n"
        "eth0 00000000 0101A8C0 0003 0 0 0 00000000 0 0 0\n"
        "eth1 000AAAC0 00000000 0001 0 0 0 00FFFFFF 0 0 0\n"
        "broken line\n"
    )
    monkeypatch.setattr(network, "_ROUTES", table)
    assert network.networks() == (IPv4Network("192.170.10.0/24"),)
    assert network.near("192.170.10.2")
    assert not network.near("192.170.11.2")
    assert network.near("127.0.0.1")
    monkeypatch.setattr(network, "_ROUTES", tmp_path / "none")
    assert network.networks() == ()


@pytest.mark.parametrize("generation", list(Generation))
def test_working_link_is_healthy(few_ports, generation):
    arm = SteppedArm(port=few_ports[0], period_ms=50, generation=generation)
    with sending(arm):
        found = examine(None, few_ports[0], 0.3)
    assert {"robot", "commanding"} <= codes(found)
    assert f"FRI {generation.value}" in text_of(found, "robot")
    assert found.figures["states"] == [("COMMANDING_ACTIVE", 0.0)]


def test_stuck_session_and_poor_quality_are_explained(few_ports):
    arm = SteppedArm(port=few_ports[0], state=SessionState.MONITORING_WAIT, quality=Quality.POOR)
    with sending(arm):
        found = examine(None, few_ports[0], 0.3)
    assert {"quality", "stuck"} <= codes(found)
    assert "stuck in MONITORING_WAIT" in text_of(found, "stuck")
    assert "commanding needs GOOD" in text_of(found, "stuck")


def test_quality_that_has_yet_to_rise_is_no_fault(few_ports, monkeypatch):
    monkeypatch.setattr(doctor, "MOST_POOR", 0.0)

    def rise(arm):
        arm.quality = Quality.EXCELLENT if len(arm.answers) > 10 else Quality.POOR

    with sending(SteppedArm(port=few_ports[0]), change=rise):
        found = examine(None, few_ports[0], 0.5)
    assert "quality" not in codes(found)
    assert set(found.figures["quality"]) == {"EXCELLENT"}


def test_lost_packets_are_said(few_ports):
    def lose(arm):
        arm.sequence += 1

    with sending(SteppedArm(port=few_ports[0]), change=lose):
        found = examine(None, few_ports[0], 0.3)
    assert "packets were lost" in text_of(found, "loss")


def shows(arm, **robot):
    """Let an arm say something of itself."""
    plain = arm.message
    info = RobotInfo(7, SafetyState.NORMAL, (DriveState.ACTIVE,) * 7)._replace(**robot)
    arm.message = lambda: plain()._replace(robot=info)
    return arm


def examined(arm, port, seconds=0.4, **at_cycle):
    with sending(arm, **at_cycle):
        return examine(None, port, seconds)


def test_a_robot_that_falls_silent_has_a_verdict_of_its_own(few_ports, monkeypatch):
    monkeypatch.setattr(doctor, "SILENCE", 0.1)

    def stop(arm):
        arm.losing = 10**9 if len(arm.answers) > 20 else 0

    found = examined(SteppedArm(port=few_ports[0]), few_ports[0], 0.8, change=stop)
    assert codes(found) == {"robot", "silent"}
    assert found.status == 4
    assert "stopped sending" in text_of(found, "silent")


def test_a_robot_that_is_silent_when_it_shall_be_answered_is_silent_too(few_ports, monkeypatch):
    arm, listen = SteppedArm(port=few_ports[0]), doctor.listen

    def then_silent(*ports):
        heard = listen(*ports)
        arm.cycle = lambda: None
        return heard

    monkeypatch.setattr(doctor, "listen", then_silent)
    found = examined(arm, few_ports[0], 1.0)
    assert codes(found) == {"robot", "silent"}
    assert "limo doctor" not in text_of(found, "silent")  # which is what runs


def test_a_link_of_one_way_has_a_verdict_of_its_own(few_ports):
    arm = SteppedArm(port=few_ports[0], state=SessionState.MONITORING_WAIT, quality=Quality.POOR)
    arm.deaf = 10**9
    found = examined(arm, few_ports[0])
    assert codes(found) == {"robot", "one-way"}
    assert found.status == 5


@pytest.mark.parametrize(
    ("robot", "code", "status"),
    [
        ({"safety_state": SafetyState.STOP2}, "safety-stop", 6),
        ({"drive_states": (DriveState.OFF,) * 7}, "drives-off", 7),
        (
            {"safety_state": SafetyState.STOP0_OR_1, "drive_states": (DriveState.OFF,) * 7},
            "safety-stop",
            6,
        ),
    ],
)
def test_stops_and_drives_have_verdicts_of_their_own(few_ports, robot, code, status):
    arm = SteppedArm(port=few_ports[0], period_ms=10, state=SessionState.MONITORING_READY)
    found = examined(shows(arm, **robot), few_ports[0])
    assert code in codes(found)
    assert found.status == status


def test_a_send_period_that_is_too_long_to_command_is_a_problem(few_ports):
    arm = SteppedArm(port=few_ports[0], period_ms=20, state=SessionState.MONITORING_READY)
    found = examined(shows(arm), few_ports[0])
    assert found.status == 8
    assert "20 ms apart" in text_of(found, "period")


def test_every_verdict_has_another_exit_status():
    assert len(set(doctor.STATUSES.values()) | {0, 1, 2}) == len(doctor.STATUSES) + 3


def test_advice_names_stop_drives_mode_and_period():
    message = monitoring()._replace(
        robot=RobotInfo(
            7, SafetyState.STOP1_ON_PATH, (DriveState.OFF,) * 7, OperationMode.T1, None
        ),
        connection=ConnectionInfo(SessionState.COMMANDING_WAIT, Quality.FAIR, 4, 2),
        ipo=IpoData(command_mode=CommandMode.TORQUE),
    )
    said = " | ".join(advice(message))
    for part in ("STOP1 ON PATH", "joints 1, 2, 3, 4, 5, 6, 7", "T1", "FAIR", "8 ms apart", "5 ms"):
        assert part in said
    assert advice(monitoring()) == []


def test_command_says_it_in_words_and_as_json(limo, few_ports):
    ended = limo("doctor", "fri", "--port", few_ports[0], "--seconds", 0.05)
    assert ended.returncode == 3
    assert ended.stdout.startswith("problem: nobody sent anything")
    ended = limo("doctor", "fri", "--port", few_ports[0], "--seconds", 0.05, "--json")
    assert ended.returncode == 3
    assert json.loads(ended.stdout)["findings"][0]["code"] == "nobody"
    arm = SteppedArm(port=few_ports[0], period_ms=50, state=SessionState.MONITORING_READY)
    with sending(arm):
        ended = limo("doctor", "fri", "--port", few_ports[0], "--seconds", 0.2, "--json")
    assert "monitoring" in [f["code"] for f in json.loads(ended.stdout)["findings"]]


def test_command_refuses_bad_options_in_one_line(limo):
    ended = limo("doctor", "fri", "--host", "x" * 70, "--seconds", 0.05)
    assert ended.returncode == 2
    assert ended.stderr.count("\n") == 1
    assert "has no IPv4 address" in ended.stderr
