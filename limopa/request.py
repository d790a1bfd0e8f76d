"""PlanRequest: everything that a LIMOPA plan can be asked for; checked when it is made.

Source: Algorithm 1 (LIMOPA) and its text in the paper on locally isotropic motion; what the paper
leaves open (margins, clearance, waypoint period) is stated here.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from math import inf, pi, radians

from limo_driver.runtime.parameters import Declared, parameter, shown

Range = tuple[float, float]


def share_of_limit(default: Range):  # noqa: ANN201  # a dataclass field
    """Declare a range of shares of a limit, which are drawn."""
    return parameter("1", length=2, lower=0.0, upper=1.0, above=True, default=default)


@dataclass(frozen=True)
class Workspace(Declared):
    """Effective workspace: where the flange may be at a scaffold, in the base frame.

    By default the quadrant of a sphere in front of the robot, bounded by the y axis and the
    positive x and z axes.

    Args:
        radius: Of the sphere [m].
        centre: Of the sphere, (3,) [m].
        lower: Lowest x, y and z, (3,) [m].
        upper: Highest x, y and z, (3,) [m].
        throughout: Whether the flange stays there all the way, to half of the clearance, and not
            only at scaffolds: the region of a task.

    Raises:
        ParameterError: Names the parameter, what was given and what is possible.

    Example:
        >>> near = limo.Workspace(radius=0.6, lower=(0.2, -0.3, 0.1))
        >>> limo.PlanRequest(scaffolds=4, workspace=near)
    """

    _called = "workspace"
    radius: float = parameter("m", lower=0.0, above=True, finite=False, default=0.8)
    centre: tuple[float, float, float] = parameter("m", length=3, default=(0.0, 0.0, 0.0))
    lower: tuple[float, float, float] = parameter(
        "m", length=3, finite=False, default=(0.0, -inf, 0.0)
    )
    upper: tuple[float, float, float] = parameter(
        "m", length=3, finite=False, default=(inf, inf, inf)
    )
    throughout: bool = False

    def __post_init__(self) -> None:
        super().__post_init__()
        if not all(a < b for a, b in zip(self.lower, self.upper, strict=True)):
            raise self._refused("lower", f"less than upper, {shown(self.upper)}")

    @property
    def in_words(self) -> str:
        """Where the flange may be, for messages and pages."""
        if self.throughout:
            return f"the region from {shown(self.lower)} to {shown(self.upper)} m"
        if self.radius == inf:
            return "all of the space"
        return f"the effective workspace within {self.radius:g} m of the base"


EVERYWHERE = Workspace(radius=inf, lower=(-inf, -inf, -inf))


@dataclass(frozen=True)
class Surroundings(Declared):
    """Distances that every configuration of the path has to keep.

    Args:
        joint_margin: Kept from either end of a joint's range [rad].
        clearance: Kept between links, between links and the table, and from either end of a joint
            that slides, unless that is more than a tenth of its range [m].
        table_height: Of the table plane in the base frame [m].
        self_collision: Whether links are checked against each other.

    Raises:
        ParameterError: Names the parameter, what was given and what is possible.

    Example:
        >>> limo.PlanRequest(scaffolds=4, surroundings=limo.Surroundings(table_height=-0.1))
    """

    joint_margin: float = parameter("rad", lower=0.0, default=radians(5.0))
    clearance: float = parameter("m", lower=0.0, upper=1.0, above=True, default=0.02)
    table_height: float = parameter("m", default=0.0)
    self_collision: bool = True  # False: links are not checked against each other


@dataclass(frozen=True)
class Reaching(Declared):
    """Approach to scaffolds: straight in joint space, relative to the joint's limits.

    Args:
        velocity: Least and most share of the limit, drawn for each joint and phase.
        acceleration: Likewise.

    Raises:
        ParameterError: Names the parameter, what was given and what is possible.

    Example:
        >>> limo.PlanRequest(scaffolds=4, reaching=limo.Reaching(velocity=(0.1, 0.2)))
    """

    _called = "reaching"
    velocity: tuple[float, float] = share_of_limit((0.6, 0.9))
    acceleration: tuple[float, float] = share_of_limit((0.6, 0.9))

    def __post_init__(self) -> None:
        super().__post_init__()
        self._increasing("velocity", "acceleration", strictly=False)


@dataclass(frozen=True)
class Exploring(Declared):
    """Exploration of each scaffold: random sinusoids, e_j(t) = sum A sin(2 pi f t + phi).

    The paper leaves the unit of t open. Here t runs in seconds of a nominal time in which waypoints
    follow each other every `waypoint_period`; the path is then slowed until the leading joint moves
    at the relative velocity drawn. The default makes 150 phases of about 2250 waypoints last about
    an hour, as the paper states.

    Args:
        sinusoids: For each joint.
        amplitude: Least and most [rad].
        frequency: Least and most, of nominal time [Hz].
        phase: Least and most [rad].
        waypoints: Least and most of a phase, both ends included.
        velocity: Least and most share of the leading joint's limit, drawn for each phase.
        waypoint_period: Of nominal time [s].

    Raises:
        ParameterError: Names the parameter, what was given and what is possible.

    Example:
        >>> limo.PlanRequest(scaffolds=4, exploring=limo.Exploring(velocity=(0.02, 0.05)))
    """

    _called = "exploring"
    sinusoids: int = parameter("", lower=1, default=3)
    amplitude: tuple[float, float] = parameter(
        "rad", length=2, lower=0.0, above=True, default=(radians(0.5), radians(3.0))
    )
    frequency: tuple[float, float] = parameter("Hz", length=2, default=(-4.0, 4.0))
    phase: tuple[float, float] = parameter("rad", length=2, default=(0.0, 2 * pi))
    waypoints: tuple[int, int] = parameter("", length=2, lower=2, default=(2000, 2500))
    velocity: tuple[float, float] = share_of_limit((0.1, 0.3))
    waypoint_period: float = parameter("s", lower=0.0, above=True, default=0.0016)

    def __post_init__(self) -> None:
        super().__post_init__()
        names = ("amplitude", "frequency", "phase", "waypoints", "velocity")
        self._increasing(*names, strictly=False)


@dataclass(frozen=True)
class PlanRequest(Declared):
    """Request for a plan.

    Args:
        scaffolds: Configurations to reach, and to explore around; 150 last about an hour.
        rate: Of the trajectory's samples [Hz], 50 to 1e4.
        workspace: Where the flange may be at a scaffold [m].
        surroundings: Margins, clearance [m] and table that every configuration keeps away from.
        reaching: Shares of each joint's limits at which scaffolds are approached.
        exploring: Sinusoids around each scaffold: how many, how large [rad], how fast.
        speed: Of the flange at most, and of what is 0.1 m from it, as a probe that turns [m/s];
            infinite: as fast as the joints' shares let it.
        candidates: Random configurations tried in vain before giving up.
        exploring_tries: Draws of one exploring phase before its scaffold is replaced.
        repairs: Replaced or added scaffolds in a row before giving up.

    Raises:
        ParameterError: Names the parameter, what was given and what is possible.

    Example:
        >>> limo.plan("iiwa14", limo.PlanRequest(scaffolds=4, rate=500.0))
    """

    scaffolds: int = parameter("", lower=1, default=150)
    rate: float = parameter("Hz", lower=50, upper=1e4, default=250.0)
    workspace: Workspace = field(default_factory=Workspace)
    surroundings: Surroundings = field(default_factory=Surroundings)
    reaching: Reaching = field(default_factory=Reaching)
    exploring: Exploring = field(default_factory=Exploring)
    speed: float = parameter("m/s", lower=0.0, above=True, finite=False, default=inf)
    candidates: int = parameter("", lower=1, default=200_000)
    exploring_tries: int = parameter("", lower=1, default=50)
    repairs: int = parameter("", lower=1, default=50)
