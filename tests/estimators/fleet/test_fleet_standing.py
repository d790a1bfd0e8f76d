"""Odd arms and drifts are found in rows that have them, and in no others."""

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
    Interval,
    RowCount,
    Unexplained,
    Verdict,
    Where,
)
from estimators.fleet import FleetDiagnosis, FleetRow
from estimators.fleet.page import fleet_page
from estimators.fleet.row import ToleratedValue, arm_of, date_of

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


def tolerated(odd: float, growth: float = 0.0) -> FleetDiagnosis:
    """Return six arms whose errors are alike; of a value that all may move, two are unlike."""
    random = np.random.default_rng(0)
    rows: list[FleetRow] = []
    for k in range(6):
        unit = 1 + 0.03 * random.standard_normal()
        for day in range(8):
            value = unit * (odd if k == 2 else 1.0) * (1 + (growth * day / 7 if k == 4 else 0.0))
            f_v = ToleratedValue("f_v of joint 5", value + 0.02 * random.standard_normal(), "", 0.3)
            rows.append(replace(row(f"arm{k}", day, (0.1,)), tolerated=(f_v,)))
    return FleetDiagnosis("one", tuple(rows))


def test_values_within_their_tolerances_tell_odd_and_drifting_arms(tmp_path):
    found = tolerated(odd=1.7, growth=0.8)
    assert found.odd == ("arm2",)
    assert found.drifting == ("arm4",)
    assert all(item.series.tolerance for item in (*found.standings[:1], *found.drifts))
    assert "f_v of joint 5" in fleet_page(found, tmp_path).html()
    assert not [item for item in found.spreads if item.series.tolerance]


def test_a_value_that_leaves_its_tolerance_goes_on_in_one_series():
    name = "f_v of joint 1 (viscous friction)"
    rows: list[FleetRow] = []
    for day in range(6):
        own = row("arm0", day, (0.1,))
        value = 2.0 + 0.2 * day
        if day < 3:
            own = replace(own, tolerated=(ToleratedValue(name, value, "N m s/rad", 0.3),))
        else:
            assert own.verdict is not None
            f_v = {"f_v": Interval(value, "N m s/rad", (value, value))}
            found = Finding(
                "viscous_friction", "wrong_parameter", (1,), (), 1.0, f_v, Where(), 1.0,
                BeforeAfter((0.1,), (0.1,)), "",
            )  # fmt: skip
            own = replace(own, verdict=replace(own.verdict, findings=(found,)))
        rows.append(own)
    (series,) = (item for item in FleetDiagnosis("one", tuple(rows)).series if not item.ratio)
    assert series.name == name
    assert series.values.tolist() == [2.0 + 0.2 * day for day in range(6)]


def test_less_than_a_tolerance_is_nothing_however_clear():
    found = tolerated(odd=1.25, growth=0.25)
    assert found.odd == found.drifting == ()


def test_a_value_that_few_recordings_of_an_arm_tell_is_no_value_of_the_arm():
    found = tolerated(odd=1.7)
    own = [row for row in found.rows if row.arm == "arm2"]
    for told, odd in ((len(own) // 2, ("arm2",)), (len(own) // 2 - 1, ())):
        silent = {row.key for row in own[told:]}
        rows = tuple(replace(r, tolerated=()) if r.key in silent else r for r in found.rows)
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
    assert "before an arm has 6 dates; one has 5" in fleet_page(found, tmp_path).html()
    more = [row(f"arm{k}", d, (0.1 * 1.5**d,) * 7) for k in range(4) for d in range(6)]
    assert FleetDiagnosis("seven", tuple(more)).drifting


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
    assert "odd: arm2, error of joint 2" in html
    assert "drifting: arm4, error of joint 2" in html
    assert "&lt;b&gt;.parquet" in html


def test_arm_and_date_come_from_the_path():
    assert arm_of(Path("fleet/arm3/run.parquet")) == "arm3"
    assert date_of(Path("arm3/2026-03-01.parquet")) == datetime(2026, 3, 1)
    assert date_of(Path("2025-01-01/20260301_1415.parquet")) == datetime(2026, 3, 1, 14, 15)
    assert date_of(Path("arm3/2026-13-41.parquet")) is None
    assert date_of(Path("arm3/serial_820260301.parquet")) is None
