"""Figures of `limo excite`: condition number, time taken, distance to the limits.

    python benchmarks/excite.py [SEED ...]

It finds a minute of excitation for the iiwa 14 with each of three seeds (or those given) and prints
each figure beside its bar. The first run also compiles, and says so.
"""

from __future__ import annotations

import argparse
from dataclasses import replace
from time import perf_counter

import numpy as np

from estimators.rigid_body.base_parameters import Conditioning
from limo_driver.model import RobotModel
from limopa import ExcitationRequest, Feasibility, excite

PAPER = 68  # condition number in Çallar and Böttger 2022


def main(*seeds: int) -> None:
    """Search, measure, print."""
    begin = perf_counter()
    model = RobotModel.load("iiwa14")
    conditioning, request = Conditioning(model), ExcitationRequest()
    untouched = replace(request, iterations=0)
    excite(model, conditioning, untouched, seeds[0])
    print(f"warm-up with a random motion (compiles the first time): {perf_counter() - begin:.1f} s")
    feasibility = Feasibility(model, request.surroundings, request.workspace)

    print(f"{'figure':<62}{'measured':>12}   bar")
    for seed in seeds:
        random = excite(model, conditioning, untouched, seed).trajectory
        begin = perf_counter()
        motion = excite(model, conditioning, request, seed).trajectory
        spent = perf_counter() - begin
        peaks, limits = motion.peaks(), model.limits
        position = motion.resample(1e-3).position
        torque = model.inverse_dynamics(motion.position, motion.velocity, motion.acceleration)
        within = feasibility.check_scaffold(position).feasible.all()
        condition = conditioning.condition(motion)
        rows = [
            ("condition number, 57 columns, SI units", condition, f"< {PAPER}"),
            ("  of a random motion with as many harmonics", conditioning.condition(random), ""),
            ("  with columns scaled to unit norm", conditioning.scaled(motion), ""),
            ("search [s]", spent, "about 60"),
            ("duration of the motion [s]", motion.duration, ""),
            ("velocity / limit", (peaks.velocity / limits.velocity).max(), "< 1"),
            ("acceleration / limit", (peaks.acceleration / limits.acceleration).max(), "< 1"),
            ("jerk / limit", (peaks.jerk / limits.jerk).max(), "< 1"),
            ("rigid-body torque / limit", (np.abs(torque) / limits.torque).max(), "< 1"),
            ("least distance beyond the clearance at 1 kHz [m]",
             feasibility.margins(position).min(), "> 0"),
            ("joint range, table, self-collision kept at 1 kHz", float(within), "1"),
        ]  # fmt: skip
        print(f"seed {seed}")
        for name, value, bar in rows:
            print(f"  {name:<60}{value:>12.6g}   {bar}")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("seeds", type=int, nargs="*", default=[0, 1, 2], help="of the searches")
    main(*parser.parse_args().seeds)
