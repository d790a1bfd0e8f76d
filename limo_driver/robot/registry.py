"""Open robots by the name of their backend; outsiders plug in the same way, see `plugins`."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from limo_driver.plugins import ROBOTS, find

if TYPE_CHECKING:
    from limo_driver.robot.robot import Robot


def open_robot(backend: str, **options: Any) -> Robot:  # noqa: ANN401  # each backend's own
    """Open a robot by the name of its backend, for example `mujoco`.

    Args:
        backend: Registered name.
        options: Arguments of the backend's constructor.

    Raises:
        BackendNotFoundError: No backend of that name.
        PlugInError: The backend is of another distribution, and cannot be used.

    Example:
        >>> with limo.open_robot("mujoco", simulation="sim.yaml") as robot:
        ...     state = robot.receive()
    """
    robot: Robot = find(ROBOTS, backend)(**options)
    return robot
