"""A MuJoCo model that knows nothing of friction and load: what a CSV of the arm adds to it."""

from pathlib import Path

import numpy as np

import limo_driver as limo
from limo_driver.physics import CoulombFriction, Payload, Simulation, ViscousFriction

OUT = Path("out/your_mjcf")
OUT.mkdir(parents=True, exist_ok=True)
MODEL, LOG = OUT / "model.xml", OUT / "log.csv"
MODEL.write_text("""<mujoco model="two links">
  <compiler angle="radian" autolimits="true"/>  <!-- ours -->
  <worldbody>
    <body name="upper">
      <joint name="shoulder" axis="0 1 0" range="-2.5 2.5" actuatorfrcrange="-90 90"/>
      <geom type="capsule" fromto="0 0 0 0 0 0.4" size="0.05" mass="4"/>
      <body name="lower" pos="0 0 0.4">
        <joint name="elbow" axis="0 1 0" range="-2.5 2.5" actuatorfrcrange="-40 40"/>
        <geom type="capsule" fromto="0 0 0 0 0 0.3" size="0.04" mass="2"/>
      </body>
    </body>
  </worldbody>
</mujoco>
""")


def write_log(path: Path) -> None:
    """Write what a test bench might leave, of an arm with friction and a load."""
    friction = [CoulombFriction(joint=j, tau_c=1.5, v_eps=0.005) for j in (1, 2)]
    friction += [ViscousFriction(joint=j, f_v=0.8) for j in (1, 2)]
    load = Payload(mass=0.6, com=(0, 0.02, 0.33), inertia=(0.002, 0, 0, 0.002, 0, 0.001))
    t = np.arange(0, 20, 0.01)
    rate = 2 * np.pi * np.array([0.13, 0.21])
    phase = np.outer(t, rate)
    q, v, a = 1.2 * np.sin(phase), 1.2 * rate * np.cos(phase), -1.2 * rate**2 * np.sin(phase)
    torque = Simulation(str(MODEL), (load, *friction)).predict(limo.Motion(t, q, v, a))
    noise = np.random.default_rng(0).normal(0, 0.03, q.shape)
    table = np.column_stack([1e3 * t, np.rad2deg(q), torque + noise])
    names = "t_ms,shoulder_deg,elbow_deg,shoulder_Nm,elbow_Nm"
    np.savetxt(path, table, delimiter=",", header=names, comments="")


write_log(LOG)
run = limo.read(LOG, MODEL)
diagnosis = limo.diagnose(limo.nominal(MODEL, run), run)  # friction is unknown to the file
print(diagnosis)
print(*diagnosis.verdict.identified, sep="\n")
print(limo.export(diagnosis.simulation, "mjcf", OUT / "better"))
