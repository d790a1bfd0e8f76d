import numpy as np
import pytest

from limo_driver.physics import (
    AsymmetricFriction,
    CoulombFriction,
    QuadraticDrag,
    Simulation,
    StribeckFriction,
    ViscousFriction,
)
from limo_driver.types import Motion

V = np.linspace(-0.3, 0.3, 41)
LAWS = [
    (CoulombFriction(joint=3, tau_c=2.2), 2.2 * np.tanh(V / 0.002)),
    (
        AsymmetricFriction(joint=1, tau_plus=1.5, tau_minus=0.5, v_eps=0.003),
        np.where(V > 0, 1.5, 0.5) * np.tanh(V / 0.003),
    ),
    (ViscousFriction(joint=2, f_v=4.0), 4.0 * V),
    (ViscousFriction(joint=2, f_v_plus=4.0, f_v_minus=2.0), np.where(V > 0, 4.0, 2.0) * V),
    (QuadraticDrag(joint=7, coefficient=3.0), 3.0 * V * np.abs(V)),
    (
        StribeckFriction(joint=1, tau_s=0.4, v_s=0.02, delta=1.5),
        0.4 * np.exp(-(np.abs(V / 0.02) ** 1.5)) * np.tanh(V / 0.002),
    ),
]


@pytest.mark.parametrize(("friction", "expected"), LAWS, ids=lambda v: getattr(v, "name", ""))
def test_each_law_is_its_equation(friction, expected):
    np.testing.assert_allclose(friction.torque(V), expected, rtol=0, atol=1e-13)
    np.testing.assert_allclose(friction.torque(V[::-2]), expected[::-2], rtol=0, atol=1e-13)


def test_frictions_of_a_simulation_act_on_their_joints_and_add_up():
    zero = np.zeros((V.size, 7))
    motion = Motion(np.arange(V.size) * 1e-3, zero, V[:, None] * np.ones(7), zero)
    simulation = Simulation("iiwa14", tuple(friction for friction, _ in LAWS))
    added = simulation.predict(motion) - simulation.without_effects().predict(motion)
    expected = zero.copy()
    for friction, torque in LAWS:
        expected[:, friction.joint - 1] += torque
    np.testing.assert_allclose(added, expected, rtol=0, atol=1e-12)


def test_coulomb_is_its_plateau_while_sliding():
    friction = CoulombFriction(joint=1, tau_c=2.2, v_eps=0.002)
    np.testing.assert_allclose(friction.torque(np.array([-0.1, 0.0, 0.1])), [-2.2, 0.0, 2.2])


def test_stribeck_fades_with_speed_and_never_with_direction():
    friction = StribeckFriction(joint=1, tau_s=0.8, v_s=0.02, delta=2.0)
    v = np.array([0.01, 0.02, 0.1])
    torque = friction.torque(v)
    np.testing.assert_allclose(torque[1], 0.8 * np.exp(-1), rtol=1e-6)
    assert torque[0] > torque[1] > torque[2] > 0
    np.testing.assert_allclose(friction.torque(-v), -torque)
