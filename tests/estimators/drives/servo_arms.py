"""A small arm behind servos, which MuJoCo simulates as well."""

from __future__ import annotations

import mujoco
import numpy as np

from limo_driver.recordings.recording import Recording

KP, KD, DAMPING, ARMATURE = (40.0, 25.0), (1.5, 0.8), 0.2, 0.02
ARM = """<mujoco>
  <option timestep="0.001" integrator="implicitfast"/>
  <default><joint damping="{damping}" armature="{armature}" frictionloss="{friction}"/></default>
  <worldbody>
    <body><joint name="shoulder" axis="0 1 0"/>
      <geom type="capsule" size=".02" fromto="0 0 0 .3 0 0" mass=".4" contype="0" conaffinity="0"/>
      <body pos=".3 0 0"><joint name="elbow" axis="0 1 0"/>
        <geom type="capsule" size=".02" fromto="0 0 0 .25 0 0" mass=".3" contype="0"
          conaffinity="0"/>
      </body>
    </body>
  </worldbody>
  <actuator>
    <position joint="shoulder" kp="{kp[0]}" kv="{kd[0]}" forcerange="-{limit} {limit}"/>
    <position joint="elbow" kp="{kp[1]}" kv="{kd[1]}" forcerange="-{limit} {limit}"/>
  </actuator>
</mujoco>"""


def write_arm(path, *, friction=0.0, limit=50.0, kd=KD, damping=DAMPING):
    """Write the arm as MJCF and return the path."""
    values = {"kp": KP, "kd": kd, "damping": damping, "armature": ARMATURE}
    path.write_text(ARM.format(friction=friction, limit=limit, **values))
    return path


def commands(duration, rate, pace=1.0):
    """Return times (T,) [s] and a wide motion of both joints, (T, 2) [rad]."""
    time = np.arange(round(duration * rate)) / rate
    t = pace * time
    shoulder = -0.6 + 0.5 * np.sin(2.1 * t) + 0.2 * np.sin(5.3 * t)
    elbow = 0.8 * np.sin(1.3 * t + 0.4)
    return time, np.stack([shoulder, elbow], axis=1)


def recorded(time, command, position):
    """Return a recording without torque."""
    return Recording.from_arrays(time, position, command=command)


def simulated(path, time, command):
    """Return where MuJoCo moves the arm, (T, 2) [rad], each command in force until the next one."""
    model = mujoco.MjModel.from_xml_path(str(path))
    data = mujoco.MjData(model)
    data.qpos[:] = command[0]
    position = np.empty_like(command)
    steps = round(float(time[1] - time[0]) / model.opt.timestep)
    for k, wanted in enumerate(command):
        position[k] = data.qpos
        data.ctrl[:] = wanted
        mujoco.mj_step(model, data, steps)
    return position
