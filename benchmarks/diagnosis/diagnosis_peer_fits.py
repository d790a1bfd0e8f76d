"""Peers of the diagnosis that fit: identification, sparse and boosted regression."""

from __future__ import annotations

import subprocess
import sys
import warnings
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from diagnosis_closure import MOVING
from diagnosis_peer_base import (
    BAND,
    LEAVES,
    Answer,
    Rows,
    Task,
    finding,
    joint_terms,
    link_finding,
    rows_of,
    spread,
)

from estimators.rigid_body.regressor import PER_LINK, RegressorChain, parameters_of
from limo_driver.physics import Simulation

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from diagnosis_peer_base import Array

    from limo_driver.model.descriptions.geometry import Inertial
    from limo_driver.recordings.recording import Recording
    from limo_driver.types import Motion

LIMO = Path(sys.executable).with_name("limo")
INCLUSION = 0.9  # share of an ensemble that has to keep a term
MEMBERS = 20
RIDGE = 1e-5  # of the mean square of a column
SINDY_ROWS = 6000
_FRICTION = ("coulomb_friction", "viscous_friction")
STRIBECK_SPEED = 0.02  # [rad/s]
PRESLIDING = (0.003, 0.02)  # [rad] of travel after a reversal
STRIDE = 12  # rows of which one is fitted: at 250 Hz, noise below 10 Hz is independent then
COGS = 4  # harmonics of the joint angle in friction over position
TREE_ROWS = 12_000


def identify(task: Task) -> Answer:
    """Fit everything that `limo identify` knows, from nothing but the robot's description."""
    out = task.case / "peers" / "identify" / "sim.yaml"
    command = [LIMO, "identify", *task.paths, "--robot", task.nominal.robot, "--out", out]
    subprocess.run(list(map(str, command)), check=True, capture_output=True, text=True)
    fitted = Simulation.load(out)
    findings = _bodies_changed(task.nominal, fitted) + _terms_changed(task, fitted)
    return Answer(findings, lambda recording: fitted.predict(recording, BAND))


def _bodies_changed(nominal: Simulation, fitted: Simulation) -> list[dict[str, Any]]:
    """Name links of which mass, first moment or inertia left the tolerance."""
    limit = LEAVES * nominal.tolerances.inertia
    pairs = zip(_links(nominal), _links(fitted), strict=True)
    changed = [_body_change(a, b) > limit for a, b in pairs]
    return [link_finding(j + 1, len(changed)) for j, named in enumerate(changed) if named]


def _links(simulation: Simulation) -> list[Inertial]:
    return list(simulation.model.inertials.values())


def _body_change(a: Inertial, b: Inertial) -> float:
    """Return the largest relative change of mass, first moment and inertia."""
    change = [abs(b.mass - a.mass) / a.mass]
    for x, y in ((_moment(a), _moment(b)), (a.tensor(), b.tensor())):
        change.append(float(np.linalg.norm(y - x) / np.linalg.norm(x)))
    return max(change)


def _moment(body: Inertial) -> Array:
    return body.mass * np.array(body.com)


def _terms_changed(task: Task, fitted: Simulation) -> list[dict[str, Any]]:
    """Name friction that left its tolerance, and armature and offsets above the noise."""
    speed, acceleration = spread(task)
    after, before = (joint_terms(simulation) for simulation in (fitted, task.nominal))
    sizes = {"armature": acceleration, "viscous_friction": speed}
    found = []
    for (effect, joint), value in after.items():
        known = before.get((effect, joint), 0.0)
        change = abs(value - known)
        torque = change * sizes.get(effect, np.ones_like(speed))[joint - 1]
        tolerated = LEAVES * task.nominal.tolerances.friction * abs(known)
        if change > tolerated and torque > task.noise[joint - 1]:
            found.append(finding(effect, joint))
    return found


def pysindy(task: Task) -> Answer:
    """Regress what fitted links leave of each joint's residual on the usual terms, sparsely."""
    links = _Links(task)
    rest = _rest(task, links)
    laws = [_Sparse(task, rest, j) for j in range(task.noise.size)]
    findings = [said for law in laws for said in law.findings()]
    return Answer(links.findings() + findings, _corrected(task, links, laws))


def _rest(task: Task, links: _Links) -> list[Array]:
    """Return what the links leave of the residual of each recording, (T, n) [N m]."""
    return [rows.residual - links.torque(rows) for rows in task.rows]


class _Sparse:
    """PySINDy's sparse law of one joint's residual."""

    def __init__(self, task: Task, rest: list[Array], joint: int) -> None:
        import pysindy as ps

        self._task, self._joint = task, joint
        self._effects = list(_terms(task.rows[0], joint))
        X = np.concatenate([self._columns(rows) for rows in task.rows])
        y = np.concatenate([part[:, joint] for part in rest])
        usable = np.concatenate([rows.usable[:, joint] for rows in task.rows])
        thin = max(1, int(usable.sum()) // SINDY_ROWS)
        X, y = X[usable][::thin], y[usable][::thin]
        scale = np.sqrt((X**2).mean(axis=0))
        self._scale = np.where(scale > 0, scale, 1.0)
        sparse = ps.STLSQ(threshold=float(task.noise[joint]), alpha=RIDGE * len(y), unbias=False)
        ensemble = ps.EnsembleOptimizer(sparse, bagging=True, n_models=MEMBERS)
        np.random.seed(0)  # noqa: NPY002  # PySINDy draws its samples from the global generator
        law = ps.SINDy(optimizer=ensemble, feature_library=ps.IdentityLibrary())
        with warnings.catch_warnings():  # no term at all is an answer, too
            warnings.filterwarnings("ignore", "Sparsity parameter is too big")
            law.fit(X / self._scale, t=1.0, x_dot=y[:, None])
        members = np.array(ensemble.coef_list)[:, 0]
        self._kept = (members != 0).mean(axis=0) > INCLUSION
        self._coefficients = np.where(self._kept, np.median(members, axis=0), 0.0)

    def findings(self) -> list[dict[str, Any]]:
        """Name the terms that the ensemble keeps; friction only outside its tolerance."""
        known = joint_terms(self._task.nominal)
        found: dict[str, dict[str, Any]] = {}
        for k in np.flatnonzero(self._kept):
            effect, _ = self._effects[k]
            value = self._coefficients[k] / self._scale[k]
            nominal = known.get((effect, self._joint + 1), 0.0)
            if abs(value) > LEAVES * self._task.nominal.tolerances.friction * abs(nominal):
                found[effect] = finding(effect, self._joint + 1)
        return list(found.values())

    def predict(self, rows: Rows) -> Array:
        """Return the residual that the law predicts, (T,) [N m]."""
        return self._columns(rows) / self._scale @ self._coefficients

    def _columns(self, rows: Rows) -> Array:
        return np.stack(list(_terms(rows, self._joint).values()), axis=1)


class _Links:
    """Links and friction that differ about as much as their tolerances say, all joints at once.

    residual = Y W x: W scales each parameter to 1 sigma of its tolerance, x ~ N(0, 1).
    """

    def __init__(self, task: Task) -> None:
        self._chain = RegressorChain.of(task.nominal.model)
        bodies, tolerances = _links(task.nominal), task.nominal.tolerances
        self._sigma = tolerances.inertia * np.concatenate([_sizes(b) for b in bodies])
        known, joints = joint_terms(task.nominal), range(1, task.noise.size + 1)
        self._friction = tolerances.friction * np.array(
            [[known.get((effect, j), 0.0) for j in joints] for effect in _FRICTION]
        )
        normal, right = np.eye(self._size), np.zeros(self._size)
        for rows in task.rows:
            usable, residual = rows.usable[::STRIDE], rows.residual[::STRIDE]
            Y = self._columns(rows.motion[::STRIDE])
            for j, noise in enumerate(task.noise):
                A, b = Y[j][usable[:, j]] / noise, residual[usable[:, j], j] / noise
                normal, right = normal + A.T @ A, right + A.T @ b
        self._x = np.linalg.solve(normal, right)

    @property
    def _size(self) -> int:
        return self._sigma.size + self._friction.size

    def _columns(self, motion: Motion) -> Array:
        """Return the torque of 1 sigma of each parameter, (n, T, p) [N m]."""
        columns = np.zeros((motion.n, len(motion), self._size))
        columns[:, :, : self._sigma.size] = self._chain.regressor(motion) * self._sigma
        for j in range(motion.n):
            v, at = motion.velocity[:, j], self._sigma.size + j
            columns[j, :, at] = self._friction[0, j] * np.tanh(v / MOVING)
            columns[j, :, at + motion.n] = self._friction[1, j] * v
        return columns

    def torque(self, rows: Rows) -> Array:
        """Return what the difference adds to the torque, (T, n) [N m]."""
        return (self._columns(rows.motion) @ self._x).T

    def findings(self) -> list[dict[str, Any]]:
        """Name links and friction of which a parameter left its tolerance."""
        by_link = np.abs(self._x[: self._sigma.size]).reshape(-1, PER_LINK).max(axis=1)
        links = [link_finding(int(k) + 1, len(by_link)) for k in np.flatnonzero(by_link > LEAVES)]
        dry = np.abs(self._x[self._sigma.size :]).reshape(self._friction.shape) > LEAVES
        return links + [finding(_FRICTION[i], int(j) + 1) for i, j in np.argwhere(dry)]


def _sizes(body: Inertial) -> Array:
    """Return the scale of a body's ten parameters: mass, first moment, inertia about the joint."""
    parameters = parameters_of(body)
    moment = float(np.linalg.norm(parameters[1:4]))
    inertia = float(np.abs(parameters[4:]).max())
    return np.array([body.mass, *[moment] * 3, *[inertia] * 6])


def _terms(rows: Rows, j: int) -> dict[tuple[str, str], Array]:
    """Return the terms of one joint's residual, by effect and variant, (T,) each."""
    motion = rows.motion
    q, v, a, load = (x[:, j] for x in (motion.position, motion.velocity, motion.acceleration,
                                       rows.load))  # fmt: skip
    s, travel = np.tanh(v / MOVING), _travel(motion)[:, j]
    time = motion.time - motion.time[0]
    table = {
        ("torque_offset", ""): np.ones_like(q),
        ("torque_drift", ""): time,
        ("coulomb_friction", ""): s,
        ("viscous_friction", ""): v,
        ("quadratic_drag", ""): v * np.abs(v),
        ("stribeck_friction", ""): s * np.exp(-np.abs(v) / STRIBECK_SPEED),
        ("load_dependent_friction", ""): s * np.abs(load),
        ("temperature_dependent_friction", ""): s * time,
        ("armature", ""): a,
        ("torque_gain", ""): load,
        ("time_delay", ""): np.gradient(load, motion.time),
        ("spring_load", ""): q,
    }
    table |= {("presliding_hysteresis", f"{d}"): s * np.exp(-travel / d) for d in PRESLIDING}
    for k in range(1, COGS + 1):
        table[("position_dependent_friction", f"sin {k}")] = s * np.sin(k * q)
        table[("position_dependent_friction", f"cos {k}")] = s * np.cos(k * q)
    for k in set(range(motion.n)) - {j}:
        table[("torque_crosstalk", f"{k}")] = rows.load[:, k]
    for k in {j - 1, j + 1} & set(range(motion.n)):
        table[("joint_coupling", f"{k}")] = motion.velocity[:, k]
    return table


def _travel(motion: Motion) -> Array:
    """Return each joint's distance from its last reversal, (T, n) [rad]."""
    sign = np.where(np.abs(motion.velocity) > MOVING, np.sign(motion.velocity), 0.0)
    index = np.arange(len(sign))[:, None]
    held = np.take_along_axis(sign, np.maximum.accumulate(np.where(sign != 0, index, 0)), axis=0)
    turned = np.diff(held, axis=0, prepend=held[:1]) != 0
    last = np.maximum.accumulate(np.where(turned, index, 0))
    return np.abs(motion.position - np.take_along_axis(motion.position, last, axis=0))


def trees(task: Task) -> Answer:
    """Boost trees on what fitted links leave of each joint's residual."""
    links = _Links(task)
    rest = _rest(task, links)
    laws = [_Grown(task, rest, j) for j in range(task.noise.size)]
    return Answer([], _corrected(task, links, laws))


class _Grown:
    """Boosted trees on one joint's residual."""

    def __init__(self, task: Task, rest: list[Array], joint: int) -> None:
        from sklearn.ensemble import HistGradientBoostingRegressor

        self._joint = joint
        usable = np.concatenate([rows.usable[:, joint] for rows in task.rows])
        X = np.concatenate([self._inputs(rows) for rows in task.rows])[usable]
        y = np.concatenate([part[:, joint] for part in rest])[usable]
        thin = max(1, len(y) // TREE_ROWS)
        forest = HistGradientBoostingRegressor(max_iter=200, learning_rate=0.05, random_state=0)
        self._forest = forest.fit(X[::thin], y[::thin])

    def predict(self, rows: Rows) -> Array:
        """Return the residual that the trees predict, (T,) [N m]."""
        return self._forest.predict(self._inputs(rows))

    def _inputs(self, rows: Rows) -> Array:
        """Return position, velocity, acceleration, load and travel of the joint, (T, 5)."""
        motion = rows.motion
        table = (motion.position, motion.velocity, motion.acceleration, rows.load, _travel(motion))
        return np.stack([x[:, self._joint] for x in table], axis=1)


def _corrected(
    task: Task, links: _Links, laws: Sequence[_Sparse | _Grown]
) -> Callable[[Recording], Array]:
    """Return the nominal prediction plus what links and laws say of its residual."""

    def torque(recording: Recording) -> Array:
        rows = rows_of(recording, task.nominal)
        said = np.stack([law.predict(rows) for law in laws], axis=1)
        return task.nominal.predict(recording, BAND) + links.torque(rows) + said

    return torque
