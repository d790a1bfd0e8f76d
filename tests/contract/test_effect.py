"""What holds for every effect of the catalogue."""

import numpy as np
import pytest
from effect_examples import EXAMPLES, JOINT, make

from limo_driver.physics import CATALOGUE, Effect, Simulation
from limo_driver.types import Motion

DISPLACING = {"backlash", "encoder_offset", "joint_elasticity"}  # these move the load of others


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
    if effect.joints and (effect.name not in DISPLACING or not effect.displaces):
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
