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


KV = (6.0, 3.0)
VELOCITY = ("command_velocity",) * 2  # channels of such an arm
TURNED = """<actuator>
    <velocity joint="shoulder" kv="{kv[0]}"/>
    <velocity joint="elbow" kv="{kv[1]}"/>
  </actuator>"""


def write_turned_arm(path, *, friction=0.0):
    """Write the arm behind servos of velocity as MJCF and return the path."""
    write_arm(path, friction=friction)
    before, _, rest = path.read_text().partition("<actuator>")
    path.write_text(before + TURNED.format(kv=KV) + rest.partition("</actuator>")[2])
    return path


def velocities(duration, rate, seed):
    """Return times (T,) [s] and velocities of both joints, (T, 2) [rad/s]."""
    random, time = np.random.default_rng(seed), np.arange(round(duration * rate)) / rate
    pace = np.exp(random.uniform(np.log(0.5), np.log(6.0), (4, 2)))
    phase = random.uniform(0.0, 2.0 * np.pi, (4, 2))
    return time, 0.5 * np.sin(pace * time[:, None, None] + phase).sum(axis=1)


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


def recorded(time, command, position, channels=()):
    """Return a recording without torque."""
    return Recording.from_arrays(time, position, command=command, channels=channels)


def simulated(path, time, command, start=None):
    """Return where MuJoCo moves the arm, (T, 2) [rad], each command in force until the next one."""
    model = mujoco.MjModel.from_xml_path(str(path))
    data = mujoco.MjData(model)
    data.qpos[:] = command[0] if start is None else start
    position = np.empty_like(command)
    steps = round(float(time[1] - time[0]) / model.opt.timestep)
    for k, wanted in enumerate(command):
        position[k] = data.qpos
        data.ctrl[:] = wanted
        mujoco.mj_step(model, data, steps)
    return position


def turned(path, time, command, start, *, kv=KV, ki=(0.0, 0.0), late=0.0):
    """Return where servos of velocity move the arm as MuJoCo has its body, (T, 2) [rad]."""
    spec = mujoco.MjSpec.from_file(str(path))
    for actuator in spec.actuators:
        actuator.set_to_motor()
    model = spec.compile()
    data, asked = mujoco.MjData(model), np.zeros(2)
    data.qpos[:] = start
    position, h = np.empty_like(command), model.opt.timestep
    for k, now in enumerate(time):
        position[k] = data.qpos
        for step in range(round((time[1] - time[0]) / h)):
            row = np.searchsorted(time, now + h * step - late + 1e-9, side="right") - 1
            error = command[max(row, 0)] - data.qvel
            asked += np.array(ki) * error * h
            data.ctrl[:] = np.array(kv) * error + asked
            mujoco.mj_step(model, data)
    return position


TORQUE = ("command_torque",) * 2  # channels of an arm whose drives are told torques
PUSHED = """<actuator>
    <motor joint="shoulder" gear="{gear[0]}"/>
    <motor joint="elbow" gear="{gear[1]}"/>
  </actuator>"""


def write_pushed_arm(path, *, friction=0.0, gear=(1.0, 1.0)):
    """Write the arm behind motors as MJCF and return the path."""
    write_arm(path, friction=friction)
    before, _, rest = path.read_text().partition("<actuator>")
    path.write_text(before + PUSHED.format(gear=gear) + rest.partition("</actuator>")[2])
    return path


def pushed(path, time, wanted, start, *, gain=(1.0, 1.0), late=0.0, limit=np.inf):
    """Return torques (T, 2) [N m] by which a program led the arm, and where it was, (T, 2) [rad].

    At each row the program pulls the arm to where it is wanted (T, 2) [rad]. Its drives make `gain`
    of what it commands, up to a limit [N m].
    """
    spec = mujoco.MjSpec.from_file(str(path))
    for actuator in spec.actuators:
        actuator.set_to_motor()
        actuator.gear[0] = 1.0
    model = spec.compile()
    data = mujoco.MjData(model)
    data.qpos[:] = start
    position, command, h = np.empty_like(wanted), np.zeros_like(wanted), model.opt.timestep
    for k, now in enumerate(time):
        position[k] = data.qpos
        error = wanted[k] - data.qpos
        command[k] = (np.array([15.0, 6.0]) * error - np.array([1.0, 0.4]) * data.qvel) / gain
        for step in range(round((time[1] - time[0]) / h)):
            row = np.searchsorted(time, now + h * step - late + 1e-9, side="right") - 1
            data.ctrl[:] = np.clip(gain * command[max(row, 0)], -limit, limit)
            mujoco.mj_step(model, data)
    return command, position
