"""Small or strange files are refused in one line before they cost time or memory.

`benchmarks/files/bombs.py` prints what each costs a whole command.
"""

import os
import threading

import pytest

from limo_driver.errors import ConfigError, LimoError, RecordingError
from limo_driver.logs.mcap_file import read_mcap
from limo_driver.logs.readers.formats.reading import read_table
from limo_driver.model import RobotModel
from limo_driver.recordings.recording import Recording
from limo_driver.runtime.declarations import read_json, read_yaml
from limo_driver.runtime.given_files import check_file
from limo_driver.trajectory import Trajectory

PATIENCE = 60.0  # [s]; matters only where something waits for ever
READERS = {
    "sim.yaml": read_yaml,
    "aliases.json": lambda path: read_json(path, ConfigError, 1),
    "log.mcap": lambda path: list(read_mcap(path)),
    "log.csv": read_table,
    "log.parquet": read_table,
    "log.npz": read_table,
    "log.db3": read_table,
    "motion.traj.parquet": Trajectory.load,
    "arm.urdf": RobotModel.load,
    "run.parquet": Recording.load,
    "run.csv": Recording.load,
}


def refused(read, path):
    """Return the line with which a reader refuses a file, on a thread that may be left behind."""
    said = []

    def run():
        try:
            read(path)
        except LimoError as error:
            said.append(str(error))

    thread = threading.Thread(target=run, daemon=True)
    thread.start()
    thread.join(PATIENCE)
    assert not thread.is_alive(), "it is still read"
    [line] = said
    assert "\n" not in line
    assert path.name in line
    return line


@pytest.mark.parametrize("name", READERS)
def test_links_to_devices_are_refused(tmp_path, name):
    path = tmp_path / name
    path.symlink_to("/dev/zero")
    refused(READERS[name], path)


@pytest.mark.parametrize("name", READERS)
def test_pipes_are_refused(tmp_path, name):
    path = tmp_path / name
    os.mkfifo(path)
    refused(READERS[name], path)


@pytest.mark.parametrize("newline", ["\n", ""])
def test_tables_of_too_many_columns_are_refused(tmp_path, newline):
    path = tmp_path / "wide.csv"
    names = ",".join(["time", *(f"position_{k}" for k in range(1, 100_000))])
    path.write_text(names + newline + ",".join(["0.0"] * 100_000) + newline)
    for read in (read_table, Recording.load):
        assert "has a first line of more than 65536 bytes" in refused(read, path)


def test_robots_of_too_many_joints_are_refused(tmp_path):
    path = tmp_path / "chain.urdf"
    joint = '<joint name="j{0}" type="revolute"><parent link="l{0}"/><child link="l{1}"/></joint>'
    joints = "".join(f'<link name="l{k}"/>' + joint.format(k, k + 1) for k in range(20_000))
    path.write_text(f'<robot name="chain">{joints}</robot>')
    assert "has 20000 joints, expected at most 1000" in refused(RobotModel.load, path)


def test_simulations_of_too_many_effects_are_refused(tmp_path):
    path = tmp_path / "sim.yaml"
    effect = "  - {effect: viscous_friction, joint: 1, coefficient: 1.0}\n"
    path.write_text("robot: iiwa14\neffects:\n" + effect * 60_000)
    assert "expected at most 262144" in refused(read_yaml, path)


def test_folders_and_what_is_not_there_are_left_to_who_opens_them(tmp_path):
    check_file(tmp_path, RecordingError)
    check_file(tmp_path / "none", RecordingError)
