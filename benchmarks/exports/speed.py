"""How fast MuJoCo steps an exported model, beside the same model without the new physics.

    python benchmarks/exports/speed.py

The arm is an iiwa with friction, damping, armature and a load. Both models are stepped by the same
loop, in turns, and the quickest round of each counts. The bar is 0.7 of the speed without.
"""

# MuJoCo ships no stubs.
# pyright: reportUnknownParameterType=false, reportAttributeAccessIssue=false
from __future__ import annotations

from pathlib import Path
from tempfile import TemporaryDirectory
from time import perf_counter

import mujoco

import limo_driver as limo
from limo_driver.physics import Armature, CoulombFriction, Payload, Simulation, ViscousFriction

ROUNDS, STEPS = 15, 2000


def seconds(model: mujoco.MjModel) -> float:
    """Return how long a number of steps takes, from a pose that falls."""
    data = mujoco.MjData(model)
    data.qpos[1:4] = 0.7
    begin = perf_counter()
    mujoco.mj_step(model, data, nstep=STEPS)
    return perf_counter() - begin


def main() -> None:
    """Export with and without, and step both."""
    effects = [Payload(mass=2.0, com=(0.01, 0.02, 0.1), inertia=(0.01, 0, 0, 0.01, 0, 0.005))]
    effects += [CoulombFriction(joint=j, tau_c=3.0 / j, v_eps=0.005) for j in range(1, 8)]
    effects += [ViscousFriction(joint=j, f_v=2.0 / j) for j in range(1, 8)]
    effects += [Armature(joint=j, inertia=0.5 / j) for j in range(1, 8)]
    with TemporaryDirectory() as folder:
        models = [
            mujoco.MjModel.from_xml_path(
                str(limo.export(Simulation("iiwa14", own), "mjcf", Path(folder) / name).file)
            )
            for name, own in (("without", ()), ("with", tuple(effects)))
        ]
    best = [
        min(times) for times in zip(*([*map(seconds, models)] for _ in range(ROUNDS)), strict=True)
    ]
    without, with_them = (1e6 * value / STEPS for value in best)
    print(f"without {without:.1f} us a step, with {with_them:.1f} us: {without / with_them:.2f}")
    print("of the speed; bar 0.7")


if __name__ == "__main__":
    main()
