"""How near Newton, reading an exported USD alone, comes to limo's own simulation, step by step.

    python benchmarks/exports/newton.py --newton VENV/bin/python

Newton and limo need not share an environment: any interpreter with `pip install "newton[sim,onnx]"
usd-core newton-usd-schemas` will do; it runs on the CPU. Twice Newton's MuJoCo solver steps an iiwa
14 with a load, dry and viscous friction and armatures:

- pushed with the torque that limo predicts along a minute of motion, one step of 1 ms from each
  state: what its acceleration is off by, as torque, of the torque of each joint, RMS. The bar is
  1 %, as of all exports.
- driven by its `NewtonActuator`s (delays, limits, a DC motor, a PID, a network with a dead band and
  punch) from commands alone for six seconds: what its positions are off by, of what limo's own
  simulation of the drives moves, RMS. Here, too, the bar is 1 %.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any

import numpy as np

ROOT = Path(__file__).parents[2]
sys.path[:0] = [str(ROOT / "tests" / "limo_driver" / "model" / "descriptions")]

# pyright: reportMissingImports=false, reportAttributeAccessIssue=false
if TYPE_CHECKING:
    import limo_driver as limo
    from limo_driver.types import FloatArray

BAR = 0.01
STEP = 0.001  # [s]
EVERY = 50  # rows of the minute of motion
SECONDS = 6.0

_IN_NEWTON = """
import sys
import numpy as np
import newton
import warp as wp

given = np.load(sys.argv[2])
step = float(given["step"])
builder = newton.ModelBuilder()
builder.add_usd(sys.argv[1])
model = builder.finalize(device="cpu")
solver = newton.solvers.SolverMuJoCo(model, use_mujoco_cpu=True, disable_contacts=True)
names = [label.rsplit("/", 1)[-1] for label in model.joint_label]
start = model.joint_qd_start.numpy()  # where all joints turn about one axis, as in joint_q
at = [int(start[names.index(str(name))]) for name in given["names"]]
state, after, control = model.state(), model.state(), model.control()


def put(array, values):
    whole = array.numpy()
    whole[at] = values
    array.assign(whole)


if "torque" in given:
    found = np.zeros_like(given["torque"])
    for k in range(len(found)):
        put(state.joint_q, given["position"][k])
        put(state.joint_qd, given["velocity"][k])
        put(control.joint_f, given["torque"][k])
        before = state.joint_qd.numpy()[at]
        solver.step(state, after, control, None, step)
        found[k] = (after.joint_qd.numpy()[at] - before) / step
else:
    found = np.zeros_like(given["command"])
    put(state.joint_q, given["start"])
    memory = [(each.state(), each.state()) for each in model.actuators]
    for k, command in enumerate(given["command"]):
        found[k] = state.joint_q.numpy()[at]
        put(control.joint_target_q, command)
        control.joint_f.zero_()
        for j, (each, (old, new)) in enumerate(zip(model.actuators, memory)):
            each.step(state, control, old, new, dt=step)
            memory[j] = (new, old)
        solver.step(state, after, control, None, step)
        state, after = after, state
np.save(sys.argv[3], found)
"""


def main() -> int:
    """Print both tables; return 0 where the bar is held."""
    arguments = argparse.ArgumentParser(description=__doc__)
    arguments.add_argument("--newton", default=sys.executable, help="an interpreter with newton")
    python = arguments.parse_args().newton
    with TemporaryDirectory() as folder:
        simulation = _simulation(Path(folder))
        pushed, driven = _pushed(simulation, python), _driven(simulation, python)
    print(f"joint   pushed, of the torque   driven, of the motion; bar {BAR:.0%}")
    for joint, (one, two) in enumerate(zip(pushed, driven, strict=True), start=1):
        print(f"{joint:5d}   {one:21.3%}   {two:21.3%}")
    return 0 if max(*pushed, *driven) <= BAR else 1


def _simulation(folder: Path) -> limo.Simulation:
    """Return what was found of an iiwa in USD, without drives."""
    from pxr import Usd, UsdPhysics
    from usd_arms import usd_of

    import limo_driver as limo
    from limo_driver.physics import Armature, CoulombFriction, Payload, ViscousFriction

    path = usd_of(limo.RobotModel.load("iiwa14"), folder / "arm.usda")
    stage = Usd.Stage.Open(str(path))
    UsdPhysics.ArticulationRootAPI.Apply(stage.GetPrimAtPath("/robot"))
    stage.GetRootLayer().Save()
    effects = [Payload(mass=0.8, com=(0.01, 0, 0.06), inertia=(0.002, 0, 0, 0.002, 0, 0.001))]
    for joint in range(1, 8):
        effects += [
            CoulombFriction(joint=joint, tau_c=0.6),
            ViscousFriction(joint=joint, f_v=0.8),
            Armature(joint=joint, inertia=0.1),
        ]
    return replace(limo.Simulation.load(path), effects=tuple(effects))


def _in_newton(simulation: limo.Simulation, python: str, **given: FloatArray) -> FloatArray:
    """Export, let Newton step the file, and return what it found."""
    import limo_driver as limo

    with TemporaryDirectory() as name:
        folder = Path(name)
        exported = limo.export(simulation, "usd", folder / "out")
        for line in exported.unwritten:
            print(f"not written: {line}")
        names = np.array(simulation.model.joint_names)
        arrays: dict[str, Any] = {**given, "names": names, "step": np.array(STEP)}
        np.savez(folder / "given.npz", **arrays)
        files = [str(exported.file), str(folder / "given.npz"), str(folder / "found.npy")]
        # its own text
        subprocess.run([python, "-c", _IN_NEWTON, *files], check=True, stdout=subprocess.DEVNULL)
        return np.load(folder / "found.npy")


def _pushed(simulation: limo.Simulation, python: str) -> list[float]:
    """Return the share of each joint's torque that Newton's acceleration is off by."""
    from limo_driver.exports.changes.joints import sharp
    from limo_driver.exports.proof import MOVING
    from limo_driver.exports.remainder import proof_motion

    motion, rows = proof_motion(simulation.model), slice(None, None, EVERY)
    exact = replace(simulation, effects=tuple(map(sharp, simulation.effects)))
    torque = exact.predict(motion)[rows]
    q, v, a = motion.position[rows], motion.velocity[rows], motion.acceleration[rows]
    found = _in_newton(simulation, python, position=q, velocity=v, torque=torque)
    rest, armature = np.zeros_like(q), 0.1
    body = simulation.body
    off = body.inverse_dynamics(q, rest, found - a) - body.inverse_dynamics(q, rest, rest)
    off += armature * (found - a)
    moving = np.abs(v) > MOVING
    error, whole = (np.sum(x**2, axis=0, where=moving) for x in (off, torque))
    return np.sqrt(error / whole).tolist()


def _driven(simulation: limo.Simulation, python: str) -> list[float]:
    """Return the share of each joint's motion that it is off by in Newton, driven by commands."""
    from estimators.diagnosis.from_motion.simulation.free_run import follow
    from estimators.diagnosis.from_motion.simulation.plant import ServoArm
    from limo_driver.physics import PositionServo
    from limo_driver.physics.drives import DcMotor

    servos = [
        PositionServo(joint=1, kp=400.0, kd=20.0, torque_limit=50.0, delay=0.015),
        PositionServo(joint=2, kp=900.0, kd=30.0, torque_limit=150.0),
        DcMotor(joint=2, kt=0.1, resistance=4.0, supply=24.0, gear=300.0),
        PositionServo(joint=3, kp=300.0, kd=10.0, ki=50.0, integral_limit=10.0),
        PositionServo(joint=4, kp=600.0, kd=10.0, dead_band=0.005, punch=1.0, torque_limit=80.0),
        *(PositionServo(joint=j, kp=200.0, kd=5.0, torque_limit=4.0) for j in (5, 6, 7)),
    ]
    simulation = replace(simulation, drives=tuple(servos))
    time = np.arange(0, SECONDS, STEP)
    phase = 2 * np.pi * np.outer(time, 0.2 + 0.03 * np.arange(7))
    command = 0.5 * np.array([1, 1, -1, 1, 1, -1, 1]) * (1 - np.cos(phase))
    start = np.zeros(7)
    found = _in_newton(simulation, python, command=command, start=start)
    arm = ServoArm.of(simulation).without_restarts()
    wanted = follow(arm, time, command, start[None, :], np.zeros((1, 7)))
    off = np.sqrt(np.mean((found - wanted) ** 2, axis=0))
    return (off / np.std(wanted, axis=0)).tolist()


if __name__ == "__main__":
    sys.exit(main())
