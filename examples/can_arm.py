"""An arm of seven CiA 402 drives on a bus: drives in one process, their master in another.

    python examples/can_arm.py  # half a minute, in real time
    python examples/can_arm.py --config examples/can_damiao.yaml  # Damiao motors

`SimulatedDrives`, or `limo drives`, is seven drives on `udp_multicast` in a process of their own,
with an iiwa 14 that has hysteresis behind them; the backend `can` finds, configures and moves them
as it would real ones. The same motion of the same arm without a bus shows what the bus costs:
torque comes in steps of a thousandth of each drive's rating, and set-points take effect a cycle
later.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np

import limo_driver as limo
from backends.can import ArmConfig
from backends.can.simulator import SimulatedDrives

HERE = Path(__file__).parent
TRUTH = HERE / "iiwa14_hysteretic.yaml"


def compare(bus: limo.Recording, direct: limo.Recording) -> None:
    """Print what both runs measured, joint by joint."""
    rows = min(len(bus.time), len(direct.time))
    print("\njoint   torque step   torque rms   difference rms")
    for j, step in enumerate(bus.torque_resolution):
        torque = direct.torque[:rows, j]
        difference = bus.torque[:rows, j] - torque
        print(f"{j + 1:5d}   {step:7.3f} N m {_rms(torque):8.2f} N m {_rms(difference):12.3f} N m")


def _rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(np.square(values))))


def main() -> None:
    """Plan, run over the bus and without it, compare."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, default=Path("out/can"))
    parser.add_argument("--config", type=Path, default=HERE / "can_cia402.yaml")
    parser.add_argument("--duration", type=float, default=10.0, help="of the motion [s]")
    given = parser.parse_args()
    out, seconds = given.out, given.duration
    out.mkdir(parents=True, exist_ok=True)
    arm = given.config
    config = ArmConfig.load(arm)
    motion = limo.plan(config.robot, limo.PlanRequest(scaffolds=2), seed=1)
    path = out / "motion.traj.parquet"
    motion.trajectory.save(path)  # where the drives stand at first
    moved = motion.trajectory.first(seconds)
    print("over the bus ...", flush=True)
    with SimulatedDrives(arm, sim=TRUTH, trajectory=path) as drives:
        bus = limo.run("can", moved, link={"config": arm}, record=out / "bus.parquet")
    print(f"the drives: {drives.summary}")
    direct = limo.run(
        "mujoco",
        moved,
        simulation=limo.Simulation.load(TRUTH),
        rate=config.rate,
        record=out / "direct.parquet",
    )
    compare(bus, direct)


if __name__ == "__main__":
    main()
