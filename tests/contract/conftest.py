"""What the contract suites share: every registered backend that is simulated.

Robots on a wire run the same suites where their other end is at hand, such as in tests/can.
"""

from importlib.metadata import entry_points

import pytest
from robot_commands import START

from limo_driver.registry import ROBOTS, open_robot


SIMULATED = sorted(entry.name for entry in entry_points(group=ROBOTS) if entry.load().simulated)


@pytest.fixture(params=SIMULATED)
def backend(request):
    return request.param


@pytest.fixture
def robot(backend):
    with open_robot(backend, robot="iiwa14", initial_position=START) as opened:
        yield opened
