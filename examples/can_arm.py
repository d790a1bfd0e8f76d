"""An arm of seven CiA 402 drives on a bus: drives in one process, `limo run` in another.

    python examples/can_arm.py             # half a minute, in real time
    python examples/can_arm.py --config examples/can_damiao.yaml      # Damiao motors

`limo drives` is seven simulated drives on `udp_multicast`, with an iiwa 14 that has hysteresis
behind them; `limo run --backend can` finds, configures and moves them as it would real ones. The
same motion of the same arm without a bus shows what the bus costs: torque comes in steps of a
thousandth of each drive's rating, and set-points take effect a cycle later.
"""

from __future__ import annotations

import argparse
import shlex
import subprocess
import sys
from pathlib import Path

import numpy as np

from backends.can import ArmConfig
from backends.can.simulator import SimulatedDrives
from limo_driver.recordings.recording import Recording

HERE = Path(__file__).parent
TRUTH = HERE / "iiwa14_hysteretic.yaml"
LIMO = [sys.executable, "-c", "from limo_driver.cli import main; main()"]


def limo(command: str) -> None:
    """Run one limo command to its end, as a shell would."""
    print(f"\n$ limo {command}", flush=True)
    subprocess.run([*LIMO, *shlex.split(command)], check=True)


def compare(bus: Recording, direct: Recording) -> None:
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
    parser.add_argument(
        "--hold-after",
        type=int,
        default=25,
        help="cycles of silence before the arm holds; 2 on a machine that keeps time",
    )
    parser.add_argument("--duration", type=float, default=10.0, help="of the motion [s]")
    given = parser.parse_args()
    out, seconds = given.out, given.duration
    out.mkdir(parents=True, exist_ok=True)
    arm = out / "arm.yaml"
    arm.write_text(f"{given.config.read_text()}hold_after: {given.hold_after}\n")
    config = ArmConfig.load(arm)
    motion = out / "motion.traj.parquet"
    limo(f"plan --robot {config.robot} --scaffolds 2 --seed 1 --out {motion}")
    print(f"\n$ limo drives --config {arm} --sim {TRUTH} --trajectory {motion} &")
    with SimulatedDrives(arm, sim=TRUTH, trajectory=motion) as drives:
        limo(
            f"run --backend can --config {arm} --trajectory {motion} "
            f"--duration {seconds} --record {out}/bus.parquet"
        )
    print(f"\nthe drives: {drives.summary}")
    limo(
        f"run --backend mujoco --sim {TRUTH} --trajectory {motion} --rate {config.rate} "
        f"--duration {seconds} --record {out}/direct.parquet"
    )
    compare(Recording.load(out / "bus.parquet"), Recording.load(out / "direct.parquet"))


if __name__ == "__main__":
    main()
