"""How near plain simulators with an exported file come to limo, and what the file cannot say.

    python benchmarks/exports/round_trip.py [TARGET ...]

The iiwa 14 with a load and friction of several laws is written for each target that is installed,
and that target's own simulator predicts a minute of motion; MJCF is written for MuJoCo 4 and, as
`mjcf3`, for 3. Bar: 1 % of the torque, RMS, what is not expressible aside; that stands beside it in
N m. Then the same file is read and written again: nothing may change. Last, other loads are written
into the exported file, one after the other: the masses of its bodies have to be those of an export
into the user's own.
"""

from __future__ import annotations

import sys
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any

import mujoco

import limo_driver as limo
from limo_driver.app.library.learning import described
from limo_driver.exports.changes.bodies import parts_of
from limo_driver.physics import (
    Armature,
    CoulombFriction,
    Payload,
    PreslidingHysteresis,
    StribeckFriction,
    TorqueRipple,
    ViscousFriction,
)

if TYPE_CHECKING:
    from limo_driver.exports.export import Export
    from limo_driver.physics import Effect

BAR = 0.01
MUJOCO = {"mjcf": 4, "mjcf3": 3}
SAME = 1e-9  # [kg]
TARGETS = ("mjcf", "mjcf3", "urdf", "drake", "isaaclab")


def effects() -> tuple[Effect, ...]:
    """Return what was found in an arm."""
    return (
        Payload(mass=0.8, com=(0.01, 0.0, 0.06), inertia=(0.002, 0, 0, 0.002, 0, 0.001)),
        *(CoulombFriction(joint=j, tau_c=0.6) for j in (1, 3, 5, 6, 7)),
        *(ViscousFriction(joint=j, f_v=0.8) for j in range(1, 8)),
        *(Armature(joint=j, inertia=0.1) for j in range(1, 8)),
        StribeckFriction(joint=2, tau_s=0.3, v_s=0.03),
        PreslidingHysteresis(joint=4, stiffness=(300.0, 90.0), width=(0.002, 0.005)),
        TorqueRipple(joint=1, cycles_per_rev=(14.0,), amplitude=(0.1,), phase=(0.4,)),
    )


def mjcf_of(urdf: Path, folder: Path) -> Path:
    """Return a URDF as the MJCF that MuJoCo makes of it."""
    path = folder / "arm.xml"
    spec: Any = vars(mujoco)["MjSpec"].from_file(str(urdf))  # of which its stubs do not know
    spec.compiler.discardvisual = True
    spec.compile()
    path.write_text(spec.to_xml(), encoding="utf-8")
    return path


def masses(file: Path) -> dict[str, float]:
    """Return the mass of each body of a file [kg], by name."""
    parts = [part for of_link in parts_of(limo.RobotModel(file)).values() for part in of_link]
    return {part.name: part.inertial.mass for part in parts if part.inertial is not None}


def written(sim: limo.Simulation, target: str, out: Path, into: Path) -> Export:
    """Export a simulation into a file."""
    to = "mjcf" if target in MUJOCO else target
    return limo.export(sim, to, out, into, mujoco=MUJOCO.get(target))


def worst_mass(sim: limo.Simulation, target: str, own: Path, exported: Path, folder: Path) -> float:
    """Return by how much a body is off at most after exports into an exported file [kg]."""
    load, *others = sim.effects
    lighter = Payload(mass=0.3, com=(0.0, 0.02, 0.05), inertia=(0.001, 0, 0, 0.001, 0, 0.001))
    into, worst = exported, 0.0
    for number, effects in enumerate(
        [(load, *others), (lighter, *others), (lighter, load, *others), tuple(others), sim.effects]
    ):
        other = limo.Simulation(str(own), effects)
        found, afresh = (
            masses(written(other, target, folder / f"{target}-{name}{number}", file).file)
            for name, file in (("again", into), ("afresh", own))
        )
        if found.keys() != afresh.keys():
            return float("inf")
        worst = max(worst, *(abs(found[name] - afresh[name]) for name in found))
        into = folder / f"{target}-again{number}" / into.name
    return worst


def main() -> int:
    """Print the table; return 0 where the bar is held."""
    held = True
    urdf = limo.RobotModel.load("iiwa14").urdf
    print(
        f"{'target':9} {'error':>7} {'bar':>5}  again  masses [kg]   "
        "not expressible, worst joint [N m RMS]"
    )
    with TemporaryDirectory() as place:
        folder = Path(place)
        for target in sys.argv[1:] or TARGETS:
            own = mjcf_of(urdf, folder) if target in MUJOCO else urdf
            sim = limo.Simulation(str(own), effects())
            found = written(sim, target, folder / target, own)
            read = described(limo.RobotModel.load(str(found.file)))
            again = written(read, target, folder / f"{target}2", found.file)
            same = "same" if not again.diff else "CHANGED"
            largest: dict[str, float] = {}
            for item in found.remainder:
                name = item.place.split(",")[0].replace("_", " ")
                largest[name] = max(largest.get(name, 0.0), *item.rms)
            off = worst_mass(sim, target, own, found.file, folder)
            left = ", ".join(f"{name} {rms:.3f}" for name, rms in largest.items()) or "nothing"
            print(f"{target:9} {found.share:7.2%} {BAR:5.0%}  {same:8} {off:9.1e}   {left}")
            held &= found.share <= BAR and not again.diff and off <= SAME
    return 0 if held else 1


if __name__ == "__main__":
    sys.exit(main())
