"""Many runs of a simulated arm, on all cores.

Threads, not processes: the compiled loop and MuJoCo in it leave the interpreter to others, and
nothing has to be imported, compiled or copied again, which took longer than the runs themselves.
"""

from __future__ import annotations

import os
import sys
import threading
from concurrent.futures import CancelledError, ThreadPoolExecutor
from functools import partial
from typing import TYPE_CHECKING, Final

from limo_driver.app.library.inputs import simulation_of
from limo_driver.errors import ConfigError
from limo_driver.robot.playback import trajectory_of
from limo_driver.runtime.parameters import seed_of

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from limo_driver.physics import Simulation
    from limo_driver.recordings.recording import Recording
    from limo_driver.trajectory import Planned, Trajectory

# [s] that a thread may keep the interpreter from another that comes out of the compiled loop after
# some milliseconds: by the usual 5 ms two workers did 1.5 times the work of one, by this 1.7.
_SWITCH_INTERVAL: Final = 5e-4


def simulate(
    simulation: Simulation | Path | str,
    trajectories: Sequence[Trajectory | Planned | Path | str],
    seeds: Sequence[int] = (0,),
    *,
    workers: int | None = None,
) -> list[Recording]:
    """Move a simulated arm along every trajectory with every seed, side by side.

    Each run is what `run("mujoco", ...)` gives with that seed, whatever runs beside it. Workers are
    threads: effects that are written in Python alone run one at a time.

    Args:
        simulation: Physics of the arm, or its file.
        trajectories: Motions, or their files.
        seeds: Of the sensors' noise.
        workers: How many run at a time; one for each core if not given.

    Returns:
        Recordings, all seeds of the first trajectory first.

    Raises:
        ConfigError: A trajectory is of another robot, a seed is no whole number, or there are no
            workers.
        LimoError: As for `run`.

    Example:
        >>> limo.simulate("sim.yaml", ["limo.traj.parquet"], seeds=[1, 2], workers=1)
    """
    arm = simulation_of(simulation)
    motions, seeds = [trajectory_of(item) for item in trajectories], [seed_of(s) for s in seeds]
    wanted = workers if workers is not None else len(os.sched_getaffinity(0))
    if wanted < 1:
        raise ConfigError(f"workers is {wanted}, expected at least 1")
    for motion in motions:
        motion.check_robot(arm.model.n, arm.model.name)
    jobs = [(arm, motion, seed) for motion in motions for seed in seeds]
    wanted = min(wanted, len(jobs))
    if wanted <= 1:
        return [_run(*job) for job in jobs]
    ended = threading.Event()
    pool = ThreadPoolExecutor(wanted, thread_name_prefix="limo-simulate")
    interval = sys.getswitchinterval()
    sys.setswitchinterval(min(interval, _SWITCH_INTERVAL))
    try:
        return list(pool.map(partial(_run, ended=ended), *zip(*jobs, strict=True)))
    finally:  # after an error, or Ctrl-C, what still runs is not wanted any more
        ended.set()
        pool.shutdown(cancel_futures=True)
        sys.setswitchinterval(interval)


def _run(
    simulation: Simulation, motion: Trajectory, seed: int, *, ended: threading.Event | None = None
) -> Recording:
    from limo_driver.app.library.live.running import run

    def go_on(_done: int, _all: int) -> None:
        if ended is not None and ended.is_set():
            raise CancelledError

    return run("mujoco", motion, simulation=simulation, seed=seed, progress=go_on)
