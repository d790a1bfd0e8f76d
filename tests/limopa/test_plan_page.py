"""The command that plans, its page and its picture."""

from __future__ import annotations

import json
import re
from dataclasses import replace

import pytest
from lanes import sampled
from matplotlib.image import imread
from one_file import check_page, title_of

from limo_driver.app.cli.excite import command as excite
from limo_driver.app.cli.plan import command
from limo_driver.errors import ConfigError, InfeasiblePathError, LimoError
from limo_driver.trajectory import Trajectory
from limopa import Exploring, PlanRequest, draw, plan, summarise
from limopa.page import plan_page, span


def test_the_page_says_what_the_plan_does(short_plan, iiwa):
    text = plan_page(short_plan, iiwa, "limo.traj.parquet", "iiwa14").html()
    check_page(text)
    said = summarise(short_plan, iiwa)
    title = title_of(text)
    assert f"{len(short_plan.scaffolds)} poses explored" in title
    assert f"{sum(joint.reversals for joint in said.joints)} reversals" in title
    words = re.sub(r"</?span[^>]*>", "", text)
    assert "--trajectory limo.traj.parquet" in words
    assert text.count("<td>") >= 7


@pytest.mark.parametrize(
    ("seconds", "said"), [(59.6, "60 s"), (119.0, "119 s"), (150.0, "2.5 min"), (3600, "60 min")]
)
def test_a_duration_is_said_in_the_unit_that_fits(seconds, said):
    assert span(seconds) == said


def test_excite_writes_it_beside_the_motion(commanded, tmp_path):
    out = tmp_path / "a.parquet"
    few = ("--duration", 10, "--harmonics", 2, "--starts", 1, "--iterations", 0, "--rate", 50)
    result = commanded(excite)(*few, "--out", out)
    assert result.exit_code == 0, result.output
    text = (tmp_path / "a.html").read_text()
    check_page(text)
    condition = result.output.split("condition number ")[1].split(";")[0]
    assert f"condition number {condition}," in title_of(text)


def test_a_page_that_cannot_be_written_is_told_before_the_work(run, tmp_path):
    (tmp_path / "a.traj.html").mkdir()
    result = run("--scaffolds", 1, "--out", tmp_path / "a.traj.parquet")
    assert isinstance(result.exception, ConfigError)
    assert "a.traj.html: cannot be written: it is a folder" in str(result.exception)
    assert not (tmp_path / "a.traj.parquet").exists()


@sampled("scaffolds", [1, 3], "draws a picture each")
def test_picture_is_drawn(iiwa, tmp_path, scaffolds):
    request = replace(PlanRequest(scaffolds=scaffolds), exploring=Exploring(waypoints=(200, 250)))
    draw(plan(iiwa, request), iiwa, tmp_path / "plan.png")
    image = imread(tmp_path / "plan.png")
    assert image.shape[0] > 1000
    assert image[..., :3].std() > 0.05


@pytest.fixture
def run(commanded):
    return commanded(command)


def test_plan_writes_trajectory_and_statistics(run, tmp_path):
    out = tmp_path / "a.traj.parquet"
    result = run("--scaffolds", 2, "--seed", 1, "--rate", 100, "--out", out, "--json")
    assert result.exit_code == 0, result.output
    statistics = json.loads(result.stdout)
    trajectory = Trajectory.load(out)
    assert statistics["samples"] == len(trajectory)
    assert statistics["duration"] == pytest.approx(trajectory.duration)
    assert [s.kind for s in trajectory.segments] == ["exploring", "reaching", "exploring"]
    check_page((tmp_path / "a.traj.html").read_text())


def test_plan_prints_a_table(run, tmp_path):
    result = run("--scaffolds", 1, "--rate", 100, "--out", tmp_path / "a.traj.parquet")
    assert "1 scaffolds" in result.stdout
    assert "self-collision" in result.stdout


@pytest.mark.parametrize(
    ("arguments", "error", "message"),
    [
        (("--scaffolds", 0), ConfigError, "scaffolds is 0, expected a whole number of 1 or more"),
        (("--robot", "kr16"), ConfigError, "'kr16' is neither built in"),
        (("--joint-margin", 130), InfeasiblePathError, "leaves joint 2 no range"),
        (("--out", "."), ConfigError, "cannot be written: it is a folder"),
        (("--out", "/proc/x.parquet"), ConfigError, "cannot be written"),
        (("--out", "a.csv"), ConfigError, "a.csv: cannot be written: Parquet is written, and its"),
        (("--picture", "x.foo"), ConfigError, "expected .png, .pdf, .svg"),
        (("--out", "no/such/folder/a.parquet"), ConfigError, "there is no folder no/such/folder"),
    ],
)
def test_bad_input_is_one_clear_line(run, tmp_path, arguments, error, message):
    result = run("--out", tmp_path / "a.traj.parquet", *arguments)
    assert isinstance(result.exception, error)
    assert isinstance(result.exception, LimoError)  # main() makes it exit status 2
    assert message in str(result.exception)
    assert "\n" not in str(result.exception)
