"""Strangers are what they say: drawn from a seed alone, with what is unusual, and nothing else."""

import numpy as np
import pytest
import strangers


@pytest.mark.parametrize("kind", strangers.KINDS)
def test_a_stranger_has_what_its_kind_says_and_no_more(kind):
    drawn, plain = strangers.draw(kind, 5, 10.0), strangers.draw("null", 5, 10.0)
    assert plain.unusual == ()
    assert len(drawn.unusual) == (0 if kind.startswith("null") else 1 + ("_and_" in kind))
    np.testing.assert_array_equal(drawn.motion, plain.motion)
    fields = set(plain.world.drive.dtype.names)
    changed = {f for f in fields if (drawn.world.drive[f] != plain.world.drive[f]).any()}
    assert bool(changed) == (kind not in {"null", "payload"})
    heavier = drawn.world.arm.mass - plain.world.arm.mass
    masses = [item.mass for item in drawn.unusual if item.effect == "payload"]
    np.testing.assert_allclose(heavier, [0.0] * 6 + [sum(masses)], atol=1e-12)
    joints = {item.joint - 1 for item in drawn.unusual if item.effect != "payload"}
    rows = np.flatnonzero(drawn.world.drive != plain.world.drive)
    assert set(rows) == (set(range(7)) if kind == "null_presliding" else joints)
