"""The simulated controller and the driver, cycle by cycle, where an arm is as fast as it may be."""

import threading
from contextlib import contextmanager

import pytest
from controller_runs import PATIENT
from ports import free_port

from backends.fri import FriRobot
from backends.fri.codec.messages import SessionState
from backends.fri.simulator.connection.port import Address
from backends.fri.simulator.controller import SimulatedController
from backends.fri.simulator.session import ControllerSettings
from limo_driver.types import PositionCommand


@contextmanager
def in_step():
    """Give a controller whose time goes on cycle by cycle, and the driver of its active session."""
    port = free_port()
    settings = ControllerSettings(Address("127.0.0.1", port), **PATIENT)
    with SimulatedController(settings) as controller:
        opened = threading.Event()

        def call():
            while not opened.wait(2e-3):
                controller._cycle()

        caller = threading.Thread(target=call)
        caller.start()
        try:
            robot = FriRobot("127.0.0.1", port)
        finally:
            opened.set()
            caller.join()
        with robot:
            while robot._link.endpoint.receive(0.0) is not None:
                pass
            while robot.session_state is not SessionState.COMMANDING_ACTIVE:
                controller._cycle()
                robot.receive()
            yield controller, robot


def speed_up(controller, robot):
    """Move as fast as it may; return the goal, which is far away."""
    controller._cycle()
    start = robot.receive().position
    robot.send(PositionCommand(position=start))
    goal = PositionCommand(position=start + 1.5)
    for _ in range(300):
        controller._cycle()
        robot.receive()
        robot.send(goal)
    return goal


def test_an_arm_at_its_velocity_limit_is_not_stopped_for_the_last_digits():
    with in_step() as (controller, robot):
        speed_up(controller, robot)
        report = controller._report(())
    assert report.as_json()["largest_step"] == pytest.approx(1.0)
    assert report.as_json()["stops"] == []


def test_a_client_that_was_late_for_a_while_and_catches_up_does_not_stop_the_arm():
    with in_step() as (controller, robot):
        goal = speed_up(controller, robot)
        controller._cycle()
        robot.receive()
        for _ in range(5):
            controller._cycle()  # the next packet is there before the answer to the last leaves
            robot._arrived -= 2 * robot.spec.period
            robot.send(goal)
            robot.receive()
        for _ in range(20):
            robot.send(goal)
            controller._cycle()
            assert not robot.receive().holding
        assert controller._report(()).as_json()["stops"] == []
        assert robot.figures.outdated >= 5  # a slow machine adds its own
