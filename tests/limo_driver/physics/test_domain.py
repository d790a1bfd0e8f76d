"""Beyond the motion that a law was learned from, it goes on as its simplest part does."""

from dataclasses import replace

import numpy as np
import pytest

from limo_driver.errors import ConfigError, ParameterError
from limo_driver.physics import (
    CoulombFriction,
    PositionDependentFriction,
    QuadraticDrag,
    Simulation,
    SpringLoad,
    TemperatureDependentFriction,
    TorqueRipple,
    ViscousFriction,
)
from limo_driver.physics.domain import Domain
from limo_driver.types import JointSample, Motion

SPRING = SpringLoad(joint=2, stiffness=10.0, rest=0.0, cubic=50.0)
RIPPLE = TorqueRipple(joint=2, cycles_per_rev=(3.0,), amplitude=(2.0,), phase=(0.4,))
KNOTS = PositionDependentFriction(joint=2, positions=(-0.5, 0.5), excess=(1.0, 2.0))
HALF = Domain(position=(-0.5, 0.5))


def torque(effect, position=0.0, velocity=0.0, temperature=None):
    """Return what an effect of joint 2 adds at rest or on the way [N m]."""
    motion = moved(position, velocity, temperature)
    simulation = Simulation("iiwa14", (effect,))
    return (simulation.predict(motion) - simulation.without_effects().predict(motion))[:, 1]


def moved(position, velocity, temperature=None):
    q, v = np.broadcast_arrays(np.atleast_1d(position), np.atleast_1d(velocity))
    none = np.zeros((q.size, 7))
    at, going = none.copy(), none.copy()
    at[:, 1], going[:, 1] = q, v
    warm = None if temperature is None else none + temperature
    return Motion(0.1 * np.arange(q.size), at, going, none, warm)


@pytest.mark.parametrize("effect", [SPRING, RIPPLE, KNOTS])
def test_in_its_domain_a_law_is_itself(effect):
    q = np.linspace(-0.5, 0.5, 11)
    np.testing.assert_allclose(
        torque(replace(effect, domain=HALF), q, 0.1), torque(effect, q, 0.1), atol=1e-9
    )


def test_a_spring_goes_on_linearly():
    there = torque(replace(SPRING, domain=HALF), [0.5, 1.5, -1.5])
    np.testing.assert_allclose(there, [11.25, 21.25, -21.25])


@pytest.mark.parametrize(("effect", "mean"), [(RIPPLE, 0.0), (KNOTS, 1.5)])
def test_what_varies_with_the_position_fades_to_its_mean_over_the_range_that_was_seen(effect, mean):
    limited, q = replace(effect, domain=HALF), np.array([1.0, 1.5, 9.0])
    varies = torque(effect, q, 0.1) - mean
    np.testing.assert_allclose(torque(limited, q, 0.1), mean + varies * [0.5, 0.0, 0.0], atol=1e-9)
    np.testing.assert_allclose(torque(limited, -9.0, -0.1), -mean, atol=1e-9)


def test_the_mean_of_friction_is_that_over_its_range_wherever_its_positions_lie():
    uneven = replace(KNOTS, positions=(-0.5, 0.4, 0.5), excess=(1.0, 1.0, 3.0))
    assert uneven.mean == pytest.approx(1.1)
    alone = replace(KNOTS, positions=(0.2,), excess=(0.7,), domain=HALF)
    np.testing.assert_allclose(torque(alone, 9.0, 0.1), 0.7)


@pytest.mark.parametrize(
    ("effect", "slope", "added"),
    [
        (ViscousFriction(joint=2, f_v=9.0), None, 9.0),
        (ViscousFriction(joint=2, f_v=9.0), 2.0, 2.0),
        (ViscousFriction(joint=2, f_v_plus=9.0, f_v_minus=4.0), 2.0, 2.0),
        (QuadraticDrag(joint=2, coefficient=3.0), None, 3.0),
        (QuadraticDrag(joint=2, coefficient=3.0), 1.0, 1.0),
    ],
)
def test_friction_goes_on_with_a_slope(effect, slope, added):
    """That is the one that was stated, or its own at the end."""
    limited = replace(effect, domain=Domain(speed=0.5, slope=slope))
    end, far = torque(limited, velocity=[0.5, 2.5])
    assert far - end == pytest.approx(2.0 * added)
    assert end == pytest.approx(float(torque(effect, velocity=0.5)[0]))
    if effect.coefficients[0] == effect.coefficients[-1]:
        np.testing.assert_allclose(torque(limited, velocity=-2.5), -far)


def test_warmth_beyond_what_was_seen_is_as_at_its_end():
    effect = TemperatureDependentFriction(
        joint=2, per_kelvin=-0.1, reference=30.0, domain=Domain(temperature=(20.0, 40.0))
    )
    at_end, beyond = (torque(effect, 0.0, 0.5, warm) for warm in (40.0, 70.0))
    np.testing.assert_allclose(beyond, at_end)
    assert at_end[0] == pytest.approx(-1.0)


def test_sample_by_sample_it_is_the_same():
    effects = (
        replace(SPRING, domain=HALF),
        replace(RIPPLE, domain=HALF),
        ViscousFriction(joint=2, f_v=9.0, domain=Domain(speed=0.5, slope=2.0)),
    )
    simulation, motion = Simulation("iiwa14", effects), moved(np.linspace(-2, 2, 9), 1.0)
    state, found = simulation.init(), []
    for k in range(9):
        sample = JointSample(
            motion.time[k], motion.position[k], motion.velocity[k], motion.acceleration[k]
        )
        value, state = simulation.step(state, sample)
        found.append(value)
    np.testing.assert_allclose(found, simulation.predict(motion), atol=1e-9)


def test_it_is_read_as_it_was_written(tmp_path):
    warm = TemperatureDependentFriction(joint=1, per_kelvin=0.1, domain=Domain(temperature=(1, 2)))
    effects = (
        replace(SPRING, domain=HALF),
        ViscousFriction(joint=2, f_v=9.0, domain=Domain(speed=0.5, slope=2.0)),
        warm,
        CoulombFriction(joint=3, tau_c=1.0),
    )
    Simulation("iiwa14", effects).save(tmp_path / "sim.yaml")
    assert Simulation.load(tmp_path / "sim.yaml").effects == effects


@pytest.mark.parametrize(
    ("domain", "message"),
    [
        ("{speed: 1.0}", "line 6.*has no 'speed'; it has position"),
        ("{position: [1.0]}", "position is .*expected a list of 2 numbers"),
        ("{position: [1.0, -1.0]}", "position is .*numbers that increase"),
        ("{position: [a, b]}", "position"),
    ],
)
def test_a_mistake_in_it_is_named(tmp_path, domain, message):
    path = tmp_path / "sim.yaml"
    spring = "effect: spring_load\n  joint: 2\n  stiffness: 1.0\n"
    path.write_text(f"robot: iiwa14\neffects:\n- {spring}  domain: {domain}\n  rest: 0.0\n")
    with pytest.raises(ConfigError, match=message):
        Simulation.load(path)


def test_a_law_that_goes_on_as_it_is_has_no_domain(tmp_path):
    path = tmp_path / "sim.yaml"
    path.write_text(
        "robot: iiwa14\neffects:\n"
        "- {effect: coulomb_friction, joint: 1, tau_c: 1.0, domain: {speed: 1.0}}\n"
    )
    with pytest.raises(ConfigError, match="has no 'domain'"):
        Simulation.load(path)


def test_limits_in_the_wrong_order_are_refused():
    with pytest.raises(ParameterError, match="domain"):
        Domain(position=(1.0, 0.0))


def test_two_domains_together_are_the_motion_of_both():
    both = Domain(position=(0.0, 1.0), speed=1.0, slope=2.0).joined(
        Domain(position=(-1.0, 0.5), speed=3.0)
    )
    assert both == Domain(position=(-1.0, 1.0), speed=3.0, slope=2.0)
    assert both.joined(None) == both
    assert str(both) == "positions -1 to 1 rad, speeds up to 3 rad/s"
