"""Conceal hysteresis and a payload in a simulated arm, record it, and find out what was left out.

`believed` is what one thinks the arm is, `true` is what it is. Only the second drives the robot;
only the first and the recording reach the diagnosis. Takes about a minute.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import limo_driver as limo
from limo_driver.physics import (
    CoulombFriction,
    Payload,
    PreslidingHysteresis,
    Sensors,
    ViscousFriction,
)

OUT = Path("out/diagnose_simulated")
COULOMB = (2.2, 2.4, 1.6, 1.7, 0.9, 0.45, 0.35)  # [N m]
VISCOUS = (4.0, 4.2, 2.4, 2.6, 1.2, 0.7, 0.6)  # [N m s/rad]
NOISE = (0.05, 0.05, 0.04, 0.04, 0.03, 0.02, 0.02)  # [N m]


believed = limo.Simulation(
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

motion = limo.plan("iiwa14", limo.PlanRequest(scaffolds=4), seed=5)
recording = limo.run("mujoco", motion, simulation=true)
found = limo.diagnose(believed, [recording])
found.save(OUT)

print("concealed:", ", ".join(effect.name for effect in concealed))
print(found)
print(f"open {OUT}/report.html")
