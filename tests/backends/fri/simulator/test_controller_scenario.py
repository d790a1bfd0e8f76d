"""A scenario on the wire: what a client sees of it, and what the report says."""

import numpy as np
import pytest
from controller_runs import PATIENT, InStep, last_line, started_client
from ports import free_port

from backends.fri.codec.messages import Quality, SafetyState, SessionState
from backends.fri.simulator.connection.port import Address
from backends.fri.simulator.controller import FAREWELL, SimulatedController
from backends.fri.simulator.scenario import (
    ControllerScenario,
    Delay,
    Direction,
    Duplicate,
    FlangeForce,
    Loss,
    ProgramMotion,
    QualityDrop,
    Reorder,
    SafetyStop,
    SessionCap,
    Silence,
    SimulatedPush,
)
from backends.fri.simulator.session import ControllerSettings
from limo_driver.model import RobotModel
from limo_driver.robot.realtime import Pace

pytestmark = pytest.mark.waits


def played(*events, duration, in_step=False, **options):
    """Let a good client live through a scenario; return the report and what the client saw.

    In step with its answers, or in real time, in which networks have their delays.
    """
    with started_client() as (client, port):
        settings = ControllerSettings(
            Address("127.0.0.1", port), period_ms=4, duration=duration, **PATIENT, **options
        )
        with SimulatedController(settings, scenario=ControllerScenario(events, seed=3)) as robot:
            if in_step:
                robot._pace = InStep(robot)
            report = robot.run().as_json()
        told = last_line(client)
    return report, told, client.returncode


def reasons(report):
    return {visit["reason"] for visit in report["states"]}


def test_stops_drops_and_pushes_are_felt_by_the_client():
    report, client, status = played(
        QualityDrop(at=1.0, duration=0.1, quality=Quality.FAIR),
        SafetyStop(at=1.5, duration=0.2, state=SafetyState.STOP2),
        SessionCap(at=2.2, duration=0.1, state=SessionState.MONITORING_READY),
        SimulatedPush(at=0.0, duration=9.0, joint=2, torque=10.0),
        duration=2.6,
        in_step=True,
    )
    assert status == 0
    assert "the quality of the connection is FAIR" in reasons(report)
    assert client["safety"] == SafetyState.STOP2
    assert client["external"][1] == pytest.approx(-10.0, abs=1.0)
    # Nothing that the client did was wrong, but for a swing that it goes on with after a hold.
    assert {text.split(":")[0] for text in (c["what"] for c in report["complaints"])} <= {
        "illegal axis delta"
    }


def test_a_force_on_the_flange_is_felt_by_all_joints():
    force = np.array([5.0, -3.0, -12.0])
    _, client, _ = played(
        FlangeForce(at=0.0, duration=9.0, force=tuple(force)), duration=2.6, in_step=True
    )
    jacobian = RobotModel.load("iiwa14").flange_jacobian(np.array(client["measured"]))
    expected = -jacobian[:3].T @ force
    assert np.abs(expected).max() > 5.0
    assert client["external"] == pytest.approx(expected, abs=0.5)


def test_a_controller_that_comes_late_leaves_out_no_time_of_the_robot():
    class Late(Pace):
        def wait(self):
            self.skipped += 4
            return 0

    settings = ControllerSettings(Address("127.0.0.1", free_port()), period_ms=4, duration=0.4)
    with SimulatedController(settings) as robot:
        robot._pace = Late(4e-3)
        report = robot.run().as_json()
    assert report["packets"]["sent"] == 100 + FAREWELL
    assert report["duration"] == pytest.approx(0.4 + FAREWELL * 4e-3)


@pytest.mark.slow("seconds at the pace of a real controller")
def test_a_bad_network_is_survived_and_accounted_for():
    report, client, status = played(
        Loss(at=0.5, duration=0.5, fraction=0.1),
        Delay(at=0.5, duration=0.5, delay=1e-3, jitter=2e-3, direction=Direction.TO_CLIENT),
        Reorder(at=1.0, duration=0.5, fraction=0.2, direction=Direction.TO_ROBOT),
        Duplicate(at=1.0, duration=0.5, fraction=0.2, direction=Direction.TO_CLIENT),
        Silence(at=1.6, duration=0.1),
        duration=2.0,
    )
    assert status == 0
    packets, network = report["packets"], report["scenario"]
    lost = network["to_client"]["lost"] + network["to_robot"]["lost"]
    assert 0 < lost < 60
    assert packets["lost"] >= lost - network["to_client"]["duplicated"] - 5
    assert network["to_client"]["duplicated"] > 0
    assert network["to_robot"]["reordered"] > 0
    assert client["received"] <= packets["sent"] + network["to_client"]["duplicated"]
    assert packets["repeated"] <= network["to_client"]["duplicated"]


@pytest.mark.slow("seconds at the pace of a real controller")
def test_the_robots_own_program_moves_what_the_client_mirrors():
    report, _, status = played(
        ProgramMotion(at=0.2, duration=1.0, joint=1, amplitude=0.05), duration=1.5
    )
    assert status == 0
    assert report["commands"]["position"]["upper"][0] > 0.01


def test_where_nobody_listens_the_arm_is_held_and_the_report_says_so():
    settings = ControllerSettings(Address("127.0.0.1", free_port()), period_ms=20, duration=0.2)
    with SimulatedController(settings) as robot:
        report = robot.run()
    assert report.ledger.unheard > 0
    assert "nobody answered" in report.as_text()
    assert "so the session stays in MONITORING_READY" in report.as_text()
