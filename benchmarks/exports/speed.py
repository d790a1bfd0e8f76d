"""How fast MuJoCo steps an exported model, beside the same model without the new physics.

    python benchmarks/exports/speed.py

The arm is an iiwa with a load, damping and armature, and with dry friction, with friction that has
memory, or with both. It is stepped as a user's loop does, as `mujoco.rollout` does, on which
`mujoco.sysid` stands, and by MuJoCo alone. Both models take turns; what counts is the median ratio
of the rounds, in processor time. The bar is 0.7 of the speed without.
"""

# MuJoCo ships no stubs.
# pyright: reportUnknownParameterType=false, reportAttributeAccessIssue=false
from __future__ import annotations

from pathlib import Path
from tempfile import TemporaryDirectory
from time import thread_time
from typing import TYPE_CHECKING

import mujoco
import mujoco.rollout
import numpy as np

import limo_driver as limo
from limo_driver.physics import (
    Armature,
    CoulombFriction,
    Payload,
    PreslidingHysteresis,
    Simulation,
    ViscousFriction,
)

if TYPE_CHECKING:
    from collections.abc import Callable

    from limo_driver.physics import Effect

ROUNDS, STEPS, BAR = 41, 1000, 0.7


def fallen(model: mujoco.MjModel) -> mujoco.MjData:
    """Return an arm in a pose from which it falls."""
    data = mujoco.MjData(model)
    data.qpos[1:4] = 0.7
    return data


def by_hand(model: mujoco.MjModel) -> None:
    """Step as a user does who sets torques."""
    data, torque = fallen(model), np.zeros(7)
    for _ in range(STEPS):
        data.qfrc_applied[:] = torque
        mujoco.mj_step(model, data)


def rolled_out(model: mujoco.MjModel) -> None:
    """Step as `mujoco.sysid` does."""
    data = fallen(model)
    size = mujoco.mj_stateSize(model, mujoco.mjtState.mjSTATE_FULLPHYSICS)
    state = np.zeros(size)
    mujoco.mj_getState(model, data, state, mujoco.mjtState.mjSTATE_FULLPHYSICS)
    mujoco.rollout.rollout(model, data, state[None, :], nstep=STEPS)


def alone(model: mujoco.MjModel) -> None:
    """Step without Python between."""
    mujoco.mj_step(model, fallen(model), nstep=STEPS)


def seconds(step: Callable[[mujoco.MjModel], None], model: mujoco.MjModel) -> float:
    """Return the processor time that it takes: others on the machine count among no steps."""
    begin = thread_time()
    step(model)
    return thread_time() - begin


def main() -> None:
    """Export with and without, and step both."""
    load = Payload(mass=2.0, com=(0.01, 0.02, 0.1), inertia=(0.01, 0, 0, 0.01, 0, 0.005))
    drives: list[Effect] = [load]
    drives += [ViscousFriction(joint=j, f_v=2.0 / j) for j in range(1, 8)]
    drives += [Armature(joint=j, inertia=0.5 / j) for j in range(1, 8)]
    dry = [CoulombFriction(joint=j, tau_c=3.0 / j, v_eps=0.005) for j in range(1, 8)]
    width = (2e-3, 8e-3, 0.02)
    memory = [
        PreslidingHysteresis(joint=j, stiffness=tuple(1.0 / j / w for w in width), width=width)
        for j in range(1, 8)
    ]
    physics = {"without": [], "dry": drives + dry, "memory": drives + memory}
    physics["both"] = drives + dry + memory
    models = dict[str, mujoco.MjModel]()
    with TemporaryDirectory() as folder:
        for name, effects in physics.items():
            found = limo.export(Simulation("iiwa14", tuple(effects)), "mjcf", Path(folder) / name)
            models[name] = mujoco.MjModel.from_xml_path(str(found.file))
    print(f"{'friction':>8} {'loop':>11} {'without':>9} {'with':>9} {'speed':>6}   bar")
    for name in ("dry", "memory", "both"):
        for step in (by_hand, rolled_out, alone):
            pairs = np.array(
                [
                    [seconds(step, models["without"]), seconds(step, models[name])]
                    for _ in range(ROUNDS)
                ]
            )
            without, with_it = 1e6 * np.median(pairs, axis=0) / STEPS
            ratio = float(np.median(pairs[:, 0] / pairs[:, 1]))
            said = f"{name:>8} {step.__name__:>11} {without:>6.1f} us {with_it:>6.1f} us"
            print(f"{said} {ratio:>6.2f}   {BAR}")


if __name__ == "__main__":
    main()
