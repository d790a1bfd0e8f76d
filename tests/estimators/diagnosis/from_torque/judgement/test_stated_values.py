"""Stated values that differ are reported, however wide their tolerance, and no others."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from estimators.diagnosis.from_torque.judgement.questions import (
    are_currents,
    with_guesses,
)
from estimators.diagnosis.from_torque.pipeline import diagnose
from limo_driver.physics import (
    CoulombFriction,
    Payload,
    Simulation,
    SpringLoad,
    Tolerances,
    TorqueOffset,
    ViscousFriction,
)
from limo_driver.recordings.recording import Recording
from limo_driver.types import Motion

RATE, NOISE = 250.0, 0.02  # [Hz], [N m]


@pytest.fixture(scope="module")
def stated(arm):
    """An arm that is known, with the tolerances that limo guesses."""
    dry = [CoulombFriction(joint=j, tau_c=tau) for j, tau in ((1, 1.0), (2, 0.6))]
    wet = [ViscousFriction(joint=j, f_v=f) for j, f in ((1, 0.5), (2, 0.3))]
    return Simulation(str(arm), (*dry, *wet, SpringLoad(joint=1, stiffness=40.0, rest=0.2)))


def recorded(true, seed=0, duration=40.0):
    """Measure a motion of both joints with white noise."""
    random, t = np.random.default_rng(seed), np.arange(round(duration * RATE)) / RATE
    pace, phase = random.uniform(0.4, 4.0, (5, 2)), random.uniform(0.0, 6.3, (5, 2))
    angle = pace * t[:, None, None] + phase
    position = 0.2 * np.sin(angle).sum(axis=1)
    velocity = 0.2 * (pace * np.cos(angle)).sum(axis=1)
    motion = Motion(t, position, velocity, -0.2 * (pace**2 * np.sin(angle)).sum(axis=1))
    noise = NOISE * random.standard_normal(position.shape)
    return Recording.from_arrays(t, position, true.predict(motion) + noise)


def changed(simulation, k, **values):
    effects = list(simulation.effects)
    effects[k] = replace(effects[k], **values)
    return replace(simulation, effects=tuple(effects))


def test_what_is_exactly_as_stated_agrees(stated):
    found = diagnose(stated, [recorded(stated)])
    assert found.verdict.states == ("agrees",)
    assert not any(item.reported for item in found.verdict.values)


@pytest.mark.slow("two whole diagnoses")
@pytest.mark.parametrize(
    ("place", "name", "true", "joint"),
    [(0, "tau_c", 1.3, "shoulder"), (4, "stiffness", 30.0, "shoulder")],
)
def test_a_value_that_differs_inside_its_tolerance_is_reported(stated, place, name, true, joint):
    found = diagnose(stated, [recorded(changed(stated, place, **{name: true}))])
    verdict = found.verdict
    assert (verdict.verdict, verdict.findings) == ("consistent", ())
    assert verdict.states == ("stated values differ",)
    (item,) = [item for item in verdict.values if item.reported]
    assert (item.name, item.joint_names, item.beyond, item.assumed) == (name, (joint,), False, True)
    assert item.ci95[0] <= true <= item.ci95[1]
    assert item.share > 0.9
    assert f"of joint 1 ({joint}) is" in found.headline()
    assert f"not the stated {item.stated:.4g}" in repr(found)


@pytest.mark.slow("a whole diagnosis")
def test_links_that_are_off_are_reported_as_the_family_that_torques_tell(stated):
    bodies = {
        name: replace(body, mass=1.03 * body.mass)
        for name, body in stated.model.inertials.items()
        if name in stated.model.link_names
    }
    found = diagnose(stated, [recorded(replace(stated, inertials=bodies))])
    families = [item for item in found.verdict.values if item.reported and not item.effect]
    assert [item.name for item in families] == ["masses and centres of links"]
    assert families[0].ci95[0] > families[0].stated
    assert found.verdict.states == ("stated values differ",)


@pytest.mark.slow("a whole diagnosis")
def test_bodies_are_reported_where_a_value_of_each_joint_is(stated):
    """A load within the tolerance of inertias is no payload, and no reason to be silent."""
    last = stated.model.link_names[-1]
    body = stated.model.inertials[last]
    heavier = replace(body, mass=1.03 * body.mass)
    more = changed(changed(stated, 0, tau_c=1.3), 1, tau_c=0.8)
    found = diagnose(stated, [recorded(replace(more, inertials={last: heavier}))])
    reported = {item.name for item in found.verdict.values if item.reported}
    joints = {item.joints for item in found.verdict.values if item.reported if item.effect}
    assert joints == {(1,), (2,)}
    assert reported & {"mass", "masses and centres of links"}
    assert found.verdict.findings == ()


@pytest.mark.slow("a whole diagnosis")
def test_an_offset_within_what_a_sensor_may_have_is_written_where_it_holds(stated):
    """It is no physics that is missing, and would be in each prediction all the same."""
    offset = TorqueOffset(joint=2, offset=0.006)
    true = changed(stated, 0, tau_c=1.3)
    true = replace(true, effects=(*true.effects, offset))
    found = diagnose(stated, [recorded(true), recorded(true, seed=1)])
    assert found.verdict.findings == ()
    (written,) = [x for x in found.after.effects if isinstance(x, TorqueOffset)]
    assert written.joint == 2
    assert 0.002 < written.offset < 0.006  # a part goes into the centre of the link
    assert any("offsets of the torque surely help" in note for note in found.verdict.notes)


@pytest.mark.slow("a whole diagnosis")
def test_where_a_guess_decides_a_note_says_so(stated):
    load = Payload(mass=0.4, com=(0.0, 0.0, 0.05), inertia=(1e-4, 0.0, 0.0, 1e-4, 0.0, 1e-4))
    true = replace(stated, effects=(*stated.effects, load))
    known = replace(stated, tolerances=Tolerances(stated=frozenset({"inertia", "friction"})))
    notes = {
        assumed: [
            note for note in diagnose(given, [recorded(true)]).verdict.notes if "guess" in note
        ]
        for assumed, given in ((True, stated), (False, known))
    }
    assert all("limo's guess" in note for note in notes[True])
    assert not any("inertia" in note or "friction" in note for note in notes[False])


def test_torques_that_are_currents_have_gains_that_are_known_to_a_tenth(stated):
    plain = recorded(stated, duration=4.0)
    current = plain.torque / np.array([2.0, 3.0])
    driven = replace(plain, extras={"current": current})
    sensed = replace(plain, extras={"current": current + 0.1})
    assert [are_currents(item) for item in (plain, driven, sensed)] == [False, True, False]
    assert with_guesses(stated, [plain]) is stated
    doubted = with_guesses(stated, [plain, driven]).tolerances
    assert doubted.gain == 0.1
    assert "gain" in doubted.assumed
    sure = replace(stated, tolerances=Tolerances(stated=frozenset({"gain"})))
    assert with_guesses(sure, [driven]) is sure
