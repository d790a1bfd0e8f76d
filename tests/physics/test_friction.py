import numpy as np

from limo_driver.physics import CoulombFriction, StribeckFriction


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
