"""What the contract suites share: every registered backend that brings its arm along.

Backends of real arms run the same tests against arms of their own; see tests/backends/fri and
tests/backends/can.
"""

from importlib.metadata import entry_points

import pytest
from robot_commands import START

from limo_driver.robot.registry import open_robot
from limo_driver.runtime.plugins import ROBOTS, find


def simulated_backends():
    names = sorted(entry.name for entry in entry_points(group=ROBOTS))
    return [name for name in names if find(ROBOTS, name).simulated]


@pytest.fixture(params=simulated_backends())
def backend(request):
    return request.param


@pytest.fixture
def robot(backend):
    with open_robot(backend, robot="iiwa14", initial_position=START) as opened:
        yield opened
