"""What a joint of a simulation becomes in files, which have fewer numbers."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from limo_driver.exports.changes.joints import sharp, split, stand_in
from limo_driver.exports.remainder import proof_motion, remainders
from limo_driver.exports.xml_edits import MJCF, URDF
from limo_driver.physics import (
    Armature,
    AsymmetricFriction,
    Backlash,
    CoulombFriction,
    JointElasticity,
    PositionDependentFriction,
    PreslidingHysteresis,
    QuadraticDrag,
    Simulation,
    SpringLoad,
    StribeckFriction,
    TorqueRipple,
    ViscousFriction,
)
from limo_driver.physics.domain import Domain
from limo_driver.physics.effect import JointMotion


def joint(urdf, *effects, target=MJCF, **options):
    """Return what is written of the first joint, and what is left."""
    found = split(Simulation(str(urdf), effects), target, **options)
    return found.joints[0], found.left


def test_effects_of_one_kind_add_up(two_links_urdf):
    written, left = joint(
        two_links_urdf,
        *(CoulombFriction(joint=1, tau_c=tau) for tau in (0.5, 0.2)),
        *(ViscousFriction(joint=1, f_v=slope) for slope in (0.3, 0.4)),
        *(Armature(joint=1, inertia=inertia) for inertia in (0.02, 0.01)),
        *(QuadraticDrag(joint=1, coefficient=drag) for drag in (0.1, 0.3)),
    )
    assert (written.friction, written.damping) == pytest.approx((0.7, 0.7))
    assert (written.armature, written.drag) == pytest.approx((0.03, 0.4))
    assert left == ()


def test_a_joint_has_one_spring(two_links_urdf):
    first, second = (SpringLoad(joint=1, stiffness=k, rest=0.1, cubic=2.0) for k in (3.0, 0.0))
    for one, other in ((first, second), (second, first)):
        written, left = joint(two_links_urdf, one, other)
        assert (written.stiffness, written.rest, written.cubic) == (one.stiffness, 0.1, 2.0)
        assert left == (other,)


def test_a_domain_is_no_number_of_a_file(two_links_urdf):
    slow, own = Domain(speed=0.5, slope=1.0), Domain(speed=0.5)
    spring = SpringLoad(joint=1, stiffness=3.0, rest=0.1, domain=Domain(position=(-1.0, 1.0)))
    for effect in (spring, ViscousFriction(joint=1, f_v=0.3, domain=slow)):
        found = split(Simulation(str(two_links_urdf), (effect,)), MJCF)
        assert found.stand_ins == ((effect, replace(effect, domain=None)),)
    same = ViscousFriction(joint=1, f_v=0.3, domain=own)  # which goes on with its own slope
    assert split(Simulation(str(two_links_urdf), (same,)), MJCF).stand_ins == ()


def test_numbers_that_a_urdf_does_not_have_are_left(two_links_urdf):
    drag, spring = (
        QuadraticDrag(joint=1, coefficient=0.1),
        SpringLoad(joint=1, stiffness=3.0, rest=0.0),
    )
    ripple = TorqueRipple(joint=1, cycles_per_rev=(7.0,), amplitude=(0.2,), phase=(0.3,))
    written, left = joint(
        two_links_urdf, ViscousFriction(joint=1, f_v=0.3), drag, spring, ripple, target=URDF
    )
    assert written.damping == 0.3
    assert left == (drag, spring, ripple)


@pytest.mark.parametrize(
    ("inertia", "with_play", "drag", "written"),
    [
        (0.02, True, None, True),
        (0.0, True, None, False),
        (0.02, False, None, False),
        (0.02, True, 0.5, False),  # the drive lets go in it, and the link stays where it is
    ],
)
def test_play_is_a_hinge_where_the_drive_before_it_has_an_inertia(
    two_links_urdf, inertia, with_play, drag, written
):
    plays = [Backlash(joint=1, gap=gap, drag=drag) for gap in (0.01, 0.02)]
    found, left = joint(
        two_links_urdf, Armature(joint=1, inertia=inertia), *plays, with_play=with_play
    )
    assert found.gap == pytest.approx(0.03 if written else 0.0)
    assert left == (() if written else tuple(plays))


def test_lines_of_a_ripple_have_the_phase_of_what_holds_against_them(two_links_urdf):
    lines = {"cycles_per_rev": (7.0, 9.0, 12.0), "amplitude": (0.2, 0.0, 0.1)}
    ripple = TorqueRipple(joint=1, phase=(0.3, 0.0, -3.0), **lines)
    (first, second) = joint(two_links_urdf, ripple)[0].ripples
    assert (first.amplitude, first.cycles) == (0.2, 7.0)
    assert (second.amplitude, second.cycles) == (0.1, 12.0)
    assert (first.phase, second.phase) == pytest.approx((0.3 - np.pi, np.pi - 3.0))


def test_bristles_have_the_numbers_of_lugre(two_links_urdf):
    law = PreslidingHysteresis(
        joint=1, law="lugre", sigma_0=900.0, sigma_1=2.0, tau_c=0.7, tau_s=0.2, v_s=0.03
    )
    (own,) = joint(two_links_urdf, law)[0].bristles
    assert tuple(own) == pytest.approx((900.0, 2.0, 0.7, 0.9, 0.03))


@pytest.mark.parametrize(
    "law",
    [
        PreslidingHysteresis(joint=1, stiffness=(300.0, 150.0, 75.0), width=(1e-3, 2e-3, 4e-3)),
        PreslidingHysteresis(joint=1, law="dahl", sigma_0=900.0, tau_c=0.7),
        PreslidingHysteresis(joint=1, law="bouc_wen", sigma_0=900.0, tau_c=0.7, beta_ratio=1.0),
    ],
    ids=lambda law: law.law,
)
def test_hysteresis_of_another_law_is_bristles_that_come_near_to_it(law):
    """Bristles half as stiff, or twice, would be wrong by a fifth of the torque and more."""
    q = 0.02 * np.sin(np.linspace(0.0, 20.0, 4000)) * np.linspace(1.0, 0.2, 4000)
    zero = np.zeros_like(q)

    def torque(effect):
        return effect.advance(effect.initial_state(), JointMotion(zero, q, zero, zero, zero))[0]

    true, near = torque(law), torque(stand_in(law, MJCF))
    assert np.std(near - true) < 0.12 * np.std(true)
    dry = stand_in(law, URDF)
    assert dry.tau_c == pytest.approx(np.abs(true).max(), rel=1e-3)


def test_what_has_no_law_of_bristles_has_none():
    relays = PreslidingHysteresis(joint=1, law="preisach", up=(0.1,), down=(-0.1,), weight=(2.0,))
    assert stand_in(relays, MJCF) is None
    assert stand_in(relays, URDF) is None


def test_friction_that_differs_by_direction_has_a_mean():
    dry = stand_in(AsymmetricFriction(joint=1, tau_plus=1.5, tau_minus=0.5, v_eps=0.003), URDF)
    assert dry == CoulombFriction(joint=1, tau_c=1.0, v_eps=0.003)
    wet = stand_in(ViscousFriction(joint=1, f_v_plus=4.0, f_v_minus=2.0), URDF)
    assert wet == ViscousFriction(joint=1, f_v=3.0)


def test_friction_that_varies_with_the_position_has_a_mean_unless_that_drives_the_joint():
    over = PositionDependentFriction(joint=1, positions=(0.0, 1.0, 3.0), excess=(1.0, 1.0, 2.0))
    assert stand_in(over, URDF) == CoulombFriction(joint=1, tau_c=4 / 3, v_eps=over.v_eps)
    assert stand_in(replace(over, excess=(-1.0, 0.5, -1.0)), MJCF) is None


def test_only_what_comes_but_near_is_told_as_a_stand_in(two_links_urdf):
    exact = (
        PreslidingHysteresis(joint=1, law="dahl", sigma_0=900.0, tau_c=0.7),
        PreslidingHysteresis(joint=1, law="bouc_wen", sigma_0=9.0, tau_c=0.7, beta_ratio=1.0),
    )
    near = (
        PreslidingHysteresis(joint=2, law="dahl", sigma_0=900.0, tau_c=0.7, exponent=1.5),
        PreslidingHysteresis(joint=2, law="bouc_wen", sigma_0=9.0, tau_c=0.7, beta_ratio=0.7),
        PreslidingHysteresis(joint=2, stiffness=(900.0,), width=(5e-4,)),
    )
    found = split(Simulation(str(two_links_urdf), (*exact, *near)), MJCF)
    assert [effect for effect, _ in found.stand_ins] == list(near)


def test_what_displaces_a_link_is_left(two_links_urdf):
    soft = JointElasticity(joint=1, stiffness=500.0)
    stribeck = StribeckFriction(joint=1, tau_s=0.2, v_s=0.05)
    assert joint(two_links_urdf, soft, stribeck)[1] == (soft, stribeck)


def test_a_link_that_swings_is_left_to_targets_that_have_its_spring(two_links_urdf):
    swings = JointElasticity(joint=1, stiffness=500.0, damping=0.5)
    simulation = Simulation(str(two_links_urdf), (swings,))
    (left,) = remainders(simulation, split(simulation, MJCF), proof_motion(simulation.model))
    assert str(left).startswith("joint_elasticity, joint 1 is not expressible (a spring")
    assert "`--to c` has it" in str(left)
    assert 0.0 < left.rms[0] < 1.0


def test_a_sign_is_as_sharp_as_other_simulators_have_it():
    """The width over which limo smooths it is none of the physics that was found."""
    assert 0.0 < sharp(CoulombFriction(joint=1, tau_c=0.7, v_eps=0.01)).v_eps < 2e-4
    viscous = ViscousFriction(joint=1, f_v=0.3)
    assert sharp(viscous) is viscous
