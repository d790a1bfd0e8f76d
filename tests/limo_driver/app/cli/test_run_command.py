"""`limo run`: through the command line, as a user would."""

import json
import signal
import subprocess
import sys
from importlib.resources import files
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest
from sessions import PATIENCE, wait_until

from limo_driver.app.cli import controller, main
from limo_driver.app.cli.run import _report
from limo_driver.errors import ConfigError, HoldingError
from limo_driver.recordings.files.recorder import partial_path, read_header
from limo_driver.recordings.recording import Recording
from limo_driver.robot.playback import PlaybackSummary
from limo_driver.trajectory import Segment, Trajectory

pytestmark = pytest.mark.waits

EXAMPLE = Path(__file__).parents[4] / "examples" / "iiwa14_hysteretic.yaml"
START = np.array([0.1, 0.5, -0.2, -1.0, 0.3, 0.8, 0.0])


def write_trajectory(path, duration, n=7):
    time_ = np.linspace(0.0, duration, int(duration * 250) + 1)
    u = 2 * np.pi * time_ / duration
    shape = 0.02 * np.array([(1 - np.cos(u)), np.sin(u) * 2 * np.pi / duration])
    acceleration = 0.02 * np.cos(u) * (2 * np.pi / duration) ** 2
    spread = np.ones((1, n))
    Trajectory(
        time_,
        START[:n] + shape[0][:, None] * spread,
        shape[1][:, None] * spread,
        acceleration[:, None] * spread,
        robot="iiwa14",
        segments=(Segment("exploring", 0, len(time_)),),
    ).save(path)
    return path


@pytest.fixture
def trajectory(tmp_path):
    return write_trajectory(tmp_path / "limo.traj.parquet", 4.0)


def test_run_records_and_sums_up(limo, tmp_path, trajectory):
    record = tmp_path / "run.parquet"
    done = limo(
        "run", "--backend", "mujoco", "--trajectory", trajectory, "--sim", EXAMPLE,
        "--record", record, "--duration", 1.0, "--seed", 3, "--json",
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    summary = json.loads(done.stdout)
    table = pq.read_table(record)
    assert summary["samples"] == table.num_rows == 1001
    assert summary["duration"] == pytest.approx(1.0)
    assert max(summary["tracking_rmse"]) < 2e-3
    assert summary["limited"] == {}
    assert not summary["interrupted"]
    header = read_header(table)
    assert header["robot"] == "iiwa14"
    assert header["segments"] == [["exploring", 0.0, 1.0]]
    assert header["provenance"]["seed"] == 3
    assert np.abs(table["position_4"][0].as_py() - START[3]) < 1e-4


def test_recording_can_be_thinned(limo, tmp_path, trajectory):
    record = tmp_path / "run.parquet"
    done = limo(
        "run", "--backend", "virtual", "--trajectory", trajectory, "--record", record,
        "--duration", 0.2, "--rate", 250,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    assert "51 samples" in done.stdout
    assert np.diff(pq.read_table(record)["time"].to_numpy()) == pytest.approx(np.full(50, 0.004))


def test_a_recording_with_gaps_says_how_many(tmp_path, capsys):
    time = np.delete(np.arange(200) * 0.01, [30, 31, 32, 33, 120, 121, 122, 123])
    values = np.sin(time)[:, None]
    Recording.from_arrays(time, values, values).save(tmp_path / "run.parquet")
    nothing = np.zeros(1)
    _report(
        PlaybackSummary(
            str(tmp_path / "run.parquet"), 192, 2.0, 1.0, nothing, nothing, {}, False, {}, ()
        ),
        as_json=False,
    )
    assert "2 gaps; the longest, 0.05 s" in capsys.readouterr().out


@pytest.mark.slow("plays a motion in a process of its own")
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_interrupt_stops_the_arm_and_keeps_the_recording(tmp_path, number):
    trajectory = write_trajectory(tmp_path / "long.parquet", 600.0)
    record = tmp_path / "run.parquet"
    command = [
        sys.executable, "-c", "from limo_driver.app.cli import main; main()",
        "run", "--backend", "mujoco", "--trajectory", trajectory, "--record", record, "--json",
    ]  # fmt: skip
    partial = partial_path(record)  # rows come after the header
    pipe = subprocess.PIPE
    with subprocess.Popen(command, stdout=pipe, stderr=pipe, text=True) as child:
        wait_until(lambda: partial.exists() and partial.stat().st_size > 10_000)
        child.send_signal(number)
        stdout, stderr = child.communicate(timeout=PATIENCE)
    assert child.returncode == 130, stderr
    summary = json.loads(stdout)
    assert summary["interrupted"]
    table = pq.read_table(record)
    assert summary["samples"] == table.num_rows > 10
    last = np.array([table[f"position_{j}"][-20:].to_numpy() for j in range(1, 8)])
    assert np.abs(np.diff(last)).max() < 2e-5  # it came to rest before the end
    assert not partial_path(record).exists()
    assert not np.isnan(table["target_position_1"].to_numpy()).any()


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"backend": "nope"}, "no robot is called 'nope'; known: can, fri, mujoco, virtual"),
        ({"trajectory": "absent.parquet"}, "absent.parquet: cannot be read as a trajectory"),
        ({"sim": "absent.yaml"}, "absent.yaml: cannot be read"),
        ({"robot": "r2d2"}, "'r2d2' is neither built in"),
        ({"rate": "5000"}, "limo: rate 5000 Hz is above the control rate of 1000 Hz"),
        ({"rate": "0"}, "limo: rate is 0 Hz, expected above 0"),
        ({"rate": "nan"}, "limo: --rate is nan, expected a number"),
        ({"rate": "700"}, "the nearest that does is 1000 Hz"),
        ({"rate": "333.333"}, "the nearest that does is 333.333333 Hz, 1000 / 3"),
        ({"record": "run.csv"}, "run.csv: cannot be written: Parquet is written, and its name"),
        ({"backend": "virtual", "host": "10.0.0.1"}, "backend 'virtual' takes no --host"),
        ({"record": "."}, "cannot be written: it is a folder"),
        ({"record": "/proc/run.parquet"}, "cannot be written"),
        ({"duration": "0.001"}, "shorter than one sample"),
        ({"record": "nowhere/run.parquet"}, "cannot be written"),
        ({"wait-for-estimates": "9"}, "waits for what answers --stream; give both"),
        ({"wait-for-estimates": "0", "stream": None}, "is 0 s, expected above 0"),
        ({"wait-for-estimates": "-1", "stream": None}, "is -1 s, expected above 0"),
        ({"wait-for-estimates": "nan", "stream": None}, "--wait-for-estimates is nan, expected"),
        ({"wait-for-estimates": "9", "stream": None, "name": "a/b"}, "the arm's name is 'a/b'"),
    ],
)
def test_bad_input_ends_with_one_line(tmp_path, trajectory, monkeypatch, capsys, change, message):
    options = {
        "backend": "virtual",
        "trajectory": trajectory,
        "record": tmp_path / "run.parquet",
        **change,
    }
    assert run_here(monkeypatch, options) == 2
    stderr = capsys.readouterr().err
    assert message in stderr
    assert stderr.count("\n") == 1


def test_trajectory_for_another_arm_is_refused(tmp_path, monkeypatch, capsys):
    trajectory = write_trajectory(tmp_path / "six.parquet", 1.0, n=6)
    options = {"backend": "virtual", "trajectory": trajectory, "record": tmp_path / "r.parquet"}
    assert run_here(monkeypatch, options) == 2
    assert "the trajectory moves 6 joints, but iiwa14 has 7" in capsys.readouterr().err


def test_trajectory_planned_for_another_robot_is_refused(tmp_path, trajectory, monkeypatch, capsys):
    other = tmp_path / "other7.urdf"
    other.write_bytes((files("limo_driver") / "assets" / "iiwa14.urdf").read_bytes())
    options = {"backend": "virtual", "trajectory": trajectory, "record": tmp_path / "r.parquet"}
    assert run_here(monkeypatch, options | {"robot": other}) == 2
    stderr = capsys.readouterr().err
    assert "was planned for iiwa14, but the robot is" in stderr
    assert "plan again" in stderr
    assert not (tmp_path / "r.parquet").exists()


def test_an_arm_that_holds_says_what_somebody_at_it_can_do(
    tmp_path, trajectory, monkeypatch, capsys
):
    def held(_backend, _motion, record, **_):
        record.touch()
        raise HoldingError("no measurement for 0.1 s")

    monkeypatch.setattr("limo_driver.app.library.moving.play", held)
    record = tmp_path / "run.parquet"
    options = {"backend": "fri", "trajectory": trajectory, "record": record}
    assert run_here(monkeypatch, options) == 2
    held_so = (
        f"limo: the arm holds (no measurement for 0.1 s); what it did until then is in {record}; "
    )
    again = "bring it back to the first pose and run again"
    assert capsys.readouterr().err == f"{held_so}{again}, with --fifo if this machine was late\n"
    assert run_here(monkeypatch, options | {"fifo": None}) == 2
    assert capsys.readouterr().err == f"{held_so}{again}\n"


def test_a_simulated_controller_refuses_the_plan_of_another_arm(commanded, tmp_path):
    plan = write_trajectory(tmp_path / "six.parquet", 1.0, n=6)
    refused = commanded(controller.command)("--trajectory", plan).exception
    assert isinstance(refused, ConfigError)
    assert "six.parquet: the trajectory moves 6 joints, but iiwa14 has 7" in str(refused)


def run_here(monkeypatch, options):
    """Run the command in this process and return its exit status."""
    arguments = (
        str(item)
        for name, value in options.items()
        for item in (f"--{name}", *(() if value is None else (value,)))
    )
    monkeypatch.setattr(sys, "argv", ["limo", "run", *arguments])
    with pytest.raises(SystemExit) as ended:
        main()
    return ended.value.code
