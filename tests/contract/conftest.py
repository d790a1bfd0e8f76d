"""What the contract suites share: every registered backend."""

from importlib.metadata import entry_points

import pytest
from robot_commands import START

from limo_driver.registry import ROBOTS, open_robot


@pytest.fixture(params=sorted(entry.name for entry in entry_points(group=ROBOTS)))
def backend(request):
    return request.param


@pytest.fixture
def robot(backend):
    with open_robot(backend, robot="iiwa14", initial_position=START) as opened:
        yield opened
