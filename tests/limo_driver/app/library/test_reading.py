"""`limo.read` and `limo inspect`: somebody else's log, from the file to the recording."""

import json

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from logged import arm, measured, numbered, written

import limo_driver as limo
from limo_driver.app.library.reading import read_commanded
from limo_driver.errors import ConfigError, RecordingError
from limo_driver.recordings.files.recorder import read_header

TIME, POSITION, VELOCITY, TORQUE = measured()


def degrees():
    log = {"t_ms": 1e3 * TIME, **numbered("q{}", np.rad2deg(POSITION))}
    return log | numbered("tau{}", TORQUE) | {"gripper": np.sin(TIME)}


def test_a_log_in_degrees_and_milliseconds_needs_no_script(run, tmp_path):
    written(degrees(), tmp_path / "log.csv")
    status, said, _ = run("inspect", "log.csv", "--robot", "iiwa14")
    assert status == 0
    assert "beyond the limits of joint 1 in rad, within all limits in deg" in said
    assert "left out: gripper" in said
    assert "undecided" not in said
    assert "3000 samples at 250 Hz of 7 joints" in said
    go_on = "--robot iiwa14 --mapping mapping.yaml --out diagnosis"
    assert said.endswith(f"wrote mapping.yaml\nnext: limo diagnose log.csv {go_on}\n")
    status, said, _ = run(
        "convert",
        "log.csv",
        "--robot",
        "iiwa14",
        "--mapping",
        "mapping.yaml",
        "--out",
        "run.parquet",
    )
    assert status == 0
    assert "run.parquet: 3000 samples of 7 joints over 11.996 s" in said
    recording = limo.Recording.load(tmp_path / "run.parquet")
    np.testing.assert_allclose(recording.position, POSITION, atol=1e-7)
    np.testing.assert_allclose(recording.torque, TORQUE, atol=1e-6)
    assert read_header(pq.read_table(tmp_path / "run.parquet"))["joints"] == list(arm().joint_names)


def test_identify_takes_the_log_itself_and_says_how_it_was_read(run, tmp_path):
    written(degrees(), tmp_path / "log.csv")
    status, _, notes = run("identify", "log.csv", "--robot", "iiwa14", "--out", "sim.yaml")
    assert status == 0, notes
    assert "log.csv: read as time t_ms [ms], position q0 … q6 [deg], torque tau0 … tau6" in notes
    friction = [e for e in limo.Simulation.load(tmp_path / "sim.yaml").effects if e.is_friction]
    assert friction


def test_what_is_undecided_is_refused_until_it_is_stated(run, tmp_path):
    log = {"t": TIME, **numbered("q{}", POSITION), **numbered("theta{}", POSITION + 0.01)}
    written(log | numbered("tau{}", TORQUE), tmp_path / "log.csv")
    convert = ("convert", "log.csv", "--robot", "iiwa14", "--out", "run.parquet")
    status, _, errors = run(*convert)
    assert status == 2
    assert "q0 … q6 or theta0 … theta6? both fit the names" in errors
    assert "limo inspect" in errors
    status, said, _ = run("inspect", "log.csv", "--robot", "iiwa14")
    assert status == 0
    assert said.endswith("next: answer the question under `undecided:` there, and delete it\n")
    status, _, errors = run(*convert, "--mapping", "mapping.yaml")
    assert status == 2
    text = (tmp_path / "mapping.yaml").read_text()
    start = text.index("undecided:")
    (tmp_path / "mapping.yaml").write_text(text[:start] + "undecided: []\n")
    assert run(*convert, "--mapping", "mapping.yaml")[0] == 0


def test_a_mapping_in_which_somebody_answered_is_not_written_over(run, tmp_path):
    written(degrees(), tmp_path / "log.csv")
    inspect = ("inspect", "log.csv", "--robot", "iiwa14")
    mapping = tmp_path / "mapping.yaml"
    for _ in range(2):  # what is as proposed is written again
        assert "wrote mapping.yaml" in run(*inspect)[1]
    answered = mapping.read_text().replace("left_out:", "# as our log has it\nleft_out:")
    mapping.write_text(answered)
    status, said, _ = run(*inspect)
    assert status == 0
    assert "kept mapping.yaml, which is there and reads otherwise" in said
    assert "--mapping mapping.yaml" in said
    assert mapping.read_text() == answered
    assert json.loads(run(*inspect, "--json")[1])["kept"] is True
    assert "wrote other.yaml" in run(*inspect, "--out", "other.yaml")[1]
    (tmp_path / "photo.png").write_bytes(b"\x89PNG\xff")  # no text at all
    assert "kept photo.png" in run(*inspect, "--out", "photo.png")[1]


def test_findings_as_json(run, tmp_path):
    written(degrees(), tmp_path / "log.csv")
    status, said, _ = run("inspect", "log.csv", "--robot", "iiwa14", "--json")
    found = json.loads(said)
    assert status == 0
    assert found["taken"]["position"]["unit"] == "deg"
    assert found["undecided"] == []


def test_arrays_are_read_like_files():
    log = {"t_ms": 1e3 * TIME, "q": np.rad2deg(POSITION), "tau": TORQUE}
    recording = limo.read(log, "iiwa14")
    np.testing.assert_allclose(recording.position, POSITION, atol=1e-12)
    assert recording.warnings[0].startswith("read as time t_ms [ms]")
    mapping = limo.inspect(log, "iiwa14").mapping
    again = limo.read(log, mapping=mapping)
    np.testing.assert_array_equal(again.position, recording.position)
    assert again.warnings == ()


def test_a_log_of_another_format_without_robot_or_mapping(tmp_path):
    path = written(degrees(), tmp_path / "log.csv")
    with pytest.raises(limo.LimoError, match="`robot` or `mapping` has to say what they are"):
        limo.read(path)


def test_limos_own_recordings_are_read_as_ever(tmp_path):
    given = limo.Recording.from_arrays(TIME, POSITION, TORQUE)
    given.save(tmp_path / "run.parquet")
    np.testing.assert_array_equal(limo.read(tmp_path / "run.parquet").torque, given.torque)


def test_exchanged_columns_are_refused_on_every_way_in(run, tmp_path):
    torque = np.array(TORQUE)
    torque[:, [1, 3]] = torque[:, [3, 1]]
    log = {"t": TIME, **numbered("q{}", POSITION), **numbered("tau{}", torque)}
    written(log, tmp_path / "log.csv")
    status, _, errors = run("identify", "log.csv", "--robot", "iiwa14", "--out", "sim.yaml")
    assert status == 2
    assert "torque_2 belongs to joint 4 and torque_4 to joint 2" in errors


class Frame(dict):
    """As much of a DataFrame as is looked at: columns by name, and an index."""

    class Index:
        def __init__(self, values, name):
            self.values, self.name = values, name

        def __array__(self, dtype=None, copy=None):
            return np.asarray(self.values, dtype)

    def __init__(self, columns, index, name=None):
        super().__init__(columns)
        self.index = self.Index(index, name)


def joints_of_a_log():
    time = np.arange(0, 4, 0.01)
    q = 0.5 * np.sin(time)[:, None] * np.ones(7)
    columns = {f"joint{j + 1}_position_rad": q[:, j] for j in range(7)}
    columns |= {f"joint{j + 1}_torque_nm": 3 * q[:, j] for j in range(7)}
    return time, columns


def test_the_index_of_a_frame_is_its_time_where_it_says_so():
    time, columns = joints_of_a_log()
    dates = np.datetime64("2026-01-01", "ns") + (1e9 * time).astype("timedelta64[ns]")
    for index, name in ((dates, None), (dates, "when"), (time, "time")):
        found = limo.inspect(Frame(columns, index, name), "iiwa14")
        assert not [q for q in found.questions if q.startswith("time")]
        assert found.recording.rate == pytest.approx(100.0)
    counted = limo.inspect(Frame(columns, np.arange(len(time))), "iiwa14")
    assert any(q.startswith("time: none was found") for q in counted.questions)
    assert "refused" not in str(counted)  # at a rate that nobody stated
    assert counted.figures()["unit"][0] == "-"


def test_dates_are_the_time_whatever_they_are_called(tmp_path):
    time, columns = joints_of_a_log()
    dates = np.datetime64("2026-01-01", "ns") + (1e9 * time).astype("timedelta64[ns]")
    path = tmp_path / "log.parquet"
    pq.write_table(pa.table({"__index_level_0__": dates, **columns}), path)
    found = limo.inspect(path, "iiwa14")
    assert not [q for q in found.questions if q.startswith("time")]
    pq.write_table(pa.table({"__index_level_0__": time, **columns}), path)
    (question,) = [q for q in limo.inspect(path, "iiwa14").questions if q.startswith("time")]
    assert question.endswith("; __index_level_0__ goes on in even steps")


def test_what_is_no_recording_yet_is_told_how_to_become_one():
    _, columns = joints_of_a_log()
    for given in (columns, [columns], 3):
        with pytest.raises(ConfigError, match=r"`limo.read\(log, robot\)` makes one of arrays"):
            limo.identify("iiwa14", given)
    with pytest.raises(ConfigError, match=r"`limo.nominal\('iiwa14'\)` is the one of that robot"):
        limo.diagnose("iiwa14", [])


def test_what_lacks_commands_is_named_once(tmp_path):
    path = tmp_path / "run.parquet"
    limo.Recording(TIME, POSITION, TORQUE).save(path)
    with pytest.raises(RecordingError) as refused:
        read_commanded(path)
    assert str(refused.value).count(str(path)) == 1
    assert str(refused.value).startswith(f"{path}: lacks command_1")
