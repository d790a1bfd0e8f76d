"""Presliding hysteresis and play."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from limo_driver.physics import (
    AsymmetricFriction,
    Backlash,
    CoulombFriction,
    PreslidingHysteresis,
    ViscousFriction,
)
from limo_driver.physics.effect import DiagnosisContext, JointMotion
from limo_driver.physics.effects.laws import STEP, dahl
from limo_driver.physics.effects.play import DRAGGED_GAPS, MOST_DRAG

LAW = PreslidingHysteresis(joint=1, stiffness=(900.0, 120.0), width=(5e-4, 4e-3))
SLIDING = 900.0 * 5e-4 + 120.0 * 4e-3


def torque(effect: PreslidingHysteresis, position: np.ndarray, velocity: float = 0.0) -> np.ndarray:
    zero = np.zeros_like(position)
    motion = JointMotion(zero, position, zero + velocity, zero, zero)
    return effect.advance(effect.initial_state(), motion)[0]


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


SMOOTH = (
    {"law": "lugre", "sigma_0": 1000.0, "tau_c": 2.0},
    {"law": "dahl", "sigma_0": 1000.0, "tau_c": 2.0},
    {"law": "dahl", "sigma_0": 1000.0, "tau_c": 2.0, "exponent": 0.5},
    {"law": "dahl", "sigma_0": 1000.0, "tau_c": 2.0, "exponent": 2.0},
    {"law": "bouc_wen", "sigma_0": 1000.0, "tau_c": 2.0},
    {"law": "bouc_wen", "sigma_0": 1000.0, "tau_c": 2.0, "beta_ratio": 0.7, "exponent": 2.0},
)


@pytest.mark.parametrize("values", SMOOTH, ids=str)
def test_smooth_laws_start_at_their_stiffness_and_slide_at_their_friction(values):
    law = PreslidingHysteresis(joint=1, **values)
    start = torque(law, np.array([0.0, 1e-8]))[-1]
    assert start == pytest.approx(law.initial_stiffness * 1e-8, rel=1e-3)
    # Dahl's of exponent 2 and Bouc-Wen's approach their end slowly.
    assert torque(law, np.linspace(0, 10.0, 2000))[-1] == pytest.approx(2.0, rel=1e-3)


@pytest.mark.parametrize("values", SMOOTH, ids=str)
def test_smooth_laws_do_not_depend_on_the_sampling(values):
    law = PreslidingHysteresis(joint=1, **values)
    path = np.concatenate([np.linspace(0, 0.01, 641), np.linspace(0.01, 0.004, 641)[1:]])
    np.testing.assert_allclose(torque(law, path[::64])[-1], torque(law, path)[-1], atol=1e-5)


@given(path=st.lists(st.floats(-0.02, 0.02), min_size=2, max_size=60))
@pytest.mark.parametrize("values", SMOOTH, ids=str)
def test_a_closed_path_never_yields_energy(values, path):
    law = PreslidingHysteresis(joint=1, **values)
    corners = np.array([0.0, *path, 0.0, *path, 0.0])
    fine = np.interp(
        np.linspace(0, corners.size - 1, 20 * corners.size), np.arange(corners.size), corners
    )
    tau = torque(law, fine)
    second = slice(fine.size // 2, None)
    stored = 2.0**2 / 1000.0  # at most what its spring holds
    assert np.trapezoid(tau[second], fine[second]) >= -stored
    assert np.abs(tau).max() <= 2.0 * (1 + 1e-9)


def test_dahl_of_exponent_1_and_lugre_without_stribeck_are_the_same_law():
    path = 0.01 * np.sin(np.linspace(0, 20, 500)) * np.linspace(1, 0.2, 500)
    lugre, other = (PreslidingHysteresis(joint=1, **SMOOTH[i]) for i in (0, 1))
    np.testing.assert_allclose(torque(lugre, path), torque(other, path), atol=1e-9)


@pytest.mark.parametrize("exponent", [0.5, 1.0, 2.0])
def test_dahl_that_slides_goes_on_sliding(exponent):
    path = np.zeros((3, 4))
    path[STEP] = 0.01
    np.testing.assert_array_equal(dahl(np.array([2.0]), path, 1000.0, 2.0, exponent), 2.0)


@pytest.mark.parametrize("v", [0.05, -0.05, 0.01])
def test_bristles_of_lugre_damp_while_they_bend_and_not_where_they_slide(v):
    """At rest dz/dt = dq; where the joint slides dz/dt = 0, and the law is Stribeck's."""
    values = {"sigma_0": 1000.0, "sigma_1": 30.0, "tau_c": 2.0, "tau_s": 0.5, "v_s": 0.02}
    law = PreslidingHysteresis(joint=1, law="lugre", **values)
    found = torque(law, np.sign(v) * np.linspace(0.0, 0.1, 1001), v)
    assert found[0] == pytest.approx(30.0 * v)
    assert found[-1] == pytest.approx(np.sign(v) * (2.0 + 0.5 * np.exp(-((v / 0.02) ** 2))))


def test_relays_switch_at_their_thresholds_and_keep_what_they_are_between():
    law = PreslidingHysteresis(joint=1, law="preisach", up=(0.1,), down=(-0.1,), weight=(2.0,))
    path = np.array([-0.5, 0.0, 0.09, 0.11, 0.0, -0.09, -0.11, 0.0])
    np.testing.assert_allclose(torque(law, path), [-2, -2, -2, 2, 2, 2, -2, -2])


def test_an_unknown_law_is_refused_with_the_known_ones():
    with pytest.raises(ValueError, match="'duhem', expected one of maxwell_slip"):
        PreslidingHysteresis(joint=1, law="duhem", stiffness=(1.0,), width=(1.0,))


def test_stiffness_and_width_come_in_pairs():
    with pytest.raises(ValueError, match="2 stiffness, 1 width; each entry needs all"):
        PreslidingHysteresis(joint=1, stiffness=(1.0, 2.0), width=(0.1,))


TRIED = [
    *PreslidingHysteresis.at_joint(1, None),
    *PreslidingHysteresis.further_laws(PreslidingHysteresis.lugre(1, 4e-3, 0.15, 0.01)),
]


@pytest.mark.parametrize("hypothesis", TRIED, ids=lambda item: f"{item.law} {item.settings}")
def test_what_is_tried_of_a_law_is_of_unit_size(hypothesis):
    """So that a coefficient of a fit is the friction of a joint that slides [N m]."""
    for term in hypothesis.terms:
        far = torque(term, np.linspace(0.0, 10.0, 4000), velocity=1.0)[-1]
        assert far == pytest.approx(1.0, rel=1e-3)
        ((_, width), *_) = term.stops()
        assert 0.9 < torque(term, np.linspace(0.0, 2.0 * width, 400), velocity=1.0)[-1] <= 1.0
        assert torque(term, np.linspace(0.0, 0.1 * width, 400), velocity=1.0)[-1] < 0.5
    (found,) = hypothesis.realise(np.full(len(hypothesis.terms), 0.7))
    far = torque(found, np.linspace(0.0, 10.0, 4000), velocity=1.0)[-1]
    assert far == pytest.approx(0.7 * len(hypothesis.terms), rel=1e-3)


def test_shapes_that_are_tried():
    """They decide what can be found at all, which otherwise only whole diagnoses show."""
    widths, shapes = (1e-3, 4e-3, 0.016), {"LuGre": (0.15, 0.01), "Bouc-Wen": (0.7, 1.5)}
    slip, *laws, dahl = TRIED
    assert [term.width[0] for term in slip.terms] == pytest.approx(np.geomspace(3e-4, 0.25, 9))
    tried = [(law, (width, *shape)) for width in widths for law, shape in shapes.items()]
    assert [(item.law, item.settings) for item in laws] == tried
    assert (dahl.law, dahl.settings) == ("Dahl", (4e-3, 1.5))
    assert {item.law: item.bounds for item in (*laws, dahl)} == {
        "LuGre": ((1e-4, 0.1), (1e-3, 1.0), (2e-3, 0.1)),
        "Bouc-Wen": ((1e-4, 0.1), (0.5, 1.0), (0.5, 3.0)),
        "Dahl": ((1e-4, 0.1), (0.3, 4.0)),
    }


@pytest.mark.parametrize(
    "hypothesis", [item for item in TRIED if item.bounds], ids=lambda item: item.law
)
def test_settings_of_a_law_are_sought_as_far_as_a_simulation_may_have_them(hypothesis):
    for k, (low, high) in enumerate(hypothesis.bounds):
        assert low < hypothesis.settings[k] < high
        for end in (low, high):
            settings = [*hypothesis.settings]
            settings[k] = end
            (found,) = hypothesis.family(*settings).realise(np.ones(1))
            assert found.law == hypothesis.terms[0].law


DRY = CoulombFriction(joint=2, tau_c=3.0, v_eps=0.01)


def recorded(*effects):
    return DiagnosisContext(
        position=np.zeros((10, 2)),
        temperature=None,
        start=0.0,
        end=1.0,
        longest=1.0,
        gravity=np.array([0.0, 0.0, -9.81]),
        effects=effects,
        inertia=np.ones(2),
    )


def drags_at(joint, *effects):
    every = Backlash.at_joint(joint, recorded(*effects))
    return [item for item in every if not item.terms[0].displaces]


@pytest.mark.parametrize(
    ("effects", "dry"),
    [
        ((DRY,), 3.0),
        ((AsymmetricFriction(joint=2, tau_plus=4.0, tau_minus=2.5),), 2.5),
        ((DRY, CoulombFriction(joint=1, tau_c=9.0), ViscousFriction(joint=2, f_v=5.0)), 3.0),
    ],
)
def test_a_drag_is_part_of_the_dry_friction_of_its_joint(effects, dry):
    found = drags_at(2, *effects)
    assert [item.settings for item in found] == [(gap,) for gap in DRAGGED_GAPS]
    assert [item.most for item in found] == [MOST_DRAG * dry] * len(found)
    refined = found[0].family(2e-4)
    assert (refined.most, refined.settings) == (MOST_DRAG * dry, (2e-4,))


def test_no_drag_is_looked_for_where_nothing_rubs():
    assert drags_at(1, DRY) == []
    assert len(drags_at(2, DRY)) == len(DRAGGED_GAPS)
