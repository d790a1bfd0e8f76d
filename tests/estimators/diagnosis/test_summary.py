"""Summary: one text for terminal and Python, with all that a reader needs to trust an error."""

from __future__ import annotations

from dataclasses import replace

import pytest

from estimators.diagnosis.headline import headline
from estimators.diagnosis.result import columns_of, coverage, identified_columns, lines_of
from estimators.diagnosis.verdict import (
    BeforeAfter,
    Finding,
    Fit,
    Holds,
    Identified,
    Interval,
    RowCount,
    Unexplained,
    Verdict,
    Where,
)

FIT = Fit((0.4312, 3.7), (0.0312, 0.0078), (0.03, 0.0096), 0.9, (0.8, 0.95), (0.5, 3.0),
          (0.52, 3.9), (0.12, 0.2))  # fmt: skip
FINDING = Finding(
    "payload", "missing", (2,), ("link_inertia",), 0.93,
    {"mass": Interval(0.968, "kg", (0.754, 1.182))}, Where(), 0.8,
    BeforeAfter((0.4, 3.0), (0.1, 0.1)), "At joint 2 the error goes with the load.",
)  # fmt: skip
ROWS = RowCount(3810, {}, 400, (300, 280), (200, 180), 100, (69, 81))
VERDICT = Verdict("explained", (FINDING,), Unexplained(), (), None, FIT, ROWS, ("A note.",))


def test_it_has_findings_equivalents_table_and_notes():
    lines = lines_of(VERDICT)
    assert lines[0] == headline(VERDICT)
    assert lines[1:4] == [
        "payload, at the flange: mass 0.97 kg [0.75, 1.18]",
        f"  {FINDING.evidence}",
        "  confidence 93 %; cannot be told from link inertia",
    ]
    assert lines[-1] == "note: A note."
    table = lines[lines.index("held-out RMSE [N m]") :]
    assert table[2].split() == [
        "joint", "given", "tolerances", "improved", "floor", "judged", "given", "improved"
    ]  # fmt: skip
    assert " ".join(table[4].split()) == "2 3.70 3.00 0.00780 0.00960 81 % 3.90 0.200"
    assert max(map(len, table[:5])) <= 80


def test_what_makes_all_of_it_doubtful_stands_above_the_findings():
    doubt = "Is it another arm?"
    lines = lines_of(replace(VERDICT, notes=("A note.", doubt), doubts=(doubt,)))
    assert lines[1] == f"doubtful: {doubt}"
    assert [line for line in lines if line.startswith("note: ")] == ["note: A note."]


def test_ordinary_friction_is_a_line_a_joint_and_a_table_in_the_report():
    identified = tuple(
        Identified(effect, joint, {name: Interval(1.25 * joint, unit, (1.0 * joint, 1.5 * joint))})
        for effect, name, unit, joints in (
            ("coulomb_friction", "tau_c", "N m", (1, 3)),
            ("viscous_friction", "f_v", "N m s/rad", (3,)),
        )
        for joint in joints
    )
    columns = identified_columns(replace(VERDICT, identified=identified))
    assert columns == {
        ("", "", "joint"): ["1", "3"],
        ("coulomb friction", "tau_c", "[N m]"): ["1.25 ± 0.25", "3.75 ± 0.75"],
        ("viscous friction", "f_v", "[N m s/rad]"): ["", "3.75 ± 0.75"],
    }
    lines = lines_of(replace(VERDICT, identified=identified))
    start = lines.index("identified, with 95 % intervals")
    assert lines[start + 1 : start + 4] == [
        "joint 1  coulomb friction: tau_c 1.25 ± 0.25 N m",
        "joint 3  coulomb friction: tau_c 3.75 ± 0.75 N m; "
        "viscous friction: f_v 3.75 ± 0.75 N m s/rad",
        "",
    ]


def test_a_law_of_several_elements_is_identified_by_them():
    """Maxwell slip has no other parameters, and a line of a joint without values says nothing."""
    stiffness = Interval((120.0, 30.5), "N m/rad", ((100.0, 140.0), (20.0, 41.0)))
    law = Identified("presliding_hysteresis", 2, {"stiffness": stiffness})
    lines = lines_of(replace(VERDICT, identified=(law,)))
    assert "joint 2  presliding hysteresis: stiffness (120, 30.5) N m/rad" in lines


def test_it_says_which_part_of_the_rows_the_errors_count():
    assert "over 69 % to 81 % of the rows held out" in coverage(VERDICT)
    assert coverage(VERDICT) in lines_of(VERDICT)
    assert columns_of(VERDICT)["rows judged"] == pytest.approx((0.69, 0.81))


def test_it_says_once_what_several_joints_keep_as_stated_and_how_fast_they_moved():
    kept = (
        "offset of joint 1 (torque offset)",
        "offset of joint 2 (torque offset)",
        "tau_c of joint 2 (coulomb friction)",
        "gravity (tilt)",
    )
    motion = ((0.0, 1.3), (0.0, 0.0))
    lines = lines_of(replace(VERDICT, holds=Holds(motion, motion, motion, kept)))
    assert "The joints moved at up to 1.3 and - rad/s; faster motion is extrapolated." in lines
    assert (
        "The motion hardly shows offset of joints 1 and 2 (torque offset), tau_c of joint 2 "
        "(coulomb friction) and gravity (tilt): of these, what is stated is all that is known."
        in lines
    )


def test_tolerances_that_do_worse_are_marked_and_explained():
    lines = lines_of(VERDICT)
    assert FIT.worse_within_tolerances == (1,)
    assert sum("0.500*" in line for line in lines) == 1
    assert any(line.startswith("* Worse than given") for line in lines)
    better = replace(VERDICT, fit=replace(FIT, heldout_rmse_tolerances=(0.4, 3.0)))
    assert not any("*" in line for line in lines_of(better))


def test_what_is_not_known_has_no_column():
    errors = (FIT.heldout_rmse_before, FIT.heldout_rmse_after, FIT.noise_floor)
    bare = replace(VERDICT, fit=Fit(*errors, 0.9, (0.8, 0.95)), rows=RowCount(10, {}))
    assert list(columns_of(bare)) == ["given", "improved", "noise floor"]
    assert coverage(bare) == ""
    assert len(lines_of(bare)) == 11
