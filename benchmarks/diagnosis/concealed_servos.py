"""Whether a diagnosis without torque names what is hidden in an arm behind servos.

The arm is the concealed plant of `tests/concealed/servo_plant.py`, which shares no code with limo.
Bars: at 200 Hz and 12 bit, three quarters of the hidden effects are named exactly, effect and joint
and nothing else; nothing is named where nothing is hidden; mass of a payload within a tenth, play
within a fifth.

    python benchmarks/diagnosis/concealed_servos.py [--rate 200] [--bits 12] [--singles 20]
        [--nulls 12] [--first 0] [--only payload] [--others]
"""

from __future__ import annotations

import argparse
import os
import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path

os.environ.setdefault("OMP_NUM_THREADS", "1")

import numpy as np

import limo_driver as limo

sys.path.insert(0, str(Path(__file__).parents[2] / "tests" / "concealed"))

import servo_cases

VALUES = {
    "payload": ("mass", 0.1),
    "backlash": ("gap", 0.2),
    "encoder_offset": ("offset", None),
    "drive_delay": ("delay", None),
    "coulomb_friction": ("tau_c", None),
    "position_servo": ("kp", None),
    "dead_band": ("dead_band", None),
    "spring_load": ("stiffness", None),
    "load_dependent_friction": ("coefficient", None),
    "gear_ratio": ("ratio", None),
    "supply_sag": ("sag", None),
    "integral_gain": ("ki", None),
    "stribeck_friction": ("tau_s", None),
}


@dataclass(frozen=True)
class Outcome:
    """What was named in one case."""

    exact: bool
    named: tuple[tuple[str, tuple[int, ...]], ...]
    ratio: float  # of the value found to the hidden one; NaN where there is none
    covered: bool  # whether its interval holds the hidden one
    seconds: float  # of processor


def main() -> None:
    """Make, diagnose, and print each case and the figures beside their bars."""
    given = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    given.add_argument("--rate", type=float, default=200.0, help="of the recordings [Hz]")
    given.add_argument("--bits", type=int, default=12, help="of the encoders")
    given.add_argument("--singles", type=int, default=20)
    given.add_argument("--nulls", type=int, default=12)
    given.add_argument("--first", type=int, default=0, help="seed")
    given.add_argument("--only", default="", help="effect")
    given.add_argument("--others", action="store_true", help="effects that came later")
    asked = given.parse_args()
    every = servo_cases.OTHERS if asked.others else servo_cases.SINGLES
    effects = [asked.only] if asked.only else list(every)
    found: dict[str, list[Outcome]] = {}
    hidden = [effects[k % len(effects)] for k in range(asked.singles)] + [""] * asked.nulls
    for k, effect in enumerate(hidden):
        case = servo_cases.make(asked.first + k, effect, asked.rate, asked.bits)
        outcome = run(case)
        found.setdefault(effect, []).append(outcome)
        print(
            f"{case.seed:4d} {effect or 'nothing':24s} joint {case.joint} {case.size:8.4f}  "
            f"{'right' if outcome.exact else 'WRONG'}  ratio {outcome.ratio:5.2f} "
            f"{'in' if outcome.covered else '--'}  {outcome.seconds:4.0f} s  {outcome.named}",
            flush=True,
        )
    show(found, f"{asked.rate:g} Hz, {asked.bits} bit")


def run(case: servo_cases.Case) -> Outcome:
    """Diagnose a case and compare."""
    with tempfile.TemporaryDirectory() as folder:
        sim, recordings = case.write(Path(folder))
        begun = time.process_time()
        verdict = limo.diagnose(sim, recordings).verdict
        seconds = time.process_time() - begun
    named = tuple((item.effect, item.joints) for item in verdict.findings)
    wanted = ((case.hidden, case.joints),) if case.hidden else ()
    right = [x for x in verdict.findings if wanted and (x.effect, x.joints) == wanted[0]]
    ratio, covered = np.nan, False
    if right and case.hidden in VALUES:
        value = right[0].parameters[VALUES[case.hidden][0]]
        ratio = float(value.value) / case.size
        low, high = value.ci95
        covered = low <= case.size <= high
    return Outcome(named == wanted, named, ratio, covered, seconds)


def show(found: dict[str, list[Outcome]], title: str) -> None:
    """Print the figures beside their bars."""
    nulls = found.pop("", [])
    print(f"\n{title}")
    for effect, outcomes in found.items():
        ratios = [f"{x.ratio:.2f}" for x in outcomes if np.isfinite(x.ratio)]
        bar = VALUES.get(effect, ("", None))[1]
        within = f", bar {1 - bar:g} to {1 + bar:g}" if bar else ""
        print(
            f"{effect:24s} {sum(x.exact for x in outcomes)} of {len(outcomes)}; value found over "
            f"hidden: {' '.join(ratios) or '-'}{within}"
        )
    every = [x for outcomes in found.values() for x in outcomes]
    if every:
        share = sum(x.exact for x in every) / len(every)
        valued = [x for x in every if np.isfinite(x.ratio)]
        print(f"exactly right: {share:.0%} of {len(every)} (bar 75 % at 200 Hz and 12 bit)")
        print(
            f"95 % intervals that hold the value: {sum(x.covered for x in valued)} of {len(valued)}"
        )
    if nulls:
        print(f"false on nulls: {sum(not x.exact for x in nulls)} of {len(nulls)} (bar 0)")


if __name__ == "__main__":
    main()
