"""Conceal hysteresis and a payload in a simulated arm, record it, and find out what was left out.

`believed.yaml` is what one thinks the arm is, `true.yaml` is what it is. Only the second drives the
robot; only the first and the recording reach the diagnosis. Takes about a minute.
"""

from __future__ import annotations

import json
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

from limo_driver.physics import (
    CoulombFriction,
    Payload,
    PreslidingHysteresis,
    Sensors,
    Simulation,
    ViscousFriction,
)

OUT = Path("out/diagnose_simulated")
COULOMB = (2.2, 2.4, 1.6, 1.7, 0.9, 0.45, 0.35)  # [N m]
VISCOUS = (4.0, 4.2, 2.4, 2.6, 1.2, 0.7, 0.6)  # [N m s/rad]
NOISE = (0.05, 0.05, 0.04, 0.04, 0.03, 0.02, 0.02)  # [N m]


def limo(command: str) -> None:
    """Run a command as a shell would."""
    print(f"$ limo {command}", flush=True)
    main = "from limo_driver.cli import main; main()"
    subprocess.run([sys.executable, "-c", main, *command.split()], check=True)


believed = Simulation(
    "iiwa14",
    effects=(
        *(CoulombFriction(joint=j, tau_c=c, v_eps=0.002) for j, c in enumerate(COULOMB, start=1)),
        *(ViscousFriction(joint=j, f_v=v) for j, v in enumerate(VISCOUS, start=1)),
    ),
    sensors=Sensors(torque_noise=NOISE),
)
concealed = (
    PreslidingHysteresis(joint=4, law="maxwell_slip", stiffness=(120.0, 40.0), width=(0.004, 0.02)),
    Payload(mass=0.8, com=(0.0, 0.02, 0.08), inertia=(2e-3, 0.0, 0.0, 2e-3, 0.0, 1e-3)),
)
true = replace(believed, effects=(*believed.effects, *concealed))

OUT.mkdir(parents=True, exist_ok=True)
believed.save(OUT / "believed.yaml")
true.save(OUT / "true.yaml")
limo(f"plan --robot iiwa14 --scaffolds 4 --seed 5 --out {OUT}/motion.traj.parquet")
limo(
    f"run --backend mujoco --trajectory {OUT}/motion.traj.parquet --sim {OUT}/true.yaml "
    f"--record {OUT}/run.parquet"
)
limo(f"diagnose {OUT}/run.parquet --sim {OUT}/believed.yaml --out {OUT}/diagnosis")

verdict = json.loads((OUT / "diagnosis" / "verdict.json").read_text())
print("concealed:", ", ".join(effect.name for effect in concealed))
print("found:", ", ".join(item["effect"] for item in verdict["findings"]) or "nothing")
print(f"verdict: {verdict['verdict']}; open {OUT}/diagnosis/report.html")
