"""Ordinary friction of a bare description: identified, unless one joint is unlike its siblings."""

from __future__ import annotations

from types import SimpleNamespace

import pytest

from estimators.diagnosis.judgement.ordinary import ordinary
from limo_driver.physics import ViscousFriction

PLAIN = [("coulomb_friction", (j,)) for j in range(7)]


def ordinary_of(places, n=7, stated=()):
    """Return the places that are ordinary beside one another on an arm of n joints."""
    simulation = SimpleNamespace(effects=stated, model=SimpleNamespace(n=n))
    candidates = [SimpleNamespace(effect=effect, joints=joints) for effect, joints in places]
    problem = SimpleNamespace(
        observed=SimpleNamespace(simulation=simulation), candidates=candidates
    )
    return [places[i] for i in ordinary(problem, range(len(places)))]


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
