"""Logs of which no name of a column says what it holds, of several arms and loggers."""

from dataclasses import replace

import numpy as np
import pytest
from logged import arm

from limo_driver.logs.readers.proposals.proposal import propose
from limo_driver.logs.readers.table import table_of
from limo_driver.model import RobotModel

BARE = "column_{}"
BODY = (
    '<joint name="{name}" type="{kind}"><parent link="l{j}"/><child link="l{k}"/>'
    '<origin xyz="{at}"/><axis xyz="{axis}"/>'
    '<limit lower="-{reach}" upper="{reach}" effort="90" velocity="4"/></joint>'
    '<link name="l{k}"><inertial><origin xyz="{com}"/><mass value="{mass}"/>'
    '<inertia ixx="0.02" iyy="0.03" izz="0.02" ixy="0" ixz="0" iyz="0"/></inertial></link>'
)


def written(folder, *joints):
    """A description of one joint after the other: name, kind, axis, reach and mass."""
    parts = [
        BODY.format(
            name=name, kind=kind, axis=axis, reach=reach, mass=mass, j=j, k=j + 1,
            at="0 0 0.3" if j else "0 0 0", com="0.15 0.02 0.1",
        )
        for j, (name, kind, axis, reach, mass) in enumerate(joints)
    ]  # fmt: skip
    path = folder / "arm.urdf"
    path.write_text(f'<robot name="own"><link name="l0"/>{"".join(parts)}</robot>')
    return RobotModel(path)


def pendulums(folder):
    joints = [("hip", "revolute", "0 1 0", 2.2, 4.0), ("knee", "revolute", "0 1 0", 2.5, 2.0)]
    return written(folder, *joints)


def excavator(folder):
    joints = [
        ("swing", "revolute", "0 0 1", 3.0, 9.0),
        ("boom", "revolute", "0 1 0", 1.2, 6.0),
        ("stick", "revolute", "0 1 0", 1.9, 3.0),
        ("bucket", "revolute", "0 1 0", 2.4, 1.0),
    ]
    return written(folder, *joints)


ARMS = {"pendulums": pendulums, "excavator": excavator, "iiwa": lambda _: arm()}


@pytest.fixture(params=ARMS)
def model(request, tmp_path):
    return ARMS[request.param](tmp_path)


class Moved:
    """An arm that moves fast, with friction and noise."""

    def __init__(self, model, seed=3, gravity=None):
        random = np.random.default_rng(seed)
        self.time, n = np.arange(0, 16, 0.02), model.n
        reach = 0.8 * np.minimum(model.limits.position_max, 2.0)
        rate = 2 * np.pi * random.uniform(0.08, 0.45, (3, n))
        rate *= np.minimum(1, 0.9 * model.limits.velocity / (reach * rate.mean(axis=0)))
        phase = self.time[:, None, None] * rate + random.uniform(0, 6, (3, n))
        self.q = reach * np.sin(phase).mean(axis=1)
        self.v = reach * (rate * np.cos(phase)).mean(axis=1)
        self.a = -reach * (rate**2 * np.sin(phase)).mean(axis=1)
        stands = model if gravity is None else model.with_gravity(gravity)
        torque = stands.inverse_dynamics(self.q, self.v, self.a)
        scale = np.abs(torque).max(axis=0)
        torque += 0.08 * scale.max() * np.tanh(self.v / 0.01) + 0.05 * scale.max() * self.v
        self.torque = torque + 0.01 * scale * random.normal(size=torque.shape)
        self.warm = 35 + np.cumsum(0.02 * random.normal(size=self.q.shape), axis=0)
        self.random = random


def columns(name, values):
    return {name.format(j + 1): values[:, j] for j in range(values.shape[1])}


def read(log, model):
    """What is proposed, which has to be asked about."""
    mapping = propose(table_of(log), model).mapping
    assert mapping.undecided
    assert mapping.undecided[0].startswith("columns: no name says what they are: is it")
    return mapping, replace(mapping, undecided=()).columns(table_of(log), model)


@pytest.mark.parametrize("unit", [1.0, 180 / np.pi], ids=["rad", "deg"])
@pytest.mark.parametrize("names", [("p{}", "m{}"), ("ch_{}_b", "ch_{}_a")])
def test_fast_motion_is_told_from_torques(model, names, unit):
    run = Moved(model)
    position, torque = names
    log = {"t": run.time, **columns(torque, run.torque), **columns(position, unit * run.q)}
    mapping, found = read(log, model)
    assert mapping.torque.columns == tuple(columns(torque, run.q))
    np.testing.assert_allclose(found.position, run.q, atol=1e-9)


@pytest.mark.parametrize("unit", [1.0, 30 / np.pi], ids=["rad/s", "rpm"])
def test_velocities_accelerations_counters_and_temperatures_are_no_torques(model, unit):
    run = Moved(model, seed=8)
    log = {"no": np.arange(run.time.size), "t": run.time, "st": np.arange(run.time.size) % 4}
    log |= {**columns("h{}", run.warm), **columns("w{}", run.a), **columns("s{}", unit * run.v)}
    log |= {**columns("m{}", run.torque), **columns("p{}", run.q)}
    mapping, found = read(log, model)
    assert mapping.torque.columns == tuple(columns("m{}", run.q))
    np.testing.assert_allclose(found.position, run.q, atol=1e-9)
    np.testing.assert_allclose(found.velocity, run.v, atol=1e-9)


def test_currents_of_any_sign_and_gear_are_proposed(model):
    run = Moved(model, seed=12)
    amperes = (
        run.torque * run.random.uniform(0.05, 4, model.n) * run.random.choice([-1, 1], model.n)
    )
    mapping, _ = read({"t": run.time, **columns("p{}", run.q), **columns("k{}", amperes)}, model)
    assert mapping.torque.columns == tuple(columns("k{}", run.q))


def test_numbers_in_another_order_than_the_joints_are_put_in_theirs(model):
    run = Moved(model, seed=21)
    order = np.roll(np.arange(model.n), 1)
    log = {"t": run.time, **columns("p{}", run.q[:, order]), **columns("m{}", run.torque[:, order])}
    mapping, found = read(log, model)
    np.testing.assert_allclose(found.position, run.q, atol=1e-9)
    assert mapping.torque.columns == tuple(f"m{k + 1}" for k in np.argsort(order))
    assert "of which the numbers are not in their order" in mapping.undecided[0]
    assert f"torque: {', '.join(mapping.torque.columns)}" in mapping.undecided[0]


def test_torques_alone_in_another_order_are_put_in_that_of_named_positions(model):
    run = Moved(model, seed=22)
    order = np.roll(np.arange(model.n), -1)
    log = {
        "t": run.time,
        **dict(zip((f"{j}_pos_rad" for j in model.joint_names), run.q.T, strict=True)),
    }
    mapping, _ = read({**log, **columns("m{}", run.torque[:, order])}, model)
    assert mapping.torque.columns == tuple(f"m{k + 1}" for k in np.argsort(order))


@pytest.mark.parametrize("axis", [(9.81, 0, 0), (0, -9.81, 0)], ids=["wall", "side"])
def test_an_arm_that_hangs_on_a_wall_is_read_as_well(tmp_path, axis):
    model = excavator(tmp_path)
    run = Moved(model, seed=30, gravity=list(axis))
    log = {"t": run.time, **columns("m{}", run.torque), **columns("p{}", np.rad2deg(run.q))}
    mapping, _ = read(log, model)
    assert mapping.position.columns[0] == "p1"
    assert mapping.torque.columns[0] == "m1"


@pytest.mark.parametrize("apart", [1, 2, 3])
def test_tables_without_names_side_by_side_or_joint_by_joint(model, apart):
    run = Moved(model, seed=40)
    parts = [np.rad2deg(run.q), run.torque, np.rad2deg(run.v)][: max(apart, 2)]
    by_joint = [part[:, [j]] for j in range(model.n) for part in parts]
    table = np.hstack(parts if apart == 1 else by_joint)
    rows = np.arange(len(table))
    table = np.column_stack([rows, run.time, run.warm[:, 0], table, rows % 7])
    mapping, found = read(columns(BARE, table), model)
    np.testing.assert_allclose(found.position, run.q, atol=1e-9)
    np.testing.assert_allclose(found.torque, run.torque)
    assert (mapping.velocity is not None) == (apart == 3)


def test_words_that_say_nothing_are_as_good_as_none(tmp_path):
    model = pendulums(tmp_path)
    run = Moved(model, seed=50)
    names = ("upper", "lower", "foo", "bar")
    values = np.hstack([run.q, run.torque])
    mapping, _ = read({"t": run.time, **dict(zip(names, values.T, strict=True))}, model)
    assert mapping.position.columns == names[:2]
    assert mapping.torque.columns == names[2:]


def test_set_points_are_ahead_of_positions_whatever_their_names(model):
    run = Moved(model, seed=60)
    late = run.q - 0.05 * run.v
    log = {"t": run.time, **columns("a{}", run.q), **columns("b{}", late)}
    mapping, _ = read({**log, **columns("c{}", run.torque)}, model)
    assert mapping.position.columns[0] == "b1"
    assert mapping.command.columns[0] == "a1"
    assert mapping.torque.columns[0] == "c1"


def test_temperatures_are_no_torques(model):
    run = Moved(model, seed=70)
    found = propose(
        table_of({"t": run.time, **columns("p{}", run.q), **columns("h{}", run.warm)}), model
    )
    assert found.mapping.torque is None
    assert found.mapping.undecided
    (why,) = (item.why for item in found.taken if item.quantity == "torque")
    assert "no name says what" in why


@pytest.mark.parametrize("names", ["observation.state.{}", "joint_position_{}"])
def test_what_names_say_is_never_taken_for_what_they_do_not(tmp_path, names):
    model = pendulums(tmp_path)
    run = Moved(model, seed=80)
    every = {"action.{}": run.q, names: run.q - 0.05 * run.v, "temperature_{}": run.warm}
    log = {k.format(j): x[:, i] for k, x in every.items() for i, j in enumerate(model.joint_names)}
    mapping = propose(table_of({"timestamp": run.time, **log}), model).mapping
    assert mapping.position.columns[0] == names.format("hip")
    assert mapping.torque is None
    assert not any("no name says" in question for question in mapping.undecided)
