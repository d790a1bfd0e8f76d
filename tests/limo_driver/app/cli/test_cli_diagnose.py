"""`limo diagnose` from file to file; what the search finds is made up and told, not searched."""

from __future__ import annotations

import json
import sys
from dataclasses import replace

import numpy as np
import pytest
from lanes import sampled

import limo_driver as limo
from estimators.diagnosis.from_torque.pipeline import Diagnosis
from estimators.diagnosis.result import Explanation, Traces
from estimators.diagnosis.settings.residuals import ROWS
from estimators.diagnosis.verdict import (
    BeforeAfter,
    Finding,
    Fit,
    NextMotion,
    RowCount,
    Unexplained,
    Verdict,
    Where,
)
from limo_driver.app.cli import main
from limo_driver.errors import ConfigError, RecordingError
from limo_driver.physics import CoulombFriction, PreslidingHysteresis, Simulation, Tolerances
from limo_driver.physics.effects.friction import SIGN_WIDTH
from limo_driver.recordings.filters.differentiation import smooth
from limo_driver.recordings.recording import Recording
from limo_driver.trajectory import Trajectory
from limo_driver.types import Motion

START = np.array([0.1, 0.5, -0.2, -1.0, 0.3, 0.8, 0.0])
SLIP = PreslidingHysteresis(joint=2, stiffness=(100.0,), width=(0.02,))
TRUE = Simulation("iiwa14", (SLIP,))
GIVEN = Simulation("iiwa14", (CoulombFriction(joint=2, tau_c=2.0),))
FILES = {"verdict.json", "sim.yaml", "report.html", "next_motion.parquet"}


@pytest.fixture(scope="module")
def recording(tmp_path_factory):
    t = np.arange(2000) / 100.0
    w = 2 * np.pi * np.array([0.31, 0.23, 0.37, 0.29, 0.41, 0.43, 0.47])
    angle = w * t[:, None]
    motion = Motion(
        t, START + 0.05 * np.sin(angle), 0.05 * w * np.cos(angle), -0.05 * w**2 * np.sin(angle)
    )
    noise = 0.01 * np.random.default_rng(0).standard_normal((2000, 7))
    path = tmp_path_factory.mktemp("run") / "run.parquet"
    Recording(t, motion.position, TRUE.predict(motion) + noise).save(path)
    return path


@pytest.fixture
def found(monkeypatch):
    """Put a made-up search in the place of the real one; its verdict can be changed."""
    changes = {"equivalent": ("stribeck_friction",), "after": TRUE, "separates": ()}

    def diagnose(simulation, recordings, bandwidth, progress, _budget):
        progress("comparing explanations", 0.5)
        return _made_up(simulation, recordings, bandwidth, **changes)

    monkeypatch.setattr("estimators.diagnosis.diagnose", diagnose)
    return changes


def _made_up(given, recordings, bandwidth, equivalent, after, separates):
    recording = recordings[0]
    motion = recording.motion(bandwidth)
    measured, before, simulated = (
        smooth(recording.time, torque, bandwidth, recording.segments)
        for torque in (recording.torque, given.predict(motion), after.predict(motion))
    )
    load = given.model.inverse_dynamics(motion.position, motion.velocity, motion.acceleration)
    traces = Traces(
        motion.time, np.zeros(len(motion), dtype=int), motion.position, motion.velocity, load,
        np.abs(motion.position - START), measured, before, before, simulated, motion.time > 15.0,
        np.abs(motion.velocity) > ROWS.rest * SIGN_WIDTH,
    )  # fmt: skip
    rmse = [tuple(np.sqrt(np.mean((measured - x) ** 2, axis=0))) for x in (before, simulated)]
    finding = Finding(
        "presliding_hysteresis", "missing", (2,), equivalent, 0.9, {}, Where(figure="joint-2"), 0.8,
        BeforeAfter(*rmse), "At joint 2 the residual rises over the distance since reversal.",
    )  # fmt: skip
    verdict = Verdict(
        "explained", (finding,), Unexplained(), (),
        NextMotion(separates, "") if separates else None,
        Fit(*rmse, (0.005,) * 7, 0.9, (0.85, np.nan)), RowCount(len(recording), {}),
    )  # fmt: skip
    explanation = Explanation(("presliding_hysteresis",), ((2,),), 100.0, 0.8)
    return Diagnosis(
        verdict, given, after, tuple(recordings), traces, (explanation,), bandwidth=bandwidth
    )


@pytest.fixture
def sim(tmp_path):
    path = tmp_path / "given.yaml"
    GIVEN.save(path)
    return path


@pytest.fixture
def diagnose(tmp_path, monkeypatch, capsys, sim):
    def run(*recordings, out=tmp_path / "out", more=()):
        arguments = (*recordings, "--sim", sim, "--out", out, *more)
        monkeypatch.setattr(sys, "argv", ["limo", "diagnose", *map(str, arguments)])
        with pytest.raises(SystemExit) as ended:
            main()
        return (ended.value.code or 0, *capsys.readouterr())

    return run


@pytest.fixture
def refused(tmp_path, diagnose):
    """Diagnose a recording that must be refused: in one line, with nothing printed or written."""

    def run(recording, said):
        status, printed, notes = diagnose(recording)
        assert status == 2
        assert printed == ""
        assert said in notes
        assert notes.count("\n") == 1
        assert not (tmp_path / "out").exists()

    return run


@pytest.mark.usefixtures("found")
def test_writes_verdict_simulation_report_and_the_next_motion(tmp_path, recording, diagnose):
    status, printed, notes = diagnose(recording)
    assert status == 0, notes
    assert {item.name for item in (tmp_path / "out").iterdir()} == FILES
    assert "Presliding hysteresis at joint 2" in printed
    assert "cannot be told from stribeck friction" in printed
    assert "next motion: Creep at five speeds" in printed
    said = printed.replace("\n", "")
    assert all(str(tmp_path / "out" / name) in said for name in FILES)
    verdict = json.loads((tmp_path / "out" / "verdict.json").read_text())
    assert verdict["schema"] == 1
    assert verdict["fit"]["ci95"] == [0.85, None]
    assert verdict["next_motion"] == {
        "separates": [["presliding_hysteresis", "stribeck_friction"]],
        "file": "next_motion.parquet",
    }
    assert Simulation.load(tmp_path / "out" / "sim.yaml") == TRUE
    motion = Trajectory.load(tmp_path / "out" / "next_motion.parquet")
    assert motion.robot == "iiwa14"
    page = (tmp_path / "out" / "report.html").read_text()
    assert "Joint 2: difference" in page
    assert "The motion to record next" in page


@pytest.mark.parametrize(
    ("more", "expected"),
    [
        ((), Tolerances(0.03, 0.2)),
        (("--gain-tolerance", "0.1"), Tolerances(0.03, 0.2, gain=0.1)),
        (("--inertia-tolerance", "0.01"), Tolerances(0.01, 0.2)),
    ],
)
def test_tolerances_that_are_given_take_the_place_of_those_stated(
    recording, diagnose, sim, monkeypatch, more, expected
):
    replace(GIVEN, tolerances=Tolerances(0.03, 0.2)).save(sim)
    known = []

    def search(simulation, *_):
        known.append(simulation.tolerances)
        raise RecordingError("that was all to see")

    monkeypatch.setattr("estimators.diagnosis.diagnose", search)
    diagnose(recording, more=more)
    assert known == [expected]


def test_a_tolerance_that_is_none_is_refused(recording, diagnose):
    status, _, notes = diagnose(recording, more=("--gain-tolerance", "-0.1"))
    assert status == 2
    assert "gain is -0.1, expected a number of 0 or more" in notes


@pytest.mark.slow("runs all stages of a diagnosis but the search")
@pytest.mark.usefixtures("found")
def test_json_is_the_verdict_and_nothing_else(tmp_path, recording, diagnose):
    status, printed, notes = diagnose(recording, more=("--json",))
    assert status == 0, notes
    assert notes == ""
    assert json.loads(printed) == json.loads((tmp_path / "out" / "verdict.json").read_text())


@pytest.mark.slow("runs all stages of a diagnosis but the search")
def test_without_ambiguity_there_is_no_next_motion_nor_an_old_one(
    tmp_path, recording, diagnose, found
):
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "next_motion.parquet").write_text("of an earlier diagnosis")
    found["equivalent"] = ()
    status, _, notes = diagnose(recording)
    assert status == 0, notes
    assert {item.name for item in (tmp_path / "out").iterdir()} == FILES - {"next_motion.parquet"}
    assert json.loads((tmp_path / "out" / "verdict.json").read_text())["next_motion"] is None


@pytest.mark.slow("plans a motion")
def test_the_pairs_that_the_search_asks_for_come_first(tmp_path, recording, diagnose, found):
    found["separates"] = (("coulomb_friction", "presliding_hysteresis"),)
    diagnose(recording)
    verdict = json.loads((tmp_path / "out" / "verdict.json").read_text())
    assert verdict["next_motion"]["separates"] == [["coulomb_friction", "presliding_hysteresis"]]


@pytest.mark.slow("runs all stages of a diagnosis but the search")
def test_what_no_motion_tells_apart_is_said_in_the_report(tmp_path, recording, diagnose, found):
    found["equivalent"] = ()
    found["separates"] = (("payload", "link_inertia"),)
    status, printed, notes = diagnose(recording)
    assert status == 0, notes
    assert "No motion to record next is proposed: " in printed
    assert "self_collision" not in printed
    page = (tmp_path / "out" / "report.html").read_text()
    assert "No motion to record next is proposed: " in page
    assert "once with and once without it" in page
    assert not (tmp_path / "out" / "next_motion.parquet").exists()


@pytest.mark.slow("runs all stages of a diagnosis but the search")
def test_a_motion_that_cannot_be_replayed_does_not_fail_the_diagnosis(
    tmp_path, recording, diagnose, found
):
    found["after"] = Simulation("iiwa14", (PreslidingHysteresis(
        joint=2, stiffness=(1e7,), width=(1e-4,)),))  # fmt: skip
    status, _, notes = diagnose(recording)
    assert status == 0, notes
    page = (tmp_path / "out" / "report.html").read_text()
    assert "The motion was not replayed: " in page


def _failing(*_args, **_more):
    raise np.linalg.LinAlgError("Singular matrix")


@pytest.mark.usefixtures("found")
@sampled(
    ("place", "stage", "missing"),
    [
        ("estimators.diagnosis.from_torque.pipeline.write_report", "report", {"report.html"}),
        ("limo_driver.app.library.diagnosing.with_replay", "replay on the simulated robot", set()),
        (
            "limo_driver.app.library.diagnosing.with_next_motion",
            "next motion",
            {"next_motion.parquet"},
        ),
    ],
    "runs all stages of a diagnosis but the search, each",
)
def test_where_a_later_stage_fails_the_verdict_is_written_and_says_so(
    tmp_path, recording, diagnose, monkeypatch, place, stage, missing
):
    monkeypatch.setattr(place, _failing)
    status, printed, notes = diagnose(recording)
    assert status == 1
    assert f"limo: a stage of the diagnosis failed: {stage} (LinAlgError: Singular" in notes
    assert "Presliding hysteresis at joint 2" in printed
    assert {item.name for item in (tmp_path / "out").iterdir()} == FILES - missing
    verdict = json.loads((tmp_path / "out" / "verdict.json").read_text())
    assert f"missing: {stage} (LinAlgError: Singular matrix)." in verdict["notes"][0]
    assert verdict["verdict"] == "explained"


def test_a_search_that_fails_leaves_no_folder(tmp_path, recording, diagnose, monkeypatch):
    def failing(*_args):
        raise ConfigError("no set of effects")

    monkeypatch.setattr("estimators.diagnosis.diagnose", failing)
    status, _, notes = diagnose(recording)
    assert (status, notes) == (2, "limo: no set of effects\n")
    assert not (tmp_path / "out").exists()


@pytest.mark.slow("runs all stages of a diagnosis but the search, twice")
@pytest.mark.usefixtures("found")
def test_python_prints_what_the_terminal_does(recording, diagnose):
    _, printed, _ = diagnose(recording)
    found = limo.diagnose(GIVEN, [Recording.load(recording)])
    assert printed[: printed.index("wrote ")].split() == str(found).split()
    assert "cannot be told from stribeck friction" in str(found)


@pytest.mark.usefixtures("found")
def test_progress_ends_at_1_and_never_goes_back(recording):
    told = []
    limo.diagnose(GIVEN, [Recording.load(recording)], progress=lambda _, part: told.append(part))
    assert told == sorted(told)
    assert told[-1] == 1.0


def _spoilt(path, tmp_path, **columns):
    import pyarrow.parquet as pq

    table = pq.read_table(path)
    for name, change in columns.items():
        at = table.column_names.index(name)
        table = table.set_column(at, name, [change(table[name].to_numpy())])
    pq.write_table(table, tmp_path / "spoilt.parquet")
    return tmp_path / "spoilt.parquet"


@pytest.mark.usefixtures("found")
@pytest.mark.parametrize(
    ("columns", "said"),
    [
        ({"position_2": lambda q: 57.3 * q + 57}, "position_2 "),
        (
            {f"torque_{j}": lambda tau: np.nan * tau for j in range(1, 8)},
            "usable rows of 2000",
        ),
        ({"time": lambda t: t / 100}, "Hz, expected 10 to 5000 Hz"),
    ],
)
def test_recordings_that_cannot_be_used_are_refused_in_one_line(
    tmp_path, recording, refused, columns, said
):
    refused(_spoilt(recording, tmp_path, **columns), said)


def _exchanged(path, tmp_path, a, b):
    import pyarrow.parquet as pq

    table = pq.read_table(path)
    names = {a: b, b: a}
    table = table.rename_columns([names.get(name, name) for name in table.column_names])
    pq.write_table(table, tmp_path / "exchanged.parquet")
    return tmp_path / "exchanged.parquet"


@sampled(
    ("a", "b", "said"),
    [
        ("torque_2", "torque_4", "torque_2 belongs to joint 4 and torque_4 to joint 2"),
        ("position_4", "position_6", "position_4 belongs to joint 6 and position_6 to joint 4"),
    ],
    "looks where a recording belongs",
)
def test_exchanged_columns_are_refused_in_one_line_before_any_search(
    tmp_path, recording, refused, a, b, said
):
    refused(_exchanged(recording, tmp_path, a, b), said)


@sampled(
    ("columns", "said"),
    [
        ({"torque_4": lambda tau: -tau}, "torque_4 has the other sign than expected"),
        ({"torque_4": lambda tau: tau / 1000}, "torque_4 is 0.001 times what its motion makes"),
    ],
    "looks where a recording belongs",
)
def test_torques_of_another_sign_or_unit_are_refused_in_one_line(
    tmp_path, recording, refused, columns, said
):
    refused(_spoilt(recording, tmp_path, **columns), said)


def test_rest_is_refused_in_one_line(tmp_path, recording, refused):
    still = {f"position_{j}": lambda q: q[0] + 0 * q for j in range(1, 8)}
    refused(
        _spoilt(recording, tmp_path, **still), "no joint keeps moving for long enough to learn from"
    )


@pytest.mark.usefixtures("found")
def test_a_recording_of_another_robot_is_refused(tmp_path, diagnose):
    t = np.arange(2000) / 250.0
    path = tmp_path / "other.parquet"
    position = 0.1 * np.sin(t)[:, None] * np.ones(6)
    Recording(t, position, position).save(path)
    status, _, notes = diagnose(path)
    assert status == 2
    assert "has 6 joints, but iiwa14 has 7" in notes


@pytest.mark.usefixtures("found")
def test_a_folder_that_cannot_be_written_is_refused_before_the_work(tmp_path, recording, diagnose):
    (tmp_path / "file").write_text("")
    for out, said in (
        (tmp_path / "file", "is a file, expected a folder"),
        (tmp_path / "file" / "below", "cannot be written to"),
    ):
        status, _, notes = diagnose(recording, out=out)
        assert status == 2
        assert said in notes
        assert notes.count("\n") == 1


@pytest.mark.usefixtures("found")
def test_a_file_that_cannot_be_written_is_said_in_one_line(tmp_path, recording, diagnose):
    (tmp_path / "out" / "verdict.json").mkdir(parents=True)
    status, _, notes = diagnose(recording)
    assert status == 2
    assert "cannot be written: " in notes
    assert notes.count("\n") == 1


@pytest.mark.usefixtures("found")
def test_the_given_simulation_is_not_written_over(tmp_path, recording, monkeypatch, capsys):
    GIVEN.save(tmp_path / "sim.yaml")
    arguments = (recording, "--sim", tmp_path / "sim.yaml", "--out", tmp_path)
    monkeypatch.setattr(sys, "argv", ["limo", "diagnose", *map(str, arguments)])
    with pytest.raises(SystemExit) as ended:
        main()
    assert ended.value.code == 2
    assert "sim.yaml: is read and would be written over" in capsys.readouterr().err
    assert Simulation.load(tmp_path / "sim.yaml") == GIVEN
