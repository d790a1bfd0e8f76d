import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from limo_driver.physics import PreslidingHysteresis
from limo_driver.physics.effect import JointMotion

LAW = PreslidingHysteresis(joint=1, stiffness=(900.0, 120.0), width=(5e-4, 4e-3))
SLIDING = 900.0 * 5e-4 + 120.0 * 4e-3


def torque(effect: PreslidingHysteresis, position: np.ndarray) -> np.ndarray:
    zero = np.zeros_like(position)
    return effect.advance(
        effect.initial_state(), JointMotion(zero, np.ascontiguousarray(position), zero, zero, zero)
    )[0]


def test_small_motion_is_a_spring():
    q = np.linspace(0, 4e-4, 50)
    np.testing.assert_allclose(torque(LAW, q), (900 + 120) * q, atol=1e-12)


def test_it_slides_at_the_sum_of_the_elements():
    assert torque(LAW, np.linspace(0, 0.1, 1000))[-1] == pytest.approx(SLIDING)


def test_the_loop_depends_on_the_path_and_not_on_its_speed():
    there_and_back = np.concatenate([np.linspace(0, 0.01, 400), np.linspace(0.01, -0.01, 800)])
    fast = torque(LAW, there_and_back[::8])
    np.testing.assert_allclose(torque(LAW, there_and_back)[::8], fast, atol=0.02)


def test_the_area_of_a_closed_loop_is_the_analytic_one():
    """One element between ±Q dissipates 4 k w (Q - w) a cycle."""
    k, w, Q = 500.0, 1e-3, 0.02
    element = PreslidingHysteresis(joint=1, stiffness=(k,), width=(w,))
    q = Q * np.sin(np.linspace(0, 4 * np.pi, 40001))
    tau = torque(element, q)
    second = slice(20000, None)
    area = np.trapezoid(tau[second], q[second])
    assert area == pytest.approx(4 * k * w * (Q - w), rel=1e-4)


@given(st.lists(st.floats(-0.05, 0.05), min_size=2, max_size=60))
def test_a_closed_inner_loop_leaves_no_trace(inner):
    """Wiping out: after any detour within the last reversal, the outer branch goes on as before."""
    low, high = -0.06, 0.06
    direct = np.array([low, high, 0.0, high])
    detour = np.array([low, high, *(0.5 * high + np.array(inner) * 0.1), high])
    assert torque(LAW, detour)[-1] == pytest.approx(torque(LAW, direct)[-1], abs=1e-9)


@given(st.lists(st.floats(-1, 1), min_size=2, max_size=200))
def test_the_torque_never_exceeds_sliding(path):
    assert np.abs(torque(LAW, np.array(path))).max() <= SLIDING * (1 + 1e-12)


def test_an_unknown_law_is_refused_with_the_known_ones():
    with pytest.raises(ValueError, match="'duhem' is unknown; known: maxwell_slip"):
        PreslidingHysteresis(joint=1, law="duhem", stiffness=(1.0,), width=(1.0,))


def test_stiffness_and_width_come_in_pairs():
    with pytest.raises(ValueError, match="2 stiffness, 1 width; each entry needs all"):
        PreslidingHysteresis(joint=1, stiffness=(1.0, 2.0), width=(0.1,))
