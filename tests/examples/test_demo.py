"""The demo where parts of it fail: the others run, the page is written, and both say which."""

import json
import shlex
from dataclasses import replace

import demo
import demo_page
import numpy as np
import pytest
import stream_and_push
from audit import violations
from browser import browser, program
from one_file import check_page, title_of

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
from limo_driver.errors import LimoError
from limo_driver.network.messages import Event, Level
from limo_driver.trajectory import Trajectory

pytestmark = pytest.mark.waits

PIXEL = bytes.fromhex(
    "89504e470d0a1a0a0000000d49484452000000010000000108060000001f15c4890000000d49444154789c63000100"
    "000500010d0a2db40000000049454e44ae426082"
)
ONES = (1.0,) * 7
VERDICT = Verdict(
    "explained",
    (
        Finding(
            "payload", "missing", (7,), (), 0.99, {"mass": Interval(0.776, "kg", (0.675, 0.878))},
            Where(), 0.9, BeforeAfter(ONES, ONES), "Evidence.",
        ),
    ),
    Unexplained(), (), None, Fit(ONES, ONES, ONES, 1.0, (1.0, 1.0)), RowCount(1, {}),
)  # fmt: skip
EVALUATION = {
    "bandwidth": 20.0,
    "joints": ["<one>"],
    "rmse_rigid_body": [1.0],
    "rmse_hybrid": [0.1],
    "noise_floor": [None],
    "mse_ratio": [100.0],
    "coverage_of_95_percent": [0.95],
    "mean_mse_rigid_body": 1.0,
    "mean_mse_hybrid": 0.01,
    "mean_mse_ratio": 100.0,
}


@pytest.fixture
def out(tmp_path, monkeypatch):
    """A folder with what the parts leave; the stream's log is left out."""
    (tmp_path / "evaluation").mkdir()
    (tmp_path / "evaluation" / "loops.png").write_bytes(PIXEL)
    time = np.linspace(0.0, 2.0, 50)
    still = np.zeros((50, 7))
    Trajectory(time, still + time[:, None] / 10, still + 0.1, still, robot="iiwa14").save(
        tmp_path / "train.traj.parquet"
    )
    (tmp_path / "evaluation" / "evaluation.json").write_text(json.dumps(EVALUATION))
    (tmp_path / "diagnosis").mkdir()
    VERDICT.save(tmp_path / "diagnosis" / "verdict.json")
    monkeypatch.setitem(demo_page.SECTIONS, "Live", ("stream", lambda *_: "<i>streamed</i>"))
    return tmp_path


def outcomes(out, monkeypatch, *failing):
    """Run the parts with other commands: those named fail, the others say their version."""
    monkeypatch.setattr(demo, "LAST_LINES", 2)
    return demo.run_all([
        replace(part, command="limo nonsense" if part.name in failing else "limo --version")
        for part in demo.parts(out, 1)
    ])  # fmt: skip


@pytest.mark.slow("makes the whole page")
def test_all_that_went_well_is_on_the_page(out, monkeypatch, capfd):
    demo.finish(outcomes(out, monkeypatch), out)
    page = (out / "index.html").read_text()
    check_page(page)
    said = title_of(page).replace("\N{NO-BREAK SPACE}", " ")
    assert said.startswith(
        "Payload of 0.8 kg at the flange was concealed, 0.78 kg [0.68, 0.88] was"
    )
    assert said.endswith("at joint 4 was concealed and not found.")
    assert "&lt;one&gt;" in page
    assert "<i>streamed</i>" in page
    assert "missing, see above" not in page
    assert "parts failed" not in page
    assert page.count("<pre>") == 12
    assert capfd.readouterr().err == ""


@pytest.mark.slow("starts a browser")
@pytest.mark.skipif(program() is None, reason="no Chromium is installed on this machine")
@pytest.mark.parametrize(("width", "dark"), [(1400, False), (390, True)])
def test_everybody_can_use_the_page(out, monkeypatch, width, dark):
    demo.finish(outcomes(out, monkeypatch), out)
    with browser() as tab:
        assert violations(tab, (out / "index.html").as_uri(), width, dark=dark) == []
        assert tab.errors == []


def test_a_part_that_fails_takes_only_those_with_it_that_need_it(out, monkeypatch, capfd):
    with pytest.raises(SystemExit, match="1"):
        demo.finish(outcomes(out, monkeypatch, "identify"), out)
    page, said = (out / "index.html").read_text(), capfd.readouterr().err
    for text in (page, said):
        assert "1 of 12 parts failed, 4 that need it were left out" in text
        assert "Identify a rigid body with Coulomb" in text
        assert text.count("exit status 2") == 1
        assert "No such command" in text
        assert "left out: it needs identify" in text
        assert "left out: it needs train" in text
    assert "0.78" in title_of(page)  # of the diagnosis, which went well
    assert page.count("missing, see above") == 3
    assert "streamed" not in page  # of an earlier run
    assert "What was concealed, and what was found" in page


def test_a_folder_with_a_space_is_one_word_of_every_command(tmp_path):
    out = tmp_path / "a b"
    words = [word for part in demo.parts(out, 1) for word in shlex.split(part.command)]
    assert f"{out}/train.traj.parquet" in words
    assert not [word for word in words if word.startswith("b/")]


def test_a_file_in_place_of_the_folder_is_refused(tmp_path, monkeypatch, capfd):
    (tmp_path / "file").write_text("")
    monkeypatch.setattr("sys.argv", ["demo.py", "--out", str(tmp_path / "file")])
    with pytest.raises(SystemExit, match="2"):
        demo.main()
    said = capfd.readouterr().err
    assert said == f"limo demo: {tmp_path / 'file'}: is a file, expected a folder for the demo\n"


def test_ctrl_c_ends_with_a_page_of_what_there_is(tmp_path, monkeypatch, capfd):
    child = tmp_path / "child.py"  # presses Ctrl-C in the demo, then waits for its own
    child.write_text("import os, signal; os.kill(os.getppid(), signal.SIGINT); signal.pause()")
    monkeypatch.setattr(demo, "PATIENCE", 0.01)
    wanted = [
        replace(part, command=f"python {child}" if part.name == "run" else "limo --version")
        for part in demo.parts(tmp_path, 1)
    ]
    with pytest.raises(SystemExit, match="130"):
        demo.finish(demo.run_all(wanted), tmp_path)
    page, said = (tmp_path / "index.html").read_text(), capfd.readouterr().err
    assert said.strip() == "limo demo: interrupted"
    assert "<h1>The demo did not get through</h1>" in page
    assert "Interrupted: 1 of 12 parts were done, 1 failed" in page  # it left no picture


@pytest.mark.slow("draws all pages of the demo once more")
def test_what_cannot_be_shown_is_a_failure_too(out, monkeypatch, capfd):
    (out / "train.traj.parquet").unlink()
    (out / "diagnosis" / "verdict.json").write_text("{}")
    with pytest.raises(SystemExit, match="1"):
        demo.finish(outcomes(out, monkeypatch), out)
    said = capfd.readouterr().err
    assert "2 of 12 parts failed" in said
    assert "what it left cannot be shown: ConfigError" in said
    assert "2 of 12 parts failed" in (out / "index.html").read_text()


def test_a_contact_is_where_it_is_in_the_stream_however_late_it_was_told():
    told = Event(9_000, Level.WARN, "contact", "on joint 2", {"state_stamp": 2_000})
    assert stream_and_push.stamp_of(told) == 2_000
    assert stream_and_push.stamp_of(replace(told, facts={})) == 9_000


def test_a_stream_without_answers_is_told_with_what_the_service_said(tmp_path):
    (tmp_path / "service.jsonl").write_text("")
    with pytest.raises(LimoError, match="no estimates in the log; the service said last: nothing"):
        stream_and_push.Live.read(tmp_path)
    line = {"status": {"phase": "compiling", "state": "compiling 3 of 4"}}
    (tmp_path / "service.jsonl").write_text(f"{json.dumps(line)}\n")
    with pytest.raises(LimoError, match="the service said last: compiling 3 of 4"):
        stream_and_push.Live.read(tmp_path)
