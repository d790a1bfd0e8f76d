"""Values print themselves in one line, and as a table in a notebook."""

import numpy as np
import pytest

import limo_driver as limo
from limo_driver.physics import CoulombFriction
from limo_driver.runtime.display import Displayed

T = np.linspace(0.0, 2.0, 201)
SWING = 0.1 * np.sin(np.pi * T)[:, None] * np.ones(7)
MOTION = limo.Motion.from_positions(T, SWING)
VALUES = [
    MOTION,
    limo.Trajectory(T, SWING, MOTION.velocity, MOTION.acceleration, robot="iiwa14"),
    limo.Recording.from_arrays(T, SWING, np.sin(T)[:, None] * np.ones(7), source="a.csv"),
    limo.RobotModel.load("iiwa14"),
    limo.Simulation("iiwa14", tuple(CoulombFriction(joint=j, tau_c=1.0) for j in (1, 2))),
]


@pytest.mark.parametrize("value", VALUES, ids=lambda value: type(value).__name__)
def test_a_value_is_one_short_line_and_a_table(value):
    assert len(repr(value)) < 100
    assert "\n" not in repr(value)
    assert repr(value).startswith(f"<{type(value).__name__}: ")
    assert value.headline() in str(value)
    assert value._repr_html_().count("<tr>") == (8 if value.figures() else 0)


def test_what_is_said():
    told = [value.headline() for value in VALUES]
    assert told[0] == "2 s, 201 samples of 7 joints"
    assert told[1] == "2 s, 201 samples of 7 joints, for iiwa14"
    assert told[2] == "2 s, 201 samples at 100 Hz of 7 joints, from a.csv"
    assert told[4] == "iiwa14, coulomb friction (2)"


def test_text_of_a_value_is_no_markup_of_a_page():
    class Named(Displayed):
        def headline(self):
            return "<b>"

        def figures(self):
            return {"<i>": ["&"]}

    assert Named()._repr_html_().count("<b>") == 0
    assert "&lt;i&gt;" in Named()._repr_html_()
    assert "&amp;" in Named()._repr_html_()
    assert str(Named()) == "<b>\n<i>\n  &"
