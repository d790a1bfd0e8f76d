"""`mujoco.sysid` on an arm behind position servos: what limo fits, by MuJoCo's own simulation.

Gain, damping, dry friction, armature, delay and an offset of torque of every joint, fitted to the
free-running positions of whole recordings by sysid's own least squares. The rollout is mujoco's,
with what sysid leaves to its user: commands delayed by a part of a step.
"""

from __future__ import annotations

import os
import sys
from dataclasses import dataclass, replace
from functools import partial
from io import StringIO
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from estimators.diagnosis.from_motion.simulation.constants import COULOMB, DAMPING, with_values
from estimators.diagnosis.from_motion.simulation.free_run import commands_of
from estimators.diagnosis.from_motion.simulation.plant import rows_of, with_rows

if TYPE_CHECKING:
    from collections.abc import Sequence

    from limo_driver.physics import Simulation
    from limo_driver.recordings.recording import Recording
    from limo_driver.types import FloatArray

STEP = 0.01  # [s], as limo's own fits
ITERATIONS = 10  # of least squares; a step is a simulation for each of 36 numbers
EPS = 1e-4  # of finite differences; smaller ones are lost in what friction makes of a step
THREADS = os.cpu_count() or 1


class Fitted(NamedTuple):
    """One number of a joint: where its fit begins, and its bounds."""

    start: float
    low: float
    high: float


NUMBERS = {
    "kp": Fitted(17.8, 1.0, 200.0),  # [N m/rad]
    DAMPING: Fitted(0.6, 0.0, 10.0),  # [N m s/rad]
    COULOMB: Fitted(0.1, 0.0, 2.0),  # [N m]
    "inertia": Fitted(0.03, 1e-3, 0.5),  # [kg m²]
    "delay": Fitted(0.02, 0.0, 0.3),  # [s]
    "offset": Fitted(0.0, -1.0, 1.0),  # [N m]
}


@dataclass(frozen=True)
class SysidFit:
    """What sysid found."""

    simulation: Simulation  # with its values
    parameters: Any
    vendor: Simulation
    simulated: int  # simulations of all recordings

    def errors(self, recordings: Sequence[Recording]) -> FloatArray:
        """Return position errors of MuJoCo's own simulation, (K, n) [rad]."""
        return _Arm(self.vendor, recordings).errors(self.parameters)


def sysid(simulation: Simulation, recordings: Sequence[Recording], evaluations: int) -> SysidFit:
    """Fit six numbers of each joint.

    Args:
        simulation: The rigid body, and drives to be replaced.
        recordings: With commands.
        evaluations: Simulations of all recordings at most, those of slopes among them.
    """
    try:
        from mujoco.sysid import build_residual_fn, optimize
    except ImportError:
        sys.exit('mujoco[sysid] is missing, expected: pip install -e ".[bench]"')
    fit = _Arm(simulation, recordings)
    residual = build_residual_fn(
        models_sequences=[fit.sequence], custom_rollout=fit.rollout, modify_residual=fit.compare,
        resample_true=False, n_threads=1,
    )  # fmt: skip
    begun = fit.parameters()
    best, _ = optimize(
        begun, residual, verbose=False, eps=EPS, output=StringIO(),
        max_iters=max(1, min(ITERATIONS, evaluations // (begun.size + 2))),
    )  # fmt: skip
    rows: list[FloatArray] = []
    for joint, row in zip(simulation.model.joint_names, rows_of(simulation), strict=True):
        values = {name: float(best[f"{joint}_{name}"].value[0]) for name in NUMBERS}
        values["offset"] *= -1.0  # MuJoCo adds what limo takes off
        rows.append(with_values(row, {**values, "kd": 0.0}))
    found = with_rows(replace(simulation, effects=()), rows)
    return SysidFit(found, best, simulation, fit.simulated)


class _Arm:
    """The vendor's model without contacts, its recordings, and what is fitted."""

    def __init__(self, simulation: Simulation, recordings: Sequence[Recording]) -> None:
        import mujoco
        from mujoco import sysid as tool

        self._tool, self._names = tool, simulation.model.joint_names
        self.simulated = 0
        self._parts = [r[rows] for r in recordings for rows in r.segments]
        spec = mujoco.MjSpec.from_file(str(simulation.model.urdf))
        spec.option.timestep = STEP
        spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
        spec.option.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONTACT
        spec.option.disableflags |= mujoco.mjtDisableBit.mjDSBL_LIMIT
        for name in self._names:
            spec.add_numeric(name=f"delay_{name}", data=[0.0])
            spec.add_sensor(
                name=f"{name}_pos", type=mujoco.mjtSensor.mjSENS_JOINTPOS,
                objtype=mujoco.mjtObj.mjOBJ_JOINT, objname=name,
            )  # fmt: skip
        self._spec = spec
        model = spec.compile()
        target = np.concatenate([part.position for part in self._parts])
        self._times = np.arange(len(target), dtype=float)
        self.sequence = tool.ModelSequences(
            simulation.model.name, spec, "recordings",
            tool.create_initial_state(model, model.qpos0, np.zeros(model.nv), np.zeros(model.na)),
            tool.TimeSeries(self._times, target),
            tool.TimeSeries.from_names(self._times, target, model),
        )  # fmt: skip

    def parameters(self) -> Any:  # noqa: ANN401  # mujoco ships no stubs
        """Return what is fitted, with bounds."""
        initial = self._tool.ParameterDict()
        for joint in self._names:
            for name, own in NUMBERS.items():
                initial.add(
                    self._tool.Parameter(
                        f"{joint}_{name}", own.start, own.low, own.high,
                        modifier=partial(_write, joint, name),
                    )
                )  # fmt: skip
        return initial

    def errors(self, parameters: Any) -> FloatArray:  # noqa: ANN401
        """Return simulated minus recorded positions of all rows, (K, n) [rad]."""
        model = self._tool.apply_param_modifiers(parameters, self._spec)
        return self._simulated(model) - np.concatenate([part.position for part in self._parts])

    def rollout(self, *, models: Sequence[Any], **_: object) -> list[Any]:
        """Return the positions of all recordings for each model."""
        series, trajectory = self._tool.TimeSeries, self._tool.SystemTrajectory
        found: list[Any] = []
        for model in models:
            told = self._simulated(model)
            state = series(self._times, np.column_stack([self._times, told, np.zeros_like(told)]))
            found.append(
                trajectory(
                    model, series(self._times, told),
                    series.from_names(self._times, told, model), np.zeros(0), state,
                )
            )  # fmt: skip
        return found

    def _simulated(self, model: Any) -> FloatArray:  # noqa: ANN401
        import mujoco
        from mujoco import rollout

        self.simulated += 1
        delays = [float(model.numeric(f"delay_{name}").data[0]) for name in self._names]
        n, longest = len(self._names), max(part.duration for part in self._parts)
        many = int(np.ceil(longest / STEP)) + 1
        start = np.zeros((len(self._parts), 1 + model.nq + model.nv))
        control = np.zeros((len(self._parts), many, n))
        for k, part in enumerate(self._parts):
            start[k, 1 : 1 + n] = part.position[0]
            for j, delay in enumerate(delays):
                control[k, :, j] = _held(part.time, commands_of(part)[:, j], delay, many)
        data = [mujoco.MjData(model) for _ in range(THREADS)]
        told, _ = rollout.rollout([model] * len(self._parts), data, start, control)
        state = np.asarray(told)
        grid = STEP * np.arange(1, many + 1)
        return np.concatenate(
            [
                np.stack(
                    [
                        np.interp(
                            part.time - part.time[0],
                            np.append(0.0, grid),
                            np.append(start[k, 1 + j], state[k, :, 1 + j]),
                        )
                        for j in range(n)
                    ],
                    axis=1,
                )
                for k, part in enumerate(self._parts)
            ]
        )

    def compare(
        self,
        _p: object,
        said: Any,  # noqa: ANN401
        measured: Any,  # noqa: ANN401
        *_: object,
        **__: object,
    ) -> tuple[Any, ...]:
        """Return position errors; a model that runs away is far, and no more."""
        return np.nan_to_num(said.data - measured.data, nan=10.0).clip(-10, 10), said, measured


def _write(joint: str, name: str, spec: Any, parameter: Any) -> None:  # noqa: ANN401
    value = float(parameter.value[0])
    actuator = next(own for own in spec.actuators if own.target == joint)
    if name == "kp":
        actuator.gainprm[0], actuator.biasprm[1] = value, -value
        actuator.biasprm[2] = 0.0
    elif name == "offset":
        actuator.biasprm[0] = value
    elif name == "delay":
        spec.numeric(f"delay_{joint}").data = [value]
    elif name == DAMPING:  # a polynomial in the speed
        spec.joint(joint).damping[0] = value
    else:
        setattr(spec.joint(joint), {COULOMB: "frictionloss", "inertia": "armature"}[name], value)


def _held(time: FloatArray, command: FloatArray, delay: float, steps: int) -> FloatArray:
    """Return the mean command of each step, delayed, (steps,) [rad]: smooth in the delay."""
    spans = np.diff(time - time[0], append=time[-1] - time[0] + 1.0)
    edges = np.append(0.0, np.cumsum(spans))
    total = np.append(0.0, np.cumsum(command * spans))
    at = STEP * np.arange(steps + 1) - delay
    held = np.interp(at, edges, total) + np.minimum(at, 0.0) * command[0]
    return np.diff(held) / STEP
