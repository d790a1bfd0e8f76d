"""A data folder for Table I that is small enough to train on in a second."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING

import numpy as np
from wandering import wander

from limo_driver.model import RobotModel
from limo_driver.physics import CoulombFriction, PreslidingHysteresis, Simulation, ViscousFriction
from limo_driver.recordings.recording import Recording

if TYPE_CHECKING:
    from pathlib import Path

RATE = 100.0
NOISE = 0.02  # [N m]
STARTS = [0.0, 8.0, 16.0, 24.0, 32.0]  # [s], of the scaffolds
_POSE = np.array([0.1, 0.5, -0.2, -1.0, 0.3, 0.8, 0.0])
_JOINTS = range(1, 8)


def robot() -> Simulation:
    """What is known of the arm."""
    return Simulation("iiwa14", tuple(CoulombFriction(joint=j, tau_c=0.5) for j in _JOINTS))


def write_data(folder: Path, urdf: Path | None = None) -> Path:
    """Write excitation, LIMO and validation motion of an arm with hysteresis: an iiwa 14, if no
    URDF is given to lie beside them.
    """
    robot = "iiwa14" if urdf is None else "arm.urdf"
    joints = range(1, RobotModel.load(urdf or robot).n + 1)
    truth = [
        *(PreslidingHysteresis(joint=j, stiffness=(80.0,), width=(0.006,)) for j in joints),
        *(ViscousFriction(joint=j, f_v=0.5) for j in joints),
    ]
    arm = Simulation(str(urdf or robot), tuple(truth))
    folder.mkdir(parents=True)
    if urdf is not None:
        (folder / robot).write_bytes(urdf.read_bytes())
    sizes = {
        "excitation": (20.0, (0.1, 0.5), (0.1, 0.3)),
        "limo": (40.0, (0.1, 0.6), (0.01, 0.05)),
        "validation": (12.0, (0.05, 0.2), (0.1, 0.3)),
    }
    for seed, (name, (duration, frequency, amplitude)) in enumerate(sizes.items()):
        random = np.random.default_rng(seed)
        t = np.arange(int(duration * RATE)) / RATE
        motion = wander(t, _POSE[: len(joints)], random, frequency, amplitude)
        torque = arm.predict(motion) + NOISE * random.standard_normal(motion.position.shape)
        Recording.from_arrays(t, motion.position, torque).save(folder / f"{name}.parquet")
    described = {
        "schema": 1,
        "robot": robot,
        "made_by": "random sinusoids",
        "scaffold_starts": STARTS,
    }
    (folder / "data.json").write_text(json.dumps(described))
    return folder
