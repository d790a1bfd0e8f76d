"""Whether a diagnosis without torque names what is hidden in an arm behind servos.

The arm is the concealed plant of `tests/concealed/servo_plant.py`, which shares no code with limo.
Bars: at 200 Hz and 12 bit, three quarters of the cases are named exactly, all hidden effects with
their joints and nothing else; nothing is named where nothing is hidden; mass of a payload within a
tenth, play within a fifth. Beside them stands how many 95 % intervals hold the true value, of what
is hidden and of what every servo has.

    python benchmarks/diagnosis/concealed_servos.py [--rate 200] [--bits 12] [--singles 20]
        [--sets 0] [--nulls 12] [--first 0] [--only payload+backlash] [--others] [--limits]
        [--turning] [--pushing] [--gripper]
"""

from __future__ import annotations

import argparse
import os
import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

os.environ.setdefault("OMP_NUM_THREADS", "1")

from fresh import first_seed

import limo_driver as limo

sys.path.insert(0, str(Path(__file__).parents[2] / "tests" / "concealed"))

import gripper_cases
import servo_cases
from told_cases import PUSHING, TURNING

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from estimators.diagnosis.verdict import Verdict

DATA = Path(os.environ.get("LIMO_DATA", Path(__file__).parents[2] / ".." / "shared" / "data"))
SO101 = DATA / "so101" / "robot" / "so101_new_calib.xml"
VALUES = {
    "payload": ("mass", 0.1),
    "backlash": ("gap", 0.2),
    "encoder_offset": ("offset", None),
    "drive_delay": ("delay", None),
    "coulomb_friction": ("tau_c", None),
    "position_servo": ("kp", None),
    "velocity_servo": ("kv", None),
    "torque_drive": ("gain", None),
    "dead_band": ("dead_band", None),
    "spring_load": ("stiffness", None),
    "load_dependent_friction": ("coefficient", None),
    "gear_ratio": ("ratio", None),
    "supply_sag": ("sag", None),
    "integral_gain": ("ki", None),
    "stribeck_friction": ("tau_s", None),
    "punch": ("punch", None),
    "thermal_derating": ("derating", None),
    "torque_limit": ("torque_limit", None),
    "voltage_limit": ("free_speed", None),
    "profile_speed": ("speed", None),
    "profile_acceleration": ("acceleration", None),
}
USUAL = {  # what every servo has: the fields of the concealed servos that it is the sum of
    ("position_servo", "kp"): ("gain",),
    ("velocity_servo", "kv"): ("gain",),
    ("torque_drive", "gain"): ("gain",),
    ("drive_delay", "delay"): ("late",),
    ("coulomb_friction", "tau_c"): ("dry",),
    ("viscous_friction", "f_v"): ("brake", "wet"),  # a servo's and a joint's damping act alike
    ("armature", "inertia"): ("rotor",),
}


@dataclass(frozen=True)
class Value:
    """A true value and the one that was found."""

    effect: str
    ratio: float  # found over hidden
    covered: bool  # whether its interval holds the hidden one


@dataclass(frozen=True)
class Outcome:
    """What was named in one case."""

    case: servo_cases.Case
    named: tuple[tuple[str, tuple[int, ...]], ...]
    values: tuple[Value, ...]  # of what was hidden
    usual: tuple[Value, ...]  # of what every servo has
    seconds: float  # of processor

    @property
    def exact(self) -> bool:
        """Whether all that is hidden was named, and nothing else."""
        return set(self.named) == {(x.effect, x.joints) for x in self.case.hidden}


def main() -> None:
    """Make, diagnose, and print each case and the figures beside their bars."""
    given = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    given.add_argument("--rate", type=float, default=200.0, help="of the recordings [Hz]")
    given.add_argument("--bits", type=int, default=12, help="of the encoders")
    given.add_argument("--singles", type=int, default=20)
    given.add_argument("--sets", type=int, default=0, help="of two or three effects")
    given.add_argument("--nulls", type=int, default=12)
    given.add_argument("--first", type=int, default=first_seed(), help="seed; else by the version")
    given.add_argument("--only", default="", help="effects, joined by +, of all singles")
    given.add_argument("--others", action="store_true", help="effects that came later")
    given.add_argument("--limits", action="store_true", help="of servos at their limits")
    given.add_argument("--turning", action="store_true", help="an arm that is told velocities")
    given.add_argument("--pushing", action="store_true", help="an arm that is told torques")
    given.add_argument("--gripper", action="store_true", help="an SO-101 in MuJoCo, loads in it")
    asked = given.parse_args()
    if asked.gripper:
        of_grippers(asked)
        return
    every = servo_cases.OTHERS if asked.others else servo_cases.SINGLES
    every = servo_cases.LIMITS if asked.limits else every
    told = TURNING if asked.turning else PUSHING if asked.pushing else None
    every, make = (told.singles, told.make) if told else (every, servo_cases.make)
    effects = [tuple(asked.only.split("+"))] if asked.only else [(effect,) for effect in every]
    hidden = [effects[k % len(effects)] for k in range(asked.singles)]
    hidden += [servo_cases.drawn_set(asked.first + len(hidden) + k) for k in range(asked.sets)]
    hidden += [()] * asked.nulls
    found: list[Outcome] = []
    for seed, own in enumerate(hidden, start=asked.first):
        found.append(run(make(seed, own, asked.rate, asked.bits)))
        print(line(found[-1]), flush=True)
    by = f", by {told.channel}" if told else ""
    show(found, f"{asked.rate:g} Hz, {asked.bits} bit{by}")


def of_grippers(asked: argparse.Namespace) -> None:
    """Make and diagnose cases of an SO-101 that has something in its gripper."""
    hidden = gripper_cases.HIDDEN
    every = [hidden[k % len(hidden)] for k in range(asked.singles)] + [()] * asked.nulls
    found: list[Outcome] = []
    for seed, own in enumerate(every, start=asked.first):
        found.append(run(gripper_cases.make(seed, own, SO101, asked.rate, asked.bits)))
        print(line(found[-1]), flush=True)
    show(found, f"gripper of an SO-101, {asked.rate:g} Hz, {asked.bits} bit")


def run(case: servo_cases.Case) -> Outcome:
    """Diagnose a case and compare."""
    with tempfile.TemporaryDirectory() as folder:
        sim, recordings = case.write(Path(folder))
        begun = time.process_time()
        verdict = limo.diagnose(sim, recordings).verdict
        seconds = time.process_time() - begun
    hidden = {(x.effect, x.joints) for x in case.hidden}
    # all values of the arm are off by a tolerance, and those that are reported are no false ones
    named: dict[tuple[str, tuple[int, ...]], tuple[float, tuple[float, float]] | None] = {
        (item.effect, item.joints): (item.fitted, item.ci95)
        for item in verdict.values
        if item.reported and item.ci95 is not None
        if item.beyond or (item.effect, item.joints) in hidden
    }
    for item in verdict.findings:
        known = item.parameters.get(VALUES.get(item.effect, ("",))[0])
        named[item.effect, item.joints] = known and (float(known.value), known.ci95)
    values: list[Value] = []
    for x in case.hidden:
        if (found := named.get((x.effect, x.joints))) is not None:
            (low, high), ratio = found[1], found[0] / x.size
            values.append(Value(x.effect, ratio, low <= x.size <= high))
    return Outcome(case, tuple(named), tuple(values), tuple(usual(case, verdict)), seconds)


def usual(case: servo_cases.Case, verdict: Verdict) -> Iterator[Value]:
    """Yield what every servo has, of joints in whose columns nothing else stands."""
    counted = {j for x in case.hidden if x.effect in servo_cases.COUNTED for j in x.joints}
    for item in verdict.identified:
        if len(item.joints) != 1 or counted & set(item.joints):
            continue
        servo = case.servos[item.joints[0] - 1]
        for name, found in item.parameters.items():
            fields = USUAL.get((item.effect, name))
            if fields is not None and found.ci95 is not None:
                true = sum(float(servo[field]) for field in fields)
                low, high = found.ci95
                yield Value(item.effect, float(found.value) / true, low <= true <= high)


def line(outcome: Outcome) -> str:
    """Return a case in a line."""
    hidden = ", ".join(f"{x.effect} {x.joints} {x.size:.4f}" for x in outcome.case.hidden)
    ratios = ", ".join(f"{x.ratio:.2f} {'in' if x.covered else '--'}" for x in outcome.values)
    text = f"{outcome.case.seed:4d} {hidden or 'nothing':40s} "
    if outcome.exact:
        return f"{text} right  found over hidden {ratios or '-'}  {outcome.seconds:.0f} s"
    return f"{text} WRONG  named {outcome.named}  {outcome.seconds:.0f} s"


def show(found: Sequence[Outcome], title: str) -> None:
    """Print the figures beside their bars."""
    print(f"\n{title}")
    nulls = [x for x in found if not x.case.hidden]
    singles, sets = (
        [x for x in found if x.case.hidden and (len(x.case.hidden) > 1) == many]
        for many in (False, True)
    )
    values = [value for x in found for value in x.values]
    for effect in dict.fromkeys(item.effect for x in found for item in x.case.hidden):
        own = [x for x in singles if x.case.hidden[0].effect == effect]
        ratios = [f"{x.ratio:.2f}" for x in values if x.effect == effect]
        bar = VALUES.get(effect, ("", None))[1]
        within = f", bar {1 - bar:g} to {1 + bar:g}" if bar else ""
        alone = f"{sum(x.exact for x in own)} of {len(own)} alone; " if own else ""
        print(f"{effect:24s} {alone}value found over hidden: {' '.join(ratios) or '-'}{within}")
    for name, own in (("one effect", singles), ("two or three", sets)):
        if own:
            share = sum(x.exact for x in own) / len(own)
            print(f"{name} exactly right: {share:.0%} of {len(own)} (bar 75 % at 200 Hz, 12 bit)")
    if sets:
        hidden = [(x, (item.effect, item.joints)) for x in sets for item in x.case.hidden]
        hit = sum(item in x.named for x, item in hidden)
        named = sum(len(x.named) for x in sets)
        print(f"effects of sets that are named: {hit} of {len(hidden)}; {named - hit} false")
    if values:
        print(
            f"95 % intervals that hold the value: {sum(x.covered for x in values)} of {len(values)}"
        )
    show_usual([value for x in found for value in x.usual])
    if nulls:
        print(f"false on nulls: {sum(not x.exact for x in nulls)} of {len(nulls)} (bar 0)")


def show_usual(values: Sequence[Value]) -> None:
    """Print of what every servo has how many intervals hold it, and how far off it is."""
    for effect in dict.fromkeys(x.effect for x in values):
        own = [x for x in values if x.effect == effect]
        off = sorted(abs(x.ratio - 1.0) for x in own)[len(own) // 2]
        held = sum(x.covered for x in own)
        print(f"{effect:24s} {held} of {len(own)} intervals hold it; median error {off:.1%}")
    if values:
        held = sum(x.covered for x in values)
        print(f"of all of these: {held} of {len(values)}, {held / len(values):.0%}")


if __name__ == "__main__":
    main()
