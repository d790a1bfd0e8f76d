"""How near Drake, reading an exported URDF alone, comes to limo's own prediction.

    python benchmarks/exports/drake.py --drake VENV/bin/python

Drake and limo need not share an environment: any interpreter with `pip install drake` will do. The
bar is 1 % of the torque of each joint, RMS, on a minute of motion; dry friction, of which Drake
knows nothing, aside.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

_IN_DRAKE = """
import sys
import numpy as np
from pydrake.multibody.parsing import Parser
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import MultibodyForces_

motion = np.load(sys.argv[2])
plant = MultibodyPlant(0.0)
parser = Parser(plant)
(arm,) = parser.AddModels(sys.argv[1])
base = plant.GetBodyByName(str(motion["base"]))
plant.WeldFrames(plant.world_frame(), base.body_frame())
plant.Finalize()
context = plant.CreateDefaultContext()
joints = [plant.GetJointByName(str(name)) for name in motion["names"]]
torque = np.zeros_like(motion["position"])
for k in range(len(torque)):
    vdot = np.zeros(plant.num_velocities())
    state = (motion[name][k] for name in ("position", "velocity", "acceleration"))
    for joint, q, v, a in zip(joints, *state):
        joint.set_angle(context, q)
        joint.set_angular_rate(context, v)
        vdot[joint.velocity_start()] = a
    forces = MultibodyForces_[float](plant)
    plant.CalcForceElementsContribution(context, forces)
    found = plant.CalcInverseDynamics(context, vdot, forces)
    torque[k] = [found[joint.velocity_start()] for joint in joints]
np.save(sys.argv[3], torque)
"""


def main() -> None:
    """Export the iiwa with damping, armature and a load, and compare."""
    arguments = argparse.ArgumentParser(description=__doc__)
    arguments.add_argument("--drake", default=sys.executable, help="an interpreter with pydrake")
    python = arguments.parse_args().drake
    import limo_driver as limo
    from limo_driver.exports.remainder import proof_motion
    from limo_driver.physics import Armature, Payload, Simulation, ViscousFriction

    effects = [Payload(mass=2.0, com=(0.01, 0.02, 0.1), inertia=(0.01, 0, 0, 0.01, 0, 0.005))]
    effects += [ViscousFriction(joint=j, f_v=2.0 / j) for j in range(1, 8)]
    effects += [Armature(joint=j, inertia=0.5 / j) for j in range(1, 8)]
    simulation = Simulation("iiwa14", tuple(effects))
    motion = proof_motion(simulation.model)
    with TemporaryDirectory() as name:
        folder = Path(name)
        exported = limo.export(simulation, "drake", folder / "arm.urdf")
        root = simulation.model.description.root
        children = {joint.find("child").get("link") for joint in root.findall("joint")}  # type: ignore[union-attr]
        base = next(x for link in root.findall("link") if (x := link.get("name")) not in children)
        np.savez(
            folder / "motion.npz",
            names=np.array(simulation.model.joint_names),
            base=np.array(base),
            position=motion.position,
            velocity=motion.velocity,
            acceleration=motion.acceleration,
        )
        files = [str(exported.file), str(folder / "motion.npz"), str(folder / "torque.npy")]
        subprocess.run([python, "-c", _IN_DRAKE, *files], check=True)  # its own text
        found = np.load(folder / "torque.npy")
    wanted = simulation.predict(motion)
    share = np.sqrt(np.mean((found - wanted) ** 2, axis=0) / np.mean(wanted**2, axis=0))
    print("joint   difference in Drake, of the torque (RMS); bar 1 %")
    for joint, value in enumerate(share.tolist(), start=1):
        print(f"{joint:5d}   {value:.2%}")


if __name__ == "__main__":
    main()
