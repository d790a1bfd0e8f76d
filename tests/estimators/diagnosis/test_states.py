"""Headlines have all states that hold, and no sentence says what the verdict does not have."""

from __future__ import annotations

import re
from dataclasses import replace

from hypothesis import given
from hypothesis import strategies as st

from estimators.diagnosis.headline import MOST, headline
from estimators.diagnosis.quantities import differs, name_of_value, value_columns
from estimators.diagnosis.reading import verdict_in
from estimators.diagnosis.report.findings import removed
from estimators.diagnosis.report.sections import identified, stated_values
from estimators.diagnosis.result import hardly_shown, lines_of
from estimators.diagnosis.verdict import (
    UNKNOWN,
    VERDICT,
    BeforeAfter,
    Finding,
    Fit,
    Holds,
    Identified,
    RowCount,
    StatedValue,
    Unexplained,
    Verdict,
    Where,
)

N = 3
NAMES = ("shoulder", "elbow", "wrist")
EFFECTS = (("coulomb_friction", "tau_c", "N m"), ("viscous_friction", "f_v", "N m s/rad"))
FLOOR = (0.1,) * N


def value(joint=2, kind=0, stated=1.0, fitted=1.44, spread=0.01, reported=True, **more):
    effect, name, unit = EFFECTS[kind]
    return StatedValue(
        name, effect, (joint,), (NAMES[joint - 1],), unit, stated, fitted,
        (fitted - 2 * spread, fitted + 2 * spread), 0.15, reported=reported,
        **{"assumed": True, "beyond": False, "share": 0.9} | more,
    )  # fmt: skip


def fit(above=(), removed=0.9, interval=(0.8, 0.95), left=()):
    before, after = (
        tuple(1.0 if j in some else 0.1 for j in range(1, N + 1)) for some in (above, left)
    )
    sides = {"above_floor": tuple(above), "still_above": tuple(left)}
    return Fit(before, after, FLOOR, removed, interval, **sides)


def verdict(**more):
    usual = Verdict(
        "consistent", (), Unexplained(), (), None, fit(), RowCount(1, {}), joint_names=NAMES
    )
    return replace(usual, **more)


def finding(effect, joint, kind="missing"):
    zeros = BeforeAfter(FLOOR, FLOOR)
    return Finding(effect, kind, (joint,), (), 0.9, {}, Where(), 0.1, zeros, "Evidence.")


def test_a_value_that_differs_inside_its_tolerance_is_told_by_name_and_from_what_to_what():
    found = verdict(values=(value(),), fit=fit(above=(2,)))
    assert found.states == ("stated values differ",)
    assert headline(found) == (
        "Coulomb friction of joint 2 (elbow) is 1.440 N m [1.420, 1.460], not the stated 1."
    )
    table = "\n".join(lines_of(found))
    assert "2.9 tolerances of 15 % (limo's guess)" in table
    assert "1.440" in stated_values(found)
    assert "1.440" in stated_values(replace(found, values=(value(reported=False),)))


def test_a_tolerance_that_the_user_stated_is_said_to_be_stated():
    assert "2.9 tolerances of 15 % (stated)" in "\n".join(
        lines_of(verdict(values=(value(assumed=False),)))
    )


def test_a_width_of_a_sign_that_nobody_has_to_state_is_said_to_be_the_usual_one():
    width = replace(value(), name="v_eps", stated=0.005, fitted=0.01)
    assert "0.005 (limo's usual)" in "\n".join(lines_of(verdict(values=(width,))))


def test_a_gain_far_off_comes_first_where_room_is_short_and_one_not_shown_says_so():
    servo = {"name": "kp", "effect": "position_servo", "unit": "N m/rad", "tolerance": 300.0}
    gain = replace(value(stated=998.0, fitted=9.1), **servo, ci95=(6.6, 12.6), share=0.5)
    taken = replace(value(1, stated=998.0, fitted=11.0, reported=False), **servo, ci95=None)
    others = ("coulomb_friction", "viscous_friction", "armature", "spring_load")
    small = [replace(value(joint=1, share=0.99), effect=one) for one in others]
    errors = replace(fit(above=(2,)), one_step_rmse_before=FLOOR)
    found = verdict(values=(*small, gain, taken), fit=errors)
    assert headline(found).startswith("P gain of joint 2 (elbow) is 9.1 N m/rad [6.6, 12.6], not ")
    columns = value_columns(found)
    assert columns["fits"][0] == "9.1 N m/rad [6.6, 12.6]"
    assert columns["fits"][-1] == "11 N m/rad (not shown by this motion)"
    assert columns["tolerance"][0] == "16 tolerances of 30.1 % (limo's guess)"


def test_a_family_is_told_by_the_torque_that_it_makes():
    family = replace(value(), name="masses and centres of links", effect="", unit="N m",
                     stated=12.0, fitted=13.0, ci95=(12.8, 13.2), tolerance=None)  # fmt: skip
    found = verdict(values=(family,), fit=fit(above=(2,)))
    assert "tolerances of" not in "\n".join(lines_of(found))
    assert differs((family,), NAMES) == (
        "masses and centres of links, felt at joint 2 (elbow), are not as stated"
    )
    assert headline(found) == (
        "Masses and centres of links make 13.00 N m [12.80, 13.20] at joint 2 (elbow), not the "
        "stated 12."
    )


def test_what_nobody_stated_is_physics_that_is_missing():
    delay = replace(value(), name="delay", effect="drive_delay", unit="s", stated=0.0,
                    fitted=0.0295, ci95=(0.0291, 0.0299), tolerance=None)  # fmt: skip
    found = verdict(values=(delay,), fit=fit(above=(2,)))
    assert found.states == ("physics is missing",)
    assert headline(found).endswith("none is stated.")
    bare = verdict(identified=(Identified("coulomb_friction", 2),), fit=fit(above=(2,)))
    assert bare.states == ("physics is missing",)
    at_floor = verdict(identified=(Identified("coulomb_friction", 2),))
    assert at_floor.states == ("agrees",)


def test_an_error_that_nothing_accounts_for_stays_unexplained():
    found = verdict(values=(value(joint=2),), fit=fit(above=(2, 3), left=(3,)))
    assert found.states == ("stated values differ", "something unexplained remains")
    assert "joint 3 (wrist): something unknown, 10.0 noise floors" in headline(found)
    moved_along = replace(found, fit=fit(above=(2, 3)))  # by what differs at another joint
    assert moved_along.states == ("stated values differ",)
    alone = verdict(fit=fit(above=(2,)))
    assert alone.states == ("something unexplained remains",)


def test_it_is_written_and_read_back(tmp_path):
    found = verdict(values=(value(),), fit=fit(above=(2,)))
    found.save(tmp_path / VERDICT)
    assert found.as_values()["states"] == ["stated values differ"]
    assert found.as_values()["values"][0]["ci95"] == [1.42, 1.46]
    assert verdict_in(tmp_path) == found


small = st.floats(0.01, 100.0, allow_nan=False)
joints = st.integers(1, N)
values = st.builds(
    value, joint=joints, kind=st.integers(0, 1), stated=small, fitted=small,
    spread=st.floats(1e-4, 1.0), reported=st.booleans(), beyond=st.booleans(),
    share=st.floats(0.0, 1.0),
)  # fmt: skip
findings = st.builds(
    finding, st.sampled_from(["payload", "torque_offset", "backlash", UNKNOWN]), joints
)
parts = st.floats(-1.0, 1.0)


@st.composite
def verdicts(draw):
    some = draw(st.lists(values, max_size=6, unique_by=lambda x: x.in_words))
    found = draw(st.lists(findings, max_size=3))
    above = draw(st.lists(joints, unique=True))
    kept = draw(st.lists(values, max_size=6, unique_by=lambda x: x.in_words))
    ranges = ((0.0, 1.0),) * N
    low, high = sorted((draw(parts), draw(parts)))
    return verdict(
        verdict="explained" if found else "consistent",
        values=tuple(some),
        findings=tuple(found),
        unexplained=Unexplained(tuple(draw(st.lists(joints, unique=True)))),
        identified=tuple(
            Identified(draw(st.sampled_from(EFFECTS))[0], joint)
            for joint in draw(st.lists(joints, unique=True))
        ),
        fit=fit(above, draw(parts), (low, high), draw(st.lists(joints, unique=True))),
        holds=Holds(ranges, ranges, ranges, tuple(x.in_words for x in kept)),
    )


@given(verdicts())
def test_all_states_that_hold_are_there_and_no_other(found):
    text = headline(found)
    agrees = found.states == ("agrees",)
    assert agrees == ("simulation agree" in text)
    assert len(set(found.states)) == len(found.states)
    reported = [item for item in found.values if item.reported]
    assert bool(reported) == ("stated values differ" in found.states)
    if reported:
        assert any(name_of_value(x).lower() in text.lower() for x in reported)
    assert ("something unknown" in text) == ("something unexplained remains" in found.states)
    assert agrees or text.endswith(".")
    assert len(text) <= MOST or "more below" in text or len(found.states) > 1


@given(verdicts())
def test_no_value_that_changed_is_said_to_be_hardly_shown(found):
    text = hardly_shown(found) + "\n".join(lines_of(found))
    assert "kept as stated" not in text
    for item in found.values:
        if item.moved or item.is_known_well:
            assert item.in_words not in found.hardly_shown
            assert item.in_words not in found.as_values()["holds"]["as_stated"]


@given(verdicts())
def test_nobody_is_said_to_state_no_friction_where_there_is_some(found):
    text = f"{headline(found)}\n{identified(found)}"
    assert "states no friction" not in text
    stated = {(item.effect, item.joints) for item in found.values}
    lacking = {item.joint for item in found.identified if (item.effect, item.joints) not in stated}
    assert {*found.not_stated} == lacking & {*found.fit.above_floor}
    assert found.not_stated or "is not stated, and was identified" not in text


@given(verdicts())
def test_no_interval_ends_where_it_begins(found):
    for text in (removed(found), headline(found), *lines_of(found)):
        for low, high in re.findall(
            r"interval (\S+?)(?: |\N{NO-BREAK SPACE})% to (\S+?)\W*%", text
        ):
            assert low != high
        for low, high in re.findall(r"\[(-?[\d.]+), (-?[\d.]+)\]", text):
            assert low != high
