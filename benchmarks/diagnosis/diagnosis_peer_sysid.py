"""mujoco.sysid as a peer of the diagnosis: MuJoCo's own parameters, fitted to recorded torques."""

from __future__ import annotations

import sys
from dataclasses import replace
from io import StringIO
from typing import TYPE_CHECKING, Any

import numpy as np
from diagnosis_peer_base import (
    BAND,
    LEAVES,
    Answer,
    Task,
    finding,
    joint_terms,
    link_finding,
    spread,
)

from limo_driver.physics import CoulombFriction, Simulation, ViscousFriction

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from diagnosis_peer_base import Array

    from limo_driver.recordings.recording import Recording

ROWS = 600  # of seven torques each, for 91 parameters
ITERATIONS = 10
STEP = 1e-5  # of finite differences; at the default, compiling a model rounds them to noise


def sysid(task: Task) -> Answer:
    """Fit MuJoCo's own parameters to the recorded torques, by its inverse dynamics."""
    try:
        from mujoco.sysid import build_residual_fn, calculate_intervals, optimize
    except ImportError:
        sys.exit('sysid: mujoco[sysid] is missing, expected: pip install -e ".[bench]"')
    fit = _Sysid(task)
    residual = build_residual_fn(
        models_sequences=[fit.sequence], custom_rollout=fit.rollout, modify_residual=fit.weigh,
        resample_true=False, n_threads=1,
    )  # fmt: skip
    initial = fit.parameters()
    best, result = optimize(
        initial, residual, verbose=False, max_iters=ITERATIONS, eps=STEP, output=StringIO()
    )
    left, _, _ = residual(result.x, best)
    _, interval = calculate_intervals([part.ravel() for part in left], np.asarray(result.jac))
    beyond = np.abs(best.as_vector() - initial.as_vector()) - interval
    return Answer(fit.findings(initial, beyond), fit.predictor(best))


class _Sysid:
    """A MuJoCo model of the nominal robot, its parameters and the rows to fit them to."""

    def __init__(self, task: Task) -> None:
        from mujoco import sysid as tool

        self._tool, self._task = tool, task
        self._dry = _only(task.nominal, CoulombFriction, ViscousFriction)
        self._spec = _spec_of(self._dry)
        model = self._spec.compile()
        stacked = [
            np.concatenate([r.motion.position, r.motion.velocity, r.motion.acceleration], axis=1)
            for r in task.rows
        ]
        thin = max(1, sum(map(len, stacked)) // ROWS)
        self._motion = np.concatenate(stacked)[::thin]
        self._usable = np.concatenate([r.usable for r in task.rows])[::thin]
        error = np.concatenate([r.residual for r in task.rows])[::thin]
        # what MuJoCo has no name for (payload, springs ...) is carried over as the nominal says
        target = error + np.concatenate(
            [self._dry.predict(r.motion) for r in task.rows]
        )[::thin]  # fmt: skip
        spread = np.sqrt((error**2).mean(axis=0, where=self._usable))
        self._weight = self._usable / np.maximum(spread, task.noise)
        times = np.arange(len(target), dtype=float)
        self.sequence = tool.ModelSequences(
            task.nominal.robot, self._spec, "recordings",
            tool.create_initial_state(model, model.qpos0, np.zeros(model.nv), np.zeros(0)),
            tool.TimeSeries(times, target), tool.TimeSeries.from_names(times, target, model),
        )  # fmt: skip

    def parameters(self) -> Any:  # noqa: ANN401  # mujoco ships no stubs
        """Return the inertia of each link and three numbers of each joint, with their bounds."""
        tool, spec = self._tool, self._spec
        model = spec.compile()
        initial = tool.ParameterDict()
        for joint in range(model.njnt):
            body = model.body(int(model.jnt_bodyid[joint])).name
            parameter = tool.body_inertia_param(spec, model, body, tool.InertiaType.Pseudo)
            parameter.modifier = _inertia_writer(body)
            initial.add(parameter)
        for joint in spec.joints:
            known = {"damping": joint.damping[0], "frictionloss": joint.frictionloss,
                     "armature": joint.armature}  # fmt: skip
            for name, value in known.items():
                initial.add(
                    tool.Parameter(
                        f"{joint.name}_{name}", value, 0.0, 10 * value + 10.0,
                        modifier=_writer(joint.name, name),
                    )
                )  # fmt: skip
        return initial

    def rollout(self, *, models: Sequence[Any], **_: object) -> list[Any]:
        """Return the torques of the recorded motion for each model."""
        series, trajectory = self._tool.TimeSeries, self._tool.SystemTrajectory
        times = np.arange(len(self._motion), dtype=float)
        n = self._motion.shape[1] // 3
        state = series(times, np.column_stack([times, self._motion[:, : 2 * n]]))
        return [
            trajectory(
                model, series(times, torque), series.from_names(times, torque, model),
                np.zeros(0), state,
            )
            for model in models
            for torque in [_inverse(model, self._motion)]
        ]  # fmt: skip

    def weigh(self, _p: object, said: Any, measured: Any, *_: object, **__: object) -> tuple:  # noqa: ANN401
        """Compare torques on moving rows, each joint in units of its nominal error."""
        return (said.data - measured.data) * self._weight, said, measured

    def findings(self, initial: Any, beyond: Array) -> list[dict[str, Any]]:  # noqa: ANN401
        """Name parameters whose change exceeds its interval by more than twice its tolerance."""
        known, task = self._task.nominal.tolerances, self._task
        speed, acceleration = spread(task)
        adds = {"damping": speed, "frictionloss": np.ones_like(speed), "armature": acceleration}
        effect = {"damping": "viscous_friction", "frictionloss": "coulomb_friction",
                  "armature": "armature"}  # fmt: skip
        found, start, n = [], 0, len(speed)
        for place, (name, parameter) in enumerate(initial.items()):
            excess = beyond[start : start + parameter.size]
            start += parameter.size
            if name.endswith("_inertia"):
                limit = LEAVES * known.inertia * _scale_of(parameter.nominal)
                found += [link_finding(place + 1, n)] if (excess > limit).any() else []
                continue
            joint, kind = (place - n) // 3, name.rsplit("_", 1)[1]
            limit = LEAVES * known.friction * float(parameter.nominal[0])
            if excess[0] > limit and excess[0] * adds[kind][joint] > task.noise[joint]:
                found.append(finding(effect[kind], joint + 1))
        return found

    def predictor(self, best: Any) -> Callable[[Recording], Array]:  # noqa: ANN401
        """Return the prediction of the fitted model, with what the nominal adds to friction."""
        model = self._tool.apply_param_modifiers(best, self._spec)

        def torque(recording: Recording) -> Array:
            m = recording.sharp_motion(BAND)
            rows = np.concatenate([m.position, m.velocity, m.acceleration], axis=1)
            more = self._task.nominal.predict(m) - self._dry.predict(m)
            return _inverse(model, rows) + more

        return torque


def _only(simulation: Simulation, *kinds: type) -> Simulation:
    """Return the simulation with no other effects."""
    return replace(simulation, effects=tuple(e for e in simulation.effects if isinstance(e, kinds)))


def _spec_of(simulation: Simulation) -> Any:  # noqa: ANN401
    """Return an editable MuJoCo model with the inertias and friction of a simulation.

    Friction is made almost hard: it reaches its plateau within a milliradian a second.
    """
    import mujoco

    spec = mujoco.MjSpec.from_file(str(simulation.model.urdf))
    spec.compiler.fusestatic = True
    spec.option.timestep = 1e-4
    spec.option.gravity = simulation.model.gravity
    spec.option.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONTACT
    known = joint_terms(simulation)
    for j, name in enumerate(simulation.model.joint_names):
        joint = spec.joint(name)
        joint.limited = mujoco.mjtLimited.mjLIMITED_FALSE
        joint.damping[0] = known.get(("viscous_friction", j + 1), 0.0)
        joint.frictionloss = known.get(("coulomb_friction", j + 1), 0.0)
        joint.solref_friction = [5e-4, 1.0]
        joint.solimp_friction = [0.99, 0.99, 1e-3, 0.5, 2.0]
        spec.add_actuator(name=name, target=name, trntype=mujoco.mjtTrn.mjTRN_JOINT)
        spec.add_sensor(
            name=f"{name}_torque", type=mujoco.mjtSensor.mjSENS_JOINTACTFRC,
            objtype=mujoco.mjtObj.mjOBJ_JOINT, objname=name,
        )  # fmt: skip
        body, inertial = joint.parent, simulation.model.inertials[joint.parent.name]
        xx, xy, xz, yy, yz, zz = inertial.inertia
        body.mass, body.ipos = inertial.mass, inertial.com
        body.fullinertia, body.explicitinertial = [xx, yy, zz, xy, xz, yz], True
    return spec


def _writer(joint: str, name: str) -> Callable[[Any, Any], None]:
    def write(spec: Any, parameter: Any) -> None:  # noqa: ANN401
        if name == "damping":  # a polynomial in the speed
            spec.joint(joint).damping[0] = parameter.value[0]
        else:
            setattr(spec.joint(joint), name, parameter.value[0])

    return write


def _inertia_writer(body: str) -> Callable[[Any, Any], None]:
    from mujoco.sysid import apply_body_inertia

    def write(spec: Any, parameter: Any) -> None:  # noqa: ANN401
        apply_body_inertia(spec, body, parameter)
        # 4.0 leaves NaN here, and the compiler then refuses the full inertia beside it
        spec.body(body).iquat = [1.0, 0.0, 0.0, 0.0]

    return write


def _scale_of(theta: Array) -> Array:
    """Return what a relative change of 1 in mass, size or first moment is in sysid's parameters."""
    size = float(np.sqrt((np.exp(2 * theta[1:4]) + theta[7:] ** 2).sum()))
    return np.array([0.5] * 4 + [size] * 6)


def _inverse(model: Any, rows: Array) -> Array:  # noqa: ANN401
    """Return MuJoCo's inverse dynamics of each row, (T, n) [N m]."""
    import mujoco

    data, n = mujoco.MjData(model), model.nv
    torque = np.empty((len(rows), n))
    for k, row in enumerate(rows):
        data.qpos[:], data.qvel[:], data.qacc[:] = row[:n], row[n : 2 * n], row[2 * n :]
        mujoco.mj_inverse(model, data)
        torque[k] = data.qfrc_inverse
    return torque
