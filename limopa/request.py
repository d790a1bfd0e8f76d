"""PlanRequest: everything that a LIMOPA plan can be asked for; checked when it is made.

Source: Algorithm 1 (LIMOPA) and its text in the paper on locally isotropic motion; what the paper
leaves open (margins, clearance, waypoint period) is stated here.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from math import inf, pi, radians

from limo_driver.errors import ConfigError

Range = tuple[float, float]


@dataclass(frozen=True)
class Workspace:
    """Effective workspace: where the flange may be at a scaffold, in the base frame.

    By default the quadrant of a sphere in front of the robot, bounded by the y axis and the
    positive x and z axes.
    """

    radius: float = 0.8  # [m]
    centre: tuple[float, float, float] = (0.0, 0.0, 0.0)  # [m]
    lower: tuple[float, float, float] = (0.0, -inf, 0.0)  # [m]
    upper: tuple[float, float, float] = (inf, inf, inf)  # [m]

    def __post_init__(self) -> None:
        require(self.radius > 0, "workspace radius", self.radius, "m, above 0")
        require(
            all(a < b for a, b in zip(self.lower, self.upper, strict=True)),
            "workspace bounds",
            (self.lower, self.upper),
            "with lower below upper",
        )


@dataclass(frozen=True)
class Surroundings:
    """What every configuration of the path has to keep away from."""

    joint_margin: float = radians(5.0)  # [rad] kept from either end of a joint's range
    clearance: float = 0.02  # [m] kept between links, and between links and the table
    table_height: float = 0.0  # [m] of the table plane in the base frame
    self_collision: bool = True  # False: links are not checked against each other

    def __post_init__(self) -> None:
        require(self.joint_margin >= 0, "joint margin", self.joint_margin, "rad, not negative")
        require(0 < self.clearance <= 1, "clearance", self.clearance, "m, in (0, 1]")
        require(abs(self.table_height) < inf, "table height", self.table_height, "m, finite")


@dataclass(frozen=True)
class Reaching:
    """How scaffolds are approached: straight in joint space, relative to the joint's limits."""

    velocity: Range = (0.6, 0.9)  # drawn for each joint and phase
    acceleration: Range = (0.6, 0.9)

    def __post_init__(self) -> None:
        _require_share(self.velocity, "reaching velocity")
        _require_share(self.acceleration, "reaching acceleration")


@dataclass(frozen=True)
class Exploring:
    """How each scaffold is explored: random sinusoids, e_j(t) = sum A sin(2 pi f t + phi).

    The paper leaves the unit of t open. Here t runs in seconds of a nominal time in which waypoints
    follow each other every `waypoint_period`; the path is then slowed until the leading joint moves
    at the relative velocity drawn. The default makes 150 phases of about 2250 waypoints last about
    an hour, as the paper states.
    """

    sinusoids: int = 3  # for each joint
    amplitude: Range = (radians(0.5), radians(3.0))  # [rad]
    frequency: Range = (-4.0, 4.0)  # [Hz] of nominal time
    phase: Range = (0.0, 2 * pi)  # [rad]
    waypoints: tuple[int, int] = (2000, 2500)  # both ends included
    velocity: Range = (0.1, 0.3)  # of the leading joint's limit, drawn for each phase
    waypoint_period: float = 0.0016  # [s] of nominal time

    def __post_init__(self) -> None:
        require(self.sinusoids >= 1, "number of sinusoids", self.sinusoids, "1 or more")
        for name in ("amplitude", "frequency", "phase", "waypoints"):
            low, high = getattr(self, name)
            require(low <= high, f"range of {name}", (low, high), "with its lower end first")
        require(self.amplitude[0] > 0, "amplitude", self.amplitude[0], "rad, above 0")
        require(self.waypoints[0] >= 2, "waypoints", self.waypoints[0], "2 or more")  # noqa: PLR2004
        _require_share(self.velocity, "exploring velocity")
        require(self.waypoint_period > 0, "waypoint period", self.waypoint_period, "s, above 0")


@dataclass(frozen=True)
class PlanRequest:
    """What to plan."""

    scaffolds: int = 150
    rate: float = 250.0  # [Hz] of the trajectory's samples
    workspace: Workspace = field(default_factory=Workspace)
    surroundings: Surroundings = field(default_factory=Surroundings)
    reaching: Reaching = field(default_factory=Reaching)
    exploring: Exploring = field(default_factory=Exploring)
    candidates: int = 200_000  # random configurations tried in vain before giving up
    exploring_tries: int = 50  # draws of one exploring phase before its scaffold is replaced
    repairs: int = 50  # replaced or added scaffolds in a row before giving up

    def __post_init__(self) -> None:
        require(self.scaffolds >= 1, "number of scaffolds", self.scaffolds, "1 or more")
        require(50 <= self.rate <= 10_000, "sample rate", self.rate, "Hz, in [50, 10000]")  # noqa: PLR2004
        for name in ("candidates", "exploring_tries", "repairs"):
            require(
                getattr(self, name) >= 1, name.replace("_", " "), getattr(self, name), "1 or more"
            )


def require(holds: bool, name: str, given: object, expected: str) -> None:
    """Refuse what a request cannot ask for.

    Raises:
        ConfigError: It does not hold.
    """
    if not holds:
        raise ConfigError(f"{name} is {given}, expected {expected}")


def _require_share(values: Range, name: str) -> None:
    low, high = values
    require(0 < low <= high <= 1, f"relative {name}", values, "two shares of the limit in (0, 1]")
