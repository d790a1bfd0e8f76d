"""Move an arm, and record it."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from limo_driver.robot.playback import open_for, trajectory_of

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping
    from pathlib import Path

    from limo_driver.physics import Simulation
    from limo_driver.recordings.recording import Recording
    from limo_driver.trajectory import Planned, Trajectory


def run(
    backend: str,
    trajectory: Trajectory | Planned,
    *,
    simulation: Simulation | None = None,
    seed: int = 0,
    record: Path | str | None = None,
    stiffness: float | None = None,
    link: Mapping[str, Any] | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> Recording:
    """Open a robot, move it along a trajectory, close it, and return what was measured.

    A simulated arm starts where the trajectory does; a real one has to stand there.

    Args:
        backend: Registered name: mujoco, virtual, fri, can, or one of another distribution.
        trajectory: The motion, or what was planned around one.
        simulation: Physics of a simulated arm; without it, the rigid body alone.
        seed: Of a simulated arm's sensor noise.
        record: Parquet file that keeps the recording; a crash loses at most its last second.
        stiffness: Follow as an impedance of this stiffness [N m/rad], not by position.
        link: How to reach a real arm: arguments of the backend, such as `host`, `port`, `config`.
        progress: Told the control cycles done and those in all, now and then.

    Raises:
        BackendNotFoundError: No such backend; names the known ones.
        ConfigError: The trajectory is of another robot, or the backend has no such option.
        JointLimitError, HoldingError, RecordingError, KeyboardInterrupt: As for `Robot.follow`.

    Example:
        >>> run("mujoco", plan("iiwa14"), simulation=Simulation.load("sim.yaml"))
    """
    motion = trajectory_of(trajectory)
    with open_for(
        backend, motion, simulation=simulation, robot=None, seed=seed, link=link
    ) as robot:
        return robot.follow(motion, record=record, stiffness=stiffness, progress=progress)
