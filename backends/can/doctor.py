"""Find out how the bus of an arm stands, and which drives are on it; none gets power."""

from __future__ import annotations

from collections import Counter
from typing import Final

from backends.can.config import ArmConfig, DriveError
from backends.can.robot import CanRobot
from limo_driver.errors import BackendError, ConfigError, CycleTimeoutError
from limo_driver.robot.registry import Examination

MOST_SILENT: Final = 0.001  # of the cycles
MOST_MISSED: Final = 0.01  # of the cycles
_FAULT: Final = "fault"  # in the words of a drive's status


def examine(config: ArmConfig, seconds: float) -> Examination:
    """Find out how a bus stands.

    Opening finds every drive, checks that it is the one of its joint, and configures it. Then all
    measure, cycle by cycle, without power and without set-points.

    Args:
        config: The arm.
        seconds: How long to measure [s].

    Raises:
        ConfigError: The bus cannot carry the rate, or the configuration does not fit together.
    """
    found = Examination()
    try:
        with CanRobot(config, listen_only=True) as robot:
            _measure(found, robot, seconds)
    except ConfigError:
        raise
    except DriveError as error:
        found.add("drive", str(error))
    except BackendError as error:
        found.add("bus", str(error))
    return found


def _measure(found: Examination, robot: CanRobot, seconds: float) -> None:
    """Count what is heard of each drive for a while, and judge it."""
    config, silent = robot.config, Counter[int]()
    versions = robot.versions()
    began, cycles = robot.now(), 0
    while robot.now() < began + seconds:
        try:
            if robot.receive().stale:
                silent.update(robot.silent_joints)
        except CycleTimeoutError:
            silent.update(robot.silent_joints)
        cycles += 1
    figures = robot.link_figures()
    found.figures |= {"link": figures, "drives": versions, "rate": config.rate}
    nodes = ", ".join(str(joint.node) for joint in config.joints)
    found.add(
        "robot",
        f"{len(config.joints)} {config.convention} drives answer on {config.bus.interface} "
        f"{config.bus.channel}, nodes {nodes}, at {config.rate:g} Hz",
        problem=False,
    )
    for joint, status in enumerate(robot.drives, start=1):
        if _FAULT in status.status or status.error:
            code = status.error or "it gives no error code"
            found.add("drive-fault", f"joint {joint} (node {status.node}) is in fault: {code}")
    for joint, count in sorted(silent.items()):
        if count > MOST_SILENT * cycles:
            found.add(
                "loss",
                f"joint {joint} did not answer in {count} of {cycles} cycles: check its plug, and "
                "those between it and this computer",
            )
    if (missed := robot.overruns) > MOST_MISSED * cycles:
        found.add(
            "late",
            f"{missed} of {cycles + missed} cycles did not take place, since this program came too "
            "late: end what else computes here, or lower the rate",
        )
