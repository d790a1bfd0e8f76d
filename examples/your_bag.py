"""A ROS 2 bag of an arm beside a gripper, joints in another order: read it by their names."""

from pathlib import Path

import numpy as np

import limo_driver as limo
from limo_driver.logs.mcap_file import LoggedMessage, McapWriter
from limo_driver.network.messages import JOINT_STATE, JointStateCodec

OUT = Path("out/your_bag")
OUT.mkdir(parents=True, exist_ok=True)
ARM = limo.RobotModel.load("iiwa14")
START = 1_700_000_000 * 10**9  # [ns]


def write_bag(path: Path) -> None:
    """Write joint states as a driver publishes them: names sorted, a gripper on the same topic."""
    arm = limo.Simulation.load(Path(__file__).parent / "iiwa14_hysteretic.yaml")
    t = np.arange(0, 20, 0.01)
    rate = 2 * np.pi * (0.05 + 0.02 * np.arange(7))
    phase = np.outer(t, rate) + np.arange(7)
    q, v, a = 0.8 * np.sin(phase), 0.8 * rate * np.cos(phase), -0.8 * rate**2 * np.sin(phase)
    torque = arm.predict(limo.Motion(t, q, v, a))
    torque += np.random.default_rng(1).normal(0, 0.05, q.shape)
    order = [3, 0, 6, 2, 5, 1, 4]
    codec = JointStateCodec([ARM.joint_names[j] for j in order])
    fingers = JointStateCodec(["finger_left", "finger_right"])
    path.unlink(missing_ok=True)
    writer = McapWriter(path)
    for k, stamp in enumerate((START + np.round(1e9 * t).astype(np.int64)).tolist()):
        of_arm = codec.encode(stamp, q[k, order], v[k, order], torque[k, order])
        of_gripper = fingers.encode(stamp, np.zeros(2), np.zeros(2), np.zeros(2))
        for payload in (of_arm, of_gripper):
            message = LoggedMessage("/joint_states", JOINT_STATE, payload, stamp, stamp, k)
            writer.add(message)
    writer.finish()


write_bag(OUT / "bag.mcap")
found = limo.inspect(OUT / "bag.mcap", ARM)
print(found, *found.notes(), *found.telemetry, sep="\n")
run = limo.read(OUT / "bag.mcap", ARM)
identified = limo.identify(ARM, run).simulation
identified.save(OUT / "sim.yaml")
print(limo.export(identified, "urdf", OUT / "improved"))
