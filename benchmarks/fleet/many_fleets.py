"""Concealed fleets of an arm that a MuJoCo file states: which arms are named, and for what.

    python benchmarks/fleet/many_fleets.py [--fleets 10] [--first 0] [--arms 20] [--dates 8]
        [--seconds 10] [--keep FOLDER]

Torques are MuJoCo's own inverse dynamics, with friction that shares no code with limo. Units differ
by 5 % in each friction. Of each fleet three arms are odd and two drift, in what `draw` draws. Bars:
all five are named with the right quantity and joint, and in ten fleets one other arm at most. No
report is written; with `--keep FOLDER`, the same command goes on where it was ended.
"""

from __future__ import annotations

import argparse
import tempfile
from contextlib import nullcontext
from dataclasses import dataclass
from datetime import date, timedelta
from pathlib import Path
from typing import TYPE_CHECKING, Final

import mujoco
import numpy as np

import limo_driver as limo
from estimators.diagnosis.reading import verdict_in
from estimators.diagnosis.verdict import VERDICT
from estimators.studies import FleetDiagnosis, FleetRow
from estimators.studies.fleet_row import arm_of, date_of

if TYPE_CHECKING:
    from limo_driver.types import FloatArray

JOINTS: Final = ("lift", "stick")
MODEL: Final = """<mujoco model="digger"><compiler angle="radian"/><worldbody><body name="base">
 <geom type="cylinder" size=".08 .1" mass="8"/><body name="boom" pos="0 0 .2">
  <joint name="lift" axis="0 1 0" range="-2 2" damping="3" frictionloss="6" armature=".4"/>
  <geom type="capsule" fromto="0 0 0 .5 0 0" size=".045" mass="5"/><body name="arm" pos=".5 0 0">
   <joint name="stick" axis="0 1 0" range="-2 2" damping="1.5" frictionloss="4" armature=".15"/>
   <geom type="capsule" fromto="0 0 0 .4 0 0" size=".04" mass="3"/>
</body></body></body></worldbody>
<actuator><motor joint="lift"/><motor joint="stick"/></actuator></mujoco>"""
DRY, VISCOUS = np.array([6.0, 4.0]), np.array([3.0, 1.5])
UNITS: Final = 0.05  # by which friction differs from unit to unit, relative
NOISE: Final = 0.1  # [N m]
RATE: Final = 100.0  # [Hz]
_KINDS: Final = ("Coulomb friction", "viscous friction", "payload", "spring")


@dataclass(frozen=True)
class Peculiar:
    """What one arm has beyond the others, at the end of its dates if it drifts."""

    kind: str
    joint: int  # 0-based
    size: float  # factor of friction, kg, or N m/rad
    drifts: bool

    def at(self, part: float) -> Peculiar:
        """Return what it has at a part of its dates."""
        if not self.drifts:
            return self
        least = 1.0 if "friction" in self.kind else 0.0
        return Peculiar(self.kind, self.joint, least + part * (self.size - least), True)

    def told_by(self, sentence: str) -> bool:
        """Say whether a sentence about the arm names the quantity and its joint."""
        joint = self.kind == "payload" or JOINTS[self.joint] in sentence
        return self.kind.lower() in sentence.lower() and joint


def draw(random: np.random.Generator, *, drifts: bool) -> Peculiar:
    """Draw what is peculiar."""
    kind = _KINDS[random.integers(2 if drifts else 4)]
    low, high = {"payload": (0.4, 1.0), "spring": (15.0, 30.0)}.get(kind, (1.6, 2.2))
    return Peculiar(
        kind, int(random.integers(len(JOINTS))), float(random.uniform(low, high)), drifts
    )


def torque(
    q: FloatArray, v: FloatArray, a: FloatArray, has: Peculiar | None, unit: FloatArray
) -> FloatArray:
    """Return what the drives give along a motion, (T, n) [N m]."""
    spec = mujoco.MjSpec.from_string(MODEL)
    for joint in spec.joints:
        joint.damping, joint.frictionloss = np.zeros_like(joint.damping), 0.0
    if has is not None and has.kind == "payload":
        spec.joint("stick").parent.add_geom(
            type=mujoco.mjtGeom.mjGEOM_SPHERE,
            pos=[0.42, 0.0, 0.03],
            size=[0.03, 0, 0],
            mass=has.size,
        )
    model = spec.compile()
    data, found = mujoco.MjData(model), np.empty_like(q)
    model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONSTRAINT
    for k in range(len(q)):
        data.qpos, data.qvel, data.qacc = q[k], v[k], a[k]
        mujoco.mj_inverse(model, data)
        found[k] = data.qfrc_inverse
    dry, viscous = DRY * unit[0], VISCOUS * unit[1]
    if has is not None and "friction" in has.kind:
        (dry if has.kind == _KINDS[0] else viscous)[has.joint] *= has.size
    if has is not None and has.kind == "spring":
        found[:, has.joint] += has.size * q[:, has.joint]
    return found + dry * v / np.sqrt(v**2 + 1e-4) + viscous * v


def make(folder: Path, seed: int, arms: int, dates: int, seconds: float) -> dict[str, Peculiar]:
    """Record a fleet, and return what is peculiar, by arm."""
    random = np.random.default_rng([77, seed])
    chosen = random.permutation(arms)[:5]
    peculiar = {int(k): draw(random, drifts=i >= 3) for i, k in enumerate(chosen)}
    (folder / "model.xml").write_text(MODEL)
    t = np.arange(int(seconds * RATE)) / RATE
    for arm in range(arms):
        unit = 1 + UNITS * random.standard_normal((2, len(JOINTS)))
        for day in range(dates):
            place = folder / "recordings" / f"unit_{arm:02d}"
            place.mkdir(parents=True, exist_ok=True)
            q, v, a = (np.zeros((t.size, len(JOINTS))) for _ in range(3))
            for w in 2 * np.pi * random.uniform(0.08, 0.6, (5, len(JOINTS))):
                size = random.uniform(0.1, 0.3, len(JOINTS))
                phase = random.uniform(0, 6.3, len(JOINTS))
                q += size * np.sin(w * t[:, None] + phase)
                v += size * w * np.cos(w * t[:, None] + phase)
                a -= size * w**2 * np.sin(w * t[:, None] + phase)
            now = peculiar[arm].at(day / max(dates - 1, 1)) if arm in peculiar else None
            felt = torque(q, v, a, now, unit) + NOISE * random.standard_normal(q.shape)
            seen = q + 2e-5 * random.standard_normal(q.shape)
            when = date(2026, 3, 1) + timedelta(days=7 * day)
            limo.Recording.from_arrays(t, seen, felt).save(place / f"{when}.parquet")
    return {f"unit_{k:02d}": has for k, has in peculiar.items()}


def diagnosed(folder: Path) -> FleetDiagnosis:
    """Diagnose each recording of a fleet that was not yet, and compare the arms."""
    simulation, rows = limo.Simulation.load(folder / "model.xml"), list[FleetRow]()
    for path in sorted(folder.glob("recordings/*/*.parquet")):
        place = path.with_suffix("")
        if not (place / VERDICT).exists():
            place.mkdir(exist_ok=True)
            limo.diagnose(simulation, path).verdict.save(place / VERDICT)
        rows.append(
            FleetRow(path, str(path), arm_of(path), date_of(path), verdict=verdict_in(place))
        )
    return FleetDiagnosis("digger", tuple(rows), joints=simulation.model.joint_names)


def judged(found: FleetDiagnosis, peculiar: dict[str, Peculiar]) -> tuple[int, int, int]:
    """Print what is named beside what is concealed; return how many are named, right, and false."""
    said = {name: line for line in str(found).splitlines() for name, _, _ in [line.partition(":")]}
    named = right = 0
    for arm, has in sorted(peculiar.items()):
        line = said.get(arm, "")
        named += bool(line)
        right += has.told_by(line)
        mark = "right" if has.told_by(line) else "WRONG" if line else "MISSED"
        verb = "drifts to" if has.drifts else "has"
        print(f"  {mark}: {verb} {has.kind} of {JOINTS[has.joint]} {has.size:.2f}: {line}")
    false = [arm for arm in {*found.odd, *found.drifting} if arm not in peculiar]
    for arm in sorted(false):
        print(f"  FALSE: {said.get(arm, arm)}")
    return named, right, len(false)


def main() -> None:
    """Print each fleet, and the sums."""
    given = argparse.ArgumentParser(description=__doc__)
    given.add_argument("--fleets", type=int, default=10)
    given.add_argument("--first", type=int, default=0, help="seed")
    given.add_argument("--arms", type=int, default=20)
    given.add_argument("--dates", type=int, default=8)
    given.add_argument("--seconds", type=float, default=10.0)
    given.add_argument("--keep", type=Path)
    asked = given.parse_args()
    sums = np.zeros(3, dtype=int)
    with nullcontext(asked.keep) if asked.keep else tempfile.TemporaryDirectory() as name:
        for seed in range(asked.first, asked.first + asked.fleets):
            folder = Path(name) / f"fleet_{seed}"
            folder.mkdir(parents=True, exist_ok=True)
            peculiar = make(folder, seed, asked.arms, asked.dates, asked.seconds)
            found = diagnosed(folder)
            print(f"fleet {seed}: {found.headline}", flush=True)
            sums += judged(found, peculiar)
    print(
        f"{asked.fleets} fleets: {sums[0]} of {5 * asked.fleets} peculiar arms named, {sums[1]} "
        f"with the right quantity and joint; {sums[2]} other arms named (bar: 1 in ten fleets)"
    )


if __name__ == "__main__":
    main()
