"""Episodes of LeRobotDatasets."""

import json

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from logged import arm, measured

from limo_driver.errors import RecordingError
from limo_driver.logs.readers.formats.reading import read_table
from limo_driver.logs.readers.proposals.proposal import propose

TIME, POSITION, _, TORQUE = measured(2.0)
NAMES = arm().joint_names


def dataset(folder, version, torque=True):
    """A LeRobotDataset of two episodes; v3.0 keeps them in one file."""
    half = TIME.size // 2
    names = {"motors": [f"{name}.pos" for name in NAMES]}
    features = {"observation.state": {"dtype": "float32", "shape": [7], "names": names}}
    columns = {
        "observation.state": list(POSITION),
        "timestamp": np.tile(TIME[:half], 2),
        "episode_index": np.repeat([0, 1], half),
        "frame_index": np.tile(np.arange(half), 2),
    }
    if torque:
        features["observation.effort"] = {"names": [f"{name}.effort" for name in NAMES]}
        columns["observation.effort"] = list(TORQUE)
    (folder / "meta").mkdir(parents=True)
    info = {"codebase_version": version, "fps": 250, "robot_type": "iiwa14", "features": features}
    (folder / "meta" / "info.json").write_text(json.dumps(info))
    data = folder / "data" / "chunk-000"
    data.mkdir(parents=True)
    table = pa.table(columns)
    if version == "v3.0":
        pq.write_table(table, data / "file-000.parquet")
    else:
        for k in range(2):
            pq.write_table(table.slice(k * half, half), data / f"episode_00000{k}.parquet")
    return folder


@pytest.mark.parametrize("version", ["v2.1", "v3.0"])
def test_episodes_of_a_dataset(tmp_path, version):
    folder = dataset(tmp_path / "set", version)
    table = read_table(folder)
    np.testing.assert_array_equal(
        table.columns[f"observation.state.{NAMES[3]}.pos"], POSITION[:, 3]
    )
    steps = np.diff(table.columns["timestamp"])
    assert (steps > 0).all()
    assert np.flatnonzero(steps > 0.5).tolist() == [TIME.size // 2 - 1]
    assert "2 episodes" in table.notes[0]
    one = read_table(folder, episode=1)
    np.testing.assert_array_equal(
        one.columns[f"observation.effort.{NAMES[0]}.effort"], TORQUE[TIME.size // 2 :, 0]
    )


@pytest.mark.parametrize("version", ["v2.1", "v3.0"])
def test_a_rate_that_is_not_that_of_the_stamps_is_a_question(tmp_path, version):
    folder = dataset(tmp_path / "set", version)
    assert propose(read_table(folder), arm()).mapping.undecided == ()
    info = json.loads((folder / "meta" / "info.json").read_text()) | {"fps": 125}
    (folder / "meta" / "info.json").write_text(json.dumps(info))
    (question,) = propose(read_table(folder), arm()).mapping.undecided
    assert "the format has 125 rows in a second, and the steps of timestamp make 250" in question
    assert "`factor: 2`" in question


def test_episodes_whose_files_are_missing_are_counted(tmp_path):
    folder = dataset(tmp_path / "set", "v2.1")
    info = json.loads((folder / "meta" / "info.json").read_text()) | {"total_episodes": 2}
    (folder / "meta" / "info.json").write_text(json.dumps(info))
    assert not any("says that there are" in note for note in read_table(folder).notes)
    (folder / "data" / "chunk-000" / "episode_000001.parquet").unlink()
    assert read_table(folder).notes == (
        "meta/info.json says that there are 2 episodes; the files here hold 1",
    )


def test_an_episode_that_is_not_there(tmp_path):
    with pytest.raises(RecordingError, match="no episode 7; it has 2, from 0 to 1"):
        read_table(dataset(tmp_path / "set", "v3.0"), episode=7)


def test_a_version_that_is_not_known(tmp_path):
    folder = dataset(tmp_path / "set", "v3.0")
    (folder / "meta" / "info.json").write_text('{"codebase_version": "v9"}')
    with pytest.raises(RecordingError, match="version 'v9' of LeRobotDataset, expected one of v2"):
        read_table(folder)
