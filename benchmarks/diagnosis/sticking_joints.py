"""Whether joints that stick are told from sensors that hang, in recordings of servos.

The concealed arm of `tests/concealed/servo_plant.py` follows slow ramps, with and without stiction,
behind servos of two gains. Each of its recordings is read as it is, from which nothing should be
left out; and with a joint whose position hangs for 12 to 40 rows of its motion, which should be.

    python benchmarks/diagnosis/sticking_joints.py [--cases 12] [--first 0]
"""

from __future__ import annotations

import argparse
import sys
from itertools import product
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from limo_driver.errors import RecordingError
from limo_driver.recordings.recording import Recording

sys.path.insert(0, str(Path(__file__).parents[2] / "tests" / "concealed"))

import servo_cases
import servo_plant as plant

if TYPE_CHECKING:
    from limo_driver.types import FloatArray

RATES = (10, 20, 50, 200)  # [Hz]
STIFFER = (1.0, 8.0)  # times the usual gain and torque
PACES = (0.1, 0.4)  # [rad] that a ramp of 2 to 6 s may lead
STICTION = ((0.0, 0.5), (1.0, 5.0))  # times the dry friction, of each joint and from one to another
MOVED = 0.02  # [rad], while a sensor hangs
EVERY = 0.005  # [s] at least between two commands


def main() -> None:
    """Count both by stiction and rate, and print them."""
    asked = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    asked.add_argument("--cases", type=int, default=12, help="of each gain and pace")
    asked.add_argument("--first", type=int, default=0, help="seed")
    given = asked.parse_args()
    print("told that a position is held, of all recordings in which it is, and in which none is")
    for stiction, rate in product(STICTION, RATES):
        told = [
            case(seed, rate, stiffer, pace, stiction)
            for stiffer, pace in product(STIFFER, PACES)
            for seed in range(given.first, given.first + given.cases)
        ]
        hung = [hangs for _, hangs in told if hangs is not None]
        false = sum(as_is for as_is, _ in told)
        low, high = stiction
        print(
            f"stiction {low:g} to {high:g} of dry friction, {rate:3d} Hz: {sum(hung)} of "
            f"{len(hung)}; {false} of {len(told)}",
            flush=True,
        )


def case(
    seed: int, rate: float, stiffer: float, pace: float, stiction: tuple[float, float]
) -> tuple[bool, bool | None]:
    """Return whether something is left out as recorded, and where a sensor hangs, if it can."""
    random = np.random.default_rng([seed, 3])
    servos = servo_cases._servos(np.random.default_rng(seed), bits=12)
    servos["gain"] *= stiffer
    servos["stall"] *= stiffer
    servos["breakaway"] = stiffer * servo_cases.DRY * random.uniform(*stiction, plant.N)
    every = max(1.0 / rate, EVERY)
    own = plant.play(plant.hobby_arm(), servos, ramps(seed, every, pace), every, rate)
    hung, rows = own.position.copy(), int(random.integers(12, 40))
    moved = np.abs(own.position[rows:] - own.position[:-rows]) > MOVED
    begins = np.argwhere(moved[1:-1]) + np.array([1, 0])
    as_is = left_out(own.time, own.position, own.command)
    if not len(begins):
        return as_is, None
    first, joint = begins[random.integers(len(begins))].tolist()
    hung[first : first + rows, joint] = hung[first, joint]
    return as_is, left_out(own.time, hung, own.command)


def ramps(seed: int, every: float, pace: float) -> FloatArray:
    """Return commands, (K, n) [rad]."""
    random = np.random.default_rng(seed)
    time = np.arange(0.0, servo_cases.SECONDS, every)
    command = np.zeros((time.size, plant.N))
    for j in range(plant.N):
        at = np.cumsum(np.append(0.0, random.uniform(2.0, 6.0, 12)))
        goals = np.cumsum(random.uniform(-pace, pace, at.size)).clip(-1.0, 1.0)
        command[:, j] = np.interp(time, at, goals)
    return command + np.array([0.0, 0.6, -0.3, 0.0])


def left_out(time: FloatArray, position: FloatArray, command: FloatArray) -> bool:
    """Say whether rows of a recording are left out, or all of it is refused."""
    try:
        return bool(Recording.from_arrays(time, position, command=command).left_out)
    except RecordingError:
        return True


if __name__ == "__main__":
    main()
