"""What holds for every effect of the catalogue."""

import numpy as np
import pytest

from limo_driver.physics import CATALOGUE, Effect
from limo_driver.physics.effect import JointMotion

EXAMPLES = {
    "armature": {"inertia": 0.4},
    "coulomb_friction": {"tau_c": 2.2, "v_eps": 0.002},
    "joint_elasticity": {"stiffness": 1e4, "cubic": 1e-9},
    "presliding_hysteresis": {"stiffness": (900.0, 120.0, 30.0), "width": (5e-4, 4e-3, 0.02)},
    "stribeck_friction": {"tau_s": 0.8, "v_s": 0.02, "delta": 1.5},
    "torque_offset": {"offset": -0.3},
    "viscous_friction": {"f_v": 4.0},
}


@pytest.fixture(params=sorted(CATALOGUE))
def effect(request: pytest.FixtureRequest) -> Effect:
    return CATALOGUE[request.param](joint=1, **EXAMPLES[request.param])


@pytest.fixture(scope="module")
def motion() -> JointMotion:
    t = np.arange(1500) * 2e-3
    q = 0.04 * np.sin(2 * np.pi * t) + 0.01 * np.sin(2 * np.pi * 3.7 * t + 1)
    dq = np.gradient(q, t)
    return JointMotion(q, dq, np.gradient(dq, t), 30 * np.cos(q) + 5 * dq)


def rows(motion: JointMotion, part: slice) -> JointMotion:
    return JointMotion(
        motion.position[part], motion.velocity[part], motion.acceleration[part], motion.load[part]
    )


def test_every_effect_of_the_catalogue_is_tested():
    assert set(EXAMPLES) == set(CATALOGUE)


def test_scanning_one_sample_at_a_time_equals_the_batch(effect: Effect, motion: JointMotion):
    batch, last = effect.advance(effect.initial_state(), motion)
    state, scanned = effect.initial_state(), []
    for t in range(batch.size):
        value, state = effect.advance(state, rows(motion, slice(t, t + 1)))
        scanned.append(value[0])
    np.testing.assert_allclose(scanned, batch, rtol=0, atol=1e-12)
    np.testing.assert_allclose(state, last)


def test_the_effect_does_something(effect: Effect, motion: JointMotion):
    values, _ = effect.advance(effect.initial_state(), motion)
    assert np.abs(values).max() > 1e-4
    assert values.shape == motion.position.shape


def test_memory_goes_in_and_out_and_is_never_changed_in_place(effect: Effect, motion: JointMotion):
    state = effect.initial_state()
    before = state.copy()
    effect.advance(state, motion)
    np.testing.assert_array_equal(state, before)


def test_every_parameter_has_a_unit_bounds_and_a_description(effect: Effect):
    for parameter in effect.parameters():
        assert parameter.unit
        assert parameter.description
        assert parameter.lower < parameter.upper


def test_a_parameter_outside_its_bounds_is_refused_by_name(effect: Effect):
    known = next(p for p in effect.parameters() if p.unit != "text" and np.isfinite(p.upper))
    beyond = 2 * known.upper + 1
    values = EXAMPLES[effect.name] | {known.name: (beyond,) * 3 if known.is_list else beyond}
    with pytest.raises(ValueError, match=rf"{effect.name}, joint 1: {known.name} = .* is outside"):
        type(effect)(joint=1, **values)


def test_nan_is_no_parameter(effect: Effect):
    known = next(p for p in effect.parameters() if p.unit != "text")
    values = EXAMPLES[effect.name] | {known.name: (np.nan,) * 3 if known.is_list else np.nan}
    with pytest.raises(ValueError, match=known.name):
        type(effect)(joint=1, **values)
