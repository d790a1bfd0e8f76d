"""The arm on paper: every text beside it is there in full, in lines that fit."""

from __future__ import annotations

import re
from html import unescape

import numpy as np
import pytest

from limo_driver.model import RobotModel
from limo_driver.pages import Pin, arm_view
from limo_driver.pages.motion import HEIGHT, still

LONG = "joint 4: quadratic drag 6.012 N m s^2/rad^2 [5.952, 6.072]"


@pytest.fixture(scope="module")
def model():
    return RobotModel.load("iiwa14")


def lines(picture):
    texts = re.findall(r'<text [^>]*y="([\d.]+)">(.*?)</text>', picture)
    return [
        (float(y), [unescape(line) for line in re.findall(r"<tspan[^>]*>(.*?)</tspan>", text)])
        for y, text in texts
    ]


def test_a_long_text_is_wrapped_and_its_interval_stays_whole(model):
    view = arm_view(model, np.zeros(7), pins=(Pin(LONG, 3),))
    ((_, said),) = lines(still(view, ""))
    assert len(said) > 1
    assert " ".join(said).replace("\N{NO-BREAK SPACE}", " ") == LONG.replace("^2", "²")
    assert any("[5.952,\N{NO-BREAK SPACE}6.072]" in line for line in said)
    assert max(map(len, said)) <= 34


def test_texts_do_not_run_into_each_other(model):
    pins = tuple(Pin(LONG, joint) for joint in range(5))
    placed = lines(still(arm_view(model, np.zeros(7), pins=pins), ""))
    assert len(placed) == len(pins)
    ends = [y + 16 * (len(said) - 1) for y, said in placed]
    starts = [y for y, _ in placed]
    assert all(start > end for start, end in zip(starts[1:], ends[:-1], strict=True))
    assert max(ends) <= HEIGHT


def test_markup_in_a_text_is_text(model):
    view = arm_view(model, np.zeros(7), pins=(Pin("<b>", None),))
    assert "<b>" not in still(view, "")
