"""How often an estimate is within what it says of itself, in the seconds after a restart.

    python benchmarks/service/restarts.py [--restarts 400]

A service that begins anew, or has lost its states for a while, does not know how the friction of a
joint stood. `joint-physics` learns an arm of two joints with presliding hysteresis, and is begun
anew at random instants of motion that it has not seen. Beside it stands the same without the part
that is unknown for want of memory, which is what the deviation was before.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Annotated

import numpy as np
import typer

from estimators.joint_physics import JointPhysics
from estimators.stream import Stream
from limo_driver.physics import CoulombFriction, PreslidingHysteresis, Simulation
from limo_driver.recordings.recording import Recording

if TYPE_CHECKING:
    from limo_driver.types import FloatArray

RATE, SECONDS = 100.0, 60.0
NOISE = 0.02  # [N m]
AFTER = ((0.0, 0.2), (0.2, 1.0), (0.0, 1.0), (1.0, 2.0), (2.0, 4.0))  # [s] since the restart
BAR = 0.93  # of the errors in any of these, within two deviations; normal ones would be 0.954
ARM = """<?xml version="1.0"?><robot name="two_joints"><link name="base"/>
<link name="upper"><inertial><mass value="2"/><origin xyz="0.1 0 0"/>
<inertia ixx="0.01" iyy="0.02" izz="0.02" ixy="0" ixz="0" iyz="0"/></inertial></link>
<link name="lower"><inertial><mass value="1"/><origin xyz="0.1 0 0"/>
<inertia ixx="0.005" iyy="0.01" izz="0.01" ixy="0" ixz="0" iyz="0"/></inertial></link>
<joint name="shoulder" type="revolute"><parent link="base"/><child link="upper"/>
<axis xyz="0 1 0"/><limit lower="-3" upper="3" velocity="2" effort="100"/></joint>
<joint name="elbow" type="revolute"><parent link="upper"/><child link="lower"/>
<origin xyz="0.3 0 0"/><axis xyz="0 1 0"/>
<limit lower="-3" upper="3" velocity="2" effort="100"/></joint></robot>"""


def recorded(arm: Simulation, seed: int, seconds: float) -> Recording:
    """Move both joints by random sinusoids of 0.1 to 0.6 Hz, and measure with noise."""
    random, t = np.random.default_rng(seed), np.arange(int(seconds * RATE)) / RATE
    position = np.array([0.4, -0.8]) + np.zeros((t.size, 2))
    for _ in range(3):
        w, phase = 2 * np.pi * random.uniform(0.1, 0.6, 2), random.uniform(0, 2 * np.pi, 2)
        position += random.uniform(0.01, 0.05, 2) * np.sin(t[:, None] * w + phase)
    still = Recording.from_arrays(t, position, np.zeros_like(position))
    torque = arm.predict(still.motion(35.0)) + NOISE * random.standard_normal(position.shape)
    return Recording.from_arrays(t, position, torque)


def restarts(
    model: JointPhysics, fresh: list[Recording], count: int
) -> tuple[FloatArray, FloatArray]:
    """Return errors and deviations of streams that begin anew, (count, T, n) each [N m]."""
    stream, random, found = Stream(model, RATE), np.random.default_rng(7), []
    length = round(AFTER[-1][1] * RATE)
    for k in range(count):
        recording = fresh[k % len(fresh)]
        first = int(random.integers(round(5 * RATE), len(recording) - length))
        part = recording[first : first + length]
        late, _ = stream.advance(stream.init(), part.time, part.position, part.torque)
        assert late.measured is not None
        found.append((late.measured - late.torque, late.std))
    errors, std = (np.array(values) for values in zip(*found, strict=True))
    return errors, std


def main(restarts_: Annotated[int, typer.Option("--restarts", help="In all.")] = 400) -> None:
    """Measure, and print beside the bar."""
    with TemporaryDirectory() as folder:
        urdf = Path(folder) / "two_joints.urdf"
        urdf.write_text(ARM)
        joints, slip = (1, 2), ((120.0, 60.0, 20.0), (0.002, 0.006, 0.02))
        true = Simulation(
            str(urdf),
            tuple(PreslidingHysteresis(joint=j, stiffness=slip[0], width=slip[1]) for j in joints),
        )
        known = {
            "dry friction": tuple(CoulombFriction(joint=j, tau_c=1.0) for j in joints),
            "another hysteresis": tuple(
                PreslidingHysteresis(joint=j, stiffness=(150.0,), width=(0.006,)) for j in joints
            ),
        }
        fresh = [recorded(true, seed, SECONDS) for seed in range(100, 120)]
        print(f"{restarts_} restarts; within 2 deviations, bar {100 * BAR:g} %; rms / deviation")
        print("simulation           after [s]    now            without the unknown memory")
        for name, effects in known.items():
            model = JointPhysics(Simulation(str(urdf), effects)).fit([recorded(true, 1, 120.0)])
            now = restarts(model, fresh, restarts_)
            certain = replace(model.fitted.unknown, heights=0.0 * model.fitted.unknown.heights)
            model.fitted_ = replace(model.fitted, unknown=certain)
            before = restarts(model, fresh, restarts_)
            for first, last in AFTER:
                rows = slice(round(first * RATE), round(last * RATE))
                figures = [figure(errors[:, rows], std[:, rows]) for errors, std in (now, before)]
                print(f"{name:20s} {first:g} to {last:<6g}  {figures[0]}    {figures[1]}")


def figure(errors: FloatArray, std: FloatArray) -> str:
    """Return the share within two deviations, and how large errors are beside deviations."""
    within = 100 * (np.abs(errors) < 2 * std).mean()
    return f"{within:5.1f} % {np.sqrt(np.mean(errors**2) / np.mean(std**2)):5.2f}"


if __name__ == "__main__":
    typer.run(main)
