"""What was concealed stands beside what was found of it, and what was found beyond it."""

from __future__ import annotations

import re

from estimators.diagnosis.report.truth import beside_the_truth, recovered
from estimators.diagnosis.verdict import BeforeAfter, Finding, Interval, Where
from limo_driver.physics import Payload, PreslidingHysteresis, QuadraticDrag

N = 7
NAMES = ("",) * N
PAYLOAD = Payload(mass=0.8, com=(0.0, 0.0, 0.1))
DRAG = QuadraticDrag(joint=4, coefficient=6.0)
HYSTERESIS = PreslidingHysteresis(joint=2, law="maxwell_slip", stiffness=(120.0,), width=(0.004,))


def found(effect, joints, **parameters):
    ones = (1.0,) * N
    return Finding(effect, "missing", joints, (), 0.9, parameters, Where(), 0.5,
                   BeforeAfter(ones, ones), "Evidence.")  # fmt: skip


MASS = found("payload", (6,), mass=Interval(0.776, "kg", (0.675, 0.878)))
ELSEWHERE = found("quadratic_drag", (5,), coefficient=Interval(5.0, "N m s^2/rad^2", (4.0, 6.0)))


def cells(page):
    rows = re.findall(r"<tr>(<td.*?)</tr>", page)
    return [
        re.findall(r"<td[^>]*>(.*?)</td>", row.replace("\N{NO-BREAK SPACE}", " ")) for row in rows
    ]


def test_a_payload_is_the_same_whichever_joint_feels_it():
    assert recovered([PAYLOAD], [MASS], NAMES) == (
        "Payload of 0.8 kg at the flange was concealed, 0.78 kg [0.68, 0.88] was found."
    )
    assert cells(beside_the_truth([PAYLOAD], [MASS], NAMES)) == [
        ["payload of 0.8 kg at the flange", "payload: 0.78 kg [0.68, 0.88]", "90 %"]
    ]


def test_the_right_effect_at_another_joint_is_not_what_was_concealed():
    assert recovered([DRAG], [ELSEWHERE], NAMES).endswith("was concealed and not found.")
    assert [row[:2] for row in cells(beside_the_truth([DRAG], [ELSEWHERE], NAMES))] == [
        ["quadratic drag of 6 N m s²/rad² at joint 4", "not found"],
        ["nothing", "quadratic drag: 5.0 N m s²/rad² [4.0, 6.0]"],
    ]


def test_an_effect_without_one_size_is_said_to_be_found():
    same = found("presliding_hysteresis", (2,))
    said = recovered([HYSTERESIS], [same], NAMES)
    assert said == "Presliding hysteresis at joint 2 was concealed, it was found."
