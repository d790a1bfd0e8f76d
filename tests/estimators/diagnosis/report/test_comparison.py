"""Two diagnoses side by side say what is new, gone and changed; a verdict reads back as it was."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from math import nan

import pytest
from audit import violations
from browser import browser, program

from estimators.diagnosis.reading import verdict_in
from estimators.diagnosis.report.truth import beside_the_truth, comparison, recovered
from estimators.diagnosis.verdict import (
    BeforeAfter,
    Finding,
    Fit,
    Identified,
    Interval,
    NextMotion,
    NotObservable,
    RowCount,
    Unexplained,
    Verdict,
    Where,
)
from limo_driver.errors import ConfigError
from limo_driver.model import RobotModel
from limo_driver.physics import Payload, PreslidingHysteresis, QuadraticDrag

N = 7
NAMES = ("",) * N
FIT = Fit((1.0,) * N, (0.1,) * N, (0.1,) * N, nan, (nan, nan))


def found(effect, joints, **parameters):
    return Finding(
        effect, "missing", joints, (), 0.9, parameters,
        Where(((1.0, 2.0),), "all", "joint-1", (1,)),
        0.5, BeforeAfter((1.0,) * N, (0.1,) * N), "Evidence.", {"lead": 3.0},
    )  # fmt: skip


def verdict(*findings):
    return Verdict(
        "explained", findings, Unexplained((2,), (0.1,)), (NotObservable("a", "b"),),
        NextMotion((("a", "b"),), "next.parquet"), FIT, RowCount(10, {"nan": 1}), ("A note.",),
        (Identified("coulomb_friction", 1, {"tau_c": Interval(1.0, "N m", (0.9, 1.1))}),),
    )  # fmt: skip


def payload(mass):
    return found("payload", (7,), mass=Interval(mass, "kg", (mass - 0.1, mass + 0.1)))


def test_a_parameter_that_is_a_number_in_one_and_several_in_the_other_is_shown_of_both(model):
    one = found("elasticity", (2,), stiffness=Interval(5e3, "N m/rad", (4e3, 6e3)))
    curve = Interval([4e3, 7e3], "N m/rad", ((3e3, 5e3), (6e3, 8e3)))
    page = comparison(
        model, ("a", "b"), (verdict(one), verdict(found("elasticity", (2,), stiffness=curve)))
    )
    shown = page.html().partition('id="findings"')[2].partition("</section>")[0]
    assert "5000" in shown
    assert "(4e+03" in shown


@pytest.fixture(scope="module")
def model():
    return RobotModel.load("iiwa14")


@pytest.mark.slow("starts a browser")
@pytest.mark.skipif(program() is None, reason="no Chromium is installed on this machine")
@pytest.mark.parametrize(("width", "dark"), [(1400, False), (390, True)])
def test_everybody_can_use_the_page(model, tmp_path, width, dark):
    pair = (verdict(payload(1.0)), verdict(payload(1.5), found("quadratic_drag", (4,))))
    comparison(model, ("monday", "tuesday"), pair).save(tmp_path / "page.html")
    with browser() as tab:
        assert violations(tab, (tmp_path / "page.html").as_uri(), width, dark=dark) == []


def test_a_verdict_reads_back_as_it_was_saved(tmp_path):
    steps = Interval((1.0, 2.0), "N m", ((0.9, 1.1), (1.9, 2.1)))
    saved = verdict(payload(1.0), found("presliding_hysteresis", (4,), steps=steps))
    saved.save(tmp_path / "verdict.json")
    read = verdict_in(tmp_path)
    assert read.as_values() == saved.as_values()
    assert read.findings == saved.findings
    assert read.identified == saved.identified


@pytest.mark.parametrize("content", ["{", "[]", '{"schema": 99}', '{"schema": 1, "fit": {}}'])
def test_what_is_no_verdict_is_refused_by_name(content, tmp_path):
    (tmp_path / "verdict.json").write_text(content)
    with pytest.raises(ConfigError, match=r"verdict\.json"):
        verdict_in(tmp_path)


def test_equal_diagnoses_agree(model):
    page = comparison(model, ("monday", "tuesday"), [verdict(payload(1.0))] * 2)
    assert page.title.startswith("monday and tuesday agree")
    assert "<b>differs</b>" not in page.html()


def test_what_changed_what_is_new_and_what_is_gone_is_said(model):
    first = verdict(payload(1.0), found("backlash", (3,)))
    second = verdict(payload(1.5), found("torque_offset", (2,)))
    page = comparison(model, ("a<b", "tuesday"), [first, second])
    text = page.html().replace("\N{NO-BREAK SPACE}", " ")
    assert page.title == (
        "Backlash at joint 3 only in a<b; torque offset at joint 2 only in tuesday; "
        "payload at the flange changed."
    )
    for said in ("1.00 kg [0.90, 1.10]", "1.50 kg [1.40, 1.60]", "backlash gone",
                 "torque offset new", "payload changed"):  # fmt: skip
        assert said in text
    assert [text.count(f"<b>{change}</b>") for change in ("differs", "gone", "new")] == [1, 1, 1]
    assert "a<b" not in text


def test_many_differences_are_counted_in_two_lines(model):
    names = ("backlash", "torque_offset", "presliding_hysteresis", "joint_elasticity")
    first = verdict(*(found(name, (j,)) for j, name in enumerate(names, 1)))
    second = verdict(*(found(name, (j + 3,)) for j, name in enumerate(names, 1)))
    page = comparison(model, ("a long name of a day", "tuesday"), [first, second])
    assert page.title == "4 findings only in a long name of a day; 4 findings only in tuesday."


def test_arms_of_other_joints_are_refused(model):
    other = replace(verdict(), fit=Fit((1.0,), (1.0,), (1.0,), 0.0, (0.0, 0.0)))
    with pytest.raises(ConfigError, match="7 and 1 joints"):
        comparison(model, ("a", "b"), [verdict(), other])


def test_values_are_json(tmp_path):
    verdict(payload(1.0)).save(tmp_path / "verdict.json")
    assert (
        json.loads((tmp_path / "verdict.json").read_text())["fit"]["reducible_error_removed"]
        is None
    )


PAYLOAD = Payload(mass=0.8, com=(0.0, 0.0, 0.1))
DRAG = QuadraticDrag(joint=4, coefficient=6.0)
HYSTERESIS = PreslidingHysteresis(joint=2, law="maxwell_slip", stiffness=(120.0,), width=(0.004,))


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
