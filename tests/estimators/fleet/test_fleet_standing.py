"""Odd arms and drifts are found in rows that have them, and in no others."""

import re
from collections.abc import Sequence
from dataclasses import replace
from datetime import datetime, timedelta
from pathlib import Path

import numpy as np
import pytest
from audit import violations
from browser import browser, program

from estimators.diagnosis.verdict import (
    BeforeAfter,
    Finding,
    Fit,
    Identified,
    Interval,
    RowCount,
    StatedValue,
    Unexplained,
    Verdict,
    Where,
)
from estimators.studies import FleetDiagnosis, FleetRow
from estimators.studies.fleet_page import fleet_page
from estimators.studies.fleet_row import arm_of, date_of

START = datetime(2026, 3, 1)


def row(arm: str, day: int, error: tuple[float, ...]) -> FleetRow:
    fit = Fit(error, error, (0.01,) * len(error), 0.0, (0.0, 0.0))
    verdict = Verdict("consistent", (), Unexplained(), (), None, fit, RowCount(1, {}))
    path = Path(arm) / f"{day}.parquet"
    return FleetRow(path, f"{arm}{day}", arm, START + timedelta(days=day), verdict=verdict)


def fleet(seed: int, odd: float = 1.0, growth: float = 0.0) -> FleetDiagnosis:
    """Return eight arms of ten days; the third may be odd, and the fifth may drift, at joint 2."""
    random = np.random.default_rng(seed)
    units = 0.1 * np.exp(0.15 * random.standard_normal((8, 2)))
    rows: list[FleetRow] = []
    for k, unit in enumerate(units):
        for day in range(10):
            error = unit * np.exp(0.05 * random.standard_normal(2))
            error[1] *= (odd if k == 2 else 1.0) * (1 + (growth * day / 9 if k == 4 else 0.0))
            rows.append(row(f"arm{k}", day, tuple(error)))
    return FleetDiagnosis("two_links", tuple(rows))


@pytest.mark.slow("judges forty fleets")
def test_of_forty_fleets_of_arms_that_are_alike_hardly_one_has_a_false_alarm():
    fleets = [fleet(seed) for seed in range(40)]
    assert sum(bool(item.odd) for item in fleets) <= 1
    assert sum(bool(item.drifting) for item in fleets) <= 1


@pytest.mark.parametrize("seed", range(5))
def test_the_odd_arm_and_the_drifting_one_are_named_and_no_other(seed):
    found = fleet(seed, odd=5.0, growth=1.0)
    assert found.odd == ("arm2",)
    assert found.drifting == ("arm4",)
    (drift,) = found.drifts
    assert drift.series.name == "error of joint 2"
    assert drift.interval[0] < 1.0 < drift.interval[1]


def stated(name: str, fitted: float, tolerance: float = 0.3) -> StatedValue:
    """Return a value of joint 1 that the simulation states as 1."""
    effect = {"f_v": "viscous_friction", "inertia": "armature"}.get(name, "coulomb_friction")
    close = (fitted - 0.01, fitted + 0.01)
    return StatedValue(name, effect, (1,), ("stick",), "u", 1.0, fitted, close, tolerance, True, False, False, 0.0)  # fmt: skip  # noqa: E501


def having(whole: FleetRow, *values: StatedValue, **found: tuple[Finding, ...]) -> FleetRow:
    """Return a row with stated values, and with findings."""
    assert whole.verdict is not None
    return replace(whole, verdict=replace(whole.verdict, values=values, **found))


def missing(effect: str, **parameters: float) -> Finding:
    known = {k: Interval(v, "u", (0.9 * v, 1.1 * v)) for k, v in parameters.items()}
    return Finding(
        effect, "missing", (1,), (), 1.0, known, Where(), 1.0, BeforeAfter((0.1,), (0.1,)), ""
    )


def of_values(odd: float, growth: float = 0.0, name: str = "f_v") -> FleetDiagnosis:
    """Return six arms whose errors are alike; of a value that all may move, two are unlike."""
    random = np.random.default_rng(0)
    rows: list[FleetRow] = []
    for k in range(6):
        unit = 1 + 0.03 * random.standard_normal()
        for day in range(8):
            value = unit * (odd if k == 2 else 1.0) * (1 + (growth * day / 7 if k == 4 else 0.0))
            own = stated(name, value + 0.02 * random.standard_normal())
            rows.append(having(row(f"arm{k}", day, (0.1,)), own))
    return FleetDiagnosis("one", tuple(rows), joints=("stick",))


def test_values_within_their_tolerances_tell_odd_and_drifting_arms(tmp_path):
    found = of_values(odd=1.7, growth=0.8)
    assert found.odd == ("arm2",)
    assert found.drifting == ("arm4",)
    assert set(found.sentences) == {"arm2", "arm4"}
    assert re.fullmatch(
        r"viscous friction of joint 1 \(stick\) is 1\.\d+ u where the fleet has [.\d]+",
        found.sentences["arm2"],
    )
    rose = (
        r"viscous friction of joint 1 \(stick\) rose from (1|0\.\d+) to 1\.[789]\d* u between the "
    )
    assert re.match(rose, found.sentences["arm4"])
    assert found.sentences["arm4"] in fleet_page(found, tmp_path).html()


def test_what_only_serves_a_fit_makes_no_arm_odd():
    found = of_values(odd=5.0, growth=5.0, name="v_eps")
    assert found.odd == found.drifting == ()
    assert [item.name for item in found.series] == ["error of joint 1 (stick)"]


def test_a_quantity_is_one_series_whatever_it_was_found_as():
    """Stated and moved, found beyond its tolerance, or as friction that was not stated."""
    rows: list[FleetRow] = []
    for day in range(8):
        own, value = row("arm0", day, (0.1,)), 4.0 + 0.5 * day
        if day < 3:
            rows.append(having(own, stated("tau_c", value)))
        elif day < 6:
            found = replace(missing("coulomb_friction", tau_c=value), kind="wrong_parameter")
            rows.append(having(own, findings=(found,)))
        else:
            friction = missing("coulomb_friction", tau_c=value).parameters
            rows.append(having(own, identified=(Identified("coulomb_friction", 1, friction),)))
    fleet = FleetDiagnosis("one", tuple(rows))
    (series,) = (item for item in fleet.series if not item.ratio)
    assert series.name == "Coulomb friction of joint 1"
    assert series.values.tolist() == [4.0 + 0.5 * day for day in range(8)]
    assert fleet.sentences == {
        "arm0": "Coulomb friction of joint 1 rose from 4 to 7.5 u between the first and the last "
        "date"
    }


@pytest.mark.parametrize(
    ("found", "named"),
    [
        (missing("payload", mass=0.75), "payload is 0.75 u where the fleet has 0"),
        (missing("spring_load", stiffness=20.0), "stiffness of the spring of joint 1 is 20 u"),
    ],
)
def test_what_one_arm_alone_has_is_zero_at_the_others(found, named):
    rows = [
        having(row(f"arm{k}", day, (0.1,)), findings=(found,) if k == 3 and day else ())
        for k in range(5)
        for day in range(4)
    ]
    (arm,) = FleetDiagnosis("one", tuple(rows)).sentences.items()
    assert arm[0] == "arm3"
    assert named in arm[1]


def test_what_grows_from_nothing_drifts():
    """A payload whose interval nobody knows, found on the last seven of sixteen dates."""
    rows = [row(f"arm{k}", day, (0.1,)) for k in range(5) for day in range(16)]
    for day in range(9, 16):
        known = {"mass": Interval(0.2 * (day - 8), "kg")}
        rows[day] = having(rows[day], findings=(replace(missing("payload"), parameters=known),))
    (drift,) = FleetDiagnosis("one", tuple(rows)).drifts
    assert (drift.arm, drift.series.name) == ("arm0", "payload")


def test_what_some_recordings_do_not_show_is_not_zero_there():
    """Neither what is stated, nor friction that every joint has, and only some motions show."""
    friction = (Identified("viscous_friction", 1, missing("", f_v=1.0).parameters),)
    vague = replace(stated("tau_c", 1.0), ci95=(0.0, 2.0))
    rows = [
        having(row(f"arm{k}", day, (0.1,)), stated("tau_c", 1.0), identified=friction)
        if day < (3 if k == 2 else 1)
        else having(row(f"arm{k}", day, (0.1,)), vague)
        for k in range(5)
        for day in range(4)
    ]
    found = FleetDiagnosis("one", tuple(rows))
    assert found.odd == ()
    assert {set(x.values) == {1.0} for x in found.series if not x.ratio} == {True}


def test_a_value_says_more_of_an_arm_than_its_error_does():
    rows = [
        having(row(f"arm{k}", day, (2.0 if k == 1 else 0.1,)), stated("tau_c", 1.0 + (k == 1)))
        for k in range(5)
        for day in range(4)
    ]
    found = FleetDiagnosis("one", tuple(rows))
    assert found.odd == ("arm1",)
    assert found.sentences["arm1"].startswith("Coulomb friction of joint 1 is 2 u")


def test_less_than_a_tolerance_is_nothing_however_clear():
    found = of_values(odd=1.25, growth=0.25)
    assert found.odd == found.drifting == ()


@pytest.mark.parametrize(
    ("arms", "odd", "named"),
    [(20, 1.45, True), (20, 1.08, False), (4, 1.45, False), (4, 2.0, True)],
)
def test_the_more_arms_are_alike_the_less_is_odd(arms, odd, named):
    random = np.random.default_rng(0)
    units = 1 + 0.05 * random.standard_normal(arms)
    units[2] = odd
    rows = [
        having(row(f"arm{k}", day, (0.1,)), stated("f_v", unit, tolerance=0.01))
        for k, unit in enumerate(units)
        for day in range(3)
    ]
    assert FleetDiagnosis("one", tuple(rows)).odd == (("arm2",) if named else ())


def test_a_value_that_few_recordings_of_an_arm_tell_is_no_value_of_the_arm():
    found = of_values(odd=1.7)
    own = [row for row in found.rows if row.arm == "arm2"]
    for told, odd in ((len(own) // 2, ("arm2",)), (len(own) // 2 - 1, ())):
        silent = {row.key for row in own[told:]}
        rows = tuple(having(r) if r.key in silent else r for r in found.rows)
        assert FleetDiagnosis("one", rows).odd == odd


def test_few_arms_or_dates_say_nothing():
    rows = [row(f"arm{k}", d, (0.1 * 10**k,)) for k in range(3) for d in range(5)]
    found = FleetDiagnosis("one", tuple(rows))
    assert found.standings == ()
    assert found.drifts == ()


def test_the_page_says_how_many_dates_it_takes(tmp_path):
    rows = [row(f"arm{k}", d, (0.1 * 1.5**d,) * 7) for k in range(4) for d in range(5)]
    found = FleetDiagnosis("seven", tuple(rows))
    assert found.drifts == ()
    few = "no arm has more than 5 dates: a drift takes 6, or from 4 on values with"
    page = fleet_page(found, tmp_path).html()
    assert few in page
    assert "Moved most: error of joint 1 of arm0" in page
    assert few in str(found)
    more = [row(f"arm{k}", d, (0.1 * 1.5**d,) * 7) for k in range(4) for d in range(6)]
    assert FleetDiagnosis("seven", tuple(more)).drifting


def test_arms_are_listed_in_the_order_of_their_numbers(tmp_path):
    rows = [row(f"bay{k}", d, (0.1 * k,)) for k in (10, 2, 1, 3) for d in range(5)]
    page = fleet_page(FleetDiagnosis("one", tuple(rows)), tmp_path)
    for figure in page.charts.figures:
        order = figure["layout"]["yaxis"].get("categoryarray", ["bay10", "bay3", "bay2", "bay1"])
        assert order == ["bay10", "bay3", "bay2", "bay1"]  # upwards
    assert any("categoryarray" in figure["layout"]["yaxis"] for figure in page.charts.figures)


def of_few_dates(values: Sequence[float], half: float) -> FleetDiagnosis:
    """Return three arms, of which one has these values, and the others its first."""
    rows: list[FleetRow] = []
    for k in range(3):
        for day, value in enumerate(values):
            own = value if k == 1 else values[0]
            known = replace(stated("tau_c", own), ci95=(own - half, own + half))
            rows.append(having(row(f"arm{k}", 7 * day, (0.1,)), known))
    return FleetDiagnosis("one", tuple(rows))


@pytest.mark.parametrize(
    ("values", "half", "drifting"),
    [
        ((0.761, 0.95, 1.14, 1.33, 1.52), 0.007, ("arm1",)),
        ((0.761, 1.014, 1.267, 1.52), 0.001, ("arm1",)),
        ((0.761, 0.95, 1.14, 1.33, 1.52), 0.5, ()),  # the line is closer than its values are known
        ((0.761, 1.2, 0.9, 1.33, 1.52), 0.007, ()),  # more scatter than the intervals tell
        ((0.761, 1.14, 1.52), 0.007, ()),
    ],
)
def test_four_or_five_dates_of_values_with_intervals_are_enough_for_a_line(values, half, drifting):
    assert of_few_dates(values, half).drifting == drifting


@pytest.mark.slow("judges two hundred fleets")
@pytest.mark.parametrize("dates", [4, 5])
def test_few_dates_without_a_drift_hardly_ever_show_one(dates):
    random = np.random.default_rng(0)
    fleets = [of_few_dates(tuple(random.normal(1.0, 0.3, dates)), 0.01) for _ in range(200)]
    assert sum(bool(item.drifting) for item in fleets) <= 4


def test_few_dates_show_a_drift_that_is_a_line():
    """By their order alone, no seven values of one arm of twenty are surely a trend."""
    random = np.random.default_rng(0)
    scatter = np.exp(0.02 * random.standard_normal((20, 7, 7)))
    scatter[3, :, 4] *= 1 + np.arange(7) / 6
    rows = [row(f"arm{k}", d, tuple(0.1 * scatter[k, d])) for k in range(20) for d in range(7)]
    found = FleetDiagnosis("seven", tuple(rows))
    assert [(item.arm, item.series.name) for item in found.drifts] == [("arm3", "error of joint 5")]


def test_one_value_far_from_the_rest_is_no_drift_and_hides_none():
    far = [0.1, 0.1, 0.11, 0.1, 0.09, 0.1, 0.1, 0.1, 0.11, 5.0]
    rising = [0.1 * 1.1**d if d != 5 else 5.0 for d in range(10)]
    rows = [row("steady", d, (value,)) for d, value in enumerate(far)]
    rows += [row("rising", d, (value,)) for d, value in enumerate(rising)]
    found = FleetDiagnosis("one", tuple(rows))
    assert found.drifting == ("rising",)


@pytest.mark.slow("starts a browser")
@pytest.mark.skipif(program() is None, reason="no Chromium is installed on this machine")
@pytest.mark.parametrize(("width", "dark"), [(1400, False), (390, True)])
def test_everybody_can_use_the_page(tmp_path, width, dark):
    page = tmp_path / "fleet.html"
    fleet_page(fleet(0, odd=5.0, growth=1.0), tmp_path).save(page)
    with browser() as tab:
        assert violations(tab, page.as_uri(), width, dark=dark) == []
        assert tab.errors == []


def test_a_recording_without_a_date_does_not_hide_a_drift(tmp_path):
    undated = replace(row("arm4", 0, (0.1, 0.1)), date=None)
    few = [row(f"young{k}", 0, (0.1, 0.1)) for k in range(60)]
    found = FleetDiagnosis("two", (*fleet(0, growth=1.0).rows, undated, *few))
    assert found.drifting == ("arm4",)
    assert "arm4: error of joint 2" in fleet_page(found, tmp_path).html()


def test_the_page_names_them_and_escapes_paths(tmp_path):
    found = fleet(0, odd=5.0, growth=1.0)
    bad = FleetRow(Path("<b>.parquet"), "", "arm0", None, error="cannot be read: no such file")
    html = fleet_page(FleetDiagnosis("two", (*found.rows, bad)), tmp_path).html()
    assert found.headline == "Odd: arm2; drifting: arm4"
    assert "<h1" in html
    assert found.headline in html
    assert "arm2: error of joint 2 is" in html
    assert "arm4: error of joint 2 rose from" in html
    assert "&lt;b&gt;.parquet" in html


def test_arm_and_date_come_from_the_path():
    assert arm_of(Path("fleet/arm3/run.parquet")) == "arm3"
    assert date_of(Path("arm3/2026-03-01.parquet")) == datetime(2026, 3, 1)
    assert date_of(Path("2025-01-01/20260301_1415.parquet")) == datetime(2026, 3, 1, 14, 15)
    assert date_of(Path("arm3/2026-13-41.parquet")) is None
    assert date_of(Path("arm3/serial_820260301.parquet")) is None


def test_what_is_found_is_listed_once_with_its_arms_and_no_setting_of_a_fit(tmp_path):
    load = missing("payload", mass=1.0)
    rows = [
        having(row(f"arm{k}", day, (0.1,)), stated("v_eps", 5.0), findings=(load,))
        for k in range(2)
        for day in range(2 + k)
    ]
    page = fleet_page(FleetDiagnosis("one", tuple(rows), joints=("stick",)), tmp_path).html()
    assert page.count("<td>payload at the flange</td>") == 1
    assert "arm1 (3 of 3), arm0 (2 of 2)" in page
    assert "at joint 1: not as stated" not in page
