"""The report of a diagnosis, of a made-up verdict on real simulated motion."""

from __future__ import annotations

import base64
import json
import re
from dataclasses import replace
from html import unescape
from html.parser import HTMLParser
from typing import TYPE_CHECKING

import numpy as np
import plotly.graph_objects as go
import pytest
import yaml
from audit import reached_by_tab, violations
from browser import browser, program

from estimators.diagnosis.from_torque.pipeline import Diagnosis
from estimators.diagnosis.headline import headline
from estimators.diagnosis.quantities import rounded
from estimators.diagnosis.report import figures, worst_stretch, write_report
from estimators.diagnosis.report.binning import loop_stretch
from estimators.diagnosis.report.cards import loop_of
from estimators.diagnosis.report.page import render
from estimators.diagnosis.result import CHOSEN, Explanation, Replay, Shift, Traces
from estimators.diagnosis.result import Test as Question
from estimators.diagnosis.settings.fitting import CONTRIBUTION
from estimators.diagnosis.verdict import (
    BeforeAfter,
    Finding,
    Fit,
    Interval,
    NextMotion,
    NotObservable,
    RowCount,
    Unexplained,
    Verdict,
    Where,
)
from limo_driver.errors import ConfigError
from limo_driver.physics import PreslidingHysteresis
from limo_driver.recordings.filters.differentiation import smooth
from limo_driver.trajectory import Trajectory

if TYPE_CHECKING:
    from collections.abc import Sequence

    from limo_driver.physics import Simulation
    from limo_driver.recordings.recording import Recording

BANDWIDTH = 10.0


def traces_of(
    before: Simulation, after: Simulation, recordings: Sequence[Recording], every: int = 2
) -> Traces:
    """Return the signals of recordings, filtered and thinned."""
    parts = [_traces(before, after, r, k, every) for k, r in enumerate(recordings)]
    return Traces(*(np.concatenate(columns) for columns in zip(*parts, strict=True)))


def _traces(before, after, recording, number, every):
    motion = recording.motion(BANDWIDTH)
    filtered = [
        smooth(recording.time, torque, BANDWIDTH, recording.segments)
        for torque in (recording.torque, *(s.predict(motion) for s in (before, before, after)))
    ]
    load = before.model.inverse_dynamics(motion.position, motion.velocity, motion.acceleration)
    signals = (
        motion.time,
        np.full(len(motion), number),
        motion.position,
        motion.velocity,
        load,
        np.stack([_since_reversal(q, v) for q, v in zip(*_columns(motion), strict=True)], axis=1),
        *filtered,
        motion.time % 20.0 > 15.0,
        np.abs(motion.velocity) > 0.01,
    )
    return tuple(values[::every] for values in signals)


def _columns(motion):
    return motion.position.T, motion.velocity.T


def _since_reversal(position, velocity):
    turns = np.flatnonzero(np.diff(np.sign(velocity)) != 0)
    last = np.zeros(len(position), dtype=int)
    last[turns] = turns
    return np.abs(position - position[np.maximum.accumulate(last)])


def made_up(before: Simulation, after: Simulation, recordings, joint: int) -> Diagnosis:
    """Return what a diagnosis of hysteresis at one joint (1-based) might say."""
    traces = traces_of(before, after, recordings)
    n = traces.measured.shape[1]
    held = traces.held_out
    error = {
        name: np.sqrt(np.mean((traces.measured - getattr(traces, name))[held] ** 2, axis=0))
        for name in ("before", "after")
    }
    floor = 0.8 * np.minimum(error["before"], error["after"])
    finding = Finding(
        effect="presliding_hysteresis",
        kind="missing",
        joints=(joint,),
        equivalent=("stribeck_friction",),
        confidence=0.93,
        parameters={
            "law": Interval("maxwell_slip", "text"),
            "stiffness": Interval((300.0, 88.2, 24.7), "N m/rad", ((280, 321), (80, 97), (19, 31))),
            "width": Interval((0.0017, 0.0052, 0.013), "rad", None),
        },
        where=Where(((12.0, 18.5), (40.2, 44.0)), "within 0.02 rad of a reversal", ""),
        share=0.87,
        heldout_rmse=BeforeAfter(tuple(error["before"]), tuple(error["after"])),
        evidence=f"At joint {joint} the residual rises over 20 mrad after each reversal, at any "
        "speed, and returns on another path.",
    )
    verdict = Verdict(
        verdict="explained",
        findings=(finding,),
        unexplained=Unexplained(),
        not_observable=(
            NotObservable("torque_gain", "no load of known mass was moved"),
            NotObservable("temperature_dependent_friction", "the recordings last 2 minutes"),
        ),
        next_motion=NextMotion(
            (("stribeck_friction", "presliding_hysteresis"),), "next_motion.parquet"
        ),
        fit=Fit(*(tuple(e.tolist()) for e in (error["before"], error["after"], floor)), 0.91,
                (0.88, 0.94), tuple(0.7 * error["before"] + 0.3 * floor),
                tuple(1.1 * error["before"]), tuple(2.0 * error["after"])),
        rows=RowCount(26_011, {"a value is missing or not finite": 12}, 1300, (n * (900,)),
                      (n * (600,)), 300, (210, 240)),
        notes=("Torque is measured on the link's side of the gear.",),
    )  # fmt: skip
    time = np.linspace(0.0, 6.0, 601)
    swing = np.zeros((601, n))
    swing[:, joint - 1] = 0.05 * (1 - np.cos(time))
    stretch = worst_stretch(traces, floor, 10.0)
    rows = stretch.rows
    return Diagnosis(
        verdict=verdict,
        before=before,
        after=after,
        recordings=tuple(recordings),
        traces=traces,
        explanations=(
            Explanation(
                ("spring_load",), ((joint,),), 830.0, -0.2, "does not hold on motion held out"
            ),
            Explanation(("presliding_hysteresis",), ((joint,),), 812.4, 0.87, CHOSEN),
            Explanation(("stribeck_friction",), ((joint,),), 810.9, 0.85),
            Explanation(
                ("coulomb_friction", "viscous_friction"), ((joint,), (joint,)), 301.0, 0.41
            ),
            Explanation(("torque_offset",), ((joint,),), 12.0, 0.02, "worse on held-out rows"),
        ),
        tests=(
            Question(
                joint, "Does the residual depend on the distance since reversal?", 0.86, yes=True
            ),
            Question(joint, "Does it depend on the speed?", 0.04, yes=False),
        ),
        shifts=(
            Shift("mass of link_4", 3.4, 3.46, "kg", 0.9),
            Shift(f"tau_c of joint {joint}", 1.0, 0.62, "N m", -2.5),
            Shift("f_v of joint 1", 4.0, 4.1, "N m s/rad", 0.2),
        ),
        next_motion=Trajectory(time, swing, np.zeros_like(swing), np.zeros_like(swing)),
        next_motion_purpose="Creep at five speeds, both ways; decides between the two.",
        bandwidth=BANDWIDTH,
        replay=(
            Replay(
                traces.time[rows],
                traces.measured[rows],
                traces.before[rows],
                traces.after[rows],
                np.full(n, 3e-4),
                traces.moving[rows],
                stretch.recording,
                traces.position[rows],
                traces.position[rows] + 1e-4,
                traces.position[rows] + 1e-5,
            ),
        ),
    )


@pytest.fixture(scope="module")
def diagnosis(rigid, true_arm, training_recording, test_recording):
    return made_up(rigid, true_arm, (training_recording, test_recording), joint=2)


@pytest.fixture(scope="module")
def page(diagnosis):
    return render(diagnosis)


class _Page(HTMLParser):
    """Checks that elements nest, and collects anchors, links and the text outside of scripts."""

    void = {"meta", "br", "img", "link", "input", "hr"}  # noqa: RUF012  # a test's constant

    def __init__(self):
        super().__init__()
        self.open, self.anchors, self.links, self.text = [], [], [], ""

    def handle_starttag(self, tag, attrs):
        given = dict(attrs)
        self.anchors += [given["id"]] if "id" in given else []
        links = (given.get(key, "data:") for key in ("href", "src"))
        self.links += [link for link in links if not link.startswith("data:")]
        if tag not in self.void:
            self.open.append(tag)

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        if self.open and self.open[-1] not in {"script", "style"}:
            self.text += data


@pytest.fixture(scope="module")
def parsed(page):
    parser = _Page()
    parser.feed(page)
    assert parser.open == []
    return parser


def test_the_page_needs_no_network_and_stays_small(page, parsed):
    assert len(page.encode()) < 3e6
    assert all(link.startswith("#") for link in parsed.links)
    assert len(set(parsed.anchors)) == len(parsed.anchors)
    assert {link[1:] for link in parsed.links} <= set(parsed.anchors)


@pytest.mark.slow("starts a browser")
@pytest.mark.skipif(program() is None, reason="no Chromium is installed on this machine")
@pytest.mark.parametrize(("width", "dark"), [(1400, False), (390, True)])
def test_everybody_can_use_the_page(page, tmp_path, width, dark):
    (tmp_path / "report.html").write_text(page, encoding="utf-8")
    with browser() as tab:
        assert violations(tab, (tmp_path / "report.html").as_uri(), width, dark=dark) == []
        made, there = reached_by_tab(tab)
        assert made >= there - tab.value("document.querySelectorAll('input[type=radio]').length")
        assert tab.errors == []


def test_the_first_screen_says_what_was_found_and_how_sure(parsed, diagnosis):
    text = " ".join(parsed.text.split())
    finding = diagnosis.verdict.findings[0]
    for said in (
        headline(diagnosis.verdict),
        finding.evidence,
        "93 %",
        "stribeck friction",
        "280 to 321",
        "removes 91 % of the reducible error (95 % interval 88 % to 94 %)",
    ):
        assert said in text


def test_every_part_of_the_evidence_is_there(parsed):
    expected = {"errors", "findings", "where", "competing", "tests", "replay", "next", "unsure",
                "data", "joint-1", "joint-2"}  # fmt: skip
    assert expected <= set(parsed.anchors)
    for said in ("cannot be told from the chosen", "no load of known mass", "tau_c of joint 2",
                 "a value is missing or not finite", "decides between the two"):  # fmt: skip
        assert said in parsed.text


def test_the_chosen_explanation_stands_out_also_where_another_has_more_evidence(diagnosis, page):
    charts = json.loads(re.search(r'id="figures">(.*?)</script>', page, re.DOTALL).group(1))
    (bars,) = (c["data"][0] for c in charts if c["data"][0].get("type") == "bar")
    colours = bars["marker"]["color"]
    assert colours[1] not in {colours[0], *colours[2:]}
    top = diagnosis.explanations[1].log_evidence
    behind = [(top - item.log_evidence) / np.log(10) for item in diagnosis.explanations]
    shown = np.clip(behind, -6.0, 6.0)  # beyond a million times there is no doubt to show
    assert bars["x"] == pytest.approx(shown, rel=1e-3)
    assert "beyond doubt likelier" in page
    assert "does not hold on motion held out" in page
    assert "are 1 (does not hold on motion held out: 1)" in page
    assert "The nearest of those less likely (" in page


def test_explanations_are_called_by_what_they_differ_in(page):
    charts = json.loads(re.search(r'id="figures">(.*?)</script>', page, re.DOTALL).group(1))
    (bars,) = (c["data"][0] for c in charts if c["data"][0].get("type") == "bar")
    assert bars["y"][:4] == [
        "1. spring load 2, not presliding hysteresis 2",
        "2. chosen",
        "3. Stribeck friction 2, not presliding hysteresis 2",
        "4. Coulomb friction 2 + viscous friction 2, not presliding hysteresis 2",
    ]


def test_hysteresis_is_shown_as_its_loop():
    stiffness, width = 100.0, 0.01
    slip = PreslidingHysteresis(joint=2, stiffness=(stiffness,), width=(width,))
    loop = loop_of(slip)
    assert loop.height == pytest.approx(2 * stiffness * width, rel=1e-3)
    assert loop.width == pytest.approx(0.95 * 2 * width, rel=0.01)  # after a reversal, 95 % of it
    assert loop.area == pytest.approx(4 * stiffness * width**2, rel=0.01)  # over four widths


def test_the_page_says_what_its_evidence_is_not(parsed):
    text = " ".join(parsed.text.split())
    assert "Near rest friction can take any value, so nothing is fitted or scored there" in text
    assert CONTRIBUTION.tellable == pytest.approx(np.log(55), abs=0.01)
    assert "cannot tell apart what is within odds of 55 to 1" in text
    assert "What is not listed is not denied" in text
    assert "Does it depend on the speed?" not in text  # a "no" may contradict a finding


def test_the_first_screen_tells_tolerances_from_findings(parsed, diagnosis):
    text = " ".join(parsed.text.split()).replace("\N{NO-BREAK SPACE}", " ")
    fit = diagnosis.verdict.fit
    for error in fit.heldout_rmse_tolerances:
        assert rounded(error, 3) in text
    before, alone, floor = (
        np.array(e) for e in (fit.heldout_rmse_before, fit.heldout_rmse_tolerances, fit.noise_floor)
    )
    taken = np.sum(before**2 - alone**2) / np.sum(before**2 - floor**2)
    assert f"within their tolerances alone removes {100 * taken:.0f} % of the error" in text
    assert "87 % of the error that tolerances leave" in text


def test_what_is_unknown_has_maps_of_its_own_and_its_times_say_the_recording(diagnosis):
    unknown = replace(
        diagnosis.verdict.findings[0], effect="unknown", joints=(2,), equivalent=(),
        where=Where(((3.0, 5.5),), "joint 2: at low speed", "joint-2", (2,)),
    )  # fmt: skip
    page = render(replace(diagnosis, verdict=replace(diagnosis.verdict, findings=(unknown,))))
    assert page.count('id="beyond-2"') == 1
    assert page.count('id="beyond-1"') == 0
    assert page.count(">Remaining residual over") == 7
    assert "3.0 to 5.5 s of seed 2" in page
    stretch = loop_stretch(diagnosis.traces, 1, 8.0)
    assert f"{stretch.stop:.1f} s of seed {stretch.recording + 1}" in page
    assert "stays" in page


def test_the_head_says_what_the_recordings_are_worth(page):
    first, _, after = page.partition('<section id="telemetry">')
    line = first.index("sampled at")
    assert first.index("<h1>") < line < first.index('<section id="errors">')
    assert '<a href="#telemetry">' in first[line:]
    head, _, rest = after.partition("</section>")
    assert "sampled at" in head
    assert "side of the gear" in head
    assert "<section" in rest  # everything else follows


def test_the_first_screen_says_which_rows_count_and_the_error_of_all(parsed, diagnosis):
    text = " ".join(parsed.text.split()).replace("\N{NO-BREAK SPACE}", " ")
    assert "The errors are over 70 % to 80 % of the rows held out" in text
    assert "all rows, given [N m]" in text
    fit = diagnosis.verdict.fit
    for error in (*fit.heldout_rmse_before_all_rows, *fit.heldout_rmse_after_all_rows):
        assert rounded(error, 3) in text
    assert "1 300 rows, thinned behind the filter" in text


def test_tolerances_that_do_worse_are_marked_and_explained(diagnosis, parsed):
    assert "Worse than given" not in parsed.text
    fit = diagnosis.verdict.fit
    fit = replace(fit, heldout_rmse_tolerances=(9.87654, fit.heldout_rmse_tolerances[1]))
    page = render(replace(diagnosis, verdict=replace(diagnosis.verdict, fit=fit)))
    assert page.count("9.88 *") == 1
    assert page.count("Worse than given") == 1


def test_six_seconds_fill_their_charts(rigid, true_arm, record):
    recording = record(3, 6.0)
    every = round(recording.rate / 25.0)  # rows of the slow grid
    traces = traces_of(rigid, true_arm, (recording,), every)
    for j in (0, 1):
        for quantity in ("position", "velocity", "since_reversal", "load", "time"):
            line = figures.dependence(traces, j, quantity, 0.01)["data"][-1]
            assert sum(y is not None for y in line["y"]) >= 6, (j, quantity)
        for drawn in figures.maps(traces, j):
            cells = drawn["data"][0]["z"]
            assert sum(z is not None for row in cells for z in row) >= 8, j


def test_neither_bands_nor_lines_lead_across_bins_without_rows(diagnosis):
    traces = diagnosis.traces
    apart = traces.position + (traces.position > np.median(traces.position, axis=0))
    drawn = figures.dependence(replace(traces, position=apart), 1, "position", 0.01)["data"]
    for curve in drawn:
        x = np.array([np.nan if v is None else v for v in curve["x"]])
        assert np.nanmax(np.abs(np.diff(x))) < 0.5
        assert np.isnan(x).sum() >= 2


def test_curves_around_a_push_do_not_lead_across_a_pause(diagnosis):
    traces = diagnosis.traces
    own = (traces.recording == 1) & (traces.time > 4.2) & (traces.time < 4.4)
    rows = {name: x[~own] for name, x in vars(traces).items() if name != "sliding"}
    drawn = figures.push(Traces(**rows), 1, (4.0, 4.6), ("", ""))["data"]
    assert all(curve["x"].count(None) == 1 for curve in drawn)


def test_near_rest_nothing_is_binned_or_scored_and_curves_are_pale(diagnosis):
    traces, replay = diagnosis.traces, diagnosis.replay[0]
    wild = np.where(traces.moving, traces.measured, 1e3)
    binned = figures.dependence(replace(traces, measured=wild), 1, "velocity", 0.01)
    assert binned == figures.dependence(traces, 1, "velocity", 0.01)
    assert figures.maps(replace(traces, measured=wild), 1) == figures.maps(traces, 1)
    pale, full = figures.replayed(replay, 1)["data"][:2]
    assert pale["opacity"] < 0.5
    assert [y is None for y in full["y"]] == (~replay.moving[:, 1]).tolist()[: len(full["y"])]
    spoilt = replace(replay, measured=np.where(replay.moving, replay.measured, 1e3))
    rows = [render(replace(diagnosis, replay=(item,))) for item in (replay, spoilt)]
    tables = [page[page.index("RMSE given [") :].split("</table>")[0] for page in rows]
    assert tables[0] == tables[1]


def test_a_push_is_drawn_on_all_joints_with_its_wrench_and_is_no_missing_physics(diagnosis):
    wrench = (-2.5, 0.4, 3.0, 0.1, 0.2, -0.3)
    intervals = tuple((x - 0.5, x + 0.5) for x in wrench)
    push = replace(
        diagnosis.verdict.findings[0], effect="external_contact", joints=(1, 2), equivalent=(),
        parameters={"windows": Interval(((4.0, 4.6),), "s"),
                    "wrench": Interval((wrench,), "N, N m", (intervals,))},
        where=Where(((4.0, 4.6),), "the flange", recording=(2,)), share=0.0,
        heldout_rmse=BeforeAfter((0.01, 0.01), (0.01, 0.01)),
    )  # fmt: skip
    verdict = replace(diagnosis.verdict, findings=(push,))
    assert headline(verdict) == "Something pushed the arm at 4.0 s."
    page = render(replace(diagnosis, verdict=verdict))
    assert 'href="#pushes"' in page
    assert "4.0 to 4.6 s of seed 2" in page
    assert "-2.5 ± 0.5" in page
    assert "an event, not a property of the arm" in page
    assert 'id="beyond-' not in page
    drawn = figures.push(diagnosis.traces, 1, (4.0, 4.6), ("lift", ""))
    times = [t for curve in drawn["data"] for t in curve["x"]]
    assert (min(times), max(times)) == pytest.approx((3.0, 5.6), abs=0.03)
    assert {curve["name"] for curve in drawn["data"]} == {"joint 1 (lift)", "joint 2"}


@pytest.mark.slow("has plotly check every number of every chart")
def test_every_chart_is_a_figure_that_plotly_accepts_with_units_on_its_axes(page):
    text = re.search(r'id="figures">(.*?)</script>', page, re.DOTALL).group(1)
    charts = json.loads(text)
    places = [int(k) for k in re.findall(r'data-figure="(\d+)"', page)]
    assert sorted(places) == list(range(len(charts)))
    for chart in charts:
        go.Figure(chart)  # refuses unknown properties
        assert chart["data"]
        titles = [chart["layout"][axis]["title"]["text"] for axis in ("xaxis", "yaxis")]
        assert all("[" in title for title in titles if title)


def test_texts_from_outside_cannot_become_markup(diagnosis):
    verdict = replace(diagnosis.verdict, rows=RowCount(1, {"</script><b>reason": 1}))
    recording = replace(diagnosis.recordings[0], source="<img src=x>.csv")
    recordings = (recording, *diagnosis.recordings[1:])
    page = render(replace(diagnosis, verdict=verdict, recordings=recordings))
    assert "<img src=x>" not in page
    assert "</script><b>" not in page


def test_joints_of_any_name_are_shown_as_text(diagnosis):
    names = tuple(f"<img src=x>{j}</script>" for j in range(len(diagnosis.verdict.names)))
    page = render(replace(diagnosis, verdict=replace(diagnosis.verdict, joint_names=names)))
    assert "<img src=x>" not in page
    assert "&lt;img src=x&gt;0" in page


def test_a_consistent_verdict_has_no_findings_and_folds_every_joint(diagnosis):
    fit = replace(diagnosis.verdict.fit, reducible_error_removed=np.nan, ci95=(np.nan, np.nan))
    verdict = replace(
        diagnosis.verdict, verdict="consistent", findings=(), next_motion=None, fit=fit
    )
    page = render(
        replace(
            diagnosis, verdict=verdict, explanations=(), tests=(), shifts=(), replay=(),
            next_motion=None, next_motion_purpose="", replay_note="The motion is too fast.",
        )
    )  # fmt: skip
    assert page.count("<details>") >= 2
    assert 'id="findings"' not in page
    assert 'id="competing"' not in page
    assert "There is no reducible error to remove." in page
    assert "The motion is too fast." in page


def test_a_report_that_cannot_be_written_is_said(diagnosis, tmp_path):
    with pytest.raises(ConfigError, match="cannot be written"):
        write_report(diagnosis, tmp_path / "nowhere" / "report.html")


def test_the_worst_stretch_is_of_one_recording_and_where_the_error_is(diagnosis):
    traces = diagnosis.traces
    simulated = traces.measured.copy()
    rows = (traces.recording == 1) & (traces.time > 10.0) & (traces.time < 14.0)
    simulated[rows] += 5.0
    floor = np.full(2, 0.01)
    found = worst_stretch(replace(traces, tolerances=simulated), floor, 4.0)
    assert found.recording == 1
    assert found.start == pytest.approx(10.0, abs=0.1)
    assert found.stop == pytest.approx(14.0, abs=0.1)


def test_the_head_has_the_command_and_the_values_that_put_it_into_a_simulation(diagnosis, page):
    _, _, box = page.partition('<aside class="put">')
    box, _, _ = box.partition("</aside>")
    kind = diagnosis.before.model.description.kind.lower()
    line = re.sub(r"<[^>]*>", "", re.search(r'<pre id="export">(.*?)</pre>', box).group(1))
    assert line == f"limo export sim.yaml --to {kind} --out improved/"
    values = unescape(re.search(r'<pre id="values">(.*?)</pre>', box, re.DOTALL).group(1))
    added = [e for e in diagnosis.after.effects if e not in diagnosis.before.effects]
    listed = [(entry["effect"], entry.get("joint")) for entry in yaml.safe_load(values)["effects"]]
    assert listed == [(e.name, *e.joints[:1]) for e in added]


def test_nothing_to_put_into_a_simulation_leaves_the_box_out(diagnosis):
    assert '<aside class="put">' not in render(replace(diagnosis, after=diagnosis.before))


def test_an_error_at_the_floor_is_not_said_to_be_below_what_is_possible(diagnosis):
    fit = diagnosis.verdict.fit
    below = replace(fit, heldout_rmse_after=tuple(0.7 * f for f in fit.noise_floor))
    page = render(replace(diagnosis, verdict=replace(diagnosis.verdict, fit=below)))
    assert page.count('<td class="n">at the floor</td>') == len(fit.noise_floor)


def test_the_arm_is_played_with_its_ghosts_and_says_what_is_where(diagnosis, page):
    drawn = json.loads(re.search(r'id="arm-data">(.*?)</script>', page, re.DOTALL).group(1))
    n = diagnosis.before.model.n
    assert [name for name, _ in drawn["errors"]] == [
        "given simulation", "improved simulation", "noise floor"
    ]  # fmt: skip
    assert drawn["errors"][0][1] == pytest.approx(
        diagnosis.verdict.fit.heldout_rmse_before, abs=1e-6
    )
    assert drawn["pins"] == [
        {"text": "joint 2: presliding hysteresis", "joint": 1, "link": "#finding-1"}
    ]
    time, moved = (_numbers(drawn["motion"][name]) for name in ("time", "position"))
    recording = diagnosis.replay[0].recording
    rows = diagnosis.traces.recording == recording
    assert time[0] == pytest.approx(diagnosis.traces.time[rows][0], rel=1e-6)
    assert len(moved) == n * len(time)
    apart = _numbers(drawn["motion"]["ghosts"][0]["position"]).reshape(-1, n)
    first, *_, last = diagnosis.replay[0].time
    replayed = (time > first - 1e-3) & (time < last + 1e-3)
    assert np.nanmax(np.abs(apart[replayed] - 1e-4)) < 1e-6
    assert np.isfinite(apart[replayed]).mean() > 0.9
    assert np.isnan(apart[~replayed]).any(axis=1).all()


def test_arrows_stand_where_pushes_were_found(diagnosis):
    push = replace(
        diagnosis.verdict.findings[0], effect="external_contact", joints=(1, 2),
        parameters={"wrench": Interval(((1.0, 2.0, 3.0, 0.1, 0.2, 0.3),), "N, N m")},
        where=Where(((4.0, 4.6),), "the flange", recording=(2,)),
    )  # fmt: skip
    page = render(replace(diagnosis, verdict=replace(diagnosis.verdict, findings=(push,))))
    drawn = json.loads(re.search(r'id="arm-data">(.*?)</script>', page, re.DOTALL).group(1))
    assert drawn["motion"]["pushes"] == [[4.0, 4.6, 1.0, 2.0, 3.0]]
    assert drawn["pins"][0]["joint"] is None
    assert "the recorded motion of seed 2" in page


def _numbers(packed):
    return np.frombuffer(base64.b64decode(packed), "<f4")


def test_many_findings_begin_with_a_table_that_leads_to_each(diagnosis):
    one = diagnosis.verdict.findings[0]
    several = replace(diagnosis.verdict, findings=(one,) * 5)
    page = render(replace(diagnosis, verdict=several))
    _, _, table = page.partition('<section id="findings">')
    table, _, cards = table.partition("</table>")
    assert [f'href="#finding-{k}"' in table for k in range(1, 6)] == [True] * 5
    assert cards.count("<article") == cards.count("<summary><h3>") == 5
    single = render(diagnosis)
    assert "<summary><h3>" not in single
