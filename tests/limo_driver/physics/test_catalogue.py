"""What effects say of themselves and of each other fits together."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from limo_driver.errors import ConfigError
from limo_driver.physics import (
    CATALOGUE,
    CoulombFriction,
    DiagnosisContext,
    Hypothesis,
    JointElasticity,
    Payload,
    PreslidingHysteresis,
    SpringLoad,
    TimeDelay,
)
from limo_driver.physics.catalogue import confusion_of, description_of, identical_to
from limo_driver.physics.effects.changing_friction import VARIANTS
from limo_driver.physics.effects.hysteresis import LAWS

OF_BODIES = "link_inertia"
# by the regressor, by a scan over time, and not at all
SOUGHT_OTHERWISE = {"payload", "external_contact", "picked_up_load"}


@pytest.fixture
def recorded():
    position = np.linspace([-1.0] * 3, [1.0] * 3, 50)
    warm = np.full((200, 3), 30.0)
    gravity, inertia = np.array([0.0, 0.0, -9.81]), np.ones(position.shape[1])
    return DiagnosisContext(position, warm, 0.0, 60.0, 60.0, gravity, (), inertia)


def tried(effect, recorded):
    return [*effect.at_joint(2, recorded), *effect.on_arm(recorded)]


def test_every_pair_is_stated_once_and_of_what_there_is():
    pairs = [
        frozenset({effect.name, item.other})
        for effect in CATALOGUE.values()
        for item in effect.description.confusions
    ]
    assert len(set(pairs)) == len(pairs) == 36
    assert {name for pair in pairs for name in pair} <= {*CATALOGUE, OF_BODIES}


def test_a_pair_is_known_from_both_sides():
    known = confusion_of("backlash", "joint_elasticity")
    assert known is confusion_of("joint_elasticity", "backlash")
    assert known is not None
    assert known.motion == "load_reversal"
    assert confusion_of("backlash", "viscous_friction") is None
    assert identical_to("torque_offset") == ("asymmetric_friction",)
    assert identical_to("asymmetric_friction") == ("torque_offset",)
    assert identical_to(OF_BODIES) == ("payload",)
    assert identical_to("backlash") == ()
    assert description_of("no_effect").signature == ""


@pytest.mark.parametrize("effect", CATALOGUE.values(), ids=CATALOGUE)
def test_every_effect_says_how_it_shows(effect):
    known = effect.description
    assert known.signature
    assert not known.signature.endswith(".")
    assert known.part_of in {"", OF_BODIES, *CATALOGUE}
    assert known.shown_by or effect.name in SOUGHT_OTHERWISE


@pytest.mark.parametrize("effect", CATALOGUE.values(), ids=CATALOGUE)
def test_what_is_tried_comes_out_as_what_it_is(effect, recorded):
    found = tried(effect, recorded)
    assert bool(found) == (effect.name not in SOUGHT_OTHERWISE)
    further = [law for hypothesis in found[:1] for law in effect.further_laws(hypothesis)]
    for hypothesis in (*found, *further):
        assert hypothesis.effect == effect.name
        assert hypothesis.joints[:1] in {(1,), ()}
        sizes = np.full(len(hypothesis.terms), 2.0)
        (made,) = hypothesis.realise(sizes)
        assert isinstance(made, effect)
        assert len(hypothesis.settings) == len(hypothesis.bounds) or not hypothesis.bounds
        if hypothesis.family is not None:
            again = hypothesis.family(*hypothesis.settings)
            assert again == replace(hypothesis, realise=again.realise)


@pytest.mark.parametrize("effect", CATALOGUE.values(), ids=CATALOGUE)
@pytest.mark.parametrize("end", [0, 1], ids=["least", "most"])
def test_settings_that_are_refined_again_and_again_stay_ones_that_can_be(effect, recorded, end):
    found = tried(effect, recorded)
    further = [law for hypothesis in found for law in effect.further_laws(hypothesis)]
    for hypothesis in (*found, *further):
        again, times = hypothesis, 0
        while again.family is not None and times < 8:
            again, times = again.family(*(bound[end] for bound in again.bounds)), times + 1
        assert again.realise(np.full(len(again.terms), 1.0))


def test_two_of_one_kind_are_one_where_that_has_a_meaning():
    dry = CoulombFriction(joint=1, tau_c=1.0)
    assert dry.with_more(replace(dry, tau_c=0.5)) == replace(dry, tau_c=1.5)
    assert dry.with_more(replace(dry, joint=2)) is None
    soft = JointElasticity(joint=1, stiffness=2e4)
    assert soft.with_more(soft) == replace(soft, stiffness=1e4)
    slip = PreslidingHysteresis(joint=1, stiffness=(10.0,), width=(0.01,))
    assert slip.with_more(slip) is None
    assert soft.with_more(dry) is None
    assert TimeDelay(joint=1, delay=0.01).with_more(TimeDelay(joint=1, delay=0.01)) is None


def test_one_effect_of_the_whole_arm_belongs_to_no_joint():
    load = Payload(mass=1.0, com=(0.0, 0.0, 0.1), inertia=(1e-3, 0.0, 0.0, 1e-3, 0.0, 1e-3))
    assert Hypothesis.of_one(load, "mass").joints == ()
    assert Hypothesis.of_one(CoulombFriction(joint=3, tau_c=1.0), "tau_c").joints == (2,)


@pytest.mark.parametrize("stiffness", [2.0, -2.0])
def test_a_spring_pulls_more_the_further_it_is_stretched(recorded, stiffness):
    _, _, middle, _ = SpringLoad.at_joint(2, recorded)
    middle = middle.family(0.0)
    (softening,) = middle.realise(np.array([stiffness, -0.33 * stiffness]))  # to 1 rad both ways
    assert softening == SpringLoad(joint=2, stiffness=stiffness, rest=0.0, cubic=-0.33 * stiffness)
    with pytest.raises(ConfigError, match=r"joint 2: .*changes sign within 1 rad"):
        middle.realise(np.array([stiffness, -0.34 * stiffness]))
    again = middle.family(0.8)  # to 1.8 rad
    with pytest.raises(ConfigError, match=r"changes sign within 1\.8 rad"):
        again.realise(np.array([stiffness, -0.15 * stiffness]))


TEXT = (Path(__file__).parents[3] / "docs" / "physics.md").read_text()


def section(name: str) -> str:
    heading = f"### `{name}`"
    assert heading in TEXT
    return TEXT.split(heading)[1].split("\n##")[0]


@pytest.mark.parametrize("name", sorted(CATALOGUE))
def test_every_effect_and_parameter_is_described(name):
    text = section(name)
    for parameter in CATALOGUE[name].parameters():
        unit = parameter.unit.replace("^2", "²").replace("^3", "³")
        assert f"| `{parameter.name}` | {unit} |" in text
    for word in ("*Signature:*", "*Excited by:*", "*Confused with:*", "*Source:*"):
        assert word in text.replace("\n", " ")


@pytest.mark.parametrize("name", sorted(CATALOGUE))
def test_bounds_and_defaults_are_the_ones_that_are_checked(name):
    for parameter in CATALOGUE[name].parameters():
        row = re.search(rf"\| `{parameter.name}` \| [^|]* \| ([^|]*) \| ([^|]*) \|", section(name))
        if parameter.unit == "text" or parameter.name == "ratio":  # words, and 1 or −1
            continue
        bounds = re.match(r"(\S+) to ([^\s,]+)", row[1].replace("\N{MINUS SIGN}", "-"))
        assert [float(value) for value in bounds.groups()] == [parameter.lower, parameter.upper]
        assert np.isfinite([parameter.lower, parameter.upper]).all()


def test_nothing_else_is_in_the_catalogue():
    headings = set(re.findall(r"^### `(\w+)`", TEXT, flags=re.MULTILINE))
    assert headings == {*CATALOGUE, "link_inertia"}  # which is an entry of inertials


def test_every_law_and_variant_is_described():
    assert all(f"| `{law}` |" in section("presliding_hysteresis") for law in LAWS)
    friction = section("load_dependent_friction")
    assert all(f"`{variant}`" in friction for variant in VARIANTS)
