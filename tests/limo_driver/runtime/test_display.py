"""Values print themselves in one line, and as a table in a notebook."""

import numpy as np
import pytest

import limo_driver as limo
from limo_driver.physics import CoulombFriction
from limo_driver.runtime.display import Displayed, call_joints

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


@pytest.mark.parametrize(
    ("text", "called"),
    [
        ("At joint 2 it is, 2.5 N m", "At joint 2 (stick) it is, 2.5 N m"),
        ("Joint 2, 2.5 N m.", "Joint 2 (stick), 2.5 N m."),
        ("of joints 1, 2 and 3.", "of joints 1 (lift), 2 (stick) and 3."),  # named joint3
        ("joint 1 (lift) and joint 22", "joint 1 (lift) and joint 22"),
        ("both joints, 2 of 3 times", "both joints, 2 of 3 times"),
    ],
)
def test_joints_that_are_counted_are_called_by_name(text, called):
    names = ("lift", "stick", "joint3")
    assert call_joints(text, names) == called
    assert call_joints(called, names) == called  # as of a verdict that is read
    assert call_joints(text, ()) == text
