import numpy as np
import pytest

from limo_driver.exports.changes.bodies import (
    BodyPart,
    inertial_of,
    pseudo_inertia,
    rescaled_lines,
    shared,
)
from limo_driver.model.descriptions.geometry import Inertial

HAND = Inertial(2.0, (0.1, 0.0, 0.05), (0.02, 0.001, 0.0, 0.03, 0.002, 0.025))
TOOL = Inertial(0.5, (0.0, 0.02, 0.0), (0.002, 0.0, 0.0, 0.002, 0.0, 0.001))
TURNED = np.array([[0.0, -1, 0, 0.1], [1, 0, 0, 0.2], [0, 0, 1, 0.3], [0, 0, 0, 1]])


def whole(parts, bodies):
    J = [part.pose @ pseudo_inertia(bodies[part.name]) @ part.pose.T for part in parts]
    return inertial_of(sum(J))


PARTS = (BodyPart("hand", HAND, np.eye(4)), BodyPart("tool", TOOL, TURNED))
BEFORE = whole(PARTS, {"hand": HAND, "tool": TOOL})


def close(first, second):
    values = [(b.mass, *b.com, *b.inertia) for b in (first, second)]
    np.testing.assert_allclose(*values, atol=1e-12)


def test_second_moments_are_those_of_the_body():
    close(inertial_of(pseudo_inertia(HAND)), HAND)


def test_nothing_changes_where_nothing_was_found():
    assert shared(PARTS, BEFORE) == {}


def test_the_own_body_takes_the_change():
    wanted = Inertial(2.9, (0.09, 0.03, 0.1), tuple(1.1 * x for x in BEFORE.inertia))
    found = shared(PARTS, wanted)
    assert set(found) == {"hand"}
    assert rescaled_lines(PARTS, found, wanted) == []
    close(whole(PARTS, {"hand": found["hand"], "tool": TOOL}), wanted)


def test_what_no_body_can_take_alone_is_shared_by_all():
    light = Inertial(0.4, (0.0, 0.0, 0.1), (0.001, 0, 0, 0.001, 0, 0.0005))
    found = shared(PARTS, light)  # lighter than the tool
    assert set(found) == {"hand", "tool"}
    assert all(body.is_consistent() for body in found.values())
    close(whole(PARTS, found), light)
    (said,) = rescaled_lines(PARTS, found, light)
    assert said.startswith("what hand, tool weigh: 2.5 kg in the file, 0.4 kg in the simulation, ")


def test_a_link_without_a_mass_of_its_own_gets_one():
    parts = (BodyPart("hand", None, np.eye(4)), BodyPart("tool", TOOL, np.eye(4)))
    wanted = Inertial(1.0, (0.0, 0.01, 0.0), (0.005, 0, 0, 0.005, 0, 0.004))
    found = shared(parts, wanted)
    assert set(found) == {"hand"}
    assert found["hand"].mass == pytest.approx(0.5)
