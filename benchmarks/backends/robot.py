"""Figures of the simulated robot beside their bars: speed, cost of hysteresis, and its loop.

    python benchmarks/backends/robot.py

One core. Each time is the best of several short stretches, so that other work on the machine
counts as little as possible; plain MuJoCo is timed on the same arm in the same run, to compare by.
"""

from __future__ import annotations

import os
import time
from dataclasses import replace
from pathlib import Path

os.environ.setdefault("OMP_NUM_THREADS", "1")

import mujoco
import numpy as np

from backends.mujoco_sim import MujocoRobot
from limo_driver.physics import PreslidingHysteresis, Simulation
from limo_driver.types import PositionCommand

PERIOD = 1e-3
STRETCH = 200  # cycles
STRETCHES = 120
START = np.array([0.1, 0.5, -0.2, -1.0, 0.3, 0.8, 0.0])
FREQUENCIES = np.array([0.2, 0.25, 0.3, 0.22, 0.35, 0.4, 0.45])  # [Hz]
EXAMPLE = Path(__file__).parents[2] / "examples" / "iiwa14_hysteretic.yaml"


def exploration(cycles: int) -> np.ndarray:
    """Return sinusoids of 2 degrees that start at rest, (T, 7) [rad]."""
    t = PERIOD * np.arange(cycles)[:, None]
    return START + np.deg2rad(2) * np.sin(2 * np.pi * FREQUENCIES * t) * (
        1 - np.exp(-((2 * t) ** 3))
    )


def opened(simulation: Simulation) -> MujocoRobot:
    """Return a robot that has run once, so that nothing is compiled while timed."""
    robot = MujocoRobot(simulation, initial_position=START)
    robot.receive()
    robot.run(START[None])
    return robot


def in_one_call(simulation: Simulation) -> float:
    """Return the time of one cycle within a whole trajectory [s]."""
    robot, targets = opened(simulation), exploration(STRETCH * STRETCHES)
    best = np.inf
    for part in np.split(targets, STRETCHES):
        began = time.perf_counter()
        robot.run(part)
        best = min(best, (time.perf_counter() - began) / STRETCH)
    return best


def through_the_interface(simulation: Simulation) -> float:
    """Return the time of one send and receive [s]."""
    robot, targets = opened(simulation), exploration(STRETCH * STRETCHES)
    best = np.inf
    for part in np.split(targets, STRETCHES):
        began = time.perf_counter()
        for target in part:
            robot.send(PositionCommand(position=target))
            robot.receive()
        best = min(best, (time.perf_counter() - began) / STRETCH)
    return best


def plain_mujoco(simulation: Simulation) -> float:
    """Return the time of one mj_step of the same model, without control [s]."""
    robot = opened(simulation)
    model, data = robot._model, robot._data
    best = np.inf
    for _ in range(STRETCHES):
        began = time.perf_counter()
        mujoco.mj_step(model, data, STRETCH)
        best = min(best, (time.perf_counter() - began) / STRETCH)
    return best


def loop_error(frequency: float, joint: int = 6) -> float:
    """Return the relative error of a settled hysteresis loop's area.

    Analytic, for elements of stiffness k and width w under an amplitude A: Σ 4 k w (A - w).
    """
    stiffness, width, amplitude = (200.0, 60.0), (0.002, 0.008), 0.03
    effect = PreslidingHysteresis(joint=joint, stiffness=stiffness, width=width)
    simulation = Simulation(robot="iiwa14", effects=(effect,))
    cycles, turn = round(3 / frequency / PERIOD), round(1 / frequency / PERIOD)
    phase = 2 * np.pi * frequency * PERIOD * np.arange(cycles)
    targets = np.zeros((cycles, 7))
    targets[:, joint - 1] = amplitude * np.sin(phase) * np.minimum(phase / np.pi, 1) ** 3
    with MujocoRobot(simulation, initial_position=targets[0]) as robot:
        robot.receive()
        run = robot.run(targets)
    rigid = simulation.without_effects().predict(run.true_motion)
    q = run.true_motion.position[-turn:, joint - 1]
    tau = (run.true_torque - rigid)[-turn:, joint - 1]
    area = 0.5 * abs(np.sum(q * np.roll(tau, -1) - np.roll(q, -1) * tau))
    reached = 0.5 * (q.max() - q.min())
    analytic = sum(4 * k * w * (reached - w) for k, w in zip(stiffness, width, strict=True))
    return area / analytic - 1


def prediction_error(simulation: Simulation) -> float:
    """Return the worst joint's RMSE of Simulation.predict on noise-free motion [N m]."""
    with MujocoRobot(simulation, initial_position=START) as robot:
        robot.receive()
        run = robot.run(exploration(10000))
    error = run.true_torque - simulation.predict(run.true_motion)
    return float(np.sqrt(np.mean(error**2, axis=0)).max())


def main() -> None:
    """Print every figure beside its bar."""
    full = Simulation.load(EXAMPLE)
    smooth = replace(
        full, effects=tuple(e for e in full.effects if e.name != "presliding_hysteresis")
    )
    plain = plain_mujoco(full)
    one_call, without = in_one_call(full), in_one_call(smooth)
    cycle = through_the_interface(full)
    print(f"hysteretic iiwa 14, {len(full.effects)} effects, 1 kHz, one core")
    for name, period, bar in (
        ("through the interface", cycle, "bar 20"),
        ("trajectory in one call", one_call, "bar 100"),
        ("plain mj_step, same arm", plain, "for comparison"),
    ):
        print(f"  {name:24}{PERIOD / period:6.1f} x real time ({1e6 * period:5.1f} µs)  {bar}")
    print(f"  cost of the hysteresis  {one_call / without:6.2f} x a step without it  bar 1.5")
    for frequency in (0.2, 2.0):
        error = 100 * loop_error(frequency)
        print(f"  loop area at {frequency:3.1f} Hz     {error:+6.3f} %  bar 1 %")
    worst = prediction_error(full)
    print(f"  torque against predict  {worst:6.4f} N m RMSE, worst joint  bar 0.01")


if __name__ == "__main__":
    main()
