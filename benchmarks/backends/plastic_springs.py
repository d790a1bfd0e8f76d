"""Slip elements of the simulated robot: as its engine has them, beside MuJoCo 4's plastic springs.

    python benchmarks/backends/plastic_springs.py [--seconds 20]

The same arm and motion, with gears that are stiff and with those that wind up, in turn, by
processor time. Error: the torque sensor without noise against the prediction on the motion that was
true, of the worst joint. Speed: in one call, without recording. The engine would be given up where
plastic springs are as exact and as fast, on both arms; and MuJoCo 3 has none.
"""

from __future__ import annotations

import argparse
import sys
import time
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
from simulated_speed import EXAMPLE, ROUNDS, motion

import backends.mujoco_sim.robot as ours
import limo_driver as limo
from backends.mujoco_sim import scene
from backends.mujoco_sim.engine import Engine
from limo_driver.model.descriptions.mjcf.joints import relax
from limo_driver.physics import JointElasticity
from limo_driver.runtime.installed_mujoco import PLASTIC, RELEASE

if TYPE_CHECKING:
    from backends.mujoco_sim.realisation import Plant


class Plastic:
    """Makes robots have plastic springs, while it is entered."""

    def __enter__(self) -> None:
        self._before = scene._add_slipping_spring, ours.Engine
        scene._add_slipping_spring, ours.Engine = self._add, self._engine

    def __exit__(self, *_: object) -> None:
        scene._add_slipping_spring, ours.Engine = self._before

    @staticmethod
    def _add(spec: Any, joint: str, stiffness: float, width: float) -> None:  # noqa: ANN401
        tendon = spec.add_tendon(name=f"{joint}_{len(spec.tendons)}", springlength=[0.0, 0.0])
        tendon.wrap_joint(joint, 1.0)
        tendon.stiffness, tendon.springyield = [stiffness, 0.0, 0.0], width

    @staticmethod
    def _engine(*given: Any) -> Engine:  # noqa: ANN401
        none, place = np.zeros(0), Engine.__init__.__code__.co_varnames.index("plant") - 1
        plant: Plant = given[place]
        bare = plant._replace(
            element_joint=none.astype(np.int64), element_stiffness=none, element_width=none
        )
        return Engine(*given[:place], bare, *given[place + 1 :])


def run(sim: limo.Simulation, planned: limo.Trajectory) -> tuple[float, float]:
    """Return the worst joint's error, RMS [N m], and how many times real time it took."""
    with ours.MujocoRobot(sim, initial_position=planned.position[0]) as robot:
        relax(robot._model, robot._data)
        robot.receive()
        begun = time.process_time()
        done = robot.run(planned.position)
        speed = float(done.time[-1] - done.time[0]) / (time.process_time() - begun)
    error = done.true_torque - sim.predict(done.true_motion)
    return float(np.sqrt(np.mean(error**2, axis=0)).max()), speed


def main() -> int:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=float, default=20.0)
    planned = motion(parser.parse_args().seconds)
    if RELEASE[0] < PLASTIC:
        sys.exit(f"needs MuJoCo {PLASTIC}, which has plastic springs")
    whole = limo.Simulation.load(EXAMPLE)
    stiff = tuple(x for x in whole.effects if not isinstance(x, JointElasticity))
    print(f"{planned.time[-1]:.0f} s of {EXAMPLE.stem}, median of {ROUNDS}")
    for name, sim in (("stiff gears", replace(whole, effects=stiff)), ("elastic gears", whole)):
        run(sim, motion(1.0))
        rows = []
        for _ in range(ROUNDS):
            engine = run(sim, planned)
            with Plastic():
                rows.append((*engine, *run(sim, planned)))
        error, speed, plastic_error, plastic_speed = np.median(rows, axis=0)
        print(f"{name:14} engine  {error:9.2e} N m {speed:7.1f} times real time")
        print(f"{'':14} plastic {plastic_error:9.2e} N m {plastic_speed:7.1f}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
