"""The pages of motions: what is said of them, and where they are written."""

from __future__ import annotations

import re

import pytest
from one_file import check_page, title_of

from limo_driver.app.cli.excite import command as excite
from limo_driver.app.cli.plan import command as plan
from limo_driver.errors import ConfigError
from limopa import summarise
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


def test_plan_writes_it_beside_the_motion(commanded, tmp_path):
    out = tmp_path / "a.traj.parquet"
    result = commanded(plan)("--scaffolds", 1, "--rate", 50, "--out", out, "--json")
    assert result.exit_code == 0, result.output
    check_page((tmp_path / "a.traj.html").read_text())


def test_excite_writes_it_beside_the_motion(commanded, tmp_path):
    out = tmp_path / "a.parquet"
    few = ("--duration", 10, "--harmonics", 2, "--starts", 1, "--iterations", 0, "--rate", 50)
    result = commanded(excite)(*few, "--out", out)
    assert result.exit_code == 0, result.output
    text = (tmp_path / "a.html").read_text()
    check_page(text)
    condition = result.output.split("condition number ")[1].split(";")[0]
    assert f"condition number {condition}," in title_of(text)


def test_a_page_that_cannot_be_written_is_told_before_the_work(commanded, tmp_path):
    (tmp_path / "a.traj.html").mkdir()
    result = commanded(plan)("--scaffolds", 1, "--out", tmp_path / "a.traj.parquet")
    assert isinstance(result.exception, ConfigError)
    assert "a.traj.html: cannot be written: it is a folder" in str(result.exception)
    assert not (tmp_path / "a.traj.parquet").exists()
