"""Arrays of NumPy: which are columns, which name columns, and why others are not read."""

import zipfile

import numpy as np
import pytest
from logged import PERIOD, measured

from limo_driver.errors import RecordingError
from limo_driver.logs.readers.formats.reading import read_table

TIME, POSITION, _, _ = measured(2.0)


def test_arrays_of_numpy(tmp_path):
    images = np.zeros((len(TIME), 5000))
    np.savez(tmp_path / "log.npz", t=TIME, q=POSITION, dt=PERIOD, note=np.array(["a"]), i=images)
    read = read_table(tmp_path / "log.npz")
    np.testing.assert_array_equal(read.columns["q[2]"], POSITION[:, 2])
    assert read.unread.keys() == {"note", "i"}
    assert read.unread["i"] == "an array of shape (500, 5000)"


def test_why_arrays_of_numpy_are_not_read_is_said(tmp_path):
    short, texts = np.zeros((len(TIME) - 5, 3)), POSITION.astype(str)
    odd = np.array([{}, 1], dtype=object)
    np.savez(tmp_path / "log.npz", t=TIME, q=POSITION, tau=short, dq=texts, odd=odd)
    unread = read_table(tmp_path / "log.npz").unread
    assert unread["tau"] == f"an array of shape {short.shape} beside {len(TIME)} rows"
    assert unread["dq"] == "texts"
    assert unread["odd"] == "objects of Python"


@pytest.mark.parametrize("kind", [np.str_, np.bytes_])
def test_an_array_of_texts_names_the_columns_of_others(tmp_path, kind):
    names = np.array([f"arm_{k}" for k in range(7)]).astype(kind)
    path = tmp_path / "log.npz"
    np.savez(path, t=TIME, q=POSITION, wide=np.c_[POSITION, TIME], joint_names=names)
    table = read_table(path)
    np.testing.assert_array_equal(table.columns["q[arm_3]"], POSITION[:, 3])
    assert "wide[7]" in table.columns  # of which they are no names
    assert table.notes == ("joint_names names the columns of arrays as wide",)
    np.savez(path, t=TIME, q=POSITION, joint_names=names, units=np.full(7, "rad").astype(kind))
    assert "q[arm_3]" in read_table(path).columns  # texts that repeat are none
    np.savez(path, t=TIME, q=POSITION, joint_names=names, others=names[::-1])
    found = read_table(path)
    assert "q[3]" in found.columns  # two could be meant
    assert set(found.unread) == {"joint_names", "others"}


def test_arrays_that_are_packed_as_no_log_is_are_refused_unread(tmp_path):
    packed = zipfile.ZipFile(tmp_path / "log.npz", "w", zipfile.ZIP_DEFLATED, compresslevel=1)
    with packed, packed.open("q.npy", "w") as file:
        for _ in range(300):
            file.write(bytes(1 << 20))
    with pytest.raises(RecordingError, match=r"unpacks to 300 MiB or more, .* 256 MiB of a file"):
        read_table(tmp_path / "log.npz")


def test_numbers_that_nothing_measures_are_none(tmp_path):
    marked = POSITION.copy()
    marked[[3, 7], 2] = np.finfo(float).max, -1e200
    np.savez(tmp_path / "log.npz", t=TIME, q=marked)
    read = read_table(tmp_path / "log.npz")
    assert np.flatnonzero(np.isnan(read.columns["q[2]"])).tolist() == [3, 7]
    assert read.notes[-1] == "q[2] has 2 numbers beyond 1e+100, read as none"


@pytest.mark.parametrize("order", "<>")
def test_labels_of_characters_that_there_are_not_are_refused(tmp_path, order):
    names = np.full(7, 0x110000, order + "u4").view(order + "U1")
    np.savez(tmp_path / "log.npz", t=TIME, q=POSITION, names=names)
    with pytest.raises(RecordingError, match="characters that there are not"):
        read_table(tmp_path / "log.npz")
