"""The headline groups what belongs together, has the values, and fits into two lines."""

from __future__ import annotations

from dataclasses import replace

import pytest

from estimators.diagnosis.headline import MOST, headline, likelier, values_of
from estimators.diagnosis.quantities import of_several, quantity, rounded
from estimators.diagnosis.report.findings import pins
from estimators.diagnosis.verdict import (
    UNKNOWN,
    BeforeAfter,
    Finding,
    Fit,
    Identified,
    Interval,
    RowCount,
    Unexplained,
    Verdict,
    Where,
)

N = 7
FIT = Fit((0.1,) * N, (0.1,) * N, (0.1,) * N, 0.9, (0.8, 0.95))  # at the floor as given


def finding(effect, joints, kind="missing", region="", **parameters):
    return Finding(
        effect, kind, joints, (), 0.9, parameters, Where(region=region), 0.1,
        BeforeAfter((1.0,) * N, (0.1,) * N), "Evidence.",
    )  # fmt: skip


def verdict(*findings, said="explained", unexplained=()):
    return Verdict(said, findings, Unexplained(unexplained), (), None, FIT, RowCount(1, {}))


def erring(*joints):
    """Errors of a simulation that is above the noise floor at some joints as given."""
    before = tuple(1.0 if j in joints else 0.1 for j in range(1, N + 1))
    return replace(FIT, heldout_rmse_before=before, above_floor=joints)


PAYLOAD = finding("payload", (7,), mass=Interval(0.968, "kg", (0.754, 1.182)))
UNKNOWN_4 = finding(UNKNOWN, (4,), region="joint 4: large |speed| (half of it above 0.4 rad/s)")


def test_many_findings_are_grouped_with_values_and_what_is_unknown():
    friction = [
        finding(effect, (j,))
        for j in range(1, N + 1)
        for effect in ("coulomb_friction", "viscous_friction", "stribeck_friction")
    ]
    assert headline(verdict(PAYLOAD, *friction, UNKNOWN_4, said="partly_explained")) == (
        "Payload of 0.97 kg [0.75, 1.18] at the flange; friction of all joints was not in the "
        "simulation; joint 4: something unknown, half of it above 0.4 rad/s."
    )


def test_a_load_is_said_before_the_law_of_a_joint_that_takes_more():
    presliding = finding("presliding_hysteresis", (4,))
    said = headline(verdict(presliding, PAYLOAD))
    assert said.index("Payload") < said.index("presliding hysteresis")


def test_a_load_that_may_weigh_nothing_is_said_by_what_it_weighs_at_most():
    # its first moment is known where the arm hardly turns about it
    light = finding("payload", (7,), mass=Interval(0.165, "kg", (0.0, 0.3497)))
    assert headline(verdict(light)) == "Payload of at most 0.35 kg at the flange."


def test_a_name_that_is_rather_wrong_than_right_stands_in_the_headline_only_where_it_is_alone():
    doubtful = replace(finding("torque_offset", (2,)), confidence=0.1)
    assert "offset" not in headline(verdict(PAYLOAD, doubtful))
    assert headline(verdict(doubtful)) == "Torque offset at joint 2."


def test_ordinary_friction_that_was_not_stated_is_said_to_be_identified():
    identified = tuple(Identified("coulomb_friction", joint) for joint in (1, 2))
    found = replace(verdict(said="consistent"), identified=identified, fit=erring(1, 2))
    assert found.states == ("physics is missing",)
    assert headline(found) == "Friction of joints 1, 2 is not stated, and was identified."


def test_a_wrong_value_is_said_with_the_one_that_fits():
    wrong = finding(
        "viscous_friction", (3,), "wrong_parameter", f_v=Interval(1.5, "N m s/rad", (1.4, 1.6))
    )
    assert headline(verdict(wrong)) == (
        "Wrong viscous friction at joint 3: 1.50 N m s/rad [1.40, 1.60] fits."
    )


def gain(joint, fits, stated):
    kp = Interval(fits, "N m/rad", (fits - 0.4, fits + 0.4), stated)
    return finding("position_servo", (joint,), "wrong_parameter", kp=kp)


def test_a_gain_that_is_off_is_said_beside_the_stated_one():
    assert headline(verdict(gain(2, 23.3, 25.0))) == (
        "P gain of joint 2 is 23.30 N m/rad [22.90, 23.70], not the stated 25."
    )
    assert headline(verdict(gain(4, 31.0, 25.0), gain(2, 23.3, 25.0))) == (
        "P gain of joints 2, 4 is 23.3 and 31 N m/rad, not the stated 25."
    )


def test_joints_in_a_row_are_said_by_the_first_and_the_last_and_many_values_by_their_ends():
    lift, elbow, wrist = (gain(j, fits, 25.0) for j, fits in ((2, 23.3), (3, 31.0), (4, 18.0)))
    names = ("pan", "lift", "elbow", "wrist", *("",) * 3)
    assert headline(replace(verdict(wrist, lift, elbow), joint_names=names)) == (
        "P gain of joints 2 (lift) to 4 (wrist) is 23.3, 31 and 18 N m/rad, not the stated 25."
    )
    more = verdict(wrist, lift, elbow, gain(5, 17.0, 50.0))
    assert headline(more) == (
        "P gain of joints 2 to 5 is 17 to 31 N m/rad, not the stated 25 to 50."
    )


def test_a_gain_that_nobody_stated_is_said_alone():
    assert headline(verdict(gain(2, 23.3, None))) == (
        "Wrong P gain at joint 2: 23.30 N m/rad [22.90, 23.70] fits."
    )


def test_what_is_stated_stands_in_the_file_only_where_it_is_known():
    (off, alone) = verdict(gain(2, 23.3, 25.0), gain(3, 2.0, None)).as_values()["findings"]
    assert off["parameters"]["kp"]["stated"] == 25.0
    assert "stated" not in alone["parameters"]["kp"]


def test_values_go_before_findings_do_where_room_is_short():
    effects = ("payload", "torque_gain", "spring_load", "armature", "backlash", "torque_offset",
               "joint_elasticity", "torque_ripple", "encoder_offset")  # fmt: skip
    many = [
        finding(effect, (j % N + 1,), gain=Interval(1.234, "N m/rad", (1.2, 1.3)))
        for j, effect in enumerate(effects)
    ]
    for count in range(1, len(many) + 1):
        text = headline(verdict(*many[:count]))
        assert len(text) <= MOST
        assert text.startswith("Payload")
    assert "more below" in text
    assert "[" not in text


def test_nothing_found_says_so():
    assert "agree" in headline(verdict(said="consistent"))
    left = verdict(said="unexplained", unexplained=(2, 5))
    assert headline(left) == "Joints 2, 5: something unknown."


@pytest.mark.parametrize(
    ("value", "ci95", "text"),
    [
        (0.8017, (0.70317, 0.90025), "0.802 kg [0.703, 0.900]"),
        (117.2, (105.0, 129.0), "117 kg [105, 129]"),
        (3.0, None, "3 kg"),
        (3.0, (None, None), "3 kg"),
        (3.0, (3.0, 3.0), "3 kg"),
    ],
)
def test_a_quantity_has_the_digits_that_its_interval_leaves(value, ci95, text):
    assert quantity(Interval(value, "kg", ci95)) == text


def test_odds_are_words_beyond_a_million():
    assert likelier(6.0) == "400 times likelier"
    assert likelier(4.0) == "55 times likelier"
    assert likelier(11.0).replace("\N{NO-BREAK SPACE}", " ") == "60 000 times likelier"
    assert likelier(14.0) == "beyond doubt likelier"
    assert "10^" not in likelier(900.0)


@pytest.mark.parametrize(
    ("error", "said"),
    [(2021.9018, "2022"), (65.2065, "65.21"), (4.3, "4.300"), (0.00339218, "0.003392"),
     (3.2e-7, "0.0000003200"), (123_456.0, "123456"), (0.0, "0.000")],
)  # fmt: skip
def test_an_error_has_four_digits_on_any_arm(error, said):
    assert rounded(error, 4) == said


def test_joints_are_said_in_few_words():
    names = ("joint_1", "a2", "stick", "A4", *("",) * 3)
    assert [of_several(j, names) for j in ((3,), (1, 4), (2, 3, 4), range(1, 8), ())] == [
        "joint 3 (stick)", "joints 1, 4 (A4)", "joints 2 (a2) to 4 (A4)", "all joints", "all joints"
    ]  # fmt: skip


def test_a_joint_has_the_name_that_the_user_gave_it():
    drag = finding("quadratic_drag", (3,), coefficient=Interval(5.0, "1", (4.0, 6.0)))
    carried = finding("payload", (5,), mass=Interval(0.12, "kg", (0.11, 0.13)))
    named = replace(verdict(drag, carried), joint_names=("", "", "stick", "", "roll", "", "jaw"))
    assert headline(named) == (
        "Payload of 0.120 kg [0.110, 0.130] on the link of joint 5 (roll); "
        "quadratic drag of 5.0 [4.0, 6.0] at joint 3 (stick)."
    )
    assert [(pin.joint, pin.text.partition(":")[0]) for pin in pins(named)] == [
        (2, "joint 3 (stick)"), (4, "joint 5 (roll)")
    ]  # fmt: skip
    assert named.labels == ("1", "2", "3 (stick)", "4", "5 (roll)", "6", "7 (jaw)")


def test_equal_verdicts_have_equal_headlines():
    assert headline(verdict(PAYLOAD)) == headline(replace(verdict(PAYLOAD), notes=("A note.",)))


def test_values_have_the_names_of_a_simulation_file():
    found = finding(
        "stribeck_friction",
        (3,),
        tau_s=Interval(0.22, "N m", (0.2, 0.24)),
        v_s=Interval(0.08, "rad/s", (0.06, 0.1)),
    )
    assert values_of(found) == "tau_s 0.220 N m [0.200, 0.240]; v_s 0.080 rad/s [0.060, 0.100]"
