"""What the first report of a stranger's log costs, from `limo inspect` to an improved model.

    python benchmarks/first_report.py [--seconds 60] [--rate 200]

The iiwa of the examples carries a load and friction that its description does not know. A minute of
its motion is written as a CSV log in degrees and milliseconds, as arrays beside an MJCF of the arm,
and as a ROS 2 bag. Each goes through inspection, and through diagnosis with report and export; the
aim is 60 s of processor time for each minute of recording. Then the three stories run that
docs/your_data.md tells, each from making its log to the improved file.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

import limo_driver as limo
from limo_driver.physics import Payload

EXAMPLES = Path(__file__).parents[1] / "examples"
AIM = 60.0  # [s] of processor time for a minute of recording
LIMO = [sys.executable, "-c", "from limo_driver.app.cli import main; main()"]
STORIES = ("your_csv", "your_mjcf", "your_bag")


def recorded(seconds: float, rate: float) -> limo.Recording:
    """Return motion of the arm with its load, and noise on the torque."""
    arm = limo.Simulation.load(EXAMPLES / "iiwa14_hysteretic.yaml")
    load = Payload(mass=1.5, com=(0.01, 0.0, 0.05), inertia=(0.004, 0, 0, 0.004, 0, 0.003))
    true = limo.Simulation(arm.robot, (*arm.effects, load), arm.inertials)
    times = np.arange(0, seconds, 1 / rate)
    pace = 2 * np.pi * (0.05 + 0.02 * np.arange(7))
    phase = np.outer(times, pace) + np.arange(7)
    motion = limo.Motion(
        times, 0.8 * np.sin(phase), 0.8 * pace * np.cos(phase), -0.8 * pace**2 * np.sin(phase)
    )
    torque = true.predict(motion) + np.random.default_rng(1).normal(0, 0.05, phase.shape)
    return limo.Recording.from_arrays(times, motion.position, torque)


def written(recording: limo.Recording, folder: Path) -> dict[str, tuple[Path, str]]:
    """Write the recording in three formats; return each log and the robot to read it with."""
    names = [f"q{j}" for j in range(7)] + [f"tau{j}" for j in range(7)]
    table = [1e3 * recording.time, np.rad2deg(recording.position), recording.torque]
    header = ",".join(["t_ms", *names])
    np.savetxt(folder / "log.csv", np.column_stack(table), "%.6f", ",", header=header, comments="")
    np.savez(
        folder / "log.npz",
        time=recording.time,
        qpos=recording.position,
        qfrc_actuator=recording.torque,
    )
    spec: Any = vars(mujoco)["MjSpec"].from_file(str(limo.RobotModel.load("iiwa14").urdf))
    spec.compiler.discardvisual = True
    spec.compile()
    (folder / "model.xml").write_text(spec.to_xml(), encoding="utf-8")
    recording.save(folder / "run.parquet")
    given = ["convert", "run.parquet", "--robot", "iiwa14", "--out", "bag.mcap"]
    cost([*LIMO, *given], folder)
    return {
        "CSV": (folder / "log.csv", "iiwa14"),
        "arrays, MJCF": (folder / "log.npz", str(folder / "model.xml")),
        "ROS 2 bag": (folder / "bag.mcap", "iiwa14"),
    }


def cost(command: list[str], folder: Path) -> tuple[float, float]:
    """Run a command in a folder; return its wall and processor time [s].

    Raises:
        SystemExit: It failed.
    """
    began = time.monotonic()
    with tempfile.TemporaryFile() as said:
        process = subprocess.Popen(command, cwd=folder, stdout=said, stderr=subprocess.STDOUT)
        _, status, usage = os.wait4(process.pid, 0)
        process.returncode = os.waitstatus_to_exitcode(status)
        if process.returncode:
            said.seek(0)
            raise SystemExit(f"{command}: {process.returncode}\n{said.read().decode()}")
    return time.monotonic() - began, usage.ru_utime + usage.ru_stime


def main() -> None:
    """Print a table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=float, default=60.0)
    parser.add_argument("--rate", type=float, default=200.0)
    asked = parser.parse_args()
    print(f"{'log':>13} {'command':>18} {'wall':>8} {'processor':>10}   aim, for each minute")
    with tempfile.TemporaryDirectory() as place:
        folder = Path(place)
        logs = written(recorded(asked.seconds, asked.rate), folder)
        for name, (log, robot) in logs.items():
            given = [str(log), "--robot", robot]
            export = str(folder / "new.xml") if robot.endswith(".xml") else str(folder / "new.urdf")
            for command in (
                ["inspect", *given],
                ["diagnose", *given, "--out", f"found-{log.suffix[1:]}", "--export", export],
            ):
                wall, cpu = cost([*LIMO, *command], folder)
                words = f"{command[0]}{' --export' * (command[0] == 'diagnose')}"
                each = cpu * 60 / asked.seconds
                print(
                    f"{name:>13} {words:>18} {wall:>6.1f} s {each:>8.1f} s   {AIM:g} s", flush=True
                )
        for story in STORIES:
            wall, cpu = cost([sys.executable, str(EXAMPLES / f"{story}.py")], folder)
            print(f"{'story':>13} {story:>18} {wall:>6.1f} s {cpu:>8.1f} s")


if __name__ == "__main__":
    main()
