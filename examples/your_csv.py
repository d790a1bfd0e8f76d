"""A lab's own log of an iiwa, in degrees and milliseconds: read it, and identify the arm."""

from pathlib import Path

import numpy as np

import limo_driver as limo

OUT = Path("out/your_csv")
OUT.mkdir(parents=True, exist_ok=True)


def write_log(path: Path) -> None:
    """Write what a logger of a lab might leave: joints from 0, a probe, no SI units."""
    arm = limo.Simulation.load(Path(__file__).parent / "iiwa14_hysteretic.yaml")
    t = np.arange(0, 20, 0.01)
    rate = 2 * np.pi * (0.05 + 0.02 * np.arange(7))
    phase = np.outer(t, rate) + np.arange(7)
    motion = limo.Motion(
        t, 0.8 * np.sin(phase), 0.8 * rate * np.cos(phase), -0.8 * rate**2 * np.sin(phase)
    )
    torque = arm.predict(motion) + np.random.default_rng(1).normal(0, 0.05, phase.shape)
    names = ["t_ms", *(f"q{j}" for j in range(7)), *(f"tau{j}" for j in range(7)), "probe_force"]
    table = np.column_stack([1e3 * t, np.rad2deg(motion.position), torque, np.sin(t)])
    np.savetxt(path, table, delimiter=",", header=",".join(names), comments="")


write_log(OUT / "scan.csv")
found = limo.inspect(OUT / "scan.csv", "iiwa14")
print(found)
print("questions:", found.questions or "none")
found.mapping.save(OUT / "mapping.yaml")  # to be looked at, and given with every later log

run = limo.read(OUT / "scan.csv", "iiwa14", OUT / "mapping.yaml")
identified = limo.identify("iiwa14", run).simulation
identified.save(OUT / "sim.yaml")
print(identified.score(run))  # of the log that it was identified from: keep another one aside
