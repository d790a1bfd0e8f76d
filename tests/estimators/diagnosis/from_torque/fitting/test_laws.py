"""Laws: which equation an effect follows, and how much likelier it is than the next."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from lanes import sampled

from estimators.diagnosis import diagnose
from estimators.diagnosis.from_torque.fitting import laws
from estimators.diagnosis.from_torque.fitting.laws import confused, sentence_of
from estimators.diagnosis.from_torque.fitting.problem import RegressionProblem, fitted
from estimators.diagnosis.from_torque.fitting.settling import refined
from estimators.diagnosis.from_torque.hypotheses.candidates import LawEvidence
from estimators.diagnosis.from_torque.hypotheses.catalogue import every, rivals
from estimators.diagnosis.from_torque.residuals.noise import Noise
from estimators.diagnosis.from_torque.residuals.observations import Observations
from estimators.diagnosis.stages import quiet
from estimators.regression.evidence import Prior
from limo_driver.physics import (
    Backlash,
    CoulombFriction,
    PreslidingHysteresis,
    Simulation,
    StribeckFriction,
    TimeDelay,
    Tolerances,
    ViscousFriction,
)
from limo_driver.physics.effects.hysteresis import STOP_WIDTHS
from limo_driver.physics.effects.play import DRAGGED_GAPS


@pytest.fixture(scope="module")
def given(arm):
    sizes = {1: (1.0, 0.5), 2: (0.6, 0.3)}
    dry = [CoulombFriction(joint=j, tau_c=size) for j, (size, _) in sizes.items()]
    wet = [ViscousFriction(joint=j, f_v=size) for j, (_, size) in sizes.items()]
    return Simulation(str(arm), (*dry, *wet), tolerances=Tolerances(inertia=0.005, friction=0.15))


@pytest.fixture(scope="module")
def seen(training_recording):
    """Motion with many reversals of unlike size, and a measurement of any arm on it."""

    def see(true):
        noise = 0.01 * np.random.default_rng(4).standard_normal(training_recording.torque.shape)
        torque = true.predict(training_recording) + noise
        return replace(training_recording, torque=torque)

    return see


def slip(**parameters):
    return PreslidingHysteresis(joint=2, **parameters)


LAWS = {
    "Maxwell slip": slip(stiffness=(30.0, 10.0), width=STOP_WIDTHS[4:8:3]),
    "Bouc-Wen": slip(law="bouc_wen", sigma_0=60.0, tau_c=0.6, beta_ratio=0.7, exponent=2.5),
    "Dahl": slip(law="dahl", sigma_0=60.0, tau_c=0.6, exponent=2.5),
    "a first-order lag": TimeDelay(joint=2, lag=0.02),
    "a pure delay": TimeDelay(joint=2, delay=0.023),
}


SHIFTS = pytest.mark.slow("searches shifts in time, which takes seconds")


@sampled(
    "law",
    [
        pytest.param(law, marks=SHIFTS if isinstance(hidden, TimeDelay) else ())
        for law, hidden in LAWS.items()
    ],
    "a whole diagnosis each",
)
def test_the_hidden_law_is_named_with_its_odds(given, seen, law):
    hidden = LAWS[law]
    true = replace(given, effects=(*given.effects, hidden))
    (finding,) = diagnose(given, [seen(true)]).verdict.findings
    assert finding.effect == hidden.name
    assert f"Its law is {law}, " in finding.evidence
    assert "likelier than" in finding.evidence.split("Its law is")[1]


@sampled("width", [(0.0015, 0.009), (0.004,)], "a whole diagnosis each")
def test_springs_that_slip_between_the_widths_tried_are_found_without_play(given, seen, width):
    assert {*width}.isdisjoint(STOP_WIDTHS)
    hidden = slip(stiffness=tuple(0.3 / w for w in width), width=width)
    true = replace(given, effects=(*given.effects, hidden))
    (finding,) = diagnose(given, [seen(true)]).verdict.findings
    assert (finding.effect, finding.joints) == ("presliding_hysteresis", (2,))
    assert finding.parameters["width"].value == pytest.approx(width, rel=0.05)
    assert finding.parameters["stiffness"].value == pytest.approx(hidden.stiffness, rel=0.05)


@sampled("gap", [0.0025, 0.006, 0.016], "a whole diagnosis each")
def test_play_of_a_width_between_those_tried_is_not_taken_for_presliding(given, seen, gap):
    assert gap not in DRAGGED_GAPS
    hidden = Backlash(joint=2, gap=gap, drag=0.5)
    true = replace(given, effects=(*given.effects, hidden))
    (finding,) = diagnose(given, [seen(true)]).verdict.findings
    assert (finding.effect, finding.joints) == ("backlash", (2,))
    assert finding.parameters["gap"].value == pytest.approx(gap, rel=0.05)
    assert finding.parameters["drag"].value == pytest.approx(0.5, rel=0.1)


@sampled(("gap", "width"), [(0.016, 0.006), (0.006, 0.003)], "a whole diagnosis each")
def test_play_behind_what_gives_way_is_not_taken_for_presliding(given, seen, gap, width):
    hidden = Backlash(joint=2, gap=gap, width=width, drag=given.effects[1].tau_c)
    true = replace(given, effects=(*given.effects, hidden))
    (finding,) = diagnose(given, [seen(true)]).verdict.findings
    assert (finding.effect, finding.joints) == ("backlash", (2,))
    assert finding.parameters["gap"].value == pytest.approx(gap, rel=0.1)
    assert finding.parameters["width"].value == pytest.approx(width, rel=0.2)


@sampled("exponent", [1.0, 1.5], "a whole diagnosis each")
def test_friction_that_keeps_acting_after_a_reversal_is_no_play(given, seen, exponent):
    """Play with twice the joint's friction for a drag would explain most of it in fewer numbers."""
    slow = slip(law="dahl", sigma_0=300.0, tau_c=0.6, exponent=exponent)
    sliding = tuple(effect for effect in given.effects if effect != given.effects[1])
    (finding,) = diagnose(given, [seen(replace(given, effects=(*sliding, slow)))]).verdict.findings
    assert (finding.effect, finding.joints) == ("presliding_hysteresis", (2,))


@pytest.mark.slow("a whole diagnosis")
def test_laws_that_come_to_the_same_are_not_told_apart(given, seen):
    """LuGre without an excess at rest is Dahl's law with an exponent of 1."""
    hidden = slip(law="lugre", sigma_0=60.0, tau_c=0.6)
    true = replace(given, effects=(*given.effects, hidden))
    (finding,) = diagnose(given, [seen(true)]).verdict.findings
    assert "these recordings cannot tell" in finding.evidence
    assert {"LuGre", "Dahl"} <= set(finding.evidence.split("(")[-1].split(")")[0].split(", "))


def test_odds_are_those_of_the_evidence():
    two = (LawEvidence("Dahl", 50.0), LawEvidence("LuGre", 50.0 - np.log(120.0)))
    assert sentence_of(two) == " Its law is Dahl, 120 times likelier than LuGre."
    assert sentence_of((two[0], LawEvidence("LuGre", -50.0))).endswith(
        "Dahl, beyond doubt likelier than LuGre."
    )
    assert sentence_of((two[0], LawEvidence("LuGre", 49.0))).endswith(
        "(Dahl, LuGre) these recordings cannot tell."
    )
    assert sentence_of(two[:1]) == sentence_of(()) == ""


def test_a_cubic_elasticity_competes_with_a_linear_one(given, training_recording):
    observed = Observations.of(given, [training_recording], 10.0)
    linear = next(item for item in every(observed) if item.effect == "joint_elasticity")
    (cubic,) = rivals(linear)
    (effect,) = cubic.realise(np.array([100.0, -3.0]))
    assert (effect.stiffness, effect.cubic) == pytest.approx((1000.0, -3e-9))


def test_settings_go_to_where_they_are_likeliest(given, seen):
    dip = StribeckFriction(joint=2, tau_s=0.5, v_s=0.02, delta=2.0)
    true = replace(given, effects=(*given.effects, dip))
    problem = RegressionProblem.of(Observations.of(given, [seen(true)], 10.0), quiet)
    noise = Noise.independent(np.full(2, 0.01), problem.split.fitted)
    places = [candidate.place for candidate in problem.candidates]
    member = places.index((dip.name, (1,)))
    # a third of the width, and of another shape
    assert problem.candidates[member].hypothesis.settings == (0.006, 1.0)
    told: list[float] = []
    solution = refined(fitted(problem, (member,), noise), lambda _, done: told.append(done))
    assert 0.0 < max(told) < 1.0
    (member,) = solution.members
    found = solution.problem.candidates[member].hypothesis
    assert (found.effect, found.settings) == (dip.name, pytest.approx((0.02, 2.0), rel=0.05))


def test_of_a_damped_fall_gap_and_damping_are_found_and_the_size_is_that_gap(
    given, training_recording
):
    hidden = Backlash(joint=2, gap=0.004, damping=20.0)
    hanging = replace(
        training_recording, position=training_recording.position + np.array([0.0, 1.97])
    )  # where the load of joint 2 reverses
    true = replace(given, effects=(*given.effects, hidden))
    torque = Observations.of(true, [hanging], 10.0).predict(true)  # with its impacts
    observed = Observations.of(given, [replace(hanging, torque=torque)], 10.0)
    problem = RegressionProblem.of(observed, quiet)
    noise = Noise.independent(np.full(2, 1e-3), problem.split.fitted)
    nothing = Prior.free(np.zeros(0, dtype=np.int64), np.zeros(0))
    around = laws.Setting(problem, nothing, noise)
    found, gain = laws.refine(Backlash.of_gap(2, 6e-3, 100.0), around)
    assert found.settings == pytest.approx((hidden.gap, hidden.damping), rel=0.1)
    half = replace(Backlash.of_gap(2, 2e-3, 20.0), family=None)  # of twice its size, it says
    free, sized = (laws.refine(replace(half, sized=s), around)[1] for s in (False, True))
    assert sized < free < gain


def test_what_brings_most_of_what_a_member_does_is_confused_with_it(monkeypatch):
    """The best of each effect, beside the rest of the set; not what is in the set already."""
    effects = ["own", "rest", "play", "play", "slip", "other"]
    candidates = [SimpleNamespace(slot=k, effect=effect) for k, effect in enumerate(effects)]
    evidence = {(1,): 5.0, (1, 0): 105.0, (1, 2): 95.0, (1, 3): 97.0, (1, 4): 10.0, (1, 5): 99.0}
    search = SimpleNamespace(gain=evidence.__getitem__)
    monkeypatch.setattr(laws, "compete", lambda other, _: other.effect != "other")
    problem = SimpleNamespace(candidates=candidates)
    solution = SimpleNamespace(problem=problem, search=search, members=(0, 1))
    assert confused(solution, 0) == [3]
