"""Concealed cases of an SO-101 in MuJoCo behind servos, with a load on one body of its gripper.

Rigid bodies, friction and armature are MuJoCo's; the servos are written here and share no code with
limo. What is hidden: a body at the gripper or at its moving jaw, a gain, a delay, or two of them.
"""

from pathlib import Path
from xml.etree import ElementTree as ET

import mujoco
import numpy as np
from servo_cases import Case, Hidden, _servos, _stated
from servo_plant import Played

N = 6
SECONDS = 20.0  # of each recording
PERIOD = 0.5e-3  # [s] of a step
LOOK = 2  # steps between two looks of a servo
TOLERANCE = 0.1
BODIES = {"gripper": (5,), "moving_jaw_so101_v1": ()}  # and how a finding says where: at the flange
GRIPPED = {"gripper": (-0.008, 0.0, -0.07), "moving_jaw_so101_v1": (0.0, -0.06, 0.02)}  # [m]
CENTRE = np.array([0.0, 0.1, 0.2, 0.2, 0.0, 0.6])  # [rad]
REACH = np.array([0.8, 0.9, 0.9, 0.9, 1.0, 0.5])  # [rad] to either side
HIDDEN = (
    ("load:gripper",), ("load:moving_jaw_so101_v1",), ("gain",), ("delay",),
    ("load:gripper", "gain"), ("load:moving_jaw_so101_v1", "gain"), ("load:gripper", "delay"),
    ("load:moving_jaw_so101_v1", "delay"), ("gain", "delay"),
)  # fmt: skip


def description(mjcf: Path) -> str:
    """Return the arm of a file without its shapes and motors: masses are stated."""
    root = ET.parse(mjcf).getroot()  # noqa: S314  # from the vendor
    for tag in ("asset", "actuator", "contact", "sensor", "keyframe", "equality"):
        for element in root.findall(tag):
            root.remove(element)
    for body in root.iter("body"):
        for geom in body.findall("geom"):
            body.remove(geom)
    for joint in root.iter("joint"):
        if "name" in joint.attrib:
            joint.attrib.pop("class", None)
            joint.attrib |= {"damping": "0", "frictionloss": "0", "armature": "0"}
    return ET.tostring(root, encoding="unicode")


def make(
    seed: int, effects: tuple[str, ...], mjcf: Path, rate: float = 50.0, bits: int = 12
) -> Case:
    """Draw a case.

    Args:
        seed: Of all that is drawn.
        effects: What is hidden: `load:BODY`, `gain` and `delay`.
        mjcf: Of the arm.
        rate: Of the recordings, and of the commands [Hz].
        bits: Of the encoders.
    """
    random = np.random.default_rng([seed, 23])
    text = description(mjcf)
    believed = _servos(random, bits, N)
    servos = believed.copy()
    for name in ("gain", "brake", "rotor", "dry", "wet", "late"):
        servos[name] *= np.exp(TOLERANCE * np.clip(random.normal(size=N), -2, 2))
    spec, hidden = mujoco.MjSpec.from_string(text), list[Hidden]()
    free = [2, 3, 4]  # joints that gravity loads, 1-based
    for effect in effects:
        kind, _, body = effect.partition(":")
        if kind == "load":
            size, joints = float(random.uniform(0.05, 0.25)), BODIES[body]
            at = np.array(GRIPPED[body]) + random.uniform(-0.01, 0.01, 3)
            load = spec.body(body).add_body(name="load", pos=at)
            load.mass, load.inertia, load.explicitinertial = size, [2e-5 * size / 0.1] * 3, True
            hidden.append(Hidden("payload", joints, size))
            continue
        joint = int(random.choice(free))
        free.remove(joint)
        if kind == "gain":
            servos["gain"][joint - 1] = believed["gain"][joint - 1] * random.uniform(0.5, 0.8)
            hidden.append(Hidden("position_servo", (joint,), float(servos["gain"][joint - 1])))
        else:
            servos["late"][joint - 1] = believed["late"][joint - 1] + random.uniform(0.01, 0.06)
            hidden.append(Hidden("drive_delay", (joint,), float(servos["late"][joint - 1])))
    model = spec.compile()
    every = 1.0 / rate
    recordings = tuple(
        play(model, servos, _command(kind, every, random), every)
        for kind in ("waves", "goals", "waves")
    )
    return Case(seed, tuple(hidden), recordings, _stated(believed), text, servos)


def play(model: mujoco.MjModel, servos: np.ndarray, command: np.ndarray, every: float) -> Played:
    """Let the arm follow commands (K, n) [rad] from rest, each in force until the next [s]."""
    model.opt.timestep, model.opt.integrator = PERIOD, mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    model.dof_frictionloss[:N], model.dof_armature[:N] = servos["dry"], servos["rotor"]
    # friction that holds: MuJoCo's own creeps under a load that is below it
    model.dof_solref[:N], model.dof_solimp[:N, :2] = (4 * PERIOD, 1.0), (0.99, 0.9999)
    model.dof_damping[:N] = servos["wet"] + servos["brake"]
    data = mujoco.MjData(model)
    data.qpos[:N] = command[0]
    steps = round(every / PERIOD)
    tick, torque, late = servos["tick"], np.zeros(N), servos["late"]
    told = np.empty_like(command)
    for t in range(len(command) * steps):
        read = tick * np.round(data.qpos[:N] / tick)
        if t % LOOK == 0:
            row = np.maximum(np.floor((t * PERIOD - late) / every + 1e-9), 0).astype(int)
            asked = command[row, np.arange(N)]
            torque = np.clip(servos["gain"] * (asked - read), -servos["stall"], servos["stall"])
        if t % steps == 0:
            told[t // steps] = read
        data.qfrc_applied[:N] = torque
        mujoco.mj_step(model, data)
    return Played(np.arange(len(command)) * every, command, told)


def _command(kind: str, every: float, random: np.random.Generator) -> np.ndarray:
    """Return commands as somebody leads an arm to tasks, (K, n) [rad]."""
    time = np.arange(0.0, SECONDS, every)
    command = np.zeros((time.size, N))
    for j in range(N):
        if kind == "waves":
            for _ in range(3):
                pace = np.exp(random.uniform(np.log(0.4), np.log(4.0)))
                height = min(1.0, 1.5 / pace) * random.uniform(0.4, 0.8)
                command[:, j] += 0.5 * height * np.sin(pace * time + random.uniform(0, 2 * np.pi))
        else:
            at = np.cumsum(random.uniform(0.6, 2.0, 60))
            goals = random.uniform(-1.0, 1.0, 60)
            goals[2::3] = goals[1::3]  # holds
            command[:, j] = np.interp(time, at, goals)
    begins = np.clip(time / 1.0, 0.0, 1.0)[:, None]
    return CENTRE + REACH * np.clip(command * begins, -1.0, 1.0)
