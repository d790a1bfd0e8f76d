"""Delimited text: separators, encodings, lines of names, cells and rows that lack something."""

import gzip
import re

import numpy as np
import pytest
from logged import measured, numbered, written

from limo_driver.errors import RecordingError
from limo_driver.logs.readers.formats.reading import read_table

TIME, POSITION, _, TORQUE = measured(2.0)


def log():
    return {"t": TIME, **numbered("q{}", POSITION), **numbered("tau{}", TORQUE)}


@pytest.mark.parametrize("separator", [",", ";", "\t", " "])
def test_text_of_any_separator(tmp_path, separator):
    path = written(log(), tmp_path / "log.txt", separator, comment="# an iiwa\n\n")
    table = read_table(path)
    assert list(table.columns) == list(log())
    np.testing.assert_allclose(table.columns["q3"], POSITION[:, 3], rtol=1e-8)


@pytest.mark.parametrize(
    ("encoding", "note"),
    [("utf-8-sig", ""), ("utf-16", ""), ("utf-16-be", ""), ("cp1252", "taken for that of Windows")],
)
def test_text_of_any_encoding(tmp_path, encoding, note):
    text = "Zeit [ms];Winkel 1 [°]\n" + "".join(f"{k};{k},5\n" for k in range(3))
    path = tmp_path / "log.csv"
    mark = b"\xfe\xff" if encoding == "utf-16-be" else b""
    path.write_bytes(mark + text.encode(encoding))
    table = read_table(path)
    np.testing.assert_array_equal(table.columns["Winkel 1 [°]"], [0.5, 1.5, 2.5])
    assert note in " ".join(table.notes)
    assert bool(note) == bool(table.notes)


def test_text_that_is_packed(tmp_path):
    plain = written(log(), tmp_path / "log.csv")
    path = tmp_path / "log.csv.gz"
    path.write_bytes(gzip.compress(plain.read_bytes()))
    np.testing.assert_array_equal(read_table(path).columns["q3"], read_table(plain).columns["q3"])
    path.write_bytes(path.read_bytes()[:-4000])
    with pytest.raises(RecordingError, match=re.escape(str(path))) as refused:
        read_table(path)
    assert "\n" not in str(refused.value)


def test_text_with_decimal_commas(tmp_path):
    path = tmp_path / "log.csv"
    path.write_text("t;q0\n0,0;1,5\n0,1;-2,5e-1\n", encoding="utf-8")
    np.testing.assert_array_equal(read_table(path).columns["q0"], [1.5, -0.25])


@pytest.mark.parametrize("cell", ["", "None", "NaN", "null", "#N/A"])
def test_cells_without_a_value_are_no_text(tmp_path, cell):
    path = tmp_path / "log.csv"
    path.write_text(f"t,q0\n0.0,1.5\n0.1,{cell}\n0.2,2.5\n", encoding="utf-8")
    np.testing.assert_array_equal(read_table(path).columns["q0"], [1.5, np.nan, 2.5])


def test_text_whose_names_stand_in_a_comment(tmp_path):
    path = tmp_path / "log.dat"
    path.write_text("# t q0\n0 1\n1 2\n", encoding="utf-8")
    assert list(read_table(path).columns) == ["t", "q0"]


def test_text_without_names(tmp_path):
    path = tmp_path / "log.csv"
    path.write_text("0,1\n1,2\n", encoding="utf-8")
    table = read_table(path)
    assert list(table.columns) == ["column_1", "column_2"]
    assert "no line of names" in table.notes[0]
    assert table.rows == 2


def test_a_column_of_words_is_named_as_unread(tmp_path):
    path = tmp_path / "log.csv"
    path.write_text("t,mode\n0,idle\n1,move\n", encoding="utf-8")
    assert read_table(path).unread == {"mode": "string"}


def test_a_row_that_is_cut_off_is_left_out_and_told(tmp_path):
    path = written(log(), tmp_path / "log.csv")
    text = path.read_text()
    path.write_text(text[: len(text) - 40])
    table = read_table(path)
    assert table.rows == TIME.size - 1
    assert "1 row left out: another number of cells than the 15 of the first line" in table.notes[0]


def test_rows_that_are_cut_off_are_not_counted_without_end(tmp_path):
    path = tmp_path / "log.csv"
    path.write_text('t,q0,q1\n0,1,2\n"' + "1,2\n" * 300_000, encoding="utf-8")
    with pytest.raises(RecordingError, match="has 4001 rows with another number of cells"):
        read_table(path)


def test_many_rows_that_are_cut_off_are_refused(tmp_path):
    path = tmp_path / "log.csv"
    path.write_text("t,q0\n" + "0,1\n" * 20 + "0\n" * 5, encoding="utf-8")
    said = "has 5 rows with another number of cells, expected 2 as in its first line$"
    with pytest.raises(RecordingError, match=said):
        read_table(path)
