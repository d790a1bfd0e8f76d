"""How well each stated value of a drive is known."""

from __future__ import annotations

from dataclasses import replace

import pytest
from servo_arms import write_arm

from estimators.drives.fitting.constants import COULOMB, DAMPING, value_in
from estimators.drives.hypotheses.search import beliefs, stated_guess
from estimators.drives.simulation.plant import rows_of, tolerances_of
from limo_driver.physics import Simulation


@pytest.fixture
def stated(tmp_path):
    """Return an arm whose first servo has tolerances of its own."""
    simulation = Simulation.load(write_arm(tmp_path / "arm.xml"))  # kd 1.5 and damping 0.2
    own = {"kp": 0.05, "kd": 0.6, "delay": 0.7}
    first = replace(simulation.drives[0], delay=0.02, tolerances=own)
    return replace(simulation, drives=(first, *simulation.drives[1:]))


def test_values_have_their_own_tolerance_or_that_of_all(stated):
    first, second = tolerances_of(stated)

    assert [value_in(first, name) for name in ("kp", "delay", COULOMB)] == [0.05, 0.7, 0.3]
    assert [value_in(second, name) for name in ("kp", "delay", DAMPING)] == pytest.approx([0.3] * 3)


def test_damping_is_known_as_well_as_its_parts(stated):
    damping = value_in(tolerances_of(stated)[0], DAMPING)

    assert damping == pytest.approx((1.5 * 0.6 + 0.2 * 0.3) / 1.7)


def test_what_is_believed_is_as_wide_as_the_tolerances(stated):
    rows = stated_guess(rows_of(stated)).rows

    first, second = beliefs(rows, tolerances_of(stated))

    assert first["kp"].deviation == 0.05
    assert first["delay"].deviation == 0.7
    assert second["kp"].deviation == 0.3
    assert second["offset"].deviation == beliefs(rows, 0.3)[1]["offset"].deviation
