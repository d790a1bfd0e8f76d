"""What finished trials say: figures, claims, files, and the command that computes them."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
import pytest
from lanes import sampled
from one_file import check_page, drawn, title_of
from table_data import write_data

from estimators.studies import table1_data as r
from estimators.studies.table1_data import (
    ALL_ROWS,
    PARTS,
    TOPOLOGIES,
    TableData,
    paper_table,
    physics_digest,
    rigid_body,
)
from estimators.studies.table1_page import CLAIMS, judge, table_page, write
from estimators.studies.table1_results import (
    SCAFFOLDS,
    SEQUENCES,
    Protocol,
    Table,
    Trial,
    TrialResult,
    TrialStore,
)
from limo_driver.app.cli import main
from limo_driver.model import RobotModel

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    Limo = Callable[..., subprocess.CompletedProcess[str]]

PROTOCOL = Protocol(runs=3, epochs=1)
ONCE = Protocol(runs=1, epochs=1)
LEFT = (r.RBD, r.LSTM2_FULL, r.FCL500_HYBRID, TOPOLOGIES[2, 15], r.MLP_FULL, r.TRANSFORMER)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_data(tmp_path_factory.mktemp("table") / "data")


@pytest.fixture(scope="module")
def data(folder: Path) -> TableData:
    return TableData.load(folder)


def result(trial: Trial, size: float) -> TrialResult:
    """Return figures of the paper's size: joint j has `size` times the paper's MSE."""
    mse = {
        part: tuple((size * paper_table()[part, trial.row.name.split(", ")[0]][:7]).tolist())
        if (part, trial.row.name) in paper_table()
        else (size,) * 7
        for part in PARTS
    }
    return TrialResult(trial, mse, 1, 2.5, "cpu", {"limo": "0"})


def table_of(data: TableData, sizes: dict[int, float]) -> Table:
    """Return a table in which the runs in `sizes` are finished."""
    trials = PROTOCOL.trials(data.digests)
    found = tuple(result(trial, sizes[trial.run]) for trial in trials if trial.run in sizes)
    return Table(data, PROTOCOL, found)


def test_mean_and_spread_are_those_of_the_runs(data: TableData) -> None:
    figures = table_of(data, {0: 1.0, 1: 2.0, 2: 6.0}).figures(r.MLP_FULL, "test", SCAFFOLDS)
    paper = paper_table()["test", r.MLP_FULL.name]
    assert figures.mean is not None
    assert figures.spread is not None
    np.testing.assert_allclose(figures.mean[:7], 3.0 * paper[:7])
    np.testing.assert_allclose(figures.mean[7], 3.0 * paper[:7].mean())
    np.testing.assert_allclose(figures.spread[:7], np.std([1, 2, 6], ddof=1) * paper[:7])
    assert (figures.numbers, figures.left) == ((0, 1, 2), 0)
    assert figures.paper is not None
    np.testing.assert_array_equal(figures.paper, paper)


def test_one_run_has_no_spread_and_none_has_no_mean(data: TableData) -> None:
    one = table_of(data, {1: 1.0}).figures(r.RBD, "training")
    assert one.mean is not None
    assert one.spread is None
    assert (one.numbers, one.left) == ((1,), 2)
    none = table_of(data, {}).figures(r.RBD, "training")
    assert none.mean is None
    assert none.left == 3


def test_only_finished_trials_of_these_data_and_settings_are_gathered(
    data: TableData, tmp_path: Path
) -> None:
    store = TrialStore(tmp_path, "one")
    trial = PROTOCOL.trials(data.digests)[0]
    store.save(result(trial, 1.0))
    assert Table.gather(data, PROTOCOL, store).results[0].trial.row == r.RBD
    longer = replace(PROTOCOL, epochs=2)
    assert Table.gather(data, longer, store).results == ()
    other = replace(data, digests={**data.digests, "limo.parquet": "changed"})
    assert Table.gather(other, PROTOCOL, store).results == ()


def test_claims_are_judged_against_the_spread(data: TableData) -> None:
    """Every run has the paper's ratios; but a row whose runs scatter proves nothing."""
    sure = table_of(data, {0: 1.0, 1: 1.1, 2: 0.9})
    hybrid = list(judge(sure, CLAIMS[0]))
    assert {j.verdict for j in hybrid} == {"holds"}
    for judgement in hybrid:
        assert judgement.factor == pytest.approx(judgement.paper, rel=0.03)
        assert judgement.runs == 3
    scattered = tuple(
        replace(found, mse=dict.fromkeys(PARTS, (10.0**found.trial.run,) * 7))
        if found.trial.row == r.MLP_HYBRID
        else found
        for found in sure.results
    )
    first = next(iter(judge(replace(sure, results=scattered), CLAIMS[0])))
    assert first.verdict == "within the spread"
    assert first.low is not None
    assert first.high is not None
    assert first.low < 1 < first.high


def test_a_claim_that_is_contradicted_does_not_hold(data: TableData) -> None:
    (attention,) = (claim for claim in CLAIMS if claim.title == "Recurrence against attention")
    table = table_of(data, {0: 1.0, 1: 1.1, 2: 0.9})
    turned = tuple(
        replace(found, mse={part: tuple(1e-3 * v for v in found.mse[part]) for part in PARTS})
        if found.trial.row == r.TRANSFORMER
        else found
        for found in table.results
    )
    verdicts = {j.verdict for j in judge(replace(table, results=turned), attention)}
    assert verdicts == {"does not hold"}


def test_claims_of_one_run_or_none_say_so(data: TableData) -> None:
    assert {j.verdict for j in judge(table_of(data, {0: 1.0}), CLAIMS[1])} == {
        "as claimed in the one run"
    }
    nothing = list(judge(table_of(data, {}), CLAIMS[1]))
    assert {j.verdict for j in nothing} == {"-"}
    assert {j.factor for j in nothing} == {None}


@sampled("done", [{}, {0: 1.0}, {0: 1.0, 1: 1.2, 2: 0.9}], "draws all pictures each")
def test_the_page_says_what_is_best_and_what_is_not_known_yet(
    data: TableData, done: dict[int, float]
) -> None:
    table = table_of(data, done)
    text = table_page(table).html()
    check_page(text)
    assert ("Least error" in title_of(text)) is bool(done)
    assert (f"{table.left} trials" in text) is bool(table.left)
    assert len(drawn(text)) == len(PARTS)
    assert all(claim.title in text for claim in CLAIMS)


@pytest.mark.slow("draws all pictures")
def test_files_have_every_row_even_before_it_is_done(data: TableData, tmp_path: Path) -> None:
    trials = PROTOCOL.trials(data.digests)
    done = next(t for t in trials if (t.row, t.split) == (r.MLP, SEQUENCES))
    table = Table(data, PROTOCOL, (result(done, 1.0),))
    write(table, tmp_path)
    assert [path.name for path in tmp_path.iterdir()] == ["table1.json"]
    page = table_page(table).html()
    for shown in ("0, 3 left", "- (0.6039)", "made by random sinusoids", "; 1 of 111 trials done"):
        assert shown in page
    values = json.loads((tmp_path / "table1.json").read_text())
    assert len(values["table"]) == 2 * 3 * 16
    (line,) = (line for line in values["table"] if line["runs"] and line["part"] == "test")
    assert (line["architecture"], line["split"]) == ("MLP-7", "sequences")
    assert line["mean"][1] == line["paper"][1] == 207.1595
    assert line["left"] == 2
    assert len(values["topologies"]) == 18
    assert {item["verdict"] for item in values["claims"]} == {"-"}
    assert "No judgement of the paper: networks were trained for 1 of its 100 epochs" in page
    assert "No judgement" not in table_page(Table(data, Protocol(), ())).html()


@pytest.mark.slow("draws all pictures each")
@pytest.mark.parametrize("name", ["arm", "seven_joints"])
def test_beside_another_arm_stand_only_the_papers_factors(
    name: str, data: TableData, tmp_path: Path, arm: Path
) -> None:
    """Errors in N m of an iiwa say nothing there, whether its joints are as many or not."""
    if name == "arm":
        data = TableData.load(write_data(tmp_path / "data", arm))
    else:
        urdf = tmp_path / f"{name}.urdf"
        urdf.write_bytes(data.model.urdf.read_bytes())
        data = replace(data, model=RobotModel.load(urdf))
    n = data.model.n
    found = tuple(
        TrialResult(trial, dict.fromkeys(PARTS, (2.0,) * n), 1, 2.5, "cpu", {"limo": "0"})
        for trial in ONCE.trials(data.digests)
    )
    table, out = Table(data, ONCE, found), tmp_path / "out"
    out.mkdir()
    write(table, out)
    page = table_page(table).html().replace("\xa0", " ")
    assert f"joint {n}</th>" in page
    assert f"joint {n + 1}" not in page
    assert "in brackets" not in page
    assert f"samples of {name} at 100 Hz, 40 s with 5 scaffolds; validation 12 s." in page
    values = json.loads((out / "table1.json").read_text())
    assert {line["paper"] for line in values["table"]} == {None}
    assert len(values["columns"]) == n + 1
    first = values["claims"][0]
    assert (first["factor"], first["paper"]) == (1.0, pytest.approx(202, abs=1))


# The command


def command_line(*arguments: object) -> list[str]:
    # what a shell runs in the background is born with SIGINT ignored, and so are its children
    listen = "import signal; signal.signal(signal.SIGINT, signal.default_int_handler)"
    code = f"{listen}; from limo_driver.app.cli import main; main()"
    return [sys.executable, "-c", code, *map(str, arguments)]


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--device", "tpu"], "no device is called 'tpu'; known: auto, cpu, cuda"),
        (["--jobs", "0"], "--jobs is 0, expected 1 or more"),
        (["--epochs", "0"], "epochs is 0, expected a whole number of 1 or more"),
        (["--batch", "0"], "batch is 0, expected a whole number of 1 or more"),
        (["--data", "nowhere"], "nowhere/data.json: cannot be read"),
    ],
)
def test_the_command_refuses(
    options: list[str],
    message: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "argv", ["limo", "reproduce", "table1", *options])
    with pytest.raises(SystemExit) as ended:
        main()
    assert ended.value.code == 2
    assert message in capsys.readouterr().err


def finished(out: Path) -> dict[str, int]:
    return {path.name: path.stat().st_mtime_ns for path in (out / "trials").glob("*.json")}


@pytest.fixture
def nearly_done(data: TableData, tmp_path: Path) -> Path:
    """Return an output folder that lacks one trial of each kind of network and of topology."""
    out = tmp_path / "out"
    for name in ("trials", "prepared"):
        (out / name).mkdir(parents=True)
    store = TrialStore(out / "trials", physics_digest(rigid_body(data, out / "prepared")))
    for trial in ONCE.trials(data.digests):
        if trial.split != SEQUENCES or trial.row not in LEFT:
            store.save(result(trial, 1.0))
    assert len(finished(out)) == 37 - len(LEFT)
    return out


@pytest.mark.slow("trains all the rows of the table in processes of their own")
def test_a_killed_command_goes_on_where_it_was(folder: Path, nearly_done: Path, limo: Limo) -> None:
    out = nearly_done
    arguments = (
        "reproduce", "table1", "--data", folder, "--out", out, "--device", "cpu",
        "--runs", ONCE.runs, "--epochs", ONCE.epochs, "--jobs", 1,
    )  # fmt: skip
    given, table = finished(out), out / "table1.json"
    with subprocess.Popen(
        command_line(*arguments), stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
    ) as first:
        while not (len(finished(out)) > len(given) + 1 and table.exists()):
            assert first.poll() is None
            time.sleep(0.05)
        first.send_signal(signal.SIGKILL)
    before = finished(out)
    assert json.loads(table.read_text())["trials_left"] > 0
    again = limo(*arguments)
    assert again.returncode == 0, again.stderr
    after = finished(out)
    assert len(after) == 37
    assert {name: after[name] for name in before} == before
    assert given.items() <= before.items()
    assert not list((out / "trials").glob(".*"))  # nothing half-written
    assert json.loads(table.read_text())["trials_left"] == 0
    assert "; 37 of 37 trials done" in (out / "report.html").read_text()
    assert not (out / "unfinished").exists() or not list((out / "unfinished").iterdir())


@pytest.mark.slow("trains all the rows of the table in processes of their own")
def test_ctrl_c_stops_at_once_and_keeps_what_is_done(folder: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    command = command_line(
        "reproduce", "table1", "--data", folder, "--out", out, "--device", "cpu",
        "--runs", 1, "--epochs", 100_000, "--jobs", 1,
    )  # fmt: skip
    with subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, start_new_session=True
    ) as running:
        while not finished(out):
            assert running.poll() is None
            time.sleep(0.05)
        os.killpg(running.pid, signal.SIGINT)  # as a terminal does: to the workers, too
        said, complaints = running.communicate(timeout=120)
    assert running.returncode == 130
    assert "finished trials are kept" in complaints
    assert "Traceback" not in complaints
    assert "; 1 of 37 trials done" in " ".join(said.split())
    assert all(row.name in (out / "report.html").read_text() for row in ALL_ROWS)
