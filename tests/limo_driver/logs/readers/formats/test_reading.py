"""What is damaged, or of other types than a log has: refused in one line, whatever the format."""

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from logged import arm, measured, numbered, written

from limo_driver.errors import RecordingError
from limo_driver.logs.readers.formats.reading import read_table
from limo_driver.logs.readers.proposals.proposal import propose

TIME, POSITION, _, _ = measured(2.0)
DAMAGED = [
    ("log.csv", b"", "holds no rows"),
    ("log.csv", b"t,q0,q1,ta", "ends in its first line"),
    ("log.csv", b"\x00\x01\xff\xfe" * 50, "is no text"),
    ("log.csv", b"t,t\n0,1\n", "more than one column t"),
    ("log.csv", b"t,q0\n" + b"0,1\n" * 90 + b"x,1\n", "column t holds text in 1 of 91.* row 90"),
    ("log.parquet", b"PAR1 and no more", "cannot be read as Parquet"),
    ("log.npz", b"PK\x03\x04 and no more", "cannot be read as .npz"),
    ("log.mcap", b"no bag", "is no MCAP file"),
    ("log.db3", b"no bag", "is no SQLite file"),
    ("log.docx", b"any", "of a kind that is not known, expected delimited text"),
    ("log.xlsx", b"any", "is a workbook, which is not read: save its sheet as CSV"),
    (
        "log.npz",
        b"version https://git-lfs.github.com/spec/v1\noid sha256:0\n",
        "pointer of Git LFS",
    ),
]


@pytest.mark.parametrize(("name", "content", "said"), DAMAGED)
def test_what_is_damaged_is_refused_in_one_line(tmp_path, name, content, said):
    path = tmp_path / name
    path.write_bytes(content)
    with pytest.raises(RecordingError, match=said) as refused:
        read_table(path)
    assert str(path) in str(refused.value)
    assert "\n" not in str(refused.value)


class Trap:
    """Runs code where it is read back from a pickle."""

    def __reduce__(self):
        return (pytest.fail, ("a pickle was opened",))


def words(folder):
    names = [f"q{j}" for j in range(7)]
    pq.write_table(pa.table({"t": TIME} | {n: ["a"] * TIME.size for n in names}), folder / "l.pq")
    return folder / "l.pq"


def pickled(folder):
    trap = np.empty(TIME.size, dtype=object)
    trap[:] = Trap()
    np.savez(folder / "l.npz", t=TIME, q=trap)
    return folder / "l.npz"


def text_for_numbers(folder):
    path = written({"t": TIME, **numbered("q{}", POSITION)}, folder / "l.csv")
    path.write_text(path.read_text().replace("\n0", "\nzero", 1))
    return path


@pytest.mark.parametrize(
    ("make", "said"),
    [
        (words, "has no positions of the 7 joints"),
        (pickled, "has no positions of the 7 joints|cannot be read as .npz"),
        (text_for_numbers, "column t holds text in 1 of 500"),
    ],
)
def test_wrong_types_are_refused_in_one_line(tmp_path, make, said):
    with pytest.raises(RecordingError, match=said) as refused:
        propose(read_table(make(tmp_path)), arm())
    assert "\n" not in str(refused.value)
