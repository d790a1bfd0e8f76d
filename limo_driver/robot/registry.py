"""Open robots by the name of their backend; outsiders plug in the same way, see `plugins`.

What an examination of a link or an arm found: each thing with a word for programs.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from inspect import signature
from typing import TYPE_CHECKING, Any, Final

from limo_driver.errors import ConfigError
from limo_driver.runtime.plugins import ROBOTS, find

if TYPE_CHECKING:
    from collections.abc import Mapping

    from limo_driver.physics import Simulation
    from limo_driver.robot.robot import Robot
    from limo_driver.trajectory import Trajectory

_SAID = {"robot": "`robot`", "sim": "`simulation`"}  # arguments, as messages name them


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


def open_for(
    backend: str,
    trajectory: Trajectory,
    *,
    simulation: Simulation | None,
    robot: str | None,
    seed: int,
    link: Mapping[str, Any] | None = None,
) -> Robot:
    """Open a robot for a trajectory; a simulated one stands where the trajectory starts.

    Args:
        backend: Registered name.
        trajectory: What the robot will be asked to do.
        simulation: Of a simulated robot.
        robot: Built-in name or URDF, where the backend can be of several.
        seed: Of a simulated robot's noise.
        link: How to reach a real robot: arguments of the backend; those that are None are left out.

    Raises:
        BackendNotFoundError: Names the known backends.
        ConfigError: Another robot than the trajectory's, or options that the backend does not
            have.
    """
    opener: type[Robot] = find(ROBOTS, backend)
    given = {name: value for name, value in (link or {}).items() if value is not None}
    if not opener.simulated:
        given |= {} if robot is None else {"robot": robot}
        given |= {} if simulation is None else {"sim": simulation}
    known = signature(opener).parameters
    if unknown := [_SAID.get(name, f'`link["{name}"]`') for name in given if name not in known]:
        raise ConfigError(f"backend {backend!r} takes no {' or '.join(unknown)}")
    if not opener.simulated:
        if (model := opener.model_for(**given)) is not None:  # before anything is sent to it
            trajectory.check_robot(model.n, model.name)
        return _checked(opener(**given), trajectory)
    arm = _arm_of(simulation, robot, trajectory)
    trajectory.check_robot(arm.model.n, arm.model.name)
    options: dict[str, Any] = {
        "simulation": arm,
        "initial_position": trajectory.position[0],
        "seed": seed,
    }
    return opener(**options)


def _arm_of(simulation: Simulation | None, robot: str | None, trajectory: Trajectory) -> Simulation:
    from limo_driver.physics import Simulation

    if simulation is not None and robot is not None:
        raise ConfigError("give `simulation` or `robot`; a simulation names its robot")
    if simulation is not None:
        return simulation
    if not (robot or trajectory.robot):
        raise ConfigError("the trajectory names no robot; give `simulation` or `robot`")
    return Simulation(robot=robot or trajectory.robot)


def _checked(robot: Robot, trajectory: Trajectory) -> Robot:
    try:
        trajectory.check_robot(robot.spec.n, robot.spec.name)
    except ConfigError:
        robot.close()
        raise
    return robot


OTHER_PROBLEM: Final = 1  # exit status of a problem that has none of its own


@dataclass(frozen=True)
class CheckResult:
    """One thing that was found out."""

    code: str  # a word for programs
    text: str  # what is, and what to do
    problem: bool = True


@dataclass
class Examination:
    """All that was found out.

    Args:
        statuses: Exit statuses of problems by their codes, the gravest first.
    """

    statuses: Mapping[str, int] = field(default_factory=dict[str, int])
    findings: list[CheckResult] = field(default_factory=list[CheckResult])
    figures: dict[str, Any] = field(default_factory=dict[str, Any])

    @property
    def healthy(self) -> bool:
        """Whether no problem was found."""
        return not any(finding.problem for finding in self.findings)

    @property
    def status(self) -> int:
        """Exit status: that of the gravest problem, 0 if there is none."""
        if self.healthy:
            return 0
        codes = {finding.code for finding in self.findings if finding.problem}
        known = (status for code, status in self.statuses.items() if code in codes)
        return next(known, OTHER_PROBLEM)

    def add(self, code: str, text: str, *, problem: bool = True) -> None:
        """Add a finding."""
        self.findings.append(CheckResult(code, text, problem))

    def as_json(self) -> dict[str, Any]:
        """Return plain values."""
        return {
            "healthy": self.healthy,
            "status": self.status,
            "findings": [vars(finding) for finding in self.findings],
            "figures": self.figures,
        }
