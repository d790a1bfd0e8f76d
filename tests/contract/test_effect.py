"""What holds for every effect of the catalogue."""

import numpy as np
import pytest

from limo_driver.physics import CATALOGUE, Effect, JointEffect, Simulation
from limo_driver.types import Motion

LAWS = {
    "maxwell_slip": {"stiffness": (900.0, 120.0, 30.0), "width": (5e-4, 4e-3, 0.02)},
    "lugre": {"sigma_0": 2e3, "sigma_1": 5.0, "tau_c": 1.0, "tau_s": 0.3, "v_s": 0.02},
    "dahl": {"sigma_0": 2e3, "tau_c": 1.0, "exponent": 1.5},
    "bouc_wen": {"sigma_0": 2e3, "tau_c": 1.0, "beta_ratio": 0.6, "exponent": 1.3},
    "preisach": {"up": (0.21, 0.22), "down": (0.19, 0.20), "weight": (0.4, 0.2)},
}
EXAMPLES = {
    "armature": [{"inertia": 0.4}],
    "asymmetric_friction": [{"tau_plus": 1.2, "tau_minus": 0.7}],
    "backlash": [{"gap": 5e-3}],
    "coulomb_friction": [{"tau_c": 2.2, "v_eps": 0.002}],
    "encoder_offset": [{"offset": 0.01}],
    "external_contact": [
        {
            "windows": ((0.2, 0.5), (0.4, 0.9)),
            "wrench": ((5, 0, -3, 0.1, 0, 0.2), (0, 4, 0, 0, 0, 0)),
        }
    ],
    "gravity_direction": [{"gravity": (0.5, 0.0, -9.7)}],
    "joint_coupling": [{"other": 3, "f_v": 2.0, "tau_c": 0.5, "inertia": 0.1, "ratio": -1}],
    "joint_elasticity": [{"stiffness": 1e4, "cubic": 1e-9}],
    "load_dependent_friction": [
        {"coefficient": 0.05},
        {"coefficient": 0.05, "variant": "positive"},
        {"coefficient": 0.05, "variant": "negative"},
        {"coefficient": 0.05, "variant": "stribeck", "v_s": 0.05},
        {"coefficient": 0.002, "variant": "quadratic"},
    ],
    "payload": [{"mass": 2.0, "com": (0.0, 0.02, 0.1), "inertia": (0.01, 0, 0, 0.01, 0, 0.005)}],
    "position_dependent_friction": [{"positions": (0.1, 0.2, 0.3), "excess": (0.5, -0.2, 1.0)}],
    "presliding_hysteresis": [{"law": law, **values} for law, values in LAWS.items()],
    "quadratic_drag": [{"coefficient": 3.0}],
    "spring_load": [{"stiffness": 20.0, "rest": 0.3, "cubic": 5.0}],
    "stribeck_friction": [{"tau_s": 0.8, "v_s": 0.02, "delta": 1.5}],
    "temperature_dependent_friction": [
        {"excess": 1.5, "time_constant": 2.0},
        {"per_kelvin": -0.1, "reference": 30.0},
    ],
    "time_delay": [{"delay": 0.0137}, {"lag": 0.02}, {"delay": 0.003, "lag": 0.01}],
    "torque_crosstalk": [{"source": 4, "gain": 0.03}],
    "torque_drift": [{"times": (0.0, 0.5, 2.0), "offset": (0.0, 0.4, -0.2)}],
    "torque_gain": [{"gain": 0.05}],
    "torque_offset": [{"offset": -0.3}],
    "torque_ripple": [{"cycles_per_rev": (320, 640), "amplitude": (0.3, 0.1), "phase": (0.2, 1)}],
    "viscous_friction": [{"f_v": 4.0}, {"f_v_plus": 4.0, "f_v_minus": 3.0}],
}
JOINT = 2
DISPLACING = {"backlash", "encoder_offset", "joint_elasticity"}  # these move the load of others


def make(name: str, **values: object) -> Effect:
    owner = CATALOGUE[name]
    joint = {"joint": JOINT} if issubclass(owner, JointEffect) or name == "joint_coupling" else {}
    return owner(**joint, **values)


CASES = [(name, values) for name, examples in EXAMPLES.items() for values in examples]


@pytest.fixture(
    params=CASES, ids=lambda case: "-".join([case[0], *map(str, case[1].values())])[:50]
)
def case(request: pytest.FixtureRequest) -> tuple[str, dict]:
    return request.param


@pytest.fixture
def effect(case: tuple[str, dict]) -> Effect:
    return make(case[0], **case[1])


@pytest.fixture(scope="module")
def motion() -> Motion:
    t = np.cumsum(np.random.default_rng(0).uniform(1e-3, 3e-3, 500))  # uneven, as recordings are
    phase = np.arange(7)
    q = (
        0.2
        + 0.04 * np.sin(2 * np.pi * t[:, None] + phase)
        + 0.01 * np.sin(2 * np.pi * 3.7 * t[:, None] + 1)
    )
    dq = np.gradient(q, t, axis=0)
    return Motion(t, q, dq, np.gradient(dq, t, axis=0), 25 + 5 * t[:, None] * np.ones(7))


def alone(effect: Effect) -> Simulation:
    return Simulation("iiwa14", effects=(effect,))


def test_every_effect_of_the_catalogue_is_tested():
    assert set(EXAMPLES) == set(CATALOGUE)


def test_scanning_one_sample_at_a_time_equals_the_batch(effect: Effect, motion: Motion):
    simulation = alone(effect)
    batch, (last,) = simulation.advance(simulation.init(), motion)
    state, scanned = simulation.init(), []
    for t in range(len(motion)):
        value, state = simulation.step(state, motion.sample(t))
        scanned.append(value)
    np.testing.assert_allclose(scanned, batch, rtol=0, atol=1e-10)
    np.testing.assert_allclose(state[0], last, atol=1e-10)


def test_the_effect_does_something_on_its_joints_alone(effect: Effect, motion: Motion):
    simulation = alone(effect)
    added = simulation.predict(motion) - simulation.without_effects().predict(motion)
    assert np.abs(added[:, JOINT - 1]).max() > 1e-3
    if effect.joints and effect.name not in DISPLACING:
        assert not np.delete(added, JOINT - 1, axis=1).any()


def test_memory_goes_in_and_out_and_is_never_changed_in_place(effect: Effect, motion: Motion):
    simulation = alone(effect)
    _, (state,) = simulation.advance(simulation.init(), motion[:100])
    before = state.copy()
    simulation.advance((state,), motion[100:])
    np.testing.assert_array_equal(state, before)


def test_it_survives_the_file(effect: Effect, tmp_path):
    path = tmp_path / "sim.yaml"
    alone(effect).save(path)
    assert Simulation.load(path) == alone(effect)


def test_every_parameter_has_a_unit_bounds_and_a_description(effect: Effect):
    for parameter in effect.parameters():
        assert parameter.unit
        assert parameter.description
        assert parameter.lower < parameter.upper


@pytest.mark.parametrize("wrong", [np.nan, np.inf])
def test_every_number_outside_its_bounds_is_refused_by_name(case: tuple[str, dict], wrong: float):
    name, values = case
    for known in CATALOGUE[name].parameters():
        if known.name not in values or known.unit == "text":
            continue
        bad = np.full(np.shape(values[known.name]), wrong).tolist()
        with pytest.raises(ValueError, match=rf"{name}.*: {known.name} is {wrong:g}"):
            make(name, **values | {known.name: bad})
