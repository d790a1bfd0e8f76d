"""How fast a simulated arm moves: cycle by cycle, as `limo run` moves it, in one call; and many.

    python benchmarks/backends/simulated_speed.py [--seconds 60]

All in one run, in turn, by processor time, which leaves out what else the machine does; opening
and recording are in it where `limo run` does them. Many runs are by the clock, beside as many
processes that share nothing and have nothing to start: what the machine itself gives to two at
that moment. Bars: 80 times real time as `limo run` moves it; two workers 1.8 times one, or 0.95 of
what two processes come to.
"""

from __future__ import annotations

import argparse
import os
import sys
import tempfile
import time
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

import limo_driver as limo
from backends.mujoco_sim import MujocoRobot
from limo_driver.robot.playback import Playback

if TYPE_CHECKING:
    from limo_driver.types import FloatArray

EXAMPLE = Path(__file__).parents[2] / "examples" / "iiwa14_hysteretic.yaml"
BAR, PARALLEL, OF_PROCESSES = 80.0, 1.8, 0.95
ROUNDS = 3
RUNS = 8


class ByCycle(MujocoRobot):
    """The arm, which never looks ahead."""

    def send_ahead(self, targets: FloatArray) -> None:
        """Refuse."""
        del targets


def motion(seconds: float) -> limo.Trajectory:
    """Return small reversing motion of all joints at 1 kHz."""
    t = np.arange(0.0, seconds, 0.001)
    pace = 2 * np.pi * np.array([0.31, 0.23, 0.41, 0.29, 0.37, 0.43, 0.47])
    rest = np.zeros((t.size, 7))
    position = np.deg2rad([10, 40, -20, -70, 30, 50, -40]) + 0.05 * (1 - np.cos(t[:, None] * pace))
    return limo.Trajectory(t, position, rest, rest, robot="iiwa14")


def played(kind: type[MujocoRobot], sim: limo.Simulation, planned: limo.Trajectory) -> float:
    """Return how many times as fast as real time a recorded run is, by processor time."""
    begun = time.process_time()
    with (
        tempfile.TemporaryDirectory() as folder,
        kind(sim, initial_position=planned.position[0]) as robot,
    ):
        playback = Playback(planned, Path(folder) / "run.parquet")
        summary = playback.run(robot, lambda _done, _all: None)
    return summary.duration / (time.process_time() - begun)


def in_one_call(sim: limo.Simulation, planned: limo.Trajectory) -> float:
    """Return the same of one call, without recording."""
    with MujocoRobot(sim, initial_position=planned.position[0]) as robot:
        robot.receive()
        begun = time.process_time()
        run = robot.run(planned.position)
        return float(run.time[-1] - run.time[0]) / (time.process_time() - begun)


def many(sim: limo.Simulation, planned: limo.Trajectory, workers: int) -> float:
    """Return the time that the runs take [s]."""
    begun = time.perf_counter()
    limo.simulate(sim, [planned], range(RUNS), workers=workers)
    return time.perf_counter() - begun


def apart(sim: limo.Simulation, planned: limo.Trajectory, processes: int) -> float:
    """Return the time that they take as copies of this process, a part of the runs each [s]."""
    begun = time.perf_counter()
    copies = []
    for _ in range(processes):
        if not (copy := os.fork()):
            limo.simulate(sim, [planned], range(RUNS // processes), workers=1)
            os._exit(0)
        copies.append(copy)
    for copy in copies:
        os.waitpid(copy, 0)
    return time.perf_counter() - begun


def main() -> int:
    """Print the table; return 0 where the bars are held."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=float, default=60.0)
    planned = motion(parser.parse_args().seconds)
    sim = limo.Simulation.load(EXAMPLE)
    played(MujocoRobot, sim, motion(2.0))  # compiles
    rows = [
        (
            played(ByCycle, sim, planned),
            played(MujocoRobot, sim, planned),
            in_one_call(sim, planned),
        )
        for _ in range(ROUNDS)
    ]
    by_cycle, ahead, one_call = np.median(rows, axis=0)
    print(f"{planned.time[-1]:.0f} s of {EXAMPLE.stem}, times real time (median of {ROUNDS})")
    print(f"cycle by cycle, recorded   {by_cycle:7.1f}")
    print(f"as `limo run`, recorded    {ahead:7.1f}   bar {BAR:g}")
    print(f"in one call, not recorded  {one_call:7.1f}")
    times = [
        (
            many(sim, planned, 1),
            many(sim, planned, 2),
            apart(sim, planned, 1),
            apart(sim, planned, 2),
        )
        for _ in range(ROUNDS)
    ]
    alone, both, copy, copies = np.median(times, axis=0)
    ratio, most = alone / both, copy / copies
    print(f"{RUNS} runs: {alone:.1f} s by one worker, {both:.1f} s by two:")
    print(f"{ratio:.2f} times as fast, bar {PARALLEL}; two processes {most:.2f} times")
    good = ratio >= PARALLEL or ratio >= OF_PROCESSES * most
    return 0 if ahead >= BAR and good else 1


if __name__ == "__main__":
    sys.exit(main())
