"""The page of an inspection: what it draws of a log, what it marks, and what it says of columns."""

from __future__ import annotations

import gzip
import json
import math
from base64 import b64decode
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from one_file import arm_of, title_of

import limo_driver as limo
from limo_driver.app.cli.inspect import command
from limo_driver.app.library.inspection_page import columns_page, inspection_page
from limo_driver.errors import ConfigError, RecordingError
from limo_driver.logs.readers.inspection import ShownParameter
from limo_driver.logs.readers.table import table_of
from limo_driver.pages import Page
from limo_driver.pages.figures import VALUES, Curve, Curves, LeftOutRows

T = 800
TIME = 0.01 * np.arange(T)
MOTION = np.stack([np.sin(TIME), 0.5 * np.cos(2 * TIME)], axis=1)


def drawn(page):
    """Return what the page draws, and the values (time, then every curve) as a browser has them."""
    said = json.loads(page.html().partition('id="curves-data">')[2].partition("</script>")[0])
    packed = gzip.decompress(b64decode(said["packed"]))
    points, flags = said["points"], len(said["flags"])
    time = np.frombuffer(packed, "<f8", points)
    rest = np.frombuffer(packed, "<f4", offset=8 * (points + flags)).reshape(-1, points + flags)
    values = [own[:points] + c["offset"] for own, c in zip(rest, said["curves"], strict=True)]
    return said, time, values


def log(**more):
    names = {"q": np.rad2deg(MOTION), "q_cmd": np.rad2deg(MOTION + 0.01)}
    columns = {f"{n}{j + 1}_deg": x[:, j] for n, x in names.items() for j in range(2)}
    return {"t": TIME, **columns, **more}


def test_columns_are_drawn_in_si_units_beside_those_that_are_not_understood(two_links_urdf):
    found = limo.inspect(log(blob=TIME**2), two_links_urdf)
    page = inspection_page(found)
    said, time, values = drawn(page)
    axes = [curve["axis"] for curve in said["curves"]]
    assert axes == ["position [rad]"] * 4 + ["blob, as logged, unit unknown"]
    assert [curve["dash"] for curve in said["curves"]] == ["solid"] * 2 + ["dash"] * 2 + ["solid"]
    np.testing.assert_allclose(time, TIME)
    np.testing.assert_allclose(values[1], MOTION[:, 1], atol=1e-6)
    assert said["curves"][0]["read"] == "q1_deg, logged in deg"
    assert said["curves"][4]["read"] == "not understood"
    assert (said["rows"], said["gaps"], said["cuts"]) == (1, [], [])
    assert said["pose"] == [0, 1]
    assert arm_of(page.html())["pose"] == pytest.approx(MOTION[0].tolist(), abs=1e-5)


def test_currents_without_a_factor_are_drawn_as_such(two_links_urdf):
    amperes = {f"c{j + 1} (A)": np.cos(TIME + j) for j in range(2)}
    given, _, values = drawn(inspection_page(limo.inspect(log(**amperes), two_links_urdf)))
    (one, other) = (c for c in given["curves"] if c["column"] in amperes)
    assert (one["axis"], one["name"], other["axis"]) == (
        "current [A]",
        "joint 1 (a)",
        "current [A]",
    )
    assert "no factor says how many N m" in one["read"]
    at = given["curves"].index(one)
    np.testing.assert_allclose(values[at], np.cos(TIME), atol=1e-6)


def test_gaps_steps_of_the_clock_and_rows_that_are_left_out_are_marked(two_links_urdf):
    time = TIME.copy()
    time[200:] += 3.0  # a gap: the arm is elsewhere
    motion = np.where(np.arange(T)[:, None] < 200, MOTION, MOTION + 0.4)
    time[500:] -= 0.5  # the clock is set back while the arm moves on
    motion[300, 0] = np.nan
    given = {"t": time, **{f"q{j + 1}_rad": motion[:, j] for j in range(2)}}
    given |= {f"q{j + 1}_cmd_rad": MOTION[:, j] for j in range(2)}
    said, seconds, values = drawn(inspection_page(limo.inspect(given, two_links_urdf)))
    assert (np.diff(seconds) >= 0).all()
    assert said["gaps"] == [pytest.approx([1.99, 5.0])]
    ((before, after, text),) = said["cuts"]
    assert "set back by 0.5" in text
    assert before == pytest.approx(time[499])
    assert after > before
    assert len(said["flags"]) == 1
    breaks = np.isnan(values[0])
    assert breaks.sum() == 2  # at the gap, and where the clock was set


def test_a_clock_that_is_set_twice_is_marked_at_both_rows(two_links_urdf):
    time = TIME.copy()
    time[200:] += 7.0
    time[500:] -= 0.5
    given = {"t": time, **{f"q{j + 1}_rad": MOTION[:, j] for j in range(2)}}
    given |= {f"q{j + 1}_cmd_rad": MOTION[:, j] for j in range(2)}
    said, _, _ = drawn(inspection_page(limo.inspect(given, two_links_urdf)))
    (forward, back) = (text for _, _, text in said["cuts"])
    assert "set forward by 7 s at row 200" in forward
    assert "set back by 0.5 s at row 500" in back


@pytest.mark.parametrize("name", ["log.csv", "page.png"])
def test_a_page_is_written_to_no_file_that_promises_another_format(commanded, tmp_path, name):
    path = tmp_path / "log.csv"
    path.write_text("t,a\n" + "".join(f"{t},1\n" for t in TIME))
    refused = commanded(command)(path, "--page", tmp_path / name)
    assert isinstance(refused.exception, ConfigError)
    assert "page" in str(refused.exception) or "is read" in str(refused.exception)
    assert path.read_text().startswith("t,a")
    assert not (tmp_path / "page.png").exists()
    assert commanded(command)(path, "--page", tmp_path / "page.html").exit_code == 0


def test_meshes_that_are_not_there_are_said(two_links_urdf, tmp_path):
    text = Path(two_links_urdf).read_text()
    shape = '<visual><geometry><mesh filename="gone.stl"/></geometry></visual><inertial>'
    path = tmp_path / "drawn.urdf"
    path.write_text(text.replace("<inertial>", shape, 1))
    page = inspection_page(limo.inspect(log(), path)).html()
    assert "Not there or not readable: mesh gone.stl" in page
    assert "Not there" not in inspection_page(limo.inspect(log(), two_links_urdf)).html()


def test_an_hour_is_thinned_and_keeps_its_peaks():
    time = 0.001 * np.arange(500_000)
    noise = np.random.default_rng(0).normal(size=time.size)  # hardly to be compressed
    noise[154_321] = 40.0
    curves = tuple(Curve(f"c{k}", "c", "c [N m]", "", noise) for k in range(4))
    page = Page("Long", "", curves=Curves(time, np.arange(time.size), curves))
    given, kept, seen = drawn(page)
    assert 2e6 < len(page.html()) < 5e6
    assert given["points"] <= VALUES / 4 + 2
    assert given["rows"] == math.ceil(2 * time.size / (VALUES // 4))
    assert seen[0].max() == 40.0
    assert abs(kept[seen[0].argmax()] - 154.321) < 0.001 * given["rows"]


def test_more_gaps_and_rows_left_out_than_can_be_seen_make_no_large_page():
    time = np.cumsum(np.where(np.arange(40_000) % 3, 0.01, 1.0))
    rows, every = np.arange(0, time.size, 2), np.arange(time.size)
    left_out = (LeftOutRows("held", rows + 1), LeftOutRows("late", rows + 1))
    curves = tuple(Curve(f"c{k}", "c", "c", "", np.sin(every)) for k in range(200))
    given, kept, _ = drawn(Page("Wide", "", curves=Curves(time, rows, curves, left_out)))
    assert len(kept) <= VALUES / 200 + 2
    assert 100 < len(given["flags"]) <= 2 * 2000
    assert len(given["flags"]) * 200 < VALUES / 5


def test_a_log_without_robot_is_shown_as_it_was_logged():
    table = table_of({"stamp": TIME, "a_1": MOTION[:, 0], "temp_2": TIME, "note": ["x"] * T})
    page = columns_page(table)
    said, time, _ = drawn(page)
    assert [curve["read"] for curve in said["curves"]] == [
        "not understood",
        "named like a temperature, not read",
    ]
    np.testing.assert_allclose(time, TIME)
    assert "note holds" in page.html()
    rows, _, _ = drawn(columns_page(table_of({"a_1": MOTION[:, 0]})))
    assert rows["layout"]["xaxis"]["title"]["text"] == "row"


def test_parameters_that_the_motion_does_not_show_come_first_with_what_would(two_links_urdf):
    found = limo.inspect(log(), two_links_urdf)
    shown = (
        ShownParameter("m_1", "kg", 1.0, 0.05, ""),
        ShownParameter("tau_c_2<", "N m", 1.0, math.inf, "joint 2 slowly"),
    )
    text = inspection_page(replace(found, parameters=shown)).html()
    assert text.index(
        "tau_c_2&lt; [N&nbsp;m]".replace("&nbsp;", "\N{NO-BREAK SPACE}")
    ) < text.index("m_1 [")
    assert "<li>joint 2 slowly: shows 1 of these parameters</li>" in text
    assert "2 parameters of the arm: 1 identifiable, 1 not from this motion" in text
    assert "2 joints" not in title_of(text)


def test_what_cannot_be_drawn_or_written_is_refused(run, tmp_path, two_links_urdf):
    np.savetxt(tmp_path / "log.csv", np.stack(list(log().values()), axis=1), delimiter=",",
               header=",".join(log()), comments="")  # fmt: skip
    inspect = ("inspect", "log.csv", "--robot", two_links_urdf)
    status, _, errors = run(*inspect, "--page", "none/page.html")
    assert (status, "there is no folder none" in errors) == (2, True)
    status, _, errors = run(*inspect, "--page", "log.csv")
    assert (status, "log.csv" in errors) == (2, True)
    status, _, errors = run("inspect", "log.csv")
    assert (status, "--robot" in errors and "--page" in errors) == (2, True)
    status, said, _ = run("inspect", "log.csv", "--page", "page.html")
    assert (status, "wrote page.html" in said) == (0, True)
    (tmp_path / "empty.csv").write_text("t,q1\n")
    status, _, errors = run("inspect", "empty.csv", "--page", "empty.html")
    assert (status, "empty.csv" in errors) == (2, True)
    assert not (tmp_path / "empty.html").exists()
    with pytest.raises(RecordingError, match="no rows"):
        columns_page(table_of({"t": np.zeros(0)}))


def test_limo_s_own_columns_are_what_every_command_takes_them_for(two_links_urdf, tmp_path):
    path = tmp_path / "run.parquet"
    limo.Recording.from_arrays(TIME, MOTION, command=MOTION + 0.01).save(path)
    found = limo.inspect(path, two_links_urdf)
    assert found.questions == ()
    assert found.mapping.command.unit == ("rad", "rad")
    assert found.mapping.torque is None
    assert {item.why for item in found.proposal.taken} == {"limo's own columns"}
