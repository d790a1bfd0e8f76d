"""Data for Table I from the simulated arm: excitation, LIMOPA motion and validation."""

from __future__ import annotations

import json
import shutil
from dataclasses import dataclass, replace
from importlib.metadata import version
from typing import TYPE_CHECKING, Final

import numpy as np

from estimators.reproduction.data import DESCRIPTION, RECORDINGS, SCHEMA
from estimators.rigid_body.dynamics.conditioning import Conditioning
from limo_driver.model import RobotModel
from limo_driver.physics import (
    CoulombFriction,
    JointElasticity,
    PreslidingHysteresis,
    Sensors,
    Simulation,
    StribeckFriction,
    ViscousFriction,
)
from limo_driver.robot.playback import Playback
from limo_driver.robot.registry import open_for
from limopa import PlanRequest, plan
from limopa.excitation.search import ExcitationRequest, excite
from limopa.planner import REACHING

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from limo_driver.physics import Effect
    from limo_driver.trajectory import Trajectory

ROBOT: Final = "iiwa14"
MADE_BY: Final = "limo's MuJoCo simulation of joints with friction, hysteresis and elasticity"
_FRICTION: Final = (2.2, 2.4, 1.6, 1.7, 0.9, 0.45, 0.35)  # [N m], of each joint while it slides
_VISCOUS: Final = (4.0, 4.2, 2.4, 2.6, 1.1, 0.55, 0.4)  # [N m s/rad]
_ELASTIC: Final = (16e3, 16e3, 12e3, 12e3, 8e3, 6e3, 6e3)  # [N m/rad]
_NOISE: Final = (0.05, 0.05, 0.04, 0.04, 0.03, 0.02, 0.02)  # [N m], of the torque sensors
_PRESLIDING: Final = 0.7  # of the friction builds up after a reversal, the rest is Coulomb's
_STRIBECK: Final = 0.15  # of the friction, added at creep
_WIDTHS: Final = np.deg2rad([0.1, 0.3, 0.75, 1.5])  # rotation after which each element slips
_SHARES: Final = np.array([0.34, 0.3, 0.21, 0.15])  # of the presliding friction
_RECORDED: Final = 4  # control cycles of 1 ms for each row of a recording


@dataclass(frozen=True)
class Size:
    """Amount of motion that is simulated."""

    scaffolds: int  # of the LIMOPA motion; 150 last about an hour
    excitation: ExcitationRequest
    validation: ExcitationRequest
    slower: tuple[float, ...]  # how often the validation is played, and how much slower each time


FULL: Final = Size(150, ExcitationRequest(), ExcitationRequest(duration=30.0), (1.0, 2.0, 4.0))
_DRAWN = ExcitationRequest(duration=20.0, starts=2, iterations=0)
QUICK: Final = Size(12, _DRAWN, _DRAWN, (1.0, 2.0))


def simulated_arm() -> Simulation:
    """Return an iiwa 14 whose joints remember where they last reversed.

    Friction is of the size seen on such arms; the maker publishes none.
    """
    effects: list[Effect] = []
    for joint, friction in enumerate(_FRICTION, start=1):
        sliding = (1.0 - _PRESLIDING) * friction
        stiffness = _SHARES * _PRESLIDING * friction / _WIDTHS
        effects += [
            CoulombFriction(joint=joint, tau_c=sliding),
            ViscousFriction(joint=joint, f_v=_VISCOUS[joint - 1]),
            StribeckFriction(joint=joint, tau_s=_STRIBECK * friction, v_s=0.03, delta=2.0),
            PreslidingHysteresis(joint=joint, stiffness=tuple(stiffness), width=tuple(_WIDTHS)),
            JointElasticity(joint=joint, stiffness=_ELASTIC[joint - 1]),
        ]
    sensors = Sensors(torque_noise=_NOISE, encoder_resolution=(1e-5,))
    return Simulation(ROBOT, tuple(effects), sensors=sensors)


def make(folder: Path, size: Size, tell: Callable[[str, float], None]) -> bool:
    """Make a data folder, whole or not at all.

    Args:
        folder: To be made.
        size: How much motion.
        tell: Called with what is being done and how much of it is.

    Returns:
        Whether it was made; an interrupt while the arm moves ends it before.
    """
    partial = folder.with_name(f"{folder.name}.partial")
    shutil.rmtree(partial, ignore_errors=True)
    partial.mkdir(parents=True)
    arm, model = simulated_arm(), RobotModel.load(ROBOT)
    conditioning = Conditioning(model)

    def excitation(request: ExcitationRequest, seed: int) -> Trajectory:
        return excite(
            model,
            conditioning,
            request,
            seed,
            lambda done, most, _: tell("searching excitation", done / most),
        ).trajectory

    limo = plan(
        model,
        PlanRequest(scaffolds=size.scaffolds),
        1,
        lambda done, wanted: tell("planning LIMOPA motion", done / wanted),
    ).trajectory
    motions = (
        excitation(size.excitation, 1),
        limo,
        repeated(excitation(size.validation, 2), size.slower),
    )
    for seed, (name, motion) in enumerate(zip(RECORDINGS, motions, strict=True)):
        with open_for("mujoco", motion, simulation=arm, robot=None, seed=seed) as robot:
            playback = Playback(
                motion, partial / name, _RECORDED, provenance={"limo": version("limo")}
            )
            summary = playback.run(
                robot, lambda done, all_, name=name: tell(f"recording {name}", done / all_)
            )
        if summary.interrupted:
            return False
    described = {
        "schema": SCHEMA,
        "robot": ROBOT,
        "made_by": MADE_BY,
        "scaffold_starts": scaffold_starts(limo),
    }
    (partial / DESCRIPTION).write_text(json.dumps(described, indent=1) + "\n")
    partial.replace(folder)
    return True


def scaffold_starts(limo: Trajectory) -> list[float]:
    """Return when the motion towards each scaffold starts [s]; it begins at the first of them."""
    reaches = [float(limo.time[s.start]) for s in limo.segments if s.kind == REACHING]
    return [float(limo.time[0]), *reaches]


def repeated(motion: Trajectory, slower: tuple[float, ...]) -> Trajectory:
    """Play a motion that returns to where it starts, at rest, again and again, ever slower.

    Args:
        motion: Starts and ends in one pose, at rest.
        slower: Factor of time of each repetition.
    """
    parts: list[tuple[np.ndarray, ...]] = []
    start = 0.0
    for factor in slower:
        rows = slice(1 if parts else 0, None)  # the pose between two repetitions counts once
        time = start + factor * (motion.time - motion.time[0])
        parts.append(
            (
                time[rows],
                motion.position[rows],
                motion.velocity[rows] / factor,
                motion.acceleration[rows] / factor**2,
            )
        )
        start = float(time[-1])
    time, position, velocity, acceleration = (
        np.concatenate(values) for values in zip(*parts, strict=True)
    )
    return replace(
        motion,
        time=time,
        position=position,
        velocity=velocity,
        acceleration=acceleration,
        segments=(),
    )
