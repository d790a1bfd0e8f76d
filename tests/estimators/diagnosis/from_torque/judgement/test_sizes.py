"""Sizes: what may be nothing is no finding."""

from __future__ import annotations

from dataclasses import replace

import pytest

from estimators.diagnosis.from_torque.judgement.questions import unsure
from estimators.diagnosis.verdict import BeforeAfter, Finding, Interval, Where
from limo_driver.physics import Simulation, SpringLoad

STATED = Simulation("iiwa14", (SpringLoad(joint=2, stiffness=4.0, rest=0.1),))


def finding(effect, joint, *, kind="missing", **intervals):
    return Finding(
        effect=effect,
        kind=kind,
        joints=(joint,),
        equivalent=(),
        confidence=0.9,
        parameters={name: Interval(1.0, "", ci95) for name, ci95 in intervals.items()},
        where=Where(),
        share=0.1,
        heldout_rmse=BeforeAfter((), ()),
        evidence="",
    )


@pytest.mark.parametrize(
    ("found", "sure"),
    [
        (finding("spring_load", 7, stiffness=(-0.01, 0.28), rest=(0.2, 0.5)), False),
        (finding("spring_load", 7, stiffness=(0.01, 0.28), rest=(-0.2, 0.5)), True),
        (finding("spring_load", 7, stiffness=(-0.01, 0.28), cubic=(0.3, 0.4)), False),
        (finding("spring_load", 7, stiffness=(-0.5, -0.1)), True),
        (finding("torque_ripple", 6, amplitude=((0.0, 0.9), (0.0, 0.5))), False),
        (finding("torque_ripple", 6, amplitude=((0.0, 0.9), (0.2, 0.3))), True),
        (finding("spring_load", 2, kind="wrong_parameter", stiffness=(3.0, 5.0)), False),
        (finding("spring_load", 2, kind="wrong_parameter", stiffness=(5.0, 6.0)), True),
        (
            finding(
                "spring_load", 2, kind="wrong_parameter", stiffness=(3.0, 5.0), rest=(0.2, 0.3)
            ),
            True,
        ),
        (finding("payload", 7, mass=(0.0, 2.0)), True),  # whose moment may well be known
        (finding("gravity_direction", 7, gravity=((-0.4, 0.2), (-0.2, 0.7), (-26.0, 6.8))), False),
        (finding("gravity_direction", 7, gravity=((-0.4, 0.2), (0.1, 0.7), (-26.0, 6.8))), True),
        (finding("spring_load", 7), True),  # without intervals nothing can be said
    ],
)
def test_a_finding_whose_interval_leaves_out_nothing_is_sure(found, sure):
    assert unsure([found], STATED) == (set() if sure else {(found.effect, found.joints)})


@pytest.mark.parametrize(("material", "sure"), [(3.2, True), (0.8, False)])
def test_elements_that_stand_in_for_one_another_are_sure_by_what_they_take_off(material, sure):
    # of a UR10e with dry friction of 2.2 N m hidden at joint 4, and of the same with none
    intervals = {
        "stiffness": Interval(
            (2766.0, 678.0, 355.0), "", ((0.0, 6020.0), (0.0, 1837.0), (0.0, 834.0))
        ),
        "width": Interval((0.0002, 0.0006, 0.0013), "", None),
    }
    found = replace(
        finding("presliding_hysteresis", 4), parameters=intervals, signs={"material": material}
    )
    assert unsure([found], STATED) == (set() if sure else {("presliding_hysteresis", (4,))})
