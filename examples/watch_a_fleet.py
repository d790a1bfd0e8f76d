"""Logs of three arms over six dates, one MuJoCo model for all: which arm changes, and what.

    python examples/watch_a_fleet.py

Logs are CSV as a lab's logger leaves them; MuJoCo makes the torques, friction is written here. The
friction of `unit_3` rises from 4 to 7.5 N m at the joint `stick`. Takes a minute.
"""

from datetime import date, timedelta
from pathlib import Path

import mujoco
import numpy as np

import limo_driver as limo

OUT = Path("out/watch_a_fleet")
MODEL = """<mujoco model="digger"><compiler angle="radian"/><worldbody><body name="base">
 <body name="boom" pos="0 0 .2">
  <joint name="lift" axis="0 1 0" range="-2 2" damping="3" frictionloss="6" armature=".4"/>
  <geom type="capsule" fromto="0 0 0 .5 0 0" size=".045" mass="5"/><body name="arm" pos=".5 0 0">
   <joint name="stick" axis="0 1 0" range="-2 2" damping="1.5" frictionloss="4" armature=".15"/>
   <geom type="capsule" fromto="0 0 0 .4 0 0" size=".04" mass="3"/>
</body></body></body></worldbody></mujoco>"""
FRICTION = np.array([6.0, 4.0])  # [N m]
DAMPING = np.array([3.0, 1.5])  # [N m s/rad]
UNITS, DATES = 3, 6


def write_log(path: Path, friction: list[float], random: np.random.Generator) -> None:
    """Write what a logger recorded of an arm with some Coulomb friction (2,) [N m]."""
    t = np.arange(0, 6, 0.01)
    q, v, a = np.zeros((3, t.size, 2))
    for w in 2 * np.pi * random.uniform(0.08, 0.6, (5, 2)):
        size, phase = random.uniform(0.1, 0.3, 2), np.outer(t, w) + random.uniform(0, 6.3, 2)
        q, v, a = (
            q + size * np.sin(phase),
            v + size * w * np.cos(phase),
            a - size * w**2 * np.sin(phase),
        )
    arm = mujoco.MjModel.from_xml_string(MODEL)
    arm.dof_damping[:] = arm.dof_frictionloss[:] = 0  # both are added below
    now, torque = mujoco.MjData(arm), np.empty_like(q)
    for k in range(t.size):
        now.qpos, now.qvel, now.qacc = q[k], v[k], a[k]
        mujoco.mj_inverse(arm, now)
        torque[k] = now.qfrc_inverse
    torque += np.array(friction) * np.tanh(100 * v) + DAMPING * v + random.normal(0, 0.1, q.shape)
    path.parent.mkdir(parents=True, exist_ok=True)
    np.savetxt(path, np.column_stack([1e3 * t, np.rad2deg(q), torque]), delimiter=",",
               header="t_ms,lift_deg,stick_deg,lift_Nm,stick_Nm", comments="")  # fmt: skip


def main() -> None:
    """Write the logs, say what their columns are, and compare the arms."""
    random = np.random.default_rng(1)
    model = OUT / "model.xml"
    for unit in range(1, UNITS + 1):
        own = FRICTION * random.normal(1, 0.03, 2)  # no two arms are alike
        for day in range(DATES):
            worn = 3.5 * day / (DATES - 1) if unit == UNITS else 0.0
            when = date(2026, 3, 1) + timedelta(weeks=day)
            write_log(OUT / f"logs/unit_{unit}/{when}.csv", [own[0], own[1] + worn], random)
    model.write_text(MODEL)
    first = next(iter(sorted(OUT.glob("logs/*/*.csv"))))
    found = limo.inspect(first, model)
    print(found)
    print("questions:", found.questions or "none")
    fleet = limo.diagnose_fleet(f"{OUT}/logs/*/*.csv", model, OUT / "fleet", mapping=found.mapping)
    print(fleet)
    print(f"open {OUT}/fleet/fleet.html")


if __name__ == "__main__":  # workers are processes that read this file, too
    main()
