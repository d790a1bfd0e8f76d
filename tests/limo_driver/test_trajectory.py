"""Between samples a trajectory is the quintic through both neighbours."""

from __future__ import annotations

import json

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from limo_driver.errors import ConfigError, PathError
from limo_driver.trajectory import Segment, Trajectory

C = np.random.default_rng(0).uniform(-1, 1, (6, 2))  # two joints, each one quintic in time


def _quintic(time, order=0):
    return np.stack([np.polynomial.Polynomial(c).deriv(order)(time) for c in C.T], axis=1)


@pytest.fixture
def trajectory():
    time = 3.0 + np.array([0.0, 0.3, 0.35, 0.8, 1.0])  # neither uniform nor from 0
    motion = (_quintic(time - 3.0, order) for order in range(3))
    return Trajectory(time, *motion, robot="arm", segments=(Segment("reaching", 0, 5),))


def test_a_quintic_is_reproduced(trajectory):
    time = np.linspace(0, 1, 301)
    motion = trajectory.evaluate(time)
    np.testing.assert_allclose(motion.position, _quintic(time), atol=1e-12)
    np.testing.assert_allclose(motion.velocity, _quintic(time, 1), atol=1e-11)
    np.testing.assert_allclose(motion.acceleration, _quintic(time, 2), atol=1e-9)


def test_resampling_ends_on_the_last_sample(trajectory):
    motion = trajectory.resample(0.03)
    assert motion.time[-1] == trajectory.duration
    np.testing.assert_allclose(motion.position[-1], trajectory.position[-1])


def test_the_beginning_keeps_the_segments_that_it_holds(trajectory):
    found = trajectory.first(0.35)
    assert found.duration == pytest.approx(0.35)
    assert found.segments == (Segment("reaching", 0, 3),)
    np.testing.assert_array_equal(trajectory.first(9.0).position, trajectory.position)
    with pytest.raises(ConfigError, match=r"0\.2 s is shorter than one sample"):
        trajectory.first(0.2)


def test_peaks_are_the_largest_values_between_samples(trajectory):
    fine = np.linspace(0, 1, 100_001)
    peaks = trajectory.peaks()
    for order, name in enumerate(("velocity", "acceleration", "jerk"), start=1):
        true = np.abs(_quintic(fine, order)).max(axis=0)
        tolerance = 5e-3 if name == "velocity" else 1e-6  # velocity is taken at nine points
        np.testing.assert_allclose(getattr(peaks, name), true, rtol=tolerance)


def test_time_outside_is_refused(trajectory):
    with pytest.raises(PathError, match=r"outside the trajectory \(0 to 1 s\)"):
        trajectory.evaluate(np.array([0.5, 1.5]))


def test_file_keeps_everything(trajectory, tmp_path):
    trajectory.save(tmp_path / "t.parquet")
    loaded = Trajectory.load(tmp_path / "t.parquet")
    for name in ("time", "position", "velocity", "acceleration"):
        np.testing.assert_array_equal(getattr(loaded, name), getattr(trajectory, name))
    assert (loaded.robot, loaded.segments) == ("arm", trajectory.segments)


def test_a_file_that_is_no_trajectory_is_refused(tmp_path):
    (tmp_path / "t.parquet").write_text("no parquet")
    with pytest.raises(ConfigError, match="cannot be read as a trajectory"):
        Trajectory.load(tmp_path / "t.parquet")


BROKEN = [
    ({"time": [0.0, np.nan, 2.0]}, "time is nan in row 1"),
    ({"time": [0.0, None, 2.0]}, "time is nan in row 1"),
    ({"time": [0.0, 1.0, 1.0]}, "time goes from 1 to 1 s in row 2"),
    ({"time": [0.0, 2.0, 1.0]}, "time goes from 2 to 1 s in row 2"),
    ({"time": [0.0, 1.0, 1e12]}, "expected a step above 0 and up to 10 s"),
    ({"time": ["0", "1", "2"]}, "column time holds string, expected numbers"),
    ({"position_1": ["a", "b", "c"]}, "column position_1 holds string, expected numbers"),
    ({"position_2": [0.0, 0.0, np.nan]}, "position_2 is nan in row 2"),
    ({"velocity_1": [0.0, np.inf, 0.0]}, "velocity_1 is inf in row 1"),
    ({"acceleration_1": [1e300, 0.0, 0.0]}, r"acceleration_1 is 1e\+300 in row 0"),
    ({"acceleration_2": None}, "lacks acceleration_2"),
]


def table_of(rows=3, joints=2):
    names = [
        f"{q}_{j + 1}" for q in ("position", "velocity", "acceleration") for j in range(joints)
    ]
    return {"time": np.arange(float(rows)).tolist()} | {name: [0.0] * rows for name in names}


def written(path, columns, header=b"{}"):
    table = pa.table(
        {
            name: pa.array(values, None if values else pa.float64())
            for name, values in columns.items()
            if values is not None
        }
    )
    pq.write_table(table.replace_schema_metadata({b"limo.trajectory": header}), path)
    return path


@pytest.mark.parametrize(("change", "message"), BROKEN)
def test_values_that_make_no_motion_are_refused(tmp_path, change, message):
    path = written(tmp_path / "t.parquet", table_of() | change)
    with pytest.raises(ConfigError, match=rf"t\.parquet: .*{message}"):
        Trajectory.load(path)


@pytest.mark.parametrize(
    ("rows", "joints", "message"),
    [(0, 2, "holds 0 samples"), (1, 2, "holds 1 samples"), (3, 0, "lacks position_1")],
)
def test_too_little_is_refused(tmp_path, rows, joints, message):
    with pytest.raises(ConfigError, match=rf"t\.parquet: .*{message}"):
        Trajectory.load(written(tmp_path / "t.parquet", table_of(rows, joints)))


@pytest.mark.parametrize(
    "header",
    [b"{", b"[]", b"\xff", b"null", b'{"robot": 3}', b'{"segments": 3}', b'{"segments": [[1]]}',
     b'{"segments": [["a", 0.5, 2]]}', b'{"segments": [[null, 0, 2]]}', b'{"segments": null}'],
)  # fmt: skip
def test_a_header_that_cannot_be_read_is_refused(tmp_path, header):
    with pytest.raises(
        ConfigError, match=r"t\.parquet: its header limo\.trajectory cannot be read"
    ):
        Trajectory.load(written(tmp_path / "t.parquet", table_of(), header))


@pytest.mark.parametrize("span", [(-1, 2), (0, 4), (2, 2), (2, 1)])
def test_a_segment_beyond_the_samples_is_refused(tmp_path, span):
    header = json.dumps({"segments": [["exploring", *span]]}).encode()
    with pytest.raises(ConfigError, match=r"segment 'exploring' spans samples .* of 0 to 3"):
        Trajectory.load(written(tmp_path / "t.parquet", table_of(), header))


def test_integer_columns_are_numbers(tmp_path):
    path = written(tmp_path / "t.parquet", table_of() | {"time": [0, 1, 2]})
    assert Trajectory.load(path).duration == 2.0


def test_longer_than_a_shift_is_refused():
    time = np.arange(0.0, 8 * 3600.0 + 20.0, 10.0)
    rest = np.zeros((time.size, 1))
    with pytest.raises(ConfigError, match="lasts 28810 s, expected up to 28800 s"):
        Trajectory(time, rest, rest, rest)
