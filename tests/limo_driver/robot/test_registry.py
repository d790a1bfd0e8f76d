import pytest

from limo_driver.errors import BackendNotFoundError
from limo_driver.robot.registry import open_robot
from limo_driver.runtime.plugins import ESTIMATORS, ROBOTS, find


def test_an_unknown_backend_lists_the_known_ones():
    with pytest.raises(
        BackendNotFoundError, match=r"no robot is called 'abb'; known: can, .*mujoco,"
    ):
        open_robot("abb")


@pytest.mark.parametrize(
    ("group", "name"),
    [
        (ROBOTS, "can"),
        (ROBOTS, "mujoco"),
        (ROBOTS, "virtual"),
        (ESTIMATORS, "hybrid"),
        (ESTIMATORS, "rigid-body"),
    ],
)
def test_every_registered_name_loads(group, name):
    assert isinstance(find(group, name), type)
