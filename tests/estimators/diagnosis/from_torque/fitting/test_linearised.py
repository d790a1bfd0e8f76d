"""A fit is taken to its end in all parameters at once, and gives their intervals."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from lanes import sampled
from wandering import wander

from estimators.diagnosis.from_torque.fitting import linearised
from estimators.diagnosis.from_torque.fitting.linearised import Linearised, polished
from estimators.diagnosis.from_torque.hypotheses.catalogue import (
    derivative,
    entries_of,
    found_in,
    moved,
)
from estimators.diagnosis.from_torque.judgement.intervals import with_parameters
from estimators.diagnosis.from_torque.residuals.observations import Observations
from estimators.diagnosis.held_out import rmse
from estimators.diagnosis.verdict import BeforeAfter, Finding, Where
from limo_driver.physics import (
    CoulombFriction,
    GravityDirection,
    JointCoupling,
    JointElasticity,
    Payload,
    PositionDependentFriction,
    PreslidingHysteresis,
    QuadraticDrag,
    Simulation,
    StribeckFriction,
    TimeDelay,
    Tolerances,
    TorqueGain,
    TorqueRipple,
)
from limo_driver.recordings.recording import Recording

RATE, NOISE = 100.0, 0.02  # [Hz], [N m]


@pytest.fixture(scope="module")
def given(arm):
    friction = tuple(CoulombFriction(joint=j, tau_c=1.0) for j in (1, 2))
    return Simulation(str(arm), friction, tolerances=Tolerances(inertia=0.005, friction=0.05))


def observe(true, believed, seed=1, duration=60.0):
    """Record an arm, and lay the recording beside what is believed of it."""
    random = np.random.default_rng(seed)
    t = np.arange(int(duration * RATE)) / RATE
    motion = wander(t, np.array([0.4, -0.8]), random, (0.05, 0.3), (0.05, 0.4))
    torque = true.predict(motion)
    torque += NOISE * random.standard_normal(torque.shape)
    recording = Recording.from_arrays(t, motion.position, torque, source=f"seed {seed}")
    return Observations.of(believed, [recording], 10.0)


def plus(simulation, *effects):
    return replace(simulation, effects=(*simulation.effects, *effects))


def finding(effect, joints, kind="missing"):
    nothing = BeforeAfter((), ())
    return Finding(effect, kind, joints, (), 0.9, {}, Where(), 0.5, nothing, "")


def test_entries_are_the_numbers_that_are_estimated():
    assert [e.name for e in entries_of(JointElasticity(joint=1, stiffness=1e4))] == ["stiffness"]
    ripple = TorqueRipple(joint=1, cycles_per_rev=(7.0,), amplitude=(0.2,), phase=(0.0,))
    assert [(e.name, e.at) for e in entries_of(ripple)] == [
        ("cycles_per_rev", 0),
        ("amplitude", 0),
        ("phase", 0),  # an angle of zero is one of many
    ]
    slip = PreslidingHysteresis(joint=1, stiffness=(30.0, 0.0), width=(0.01, 0.05))
    assert [(e.name, e.at) for e in entries_of(slip)] == [
        ("stiffness", 0),
        ("width", 0),
        ("width", 1),
    ]


def test_an_entry_stays_inside_its_bounds():
    effect = StribeckFriction(joint=1, tau_s=0.2, v_s=0.05, delta=2.0)
    delta = next(e for e in entries_of(effect) if e.name == "delta")
    assert moved(effect, [delta], [9.0]).delta == 4.0
    assert moved(effect, [delta], [-9.0]).delta == 0.5


def test_what_was_added_is_the_last_of_its_kind_and_what_was_changed_the_first(given):
    both = plus(given, CoulombFriction(joint=2, tau_c=0.3))
    assert found_in(both, "coulomb_friction", (2,), missing=True) is both.effects[2]
    assert found_in(both, "coulomb_friction", (2,), missing=False) is both.effects[1]
    assert found_in(both, "backlash", (2,), missing=True) is None


def test_what_a_joint_feels_of_another_is_not_what_the_other_feels_of_it(given):
    one, other = (JointCoupling(joint=j, other=3 - j, f_v=0.1 * j) for j in (1, 2))
    both = plus(given, one, other)
    for effect in (one, other):
        assert found_in(both, "joint_coupling", effect.joints, missing=True) == effect


def test_a_gain_acts_on_the_torque_that_reaches_it_whatever_it_makes_of_it(given):
    """A large gain in the simulation would otherwise be taken for a part of its own input."""
    with_gain = plus(given, TorqueGain(joint=2, gain=-0.6))
    observed = observe(with_gain, with_gain)
    joints, values = derivative(observed, with_gain.effects[2], "gain")
    bare = observed.filter(observed.predict(given))
    assert joints == (1,)
    np.testing.assert_allclose(values[0], -0.6 * bare[:, 1], rtol=1e-6, atol=1e-9)


def test_a_fit_goes_to_its_end_where_effects_act_on_one_another(given):
    slip = PreslidingHysteresis(joint=2, stiffness=(30.0, 10.0), width=(0.01, 0.05))
    true = plus(given, slip, TorqueGain(joint=2, gain=-0.4))
    near = PreslidingHysteresis(joint=2, stiffness=(24.0, 8.0), width=(0.008, 0.06))
    start = plus(given, near, TorqueGain(joint=2, gain=-0.3))
    observed = observe(true, given)
    places = [("presliding_hysteresis", (2,), True), ("torque_gain", (2,), True)]
    found = polished(observed.under(start), observed.simulation, observed.moving, places)
    fitted = found.simulation.effects
    assert fitted[3].gain == pytest.approx(-0.4, abs=0.01)
    np.testing.assert_allclose(fitted[2].stiffness, slip.stiffness, rtol=0.05)
    np.testing.assert_allclose(fitted[2].width, slip.width, rtol=0.05)
    left = found.residual[observed.moving]
    assert np.sqrt(np.mean(left**2)) < 1.05 * np.sqrt(
        np.mean(observed.under(true).residual[observed.moving] ** 2)
    )


def test_where_nothing_else_may_move_what_was_found_goes_to_its_end_alone(given, monkeypatch):
    """Steps of everything that would raise a joint's error are not taken."""
    none = replace(linearised.NEWTON, slack=0.0)  # no step of everything lowers errors to nothing
    monkeypatch.setattr(linearised, "NEWTON", none)
    observed = observe(plus(given, TorqueGain(joint=2, gain=-0.4)), given)
    start = plus(given, TorqueGain(joint=2, gain=-0.2))
    found = polished(
        observed.under(start), observed.simulation, observed.moving, [("torque_gain", (2,), True)]
    )
    assert found.simulation.effects[2].gain == pytest.approx(-0.4, abs=0.01)
    assert found.simulation.effects[:2] == given.effects
    rows = observed.moving
    assert np.all(rmse(found.residual, rows) < 1.01 * rmse(observed.under(start).residual, rows))


def test_a_joint_without_torque_keeps_no_other_from_its_end(given, monkeypatch):
    """It errs by nothing, and nothing is a part of nothing."""
    monkeypatch.setattr(linearised, "NEWTON", replace(linearised.NEWTON, slack=0.0))
    observed = observe(plus(given, TorqueGain(joint=2, gain=-0.4)), given)
    silent = np.broadcast_to([True, False], observed.measured.shape)
    observed = replace(observed, unmeasured=silent)
    start = plus(given, TorqueGain(joint=2, gain=-0.2))
    found = polished(
        observed.under(start), observed.simulation, observed.moving, [("torque_gain", (2,), True)]
    )
    assert found.simulation.effects[2].gain == pytest.approx(-0.4, abs=0.01)
    assert found.simulation.effects[:2] == given.effects  # which a step of everything moves


def test_what_some_rows_say_nothing_of_is_as_given_to_them(given):
    found = (TorqueGain(joint=1, gain=-0.4), TorqueGain(joint=2, gain=-0.4))
    observed = observe(plus(given, *found), given)
    around = Linearised.of(observed.under(plus(given, *found)), found, stated=given)
    some = np.arange(len(observed.moving))[:, None] % 5 > 0
    taught = around.learned_from(observed.moving & some & [True, False], given).simulation
    assert taught.effects[2].gain == pytest.approx(-0.4, abs=0.01)
    assert taught.effects[3].gain == pytest.approx(0.0, abs=1e-6)


@pytest.mark.parametrize(("of_short", "taken"), [(1.1, True), (1.5, False)])
def test_a_joint_that_hardly_moved_counts_as_the_others_do(given, monkeypatch, of_short, taken):
    """Its few rows are nothing beside the sum of squares of the other's."""
    observed = observe(given, given, duration=20.0)
    trial = SimpleNamespace(residual=observed.residual * [0.2, of_short])
    for name, returned in (("_newton", None), ("_shorter", [trial])):
        monkeypatch.setattr(Linearised, name, lambda *_, returned=returned: returned)
    rows = observed.moving & (np.arange(len(observed.moving))[:, None] < [np.inf, 100])
    assert Linearised.of(observed, ()).step(rows) is (trial if taken else None)


def test_a_fit_that_is_at_its_end_stays(given):
    observed = observe(given, given)
    once = polished(observed.under(given), observed.simulation, observed.moving, [])
    assert Linearised.of(once, ()).step(observed.moving) is None


@sampled(
    "inertia",
    [
        (0.0, 0.0, 0.0, 0.0, 0.0, 0.0),  # a point
        (1e-5, 0.0, 0.0, 1e-5, 0.0, 1e-5),  # smaller than a step of one moment
        (0.005, 0.0, 0.0, 0.005, 0.0, 0.01),  # a thin disc, at the edge of what can exist
    ],
    "fits an arm of seven joints each",
)
def test_bodies_that_no_single_moment_can_leave_are_fitted(given, inertia):
    load = Payload(mass=0.3, com=(0.1, 0.0, 0.0), inertia=inertia)
    start = plus(given, replace(load, mass=0.2))
    observed = observe(plus(given, load), given)
    found = polished(
        observed.under(start), observed.simulation, observed.moving, [("payload", (1, 2), True)]
    )
    assert found.simulation.effects[2].mass == pytest.approx(0.3, abs=0.05)


def test_a_fit_stays_inside_the_tolerances_of_what_is_stated(given):
    """However many steps it takes: three deviations of 5 % are the reach."""
    true = replace(given, effects=(replace(given.effects[0], tau_c=1.6), given.effects[1]))
    observed = observe(true, given)
    found = polished(observed.under(given), observed.simulation, observed.moving, [])
    assert found.simulation.effects[0].tau_c == pytest.approx(1.15, abs=1e-6)


@pytest.mark.slow("fits ten draws of noise")
def test_intervals_hold_the_truth_as_often_as_they_say(given):
    """Settings that the torque is not linear in have intervals, too."""
    dip = StribeckFriction(joint=1, tau_s=0.4, v_s=0.05, delta=1.5)
    true, held = plus(given, dip), []
    for seed in range(10):
        observed = observe(true, given, seed)
        place = [("stribeck_friction", (1,), True)]
        off = plus(given, replace(dip, tau_s=0.32, v_s=0.06))
        found = polished(observed.under(off), observed.simulation, observed.moving, place)
        (said,) = with_parameters([finding("stribeck_friction", (1,))], found)
        for name in ("tau_s", "v_s", "delta"):
            low, high = said.parameters[name].ci95
            assert low < said.parameters[name].value < high
            half = (high - low) / 2
            held.append((said.parameters[name].value - getattr(dip, name)) / half)
    assert 0.25 < np.sqrt(np.mean(np.square(held))) < 0.8  # of a right one 1 / 1.96


def test_intervals_are_as_wide_as_values_scatter(given):
    """Errors of ten draws of noise and two joints, over half of the interval of each."""
    drags = [QuadraticDrag(joint=j, coefficient=c) for j, c in ((1, 3.0), (2, 1.0))]
    places = [(drag.name, (drag.joint,), True) for drag in drags]
    true, errors = plus(given, *drags), []
    for seed in range(10):
        observed = observe(true, true, seed, duration=12.0)
        found = polished(observed, observed.simulation, observed.moving, places)
        said = with_parameters([finding(drag.name, (drag.joint,)) for drag in drags], found)
        for item, drag in zip(said, drags, strict=True):
            value = item.parameters["coefficient"]
            low, high = value.ci95
            errors.append((value.value - drag.coefficient) / ((high - low) / 2))
    assert 0.3 < np.sqrt(np.mean(np.square(errors))) < 0.75  # of a right one 1 / 1.96


def half_widths(found, effect, joint, name):
    """Return half of the intervals of what was found, an array."""
    (said,) = with_parameters([finding(effect, (joint,))], found)
    return np.diff(np.reshape(said.parameters[name].ci95, (-1, 2)))[:, 0] / 2


def test_friction_that_is_free_everywhere_takes_no_part_of_what_is_stated(given):
    """Its heights would have no interval else: what they all have could as well be the other's."""
    heights = (0.0, 0.0, 0.3, 0.0, 0.0)
    bump = PositionDependentFriction(
        joint=2, positions=tuple(np.linspace(-1.6, 0.0, 5)), excess=heights
    )
    observed = observe(plus(given, bump), given)
    start = plus(given, replace(bump, excess=(0.1,) * 5))
    place = [("position_dependent_friction", (2,), True)]
    found = polished(observed.under(start), observed.simulation, observed.moving, place)
    assert found.simulation.effects[1].tau_c == 1.0
    np.testing.assert_allclose(found.simulation.effects[2].excess, heights, atol=0.02)
    assert half_widths(found, "position_dependent_friction", 2, "excess").max() < 0.02


def test_a_lag_of_a_sensor_is_made_up_for_by_no_value_of_the_simulation(given):
    true = plus(given, TorqueGain(joint=2, gain=-0.4))
    observed = observe(plus(true, TimeDelay(joint=2, lag=5e-4)), given)
    start = plus(given, TorqueGain(joint=2, gain=-0.3))
    found = polished(
        observed.under(start), observed.simulation, observed.moving, [("torque_gain", (2,), True)]
    )
    assert found.simulation.effects[2].gain == pytest.approx(-0.4, abs=0.002)


def test_a_delay_that_was_found_is_all_of_it(given):
    """A sensor's own lag beside it would leave neither determined."""
    late = TimeDelay(joint=2, delay=0.02)
    observed = observe(plus(given, late), given)
    found = observed.under(plus(given, late))
    around = Linearised.of(found, found.simulation.effects[2:])
    held = {
        item.name
        for item, deviation in zip(
            around.nuisance.parameters, around.known.deviation.tolist(), strict=True
        )
        if deviation == 0.0
    }
    assert held == {"lag of sensor 2"}


def test_intervals_are_those_of_the_best_fit_where_a_simulation_is_not_quite_it(given):
    """Scores of a value that is off are all of one sign, which is no spread."""
    load = Payload(mass=0.3, com=(0.1, 0.0, 0.0), inertia=(0.005, 0.0, 0.0, 0.005, 0.0, 0.01))
    observed = observe(plus(given, load), given)
    near = plus(given, replace(load, mass=0.31))
    best, off = (
        half_widths(observed.under(one), "payload", 2, "mass") for one in (plus(given, load), near)
    )
    np.testing.assert_allclose(off, best, rtol=0.15)


def test_what_joints_disagree_about_is_less_sure(given):
    """A gain of one joint that nobody knows: its load is another than the other joint has."""
    load = Payload(mass=0.3, com=(0.1, 0.0, 0.0), inertia=(0.005, 0.0, 0.0, 0.005, 0.0, 0.01))
    with_load = plus(given, load)
    alike, torn = (
        half_widths(observe(true, given).under(with_load), "payload", 2, "mass")
        for true in (with_load, plus(with_load, TorqueGain(joint=2, gain=0.04)))
    )
    assert (torn > 1.5 * alike).all()


def test_one_joint_disagrees_with_none():
    """However far its values are from where they are known to be."""
    gram, best = 9.0 * np.eye(2), np.array([4.0, -3.0])
    information = linearised._Information(gram[None], (10.0 * best)[None], ())
    assert information.best == pytest.approx(best)
    assert information.disagreement() == 1.0


def test_a_wrong_body_has_intervals_as_narrow_as_motion_shows_it(given):
    """It turns about its y axis only."""
    body = given.model.inertials["lower"]
    true = replace(given, inertials={"lower": replace(body, mass=1.3 * body.mass)})
    observed = observe(true, true)
    (said,) = with_parameters([finding("link_inertia", (2,), "wrong_parameter")], observed)
    low, high = said.parameters["mass"].ci95
    assert 0.8 < low < 1.3 < high < 1.8
    xx, xy, xz, yy, yz, zz = said.parameters["inertia"].ci95
    assert min(xx[0], zz[0]) > 0.0
    assert max(*xy, *xz, *yz) < zz[1] - 0.01  # products are known better than moments
    assert 4 * np.diff(yy) < np.diff(zz)  # both moments are 0.01 kg m^2


def test_a_finding_without_an_effect_in_the_simulation_stays_as_it_is(given):
    observed = observe(given, given)
    some = [finding("external_contact", (1, 2)), finding("unknown", (2,))]
    assert with_parameters(some, observed) == tuple(some)


def test_a_fit_turns_gravity_and_makes_it_no_stronger():
    effect = GravityDirection(gravity=(0.0, 3.0, -9.0))
    turned = moved(effect, entries_of(effect), (0.5, 0.0, -4.0))
    assert np.linalg.norm(turned.gravity) == pytest.approx(np.hypot(3.0, 9.0))
    assert turned.gravity[0] / turned.gravity[2] == pytest.approx(0.5 / -13.0)
