"""Commands as a LeRobotDataset, and LeRobotDatasets of commands and positions as recordings."""

from __future__ import annotations

import json

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

import limo_driver as limo
from limo_driver.errors import ConfigError, RecordingError
from limo_driver.logs.readers.formats.lerobot import write_actions
from limo_driver.logs.readers.formats.reading import read_table

FPS, ROWS = 50, 600
NAMES = ("turn", "lift")
TIME = np.arange(ROWS) / FPS
COMMAND = np.stack([1.3 * np.sin(1.1 * TIME), 0.9 * np.sin(1.7 * TIME)], axis=1)
ARM = """<mujoco model="pan tilt"><compiler angle="radian" autolimits="true"/><worldbody>
  <body><joint name="turn" axis="0 0 1" range="-2 2"/><geom size=".05" mass="1"/>
    <body><joint name="lift" axis="0 1 0" range="-2 2"/><geom size=".05" pos=".2 0 0" mass="1"/>
    </body>
  </body>
</worldbody></mujoco>"""


@pytest.fixture
def arm(tmp_path):
    (tmp_path / "arm.xml").write_text(ARM)
    return tmp_path / "arm.xml"


def recorded(folder, scale=57.29578, names=NAMES, gripper=False):
    """Write what LeRobot records of an arm that is 60 ms late."""
    late = np.concatenate([COMMAND[:1].repeat(3, axis=0), COMMAND[:-3]])
    motors = [f"{name}.pos" for name in (*names, *(["gripper"] if gripper else []))]
    more = [np.full((ROWS, 1), 30.0)] if gripper else []
    columns = {
        "action": list(np.hstack([scale * COMMAND, *more]).astype(np.float32)),
        "observation.state": list(np.hstack([scale * late, *more]).astype(np.float32)),
        "timestamp": TIME,
        "episode_index": np.zeros(ROWS, dtype=np.int64),
    }
    features = {key: {"names": motors} for key in ("action", "observation.state")}
    (folder / "meta").mkdir(parents=True)
    (folder / "data" / "chunk-000").mkdir(parents=True)
    info = {"codebase_version": "v3.0", "fps": FPS, "features": features}
    (folder / "meta" / "info.json").write_text(json.dumps(info))
    pq.write_table(pa.table(columns), folder / "data" / "chunk-000" / "file-000.parquet")
    return folder


def test_episodes_hold_goals_in_degrees(tmp_path):
    write_actions(tmp_path / "set", COMMAND, [slice(0, 200), slice(200, ROWS)], NAMES, FPS)

    table = read_table(tmp_path / "set")

    read = np.stack([table.columns[f"action.{name}.pos"] for name in NAMES], axis=1)
    np.testing.assert_allclose(np.radians(read), COMMAND, atol=1e-6)
    assert np.bincount(table.columns["episode_index"]).tolist() == [200, 400]
    info = json.loads((tmp_path / "set" / "meta" / "info.json").read_text())
    assert (info["total_episodes"], info["total_frames"], info["fps"]) == (2, ROWS, FPS)
    listed = pq.read_table(tmp_path / "set" / "meta" / "episodes").to_pydict()
    assert listed["dataset_from_index"] == [0, 200]
    assert listed["length"] == [200, 400]


def test_a_gripper_is_counted_in_percent_of_its_range(tmp_path):
    ends = [(-2.0, 2.0), (-0.5, 1.5)]
    motors = ("turn", "gripper")
    write_actions(tmp_path / "set", COMMAND, [slice(0, ROWS)], motors, FPS, ranges=ends)

    table = read_table(tmp_path / "set")

    np.testing.assert_allclose(
        table.columns["action.gripper.pos"], 50 * (COMMAND[:, 1] + 0.5), rtol=1e-5
    )
    with pytest.raises(ConfigError, match="gripper has no range"):
        write_actions(tmp_path / "other", COMMAND, [slice(0, ROWS)], motors, FPS)


def test_a_folder_that_holds_something_is_kept(tmp_path):
    (tmp_path / "precious").touch()
    with pytest.raises(ConfigError, match="holds something"):
        write_actions(tmp_path, COMMAND, [slice(0, ROWS)], NAMES, FPS)


def test_parts_of_a_frame_are_not_played(tmp_path):
    with pytest.raises(ConfigError, match=r"whole numbers .* 12\.5 given"):
        write_actions(tmp_path / "set", COMMAND, [slice(0, ROWS)], NAMES, 12.5)


def test_actions_are_the_commands_of_a_recording(tmp_path, arm):
    folder = recorded(tmp_path / "set", gripper=True)

    asked = limo.inspect(folder, arm)
    recording = limo.read(folder, arm, decided(asked.mapping))

    np.testing.assert_allclose(recording.command, COMMAND, atol=1e-5)
    assert not recording.has_torque
    assert "action.gripper.pos" in asked.mapping.left_out


def test_what_may_be_normalised_is_asked(tmp_path, arm):
    asked = limo.inspect(recorded(tmp_path / "set"), arm)

    assert any("normalised to the calibrated range" in text for text in asked.questions)
    with pytest.raises(ConfigError, match="normalised"):
        limo.read(tmp_path / "set", arm)


def test_what_goes_beyond_a_hundred_is_in_degrees(tmp_path, arm):
    asked = limo.inspect(recorded(tmp_path / "set", scale=80.0), arm)

    assert not any("normalised" in text for text in asked.questions)


def test_normalised_values_are_read_with_a_factor(tmp_path, arm):
    folder = recorded(tmp_path / "set", scale=100.0 / 1.5)  # a range of 1.5 rad to either side
    mapping = decided(limo.inspect(folder, arm).mapping).save
    mapping(tmp_path / "mapping.yaml")
    text = (tmp_path / "mapping.yaml").read_text()
    text = text.replace("unit: deg", f"unit: deg\n  factor: {np.degrees(1.5) / 100.0}")
    (tmp_path / "mapping.yaml").write_text(text)

    recording = limo.read(folder, arm, tmp_path / "mapping.yaml")

    np.testing.assert_allclose(recording.command, COMMAND, atol=1e-4)


def test_commands_that_lack_a_joint_are_told(arm):
    log = {"t": TIME, "turn.pos": COMMAND[:, 0], "lift.pos": COMMAND[:, 1]}
    log["goal.turn.pos"] = COMMAND[:, 0]

    with pytest.raises(RecordingError, match=r"set-points of all joints: .* lacks lift"):
        limo.read(log, arm)


def decided(mapping):
    """Return a mapping whose questions are answered as proposed."""
    return limo.LogMapping(
        **{name: getattr(mapping, name) for name in mapping.__dataclass_fields__}
        | {"undecided": ()}
    )
