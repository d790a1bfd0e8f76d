"""An arm of hobby servos that tells no torque: what is in its gripper is weighed by its sag.

    python examples/weigh_by_servos.py

`limo` plans the commands, `play_servos.py` plays them on MuJoCo's arm, which holds 0.12 kg that the
model does not know. With an arm of yours, only the middle differs. Takes a minute.
"""

from pathlib import Path

import numpy as np
from play_servos import SimulatedArm, play, save

import limo_driver as limo

OUT = Path("out/weigh_by_servos")
SERVO = 'kp="17.8" kv="0.6" forcerange="-3.35 3.35"'
JOINT = (
    'axis="0 1 0" damping="0.1" frictionloss="0.05" armature="0.028" '
    'solreffriction="0.004 1" solimpfriction="0.99 0.9999 0.001 0.5 2"'  # holds, and does not creep
)
ARM = f"""<mujoco model="hobby arm"><compiler angle="radian"/><option timestep="0.001"/>
 <worldbody><body name="upper_arm" pos="0 0 .15">
  <joint name="shoulder_lift" range="-1.6 1.6" {JOINT}/>
  <geom type="capsule" fromto=".02 0 0 .1 0 0" size=".015" mass=".15"/>
  <body name="forearm" pos=".12 0 0">
   <joint name="elbow_flex" range="-1.6 1.6" {JOINT}/>
   <geom type="capsule" fromto=".03 0 0 .1 0 0" size=".015" mass=".12"/>
   <body name="gripper" pos=".13 0 0">
    <joint name="wrist_flex" range="-1.6 1.6" {JOINT}/>
    <geom type="capsule" fromto=".03 0 0 .07 0 0" size=".015" mass=".1"/>
   </body></body></body></worldbody>
 <actuator><position joint="shoulder_lift" {SERVO}/><position joint="elbow_flex" {SERVO}/>
  <position joint="wrist_flex" {SERVO}/></actuator></mujoco>"""
LOAD = '<body pos=".08 0 0"><geom size=".015" mass=".12" contype="0" conaffinity="0"/></body>'


def main() -> None:
    """Plan, play and diagnose."""
    OUT.mkdir(parents=True, exist_ok=True)
    model, real = OUT / "arm.xml", OUT / "real.xml"
    model.write_text(ARM)
    real.write_text(ARM.replace("</body></body></body>", f"{LOAD}</body></body></body>"))
    limo.excite_servos(model, limo.ServoRequest(), seed=1).save(OUT / "moves.csv")
    arm = SimulatedArm(str(real))
    commands = np.loadtxt(OUT / "moves.csv", delimiter=",", skiprows=1)
    save(play(commands, arm.send, arm.read, arm.now, arm.sleep), str(OUT / "run.csv"))
    run = limo.read(OUT / "run.csv", model)
    found = limo.diagnose(limo.Simulation.load(model), run)
    print(found)
    found.save(OUT / "diagnosis")
    print(f"open {OUT}/diagnosis/report.html")


if __name__ == "__main__":
    main()
