"""Where a disk is full, a file is there in full or not at all, and one line says why."""

from __future__ import annotations

import os
import resource
import subprocess
import sys
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest
from recorded_columns import make_columns

from limo_driver.app.cli import main
from limo_driver.app.cli.predict import write as write_prediction
from limo_driver.errors import ConfigError, LimoError, RecordingError
from limo_driver.logs.ros.joint_state_log import write_joint_states
from limo_driver.physics import Simulation
from limo_driver.recordings.files.recorder import Recorder
from limo_driver.recordings.recording import Recording
from limo_driver.runtime.outputs import whole
from limo_driver.trajectory import Trajectory
from limo_driver.types import JointState
from limopa.picture import sheet

COLUMNS = make_columns(T=2000)
POSITION = np.stack([COLUMNS[f"position_{j}"] for j in (1, 2, 3)], axis=1)
RECORDING = Recording.from_arrays(COLUMNS["time"], POSITION, POSITION)
SIMULATION = Simulation.load(Path(__file__).parents[2] / "examples" / "iiwa14_hysteretic.yaml")
OLD = b"what was there"


def write_text(path):
    with whole(path) as draft:
        draft.write_text("x" * 9999)


WRITERS = {
    "recording": RECORDING.save,
    "simulation": SIMULATION.save,
    "prediction": lambda path: write_prediction(
        RECORDING, RECORDING.time, {"torque": POSITION}, path
    ),
    "trajectory": Trajectory(RECORDING.time, POSITION, POSITION, POSITION, robot="arm").save,
    "log": lambda path: write_joint_states(RECORDING, path, ("a", "b", "c"), "/joint_states"),
    "text": write_text,
}


@contextmanager
def room(size):
    """Let no file grow beyond a size [bytes], as on a disk that is full.

    Python keeps as much byte code of a module as fits, and never reads the module again: so that of
    what is imported meanwhile is not kept.
    """
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    kept, sys.dont_write_bytecode = sys.dont_write_bytecode, True
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
        sys.dont_write_bytecode = kept


@pytest.mark.parametrize("name", WRITERS)
@pytest.mark.parametrize("there", [False, True])
def test_a_file_is_whole_or_what_it_was(tmp_path, name, there):
    path = tmp_path / "out.parquet"
    if there:
        path.write_bytes(OLD)
    with room(700), pytest.raises(LimoError, match=r"out\.parquet: cannot be written: File too"):
        WRITERS[name](path)
    assert [p.read_bytes() for p in tmp_path.iterdir()] == [OLD] * there
    WRITERS[name](path)
    assert [p.name for p in tmp_path.iterdir()] == ["out.parquet"]
    assert path.stat().st_size > 700


def test_a_picture_is_whole_or_not_there(tmp_path):
    def draw():
        with sheet(tmp_path / "a.svg", widths=(1, 1)) as (figure, grid):
            figure.add_subplot(grid[0, 0]).plot([0, 1])

    with room(700), pytest.raises(ConfigError, match=r"a\.svg: cannot be written: File too large"):
        draw()
    assert not list(tmp_path.iterdir())
    draw()
    assert (tmp_path / "a.svg").read_text().startswith("<?xml")


def test_a_recorder_that_cannot_begin_leaves_nothing(tmp_path):
    with room(10), pytest.raises(RecordingError, match="cannot be written: File too large"):
        Recorder(tmp_path / "run.parquet", 3, {})
    assert not list(tmp_path.iterdir())


def test_a_recording_that_cannot_be_finished_stays_in_its_log(tmp_path):
    recorder = Recorder(tmp_path / "run.parquet", 3, {})
    for k in range(400):
        values = POSITION[k]
        recorder.append(JointState(0.01 * k, values, values, values, sequence=k))
    recorder._flush()
    with room(700), pytest.raises(RecordingError, match=r"what was written is in .*\.partial"):
        recorder.close()
    assert [path.name for path in tmp_path.iterdir()] == ["run.parquet.partial"]
    assert len(Recording.load(tmp_path / "run.parquet")) == 400


def test_what_is_no_file_is_written_to_itself(tmp_path):
    with whole("/dev/null") as draft:
        draft.write_text("gone")
    assert Path("/dev/null").is_char_device()
    (tmp_path / "link").symlink_to(tmp_path / "file")
    with whole(tmp_path / "link") as draft:
        draft.write_text("here")
    assert (tmp_path / "link").is_symlink()
    assert (tmp_path / "file").read_text() == "here"


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """A folder with a motion, a recording and a simulation."""
    folder = tmp_path_factory.mktemp("made")
    for command in (
        "plan --scaffolds 1 --out motion.parquet",
        "run --backend mujoco --trajectory motion.parquet --record run.parquet",
        "identify run.parquet --robot iiwa14 --out sim.yaml",
    ):
        assert called(command, folder) == 0
    return folder


def called(command, folder):
    """Run a command in this process and in a folder; return its exit status."""
    before, given = Path.cwd(), sys.argv
    sys.argv = ["limo", *command.split()]
    os.chdir(folder)
    try:
        main()
    except SystemExit as ended:
        return ended.code or 0
    finally:
        sys.argv = given
        os.chdir(before)
    return 0


@pytest.fixture
def disk(tmp_path):
    """A real file system of 8 kB, which takes a small file and no more."""
    folder = tmp_path / "disk"
    folder.mkdir()
    mount = ["mount", "-t", "tmpfs", "-o", "size=8k", "tmpfs", str(folder)]
    done = subprocess.run(mount, capture_output=True, text=True, check=False)
    if done.returncode:
        pytest.skip(f"no file system can be mounted: {done.stderr.strip()}")
    yield folder
    subprocess.run(["umount", str(folder)], check=True)


@pytest.mark.parametrize(
    "command",
    [
        "plan --scaffolds 1 --out {}/motion.parquet",
        "run --backend mujoco --trajectory motion.parquet --record {}/run.parquet --duration 3",
        "identify run.parquet --robot iiwa14 --out {}/sim.yaml",
        "predict run.parquet --sim sim.yaml --out {}/torque.parquet",
        "convert run.parquet --out {}/run.mcap",
        pytest.param(
            "train run.parquet --sim sim.yaml --model joint-physics --out {}/model",
            marks=pytest.mark.slow("learns before it writes"),
        ),
        "secure --out {}/trust --driver a --service b",
    ],
    ids=lambda command: command.split()[0],
)
def test_a_command_on_a_full_disk_says_so_and_leaves_no_stump(command, made, disk, capsys):
    (disk / "other").write_bytes(bytes(4096))
    (disk / "more").write_bytes(bytes(2048))  # and the rest of a page, where one may begin
    capsys.readouterr()
    assert called(command.format(disk), made) == 2
    told = capsys.readouterr()
    assert told.err.count("\n") == 1
    assert told.err.startswith("limo: ")
    assert "cannot be written: No space left on device" in told.err
    assert "Traceback" not in told.err + told.out
    left = {path.name for path in disk.rglob("*") if path.is_file()} - {"other", "more"}
    assert not left
