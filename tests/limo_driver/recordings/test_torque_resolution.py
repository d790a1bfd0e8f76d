"""The step of each joint's torque goes from the robot to whoever reads the recording."""

import numpy as np
import pytest

from limo_driver.recordings.files.recorder import Recorder
from limo_driver.recordings.recording import Recording
from limo_driver.types import JointState

STEPS = [0.32, 0.04]


def recorded(path, header):
    with Recorder(path, 2, header) as recorder:
        for k in range(900):
            values = np.array([0.001 * k, -0.001 * k])
            recorder.append(JointState(k * 1e-3, values, values, values, k), values)
    return Recording.load(path)


def test_recording_knows_it_and_keeps_it(tmp_path):
    recording = recorded(tmp_path / "run.parquet", {"robot": "two", "torque_resolution": STEPS})
    assert recording.torque_resolution == pytest.approx(STEPS)
    part = recording[:700]
    part.save(tmp_path / "part.parquet")
    assert Recording.load(tmp_path / "part.parquet").torque_resolution == pytest.approx(STEPS)


@pytest.mark.parametrize("said", [None, "fine", [0.1], [0.1, -1.0], [0.1, float("nan")], {"a": 1}])
def test_what_cannot_be_so_is_not_known(tmp_path, said):
    recording = recorded(tmp_path / "run.parquet", {"robot": "two", "torque_resolution": said})
    assert recording.torque_resolution is None
    assert recording.robot == "two"
