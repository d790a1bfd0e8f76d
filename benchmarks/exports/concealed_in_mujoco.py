"""A log made by plain MuJoCo, and what limo writes into the model: values beside the truth.

Each arm is an MJCF file whose joints all state an armature of 0.1 kg m² and a damping of
1 N m s/rad, as models of simulators do. MuJoCo alone moves it under torque control for a minute,
with friction, damping and a load of 1.2 kg that the file does not know; the log is a CSV in degrees
and milliseconds with noise of 0.05 N m. Then, as one command does it: read, nominal, diagnose,
export.

    python benchmarks/exports/concealed_in_mujoco.py [--armature 0.3]

`--armature` is what the file says where 0.1 is true.
"""

from __future__ import annotations

import argparse
import tempfile
import time
from importlib.metadata import files
from pathlib import Path
from typing import TYPE_CHECKING, Any

import mujoco
import numpy as np

import limo_driver as limo

if TYPE_CHECKING:
    from limo_driver.types import FloatArray

ARMS = {"panda.urdf": "panda", "ur5_robot.urdf": "ur5", "iiwa14": "iiwa14"}
TRUE_ARMATURE, MASS, COM, SECONDS = 0.1, 1.2, (0.02, 0.03, 0.09), 60


def main() -> None:
    """Print a table for each arm."""
    options = argparse.ArgumentParser(description=__doc__)
    options.add_argument("--armature", type=float, default=TRUE_ARMATURE)
    stated = options.parse_args().armature
    for source, name in ARMS.items():
        with tempfile.TemporaryDirectory() as folder:
            _report(source, name, Path(folder), stated)


def _report(source: str, name: str, folder: Path, stated: float) -> None:
    random = np.random.default_rng(7)
    found = next((x for x in files("example-robot-data") or () if x.name == source), None)
    robot = source if found is None else str(Path(str(found.locate())).resolve())
    bare = limo.export(limo.Simulation(robot), "mjcf", folder / "bare").file
    joints = limo.RobotModel.load(bare).joint_names
    spec = mujoco.MjSpec.from_file(str(bare))
    for joint in joints:
        _set(spec.joint(joint), armature=stated, damping=1.0)
    path = folder / f"{name}.xml"
    path.write_text(spec.to_xml(), encoding="utf-8")
    loss = random.uniform(0.2, 2.0, len(joints)).round(2)
    damping = random.uniform(0.5, 5.0, len(joints)).round(2)
    log = folder / "log.csv"
    _record(spec, joints, loss, damping, log)
    wall, used = time.perf_counter(), time.process_time()
    recording = limo.read(log, path)
    diagnosis = limo.diagnose(limo.nominal(path), recording)
    better = limo.export(diagnosis.simulation, "mjcf", folder / "better", into=path).file
    wall, used = time.perf_counter() - wall, time.process_time() - used
    _compare(name, mujoco.MjModel.from_xml_path(str(better)), joints, loss, damping)
    print(f"{used:.0f} s of processor time, {wall:.0f} s\n")


def _set(joint: Any, **values: float) -> None:  # noqa: ANN401  # MuJoCo has no stubs
    for key, value in values.items():
        known = getattr(joint, key)
        setattr(joint, key, [value, *known[1:]] if np.ndim(known) else value)


def _record(
    spec: Any,  # noqa: ANN401
    joints: tuple[str, ...],
    loss: FloatArray,
    damping: FloatArray,
    log: Path,
) -> None:
    """Move the arm in MuJoCo with what is concealed, and write what a lab's logger would."""
    for joint, dry, viscous in zip(joints, loss, damping, strict=True):
        _set(spec.joint(joint), armature=TRUE_ARMATURE, damping=viscous, frictionloss=dry)
        spec.joint(joint).solimp_friction = [0.999, 0.999, 0.001, 0.5, 2.0]
    load = spec.joint(joints[-1]).parent.add_body(name="load")
    load.mass, load.ipos, load.explicitinertial = MASS, COM, True
    load.inertia = [0.004, 0.003, 0.004]
    spec.option.timestep = 0.001
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    spec.option.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONTACT
    model = spec.compile()
    data, n = mujoco.MjData(model), len(joints)
    middle = np.array([0.0, -0.5, 0.2, -1.5, 0.3, 1.2, 0.2])[:n]
    middle = np.clip(middle, model.jnt_range[:, 0] + 0.9, model.jnt_range[:, 1] - 0.9)
    rate = 2 * np.pi * np.array([0.07, 0.11, 0.13, 0.17, 0.19, 0.23, 0.29])[:n]
    kp, kd = np.linspace(900, 200, n), np.linspace(50, 8, n)
    random, rows = np.random.default_rng(1), list[Any]()
    data.qpos[:] = middle
    for k in range(1000 * SECONDS):
        t, s = 1e-3 * k, min(1e-3 * k / 3, 1.0)
        reach = 0.6 * s**3 * (10 - 15 * s + 6 * s**2)
        target = middle + reach * (np.sin(rate * t) + 0.3 * np.sin(2.3 * rate * t))
        speed = reach * rate * (np.cos(rate * t) + 0.69 * np.cos(2.3 * rate * t))
        mujoco.mj_step1(model, data)
        torque = kp * (target - data.qpos) + kd * (speed - data.qvel) + data.qfrc_bias
        data.qfrc_applied[:] = torque
        if k % 4 == 0:
            noise = random.normal(0, [[2e-3], [0.05]], (2, n))
            rows.append([k, *(np.rad2deg(data.qpos) + noise[0]), *(torque + noise[1])])
        mujoco.mj_step2(model, data)
    names = [f"{joint}_pos_deg" for joint in joints] + [f"{joint}_torque" for joint in joints]
    header = ",".join(["stamp_ms", *names])
    np.savetxt(log, rows, delimiter=",", header=header, comments="", fmt="%.6g")


def _compare(
    name: str,
    model: Any,  # noqa: ANN401
    joints: tuple[str, ...],
    loss: FloatArray,
    damping: FloatArray,
) -> None:
    print(f"{name:>20}  frictionloss [N m]  damping [N m s/rad]  armature [kg m²]")
    for joint, dry, viscous in zip(joints, loss, damping, strict=True):
        own = model.joint(joint)
        values = (own.frictionloss[0], dry, own.damping[0], viscous, own.armature[0])
        print(
            "{:>20}  {:8.3f} for {:4.2f}  {:9.3f} for {:4.2f}  {:7.3f} for {:.1f}".format(
                joint, *values, TRUE_ARMATURE
            )
        )
    for body in range(model.nbody):
        if model.body(body).name.startswith("payload"):
            com = ", ".join(f"{x:.3f}" for x in model.body_ipos[body])
            print(f"load {model.body_mass[body]:.3f} kg at ({com}) m, for {MASS} kg at {COM} m")


if __name__ == "__main__":
    main()
