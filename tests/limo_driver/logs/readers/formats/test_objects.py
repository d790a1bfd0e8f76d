"""Logs as objects: records and arrays of JSON, variables of MATLAB."""

import json

import numpy as np
import pytest
from logged import measured
from scipy.io import savemat

import limo_driver as limo
from limo_driver.errors import RecordingError
from limo_driver.logs.readers.formats import arrays
from limo_driver.logs.readers.formats.reading import read_table

TIME, POSITION, VELOCITY, TORQUE = measured(8.0)
RECORDS = [
    {"time": t, "position": q, "velocity": v, "effort": tau}
    for t, q, v, tau in zip(
        TIME.tolist(), POSITION.tolist(), VELOCITY.tolist(), TORQUE.tolist(), strict=True
    )
]


@pytest.fixture
def log(tmp_path):
    def write(content, name="log.json"):
        text = content if isinstance(content, str) else json.dumps(content)
        (tmp_path / name).write_text(text, encoding="utf-8")
        return tmp_path / name

    return write


@pytest.mark.parametrize(
    "content",
    [
        RECORDS,
        "\n".join(json.dumps(record) for record in RECORDS),
        {"robot": "arm", "gains": [1, 2], "entries": RECORDS},
        {"data": {"time": TIME.tolist(), "position": POSITION.tolist(), "effort": TORQUE.tolist()}},
        {"time": TIME.tolist(), "position": POSITION.T.tolist(), "effort": TORQUE.T.tolist()},
    ],
    ids=["records", "lines", "records in an object", "arrays", "arrays by joint"],
)
def test_a_log_of_json_is_read_whatever_its_form(log, content):
    read = limo.read(log(content), "iiwa14")
    np.testing.assert_array_equal(read.position, POSITION)
    np.testing.assert_array_equal(read.torque, TORQUE)
    np.testing.assert_allclose(read.time, TIME)


def test_what_records_hold_inside_is_named_by_both(log):
    inside = [{"t": k, "state": {"q": [1.0, k]}, "say": "x"} for k in range(4)]
    read = read_table(log([*inside, {"t": 4, "state": {"q": [1.0, None]}}]))
    assert set(read.columns) == {"t", "state.q[0]", "state.q[1]"}
    assert np.isnan(read.columns["state.q[1]"][-1])
    assert read.unread == {"say": "string"}


@pytest.mark.parametrize(
    ("content", "said"),
    [
        (json.dumps(RECORDS)[:-700], "is no JSON at line 1: .* was it cut off"),
        ('{"t": 0, "q": 1}\n{"t": 1, "q": 2}\n{"t": 2, "q"', "is no JSON at line 3: "),
        ('{"t": 0} {"t": 1}', "is no JSON at line 1: Extra data"),
        ([1.0, 2.0], "holds no records, expected"),
        ([{"q": 1.0}, {"q": "much"}], "its 2 records are not alike"),
        ("[" * 100_000, "nested far deeper than a log"),
    ],
)
def test_json_that_is_no_log_is_refused_in_one_line(log, content, said):
    with pytest.raises(RecordingError, match=said) as refused:
        read_table(log(content))
    assert "\n" not in str(refused.value)


def test_json_too_large_to_be_read_at_once_is_refused(log, monkeypatch):
    monkeypatch.setattr(arrays, "_LARGEST", 100)
    with pytest.raises(RecordingError, match=r"has .* bytes, expected at most 100"):
        read_table(log(RECORDS))


@pytest.mark.parametrize("packed", [False, True])
@pytest.mark.parametrize("turned", [False, True], ids=["rows", "columns"])
def test_variables_of_matlab_and_their_structures_are_read(tmp_path, turned, packed):
    q, tau = (values.T if turned else values for values in (POSITION, TORQUE))
    state = {"t": TIME if turned else TIME[:, None], "q": q, "tau": tau, "note": "free"}
    savemat(tmp_path / "log.mat", {"run": state, "dt": 0.004}, do_compression=packed)
    read = limo.read(tmp_path / "log.mat", "iiwa14")
    np.testing.assert_array_equal(read.position, POSITION)
    np.testing.assert_array_equal(read.torque, TORQUE)


def test_many_small_matrices_do_not_hide_samples_that_are_columns(tmp_path):
    own = {f"M{k}": np.eye(6) for k in range(9)}
    savemat(tmp_path / "log.mat", {"t": TIME, "q": POSITION.T, "tau": TORQUE.T} | own)
    read = limo.read(tmp_path / "log.mat", "iiwa14")
    np.testing.assert_array_equal(read.position, POSITION)


@pytest.mark.parametrize(
    ("content", "said"),
    [
        (b"MATLAB 7.3 MAT-file, Platform: x".ljust(124) + b"\x00\x02IM", "cannot be read as HDF5"),
        (b"nothing of the kind" * 20, "cannot be read as .mat"),
    ],
)
def test_files_that_are_no_variables_of_matlab_are_refused_in_one_line(tmp_path, content, said):
    (tmp_path / "log.mat").write_bytes(content)
    with pytest.raises(RecordingError, match=said) as refused:
        read_table(tmp_path / "log.mat")
    assert "\n" not in str(refused.value)
