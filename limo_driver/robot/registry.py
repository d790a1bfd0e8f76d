"""Find backends and estimators by name, through entry points; outsiders plug in the same way."""

from __future__ import annotations

from importlib.metadata import entry_points
from typing import TYPE_CHECKING, Any

from limo_driver.errors import BackendNotFoundError

if TYPE_CHECKING:
    from limo_driver.robot.robot import Robot

ROBOTS = "limo.robots"
ESTIMATORS = "limo.estimators"


def find(group: str, name: str) -> Any:  # noqa: ANN401  # the class behind an entry point
    """Return the class registered as `name` in an entry point group.

    Raises:
        BackendNotFoundError: No such name; the message lists the known ones.
    """
    found = {entry.name: entry for entry in entry_points(group=group)}
    if name not in found:
        raise BackendNotFoundError(group.removeprefix("limo.").removesuffix("s"), name, found)
    return found[name].load()


def open_robot(backend: str, **options: Any) -> Robot:  # noqa: ANN401  # each backend's own
    """Open a robot by the name of its backend, for example `mujoco`.

    Args:
        backend: Registered name.
        options: Arguments of the backend's constructor.

    Raises:
        BackendNotFoundError: No backend of that name.

    Example:
        >>> with open_robot("mujoco", simulation="sim.yaml") as robot:
        ...     state = robot.receive()
    """
    robot: Robot = find(ROBOTS, backend)(**options)
    return robot
