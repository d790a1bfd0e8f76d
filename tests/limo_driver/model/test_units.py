"""Slides are in m and N, where joints that turn are in rad and N m."""

from types import SimpleNamespace

import numpy as np
import pytest

from estimators.rigid_body.identification import _estimates
from estimators.rigid_body.terms import JointTerms
from limo_driver.app.cli.predict import _written
from limo_driver.model.units import unit_of


@pytest.mark.parametrize(
    ("turning", "sliding"),
    [
        ("rad", "m"),
        ("mrad", "mm"),
        ("N m", "N"),
        ("N m s/rad", "N s/m"),
        ("rad/(N m)^3", "m/N^3"),
        ("kg m^2", "kg"),
        ("N m/A", "N/A"),
        ("1", "1"),
        ("", ""),
    ],
)
def test_units_of_slides(turning, sliding):
    assert unit_of(turning, (False, True), 1) == sliding
    assert unit_of(turning, (False, True), 0) == turning
    assert unit_of(turning, ()) == turning


def test_joints_of_both_kinds_have_both_units():
    assert unit_of("N m", (True, False, True)) == "N, N m"
    assert unit_of("rad", (False, False)) == "rad"


def test_what_is_identified_of_a_slide_is_in_newtons():
    terms = JointTerms()
    values = np.ones(2 * len(terms.all()))
    fit = SimpleNamespace(parameters=values, deviation=0.1 * values)
    found = _estimates(terms, fit, np.array([True, True]), (True, False))
    units = {(item.parameter, item.joint): item.unit for item in found}
    assert units["f_v", 1] == "N s/m"
    assert units["f_v", 2] == "N m s/rad"
    assert units["tau_c", 1] == "N"
    assert units["inertia", 1] == "kg"


def test_predicted_positions_of_a_slide_are_in_metres(tmp_path):
    text = _written(tmp_path / "out", _Rows(), {"position": np.zeros((3, 2))}, (True, False))
    assert text.endswith("position_1 … position_2 [m, rad]")


class _Rows:
    rows_total, n = 3, 2

    def __len__(self):
        return 3
