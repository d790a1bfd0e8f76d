"""limo and mujoco.sysid on the same real logs, with the same parameters: whose torques are nearer?

    python benchmarks/estimators/sysid.py [ur10e] [lwr4] [panda] [--rows 1500] [--iterations 15]

Both fit ten numbers of inertia for each link, and damping, dry friction and armature of each joint,
to one recording. The table has the RMS error of the torque below 10 Hz on motion that neither has
seen: of the description alone, of limo (`limo.identify`), of limo's result exported to MJCF and
read by MuJoCo alone, and of mujoco.sysid (`pip install "mujoco[sysid]"`), which starts at the
description and fits MuJoCo's inverse dynamics by its own least squares. sysid gets as many rows as
its finite differences bear; limo takes all of them. Times are processor times of this process.
"""

# MuJoCo and its sysid ship no stubs.
# pyright: reportUnknownParameterType=false, reportAttributeAccessIssue=false
from __future__ import annotations

import argparse
import os
import sys
import time
from functools import partial
from io import StringIO
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any, NamedTuple

import mujoco
import numpy as np

import limo_driver as limo

if TYPE_CHECKING:
    from collections.abc import Sequence

    from limo_driver.physics import Simulation
    from limo_driver.recordings.recording import Recording
    from limo_driver.types import FloatArray, Motion

DATA = Path(os.environ.get("LIMO_DATA", Path(__file__).parents[3] / "shared" / "data"))
BANDWIDTH = 10.0  # [Hz]
EPS = 1e-5  # of finite differences; sysid's own compile to the same model
STARTS = {"damping": 0.3, "frictionloss": 0.3, "armature": 0.03}  # [N m s/rad], [N m], [kg m²]
MOST = 100.0  # of each of them: no bound


class Case(NamedTuple):
    """A robot, a recording to fit and one to judge by."""

    robot: str
    fitted: str
    unseen: str
    cut: float = 0.0  # of one recording, the part that is fitted; the rest judges


CASES = {
    "ur10e": Case("ur10e/ur10e.urdf", "ur10e/unloaded_14harm", "ur10e/unloaded_15harm"),
    "lwr4": Case(
        "kuka_lwr4/kuka_lwr4.urdf", "kuka_lwr4/measurements_1", "kuka_lwr4/measurements_3"
    ),
    "panda": Case("panda.urdf", "panda/exciting_trajectory", "panda/exciting_trajectory", 0.6),
}


def main() -> int:
    """Print a table for each robot."""
    options = argparse.ArgumentParser(description=__doc__)
    options.add_argument("cases", nargs="*", default=[*CASES], help=", ".join(CASES))
    options.add_argument("--rows", type=int, default=1000, help="that sysid fits")
    options.add_argument("--iterations", type=int, default=30, help="of sysid, at most")
    asked = options.parse_args()
    for name in asked.cases:
        compare(name, CASES[name], asked.rows, asked.iterations)
    return 0


def compare(name: str, case: Case, rows: int, iterations: int) -> None:
    """Fit both and print their errors."""
    robot = robot_of(case.robot)
    fitted = limo.Recording.load(DATA / f"{case.fitted}.parquet")
    unseen = limo.Recording.load(DATA / f"{case.unseen}.parquet")
    if case.cut:
        at = int(case.cut * len(fitted))
        fitted, unseen = fitted[:at], fitted[at:]
    motion, scored = unseen.sharp_motion(BANDWIDTH), unseen.scored(BANDWIDTH)
    measured = unseen.filtered_torque(BANDWIDTH)

    def told(what: str, torque: FloatArray, seconds: float) -> None:
        error = (unseen.filtered(torque, BANDWIDTH) - measured)[scored]
        by_joint = "  ".join(f"{x:6.3f}" for x in np.sqrt(np.mean(error**2, axis=0)))
        total = float(np.sqrt(np.mean(error**2)))
        print(f"{what:34} {by_joint}   {total:6.3f}   {seconds:6.1f}", flush=True)

    joints = "  ".join(f"{f'j{j + 1}':>6}" for j in range(unseen.n))
    size = float(np.sqrt(np.mean(measured[scored] ** 2)))
    print(f"\n{name}: fitted to {fitted.duration:.0f} s", end=", ")
    print(f"judged by {unseen.duration:.0f} s of other motion; its torque is {size:.2f} N m RMS")
    print(f"{'held-out torque error [N m RMS]':34} {joints}   {'all':>6}   {'time [s]':>6}")
    nominal = limo.Simulation(robot)
    told("description alone", nominal.predict(motion), 0.0)
    begun = time.process_time()
    found = limo.identify(robot, [fitted], limo.JointTerms(armature=True)).simulation
    spent = time.process_time() - begun
    told("limo.identify", found.predict(motion), spent)
    with TemporaryDirectory() as place:
        own = limo.export(nominal, "mjcf", Path(place) / "own").file
        better = limo.export(found, "mjcf", Path(place) / "found").file
        told("the same, exported, in MuJoCo", inverse(hard(better).compile(), motion), spent)
        begun = time.process_time()
        model = SysidFit(own, nominal, fitted, rows).fitted(iterations)
        told("mujoco.sysid", inverse(model, motion), time.process_time() - begun)


def robot_of(stated: str) -> str:
    """Return the description: beside the recordings, or that of example-robot-data."""
    if (path := DATA / stated).is_file():
        return str(path)
    from importlib.metadata import files

    path = next(x for x in files("example-robot-data") or () if x.name == stated)
    return str(path.locate())


def hard(file: Path) -> Any:  # noqa: ANN401
    """Return an MJCF with dry friction that is there within a milliradian a second."""
    spec = mujoco.MjSpec.from_file(str(file))
    spec.option.timestep = 1e-4
    spec.option.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONTACT
    for joint in spec.joints:
        joint.limited = mujoco.mjtLimited.mjLIMITED_FALSE
        joint.solref_friction = [5e-4, 1.0]
        joint.solimp_friction = [0.99, 0.99, 1e-3, 0.5, 2.0]
    return spec


def inverse(model: Any, motion: Motion) -> FloatArray:  # noqa: ANN401
    """Return the torques that MuJoCo says a motion needs, (T, n) [N m]."""
    data, torque = mujoco.MjData(model), np.empty_like(motion.position)
    pairs = zip(motion.position, motion.velocity, motion.acceleration, strict=True)
    for k, (data.qpos[:], data.qvel[:], data.qacc[:]) in enumerate(pairs):
        mujoco.mj_inverse(model, data)
        torque[k] = data.qfrc_inverse
    return torque


class SysidFit:
    """A MuJoCo model of an arm, its parameters, and the rows to fit them to."""

    def __init__(self, file: Path, nominal: Simulation, fitted: Recording, rows: int) -> None:
        try:
            from mujoco import sysid as tool

            tool.optimize  # noqa: B018  # absent without what the extra brings
        except (ImportError, AttributeError):
            sys.exit('mujoco.sysid is missing, expected: pip install "mujoco[sysid]"')
        self._tool, self._spec = tool, hard(file)
        usable = np.flatnonzero(fitted.scored(BANDWIDTH))
        kept = usable[:: max(1, len(usable) // rows)]
        self._motion = fitted.sharp_motion(BANDWIDTH)[kept]
        torque = fitted.filtered_torque(BANDWIDTH)[kept]
        error = torque - nominal.predict(self._motion)
        self._weight = 1.0 / np.sqrt(np.mean(error**2, axis=0))  # (n,) joints count alike
        self._times = np.arange(len(kept), dtype=float)
        for joint in self._spec.joints:
            self._spec.add_actuator(
                name=joint.name, target=joint.name, trntype=mujoco.mjtTrn.mjTRN_JOINT
            )
            self._spec.add_sensor(
                name=f"{joint.name}_torque", type=mujoco.mjtSensor.mjSENS_JOINTACTFRC,
                objtype=mujoco.mjtObj.mjOBJ_JOINT, objname=joint.name,
            )  # fmt: skip
        model = self._spec.compile()
        self._sequence = tool.ModelSequences(
            "arm", self._spec, "recording",
            tool.create_initial_state(model, model.qpos0, np.zeros(model.nv), np.zeros(0)),
            tool.TimeSeries(self._times, torque),
            tool.TimeSeries.from_names(self._times, torque, model),
        )  # fmt: skip

    def fitted(self, iterations: int) -> Any:  # noqa: ANN401
        """Return the model that fits best."""
        residual = self._tool.build_residual_fn(
            models_sequences=[self._sequence], custom_rollout=self._rollout,
            modify_residual=self._weigh, resample_true=False, n_threads=1,
        )  # fmt: skip
        best, _ = self._tool.optimize(
            self._parameters(), residual, verbose=False, max_iters=iterations, eps=EPS,
            output=StringIO(),
        )  # fmt: skip
        return self._tool.apply_param_modifiers(best, self._spec)

    def _parameters(self) -> Any:  # noqa: ANN401
        model, initial = self._spec.compile(), self._tool.ParameterDict()
        for joint in range(model.njnt):
            body = model.body(int(model.jnt_bodyid[joint])).name
            kind = self._tool.InertiaType.Pseudo
            own = self._tool.body_inertia_param(self._spec, model, body, kind)
            own.modifier = partial(_write_inertia, body)
            initial.add(own)
        for joint in self._spec.joints:
            for name, start in STARTS.items():
                write = partial(_write, joint.name, name)
                parameter = self._tool.Parameter
                initial.add(parameter(f"{joint.name}_{name}", start, 0.0, MOST, modifier=write))
        initial.move_off_bounds()
        return initial

    def _rollout(self, *, models: Sequence[Any], **_: object) -> list[Any]:
        series, found = self._tool.TimeSeries, list[Any]()
        state = series(
            self._times,
            np.column_stack([self._times, self._motion.position, self._motion.velocity]),
        )
        for model in models:
            torque = inverse(model, self._motion)
            named = series.from_names(self._times, torque, model)
            told = series(self._times, torque)
            found.append(self._tool.SystemTrajectory(model, told, named, np.zeros(0), state))
        return found

    def _weigh(
        self,
        _p: object,
        said: Any,  # noqa: ANN401
        measured: Any,  # noqa: ANN401
        *_: object,
        **__: object,
    ) -> tuple[Any, ...]:
        return (said.data - measured.data) * self._weight, said, measured


def _write_inertia(body: str, spec: Any, parameter: Any) -> None:  # noqa: ANN401
    from mujoco.sysid import apply_body_inertia

    apply_body_inertia(spec, body, parameter)
    spec.body(body).iquat = [1.0, 0.0, 0.0, 0.0]  # 4.0 leaves NaN beside the full inertia


def _write(joint: str, name: str, spec: Any, parameter: Any) -> None:  # noqa: ANN401
    own = spec.joint(joint)
    if name == "damping":  # a polynomial in the speed
        own.damping[0] = parameter.value[0]
    else:
        setattr(own, name, parameter.value[0])


if __name__ == "__main__":
    sys.exit(main())
