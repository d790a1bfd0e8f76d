"""Ordinary friction of a bare description: identified, unless one joint is unlike its siblings."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
from noisy_recordings import observed

from estimators.diagnosis.from_torque.fitting import contribution
from estimators.diagnosis.from_torque.fitting.problem import RegressionProblem, fitted
from estimators.diagnosis.from_torque.hypotheses.candidates import entered
from estimators.diagnosis.from_torque.hypotheses.ripple import ripples as hypotheses_of_ripple
from estimators.diagnosis.from_torque.judgement import ordinary as module
from estimators.diagnosis.from_torque.judgement.ordinary import (
    beyond_siblings,
    convinced,
    ordinary,
    to_identify,
)
from estimators.diagnosis.from_torque.residuals.noise import Noise
from estimators.diagnosis.stages import quiet
from limo_driver.physics import (
    CoulombFriction,
    GravityDirection,
    PreslidingHysteresis,
    Simulation,
    TorqueRipple,
    ViscousFriction,
)

PLAIN = [("coulomb_friction", (j,)) for j in range(7)]


def ordinary_of(places, n=7, stated=()):
    """Return the places that are ordinary beside one another on an arm of n joints."""
    simulation = SimpleNamespace(effects=stated, model=SimpleNamespace(n=n))
    candidates = [
        SimpleNamespace(effect=effect, joints=joints, hypothesis=None) for effect, joints in places
    ]
    problem = SimpleNamespace(
        observed=SimpleNamespace(simulation=simulation), candidates=candidates
    )
    members = range(len(places))
    return [places[i] for i in ordinary(SimpleNamespace(problem=problem, members=members), members)]


def test_coulomb_friction_is_ordinary_wherever_none_is_stated():
    assert ordinary_of(PLAIN) == PLAIN
    assert ordinary_of(PLAIN[:1], n=1) == PLAIN[:1]
    assert ordinary_of(PLAIN, stated=(ViscousFriction(joint=1, f_v=1.0),)) == PLAIN[1:]


@pytest.mark.parametrize("effect", ["presliding_hysteresis", "quadratic_drag", "armature"])
@pytest.mark.parametrize(("count", "usual"), [(1, False), (3, False), (4, True), (7, True)])
def test_what_more_than_half_of_the_joints_have_is_ordinary(effect, count, usual):
    places = [*PLAIN, *((effect, (j,)) for j in range(count))]
    assert ordinary_of(places) == (places if usual else PLAIN)


def test_of_two_joints_none_is_unlike_the_other():
    places = [("coulomb_friction", (0,)), ("quadratic_drag", (1,))]
    assert ordinary_of(places, n=2) == places[:1]
    assert ordinary_of(places[1:], n=1) == []


@pytest.mark.parametrize("effect", ["payload", "spring_load", "torque_offset", "torque_ripple"])
def test_what_is_no_friction_is_never_ordinary(effect):
    assert ordinary_of([(effect, (j,)) for j in range(7)]) == []


def sized(tau_c, simulation):
    """Return a problem whose joints have Coulomb friction of sizes (n,) [N m], and its fit."""
    hypotheses = [CoulombFriction.of_unit_size(j, 0.002) for j in range(1, len(tau_c) + 1)]
    candidates = [
        SimpleNamespace(
            effect=item.effect, joints=item.joints, hypothesis=item,
            prior=SimpleNamespace(index=np.array([k])),
        )
        for k, item in enumerate(hypotheses)
    ]  # fmt: skip
    nothing = SimpleNamespace(prior=SimpleNamespace(index=np.zeros(0)))
    observed = SimpleNamespace(simulation=simulation)
    problem = SimpleNamespace(observed=observed, candidates=candidates, nuisance=nothing)
    fitted = SimpleNamespace(mean=np.array(tau_c))
    return SimpleNamespace(problem=problem, members=tuple(range(len(tau_c))), fitted=fitted)


USUAL = np.array([2.2, 2.4, 1.6, 1.7, 0.9, 0.45, 0.35])  # [N m], of drives of 320 to 40 N m


@pytest.mark.parametrize("joint", range(7))
def test_a_joint_that_binds_is_unlike_its_siblings(joint):
    solution = sized(np.where(np.arange(7) == joint, 8.0, 1.0) * USUAL, Simulation("iiwa14"))
    ((member, times),) = beyond_siblings(solution).items()
    assert member == joint
    part = USUAL / Simulation("iiwa14").model.limits.torque
    assert times == pytest.approx(8.0 * part[joint] / np.delete(part, joint).max())
    assert ordinary(solution, solution.members) == tuple(j for j in range(7) if j != joint)


@pytest.mark.parametrize("limit", [0.0, np.inf])
def test_a_joint_whose_drive_has_no_limit_is_like_its_siblings(limit):
    limits = SimpleNamespace(torque=np.array([320.0] * 6 + [limit]), velocity=np.ones(7))
    arm = SimpleNamespace(effects=(), model=SimpleNamespace(n=7, limits=limits))
    assert beyond_siblings(sized(np.where(np.arange(7) == 6, 300.0, USUAL), arm)) == {}


@pytest.mark.parametrize(("width", "plain"), [(1e-4, True), (2.9e-4, True), (3.1e-4, False)])
def test_presliding_that_is_over_before_a_row_is_judged_is_plain_friction(width, plain):
    """Rows from 3 mrad/s on are judged, in a band of 10 Hz."""
    slip = PreslidingHysteresis(joint=6, stiffness=(0.5 / width,), width=(width,))
    hypothesis = SimpleNamespace(effect=slip.name, realise=lambda _c: (slip,))
    solution = sized(USUAL, Simulation("iiwa14"))
    problem = solution.problem
    problem.observed.bandwidth = 10.0
    index = SimpleNamespace(index=np.array([0]))
    problem.candidates[5] = SimpleNamespace(
        effect=slip.name, joints=(5,), hypothesis=hypothesis, prior=index
    )
    assert (5 in ordinary(solution, solution.members)) == plain


def test_sizes_that_differ_from_drive_to_drive_are_no_more_than_that():
    iiwa = Simulation("iiwa14")
    assert beyond_siblings(sized(USUAL, iiwa)) == {}
    assert beyond_siblings(sized(np.array([0.3, 0.3, 0.2, 0.2, 1.3, 0.5, 0.5]), iiwa)) == {}
    assert beyond_siblings(sized(np.array([2.2, 120.0, 1.6]), iiwa)) == {}  # too few to compare


STATED = tuple(CoulombFriction(joint=j, tau_c=1.0) for j in range(1, 8))


@pytest.mark.parametrize(
    ("places", "unsure", "change", "values"),
    [
        ([("presliding_hysteresis", "missing")], [], 1.0, []),
        ([("presliding_hysteresis", "missing")], [0], 1.0, [0]),
        ([("coulomb_friction", "wrong_parameter")], [], -0.5, []),
        ([("coulomb_friction", "wrong_parameter"), ("quadratic_drag", "missing")], [], -0.5, [0]),
        ([("coulomb_friction", "wrong_parameter"), ("quadratic_drag", "missing")], [], 2.0, []),
        ([("coulomb_friction", "wrong_parameter"), ("quadratic_drag", "missing")], [1], -0.5, [1]),
        ([("quadratic_drag", "wrong_parameter"), ("stribeck_friction", "missing")], [], -0.5, []),
        ([("torque_offset", "missing")], [0], 1.0, []),
    ],
    ids=[
        "sure",
        "unsure",
        "wrong",
        "re-divided",
        "grown",
        "beside an unsure one",
        "law",
        "no friction",
    ],
)
def test_a_law_of_stated_friction_is_a_finding_if_sure_and_no_other_stands_for_it(
    monkeypatch, places, unsure, change, values
):
    """Plain friction that stood for a law that was missing has a lower value beside it."""
    monkeypatch.setattr(module, "convincing", lambda _solution, member: member not in unsure)
    assert list(to_identify(changed(monkeypatch, places, change))) == values


def changed(monkeypatch, places, change, within=0.0, *, other_width=False):
    """Return what was compared where each place changes, within its tolerance of 15 %, and so."""
    monkeypatch.setattr(contribution, "coefficients", lambda *_given: np.array([change]))
    candidates = [
        SimpleNamespace(
            effect=effect,
            kind=kind,
            joints=(2,),
            place=(effect, (2,)),
            hypothesis=None,
            other_width=other_width,
        )
        for effect, kind in places
    ]
    simulation = SimpleNamespace(effects=STATED, model=SimpleNamespace(n=7))
    nuisance = SimpleNamespace(
        of=lambda _places: np.array([False, True]),
        prior=SimpleNamespace(deviation=np.array([0.7, 0.15])),
    )
    problem = SimpleNamespace(
        observed=SimpleNamespace(simulation=simulation),
        candidates=candidates,
        nuisance=nuisance,
        first=None,
    )
    fit = SimpleNamespace(mean=np.array([-0.5, within, change]))
    return SimpleNamespace(problem=problem, members=range(len(places)), fitted=fit)


@pytest.mark.parametrize(
    ("effects", "sure"),
    [
        (["coulomb_friction", "presliding_hysteresis"], (0,)),
        (["presliding_hysteresis", "coulomb_friction"], (1,)),
        (["coulomb_friction"], ()),
        (["torque_gain", "torque_offset"], ()),
    ],
)
def test_of_two_laws_that_can_each_stand_for_the_other_the_likelier_is_sure(
    monkeypatch, effects, sure
):
    """Without one of them nothing is lost, and without both much is."""
    candidates = [SimpleNamespace(effect=effect, joints=(2,)) for effect in effects]
    problem = SimpleNamespace(
        candidates=candidates, less=lambda members, some: tuple(m for m in members if m not in some)
    )

    def having(members):
        gain = float(sum(effects[m] == "coulomb_friction" for m in members))
        return SimpleNamespace(problem=problem, members=members, gain=gain, having=having)

    def alone(solution, _member):
        return len(solution.members) < len(effects)

    monkeypatch.setattr(module, "convincing", alone)
    members = tuple(range(len(effects)))
    assert convinced(having(members), members) == sure


@pytest.mark.parametrize(
    ("within", "change", "values"),
    [(-0.9, 1.2, [0]), (-0.1, -0.2, [0]), (0.0, 3.0, []), (-0.3, -0.2, [])],
)
def test_friction_that_is_but_sharper_or_softer_is_a_value(monkeypatch, within, change, values):
    """Three deviations of its tolerance are 45 %: a change beyond that is a finding."""
    monkeypatch.setattr(module, "convincing", lambda *_given: True)
    places = [("coulomb_friction", "wrong_parameter")]
    found = to_identify(changed(monkeypatch, places, change, within, other_width=True))
    assert list(found) == values


def seen(arm, *effects):
    """Record effects of an arm of two joints."""
    return observed(*effects, robot=str(arm), duration=30.0)


@pytest.mark.parametrize(("amplitude", "detail"), [(0.28, True), (0.6, False)])
def test_little_more_of_a_stated_effect_is_a_value_of_it(arm, amplitude, detail):
    stated = TorqueRipple(joint=1, cycles_per_rev=(14.0,), amplitude=(4.0,), phase=(0.3,))
    other = TorqueRipple(joint=1, cycles_per_rev=(28.0,), amplitude=(amplitude,), phase=(0.1,))
    recorded = seen(arm, stated, other).under(Simulation(str(arm), (stated,)))
    problem = RegressionProblem.of(recorded, quiet)
    (line,) = hypotheses_of_ripple(recorded, recorded.residual, {})
    candidate = entered(line, recorded, problem.columns, problem.level)
    problem = problem.with_candidates([*problem.candidates, candidate])
    noise = Noise.independent(np.full(2, 0.02), problem.split.fitted)
    member = len(problem.candidates) - 1
    found = to_identify(fitted(problem, (member,), noise))
    assert found == ((member,) if detail else ())


def test_a_little_more_tilt_of_an_arm_that_is_known_to_hang_is_no_value_of_a_joint(arm):
    on_a_wall = Simulation(str(arm), (GravityDirection(gravity=(9.81, 0.0, 0.0)),))
    recorded = seen(arm, GravityDirection(gravity=(9.8, 0.0, 0.4))).under(on_a_wall)
    problem = RegressionProblem.of(recorded, quiet)
    noise = Noise.independent(np.full(2, 0.02), problem.split.fitted)
    (member,) = (
        i for i, item in enumerate(problem.candidates) if item.effect == "gravity_direction"
    )

    assert to_identify(fitted(problem, (member,), noise)) == ()
