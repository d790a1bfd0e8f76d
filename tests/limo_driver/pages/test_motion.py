"""A planned motion on a page: the arm plays it along the flange's path."""

from __future__ import annotations

import re
from base64 import b64decode

import numpy as np
import pytest
from one_file import arm_of, check_page, drawn

from limo_driver.model import RobotModel
from limo_driver.model.kinematics import KinematicChain
from limo_driver.pages import Charts, Page
from limo_driver.pages.figures import rounded_ticks
from limo_driver.pages.markup import columns, header, listed, next_steps
from limo_driver.pages.motion import planned_motion
from limo_driver.trajectory import Trajectory
from limo_driver.types import Motion


def trajectory(samples):
    time = np.linspace(0.0, 40.0, samples)
    swing = 0.3 * (1 - np.cos(np.pi * time / 4))[:, None] * np.array([1.0, 0, 0.5, 0, 0, 0, 1])
    motion = Motion.from_positions(time, swing)
    return Trajectory(time, swing, motion.velocity, motion.acceleration, robot="iiwa14")


def floats(text):
    return np.frombuffer(b64decode(text), dtype="<f4")


@pytest.mark.parametrize("samples", [200, 10_001])
def test_the_arm_plays_it_from_end_to_end_along_the_path_of_the_flange(samples):
    model, charts, motion = RobotModel.load("iiwa14"), Charts(), trajectory(samples)
    view, body = planned_motion(model, motion, charts)
    text = Page("Swing", header("A motion", "Swing") + body, charts, view).html()
    check_page(text)
    played = arm_of(text)["motion"]
    time = floats(played["time"])
    assert (time[0], time[-1]) == pytest.approx((0.0, 40.0))
    assert len(time) <= 3000
    position = floats(played["position"]).reshape(len(time), 7)
    expected = KinematicChain.of(model).flange_position(position.astype(float))
    np.testing.assert_allclose(floats(played["path"]).reshape(-1, 3), expected, atol=1e-5)
    assert "<polyline" in text  # on paper, too
    assert [curve["name"] for curve in drawn(text)[0]["data"]] == ["joint 1", "joint 3", "joint 7"]


def test_texts_of_a_page_are_escaped():
    said = header("<a>", "<b>", "<c>", "") + listed(["<d>"]) + next_steps([("<e>", "<f>")])
    said += columns({"<g>": ["<h>"], "value": [0.123456]})
    assert not set("abcdefgh") & set(re.findall("<([a-h])>", said))
    assert "0.123<" in said
    assert len(re.findall("class=.sources.", said)) == 1


def test_without_items_there_is_no_list():
    assert listed([]) == ""
    assert next_steps([]) == ""


@pytest.mark.parametrize(
    ("values", "ticks"),
    [([0.02, 0.3], [0.01, 0.02, 0.05, 0.1]), ([1e-4, 10.0], [1e-4, 1e-3, 1e-2]), ([np.nan], [])],
)
def test_ticks_are_round(values, ticks):
    assert set(ticks) <= set(rounded_ticks(np.array(values)).get("tickvals", []))
