"""Of many rows, evenly spread stretches are kept, however the rows come."""

import numpy as np
import pyarrow as pa
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pyarrow import csv

from limo_driver.recordings.files.batches import Stretches, blocks_of, kept_of, text_batches
from limo_driver.recordings.recording import Recording


@given(
    st.lists(st.integers(0, 60), max_size=30),
    st.integers(1, 12),
    st.integers(1, 8),
)
def test_what_is_kept_is_spread_evenly_and_never_too_much(sizes, rows, many):
    stretches = Stretches[np.ndarray](lambda piece, a, b: piece[a:b], most=rows * many, rows=rows)
    start = 0
    for size in sizes:
        stretches.add(np.arange(start, start + size), size)
        start += size
    kept = np.concatenate([np.zeros(0, int), *stretches.pieces()])
    assert stretches.total == start
    assert kept.size <= rows * many
    numbers = np.unique(kept // rows)
    whole = [k * rows + r for k in numbers for r in range(rows)]
    assert kept.tolist() == [row for row in whole if row < start]
    if start <= rows * many:
        assert kept.size == start
        assert not stretches.note()
    else:
        assert numbers.tolist() == list(range(0, numbers[-1] + 1, max(1, numbers[:2].max())))
        assert kept.size >= (rows * many) // 2 - 2 * rows
        assert f"of {start} rows" in stretches.note()


@given(st.lists(st.integers(0, 50), max_size=20), st.integers(1, 40))
def test_blocks_are_all_rows_in_order_and_the_last_is_no_rest(sizes, rows):
    schema = pa.schema([("x", pa.int64())])
    starts = np.cumsum([0, *sizes])
    batches = [
        pa.record_batch({"x": np.arange(a, a + size)}, schema)
        for a, size in zip(starts, sizes, strict=False)
    ]
    blocks = list(blocks_of(batches, schema, rows))
    found = [x for block in blocks for x in block["x"].to_pylist()]
    assert found == list(range(sum(sizes)))
    assert all(block.num_rows == rows for block in blocks[:-1])
    if len(blocks) > 1:
        assert rows <= blocks[-1].num_rows < 2 * rows


def test_numbers_of_text_may_become_fractions_late_and_counters_stay_whole(tmp_path):
    path = tmp_path / "log.csv"
    stamps = 1_700_000_000_000_000_000 + np.arange(200_000) * 1_000_003
    late = np.where(np.arange(200_000) < 150_000, 0, 0.5)
    csv.write_csv(pa.table({"stamp": stamps, "late": late}), path)
    kept = kept_of(*text_batches(path))
    assert kept.table["stamp"].to_numpy().tolist() == stamps.tolist()
    assert kept.table["late"].to_numpy().tolist() == late.tolist()


def test_a_recording_of_at_most_so_many_samples_says_so():
    time = 0.01 * np.arange(200_000)
    position = np.sin(time)[:, None]
    recording = Recording.from_arrays(time, position, np.cos(time)[:, None] * 3)
    assert recording.at_most(200_000) is recording
    short = recording.at_most(100_000)
    assert len(short) <= 100_000
    assert short.spread == 200_000
    assert "of 200000 rows" in short.warnings[-1]
    assert len(short.segments) == len(short) // 2_500  # of 25 s
    kept = np.isin(recording.time, short.time)
    assert recording.position[kept].tolist() == short.position.tolist()


@pytest.mark.parametrize("text", ["time,x\n1,a\n", "time,x\n"])
def test_text_that_ends_soon(tmp_path, text):
    path = tmp_path / "log.csv"
    path.write_text(text, encoding="utf-8")
    assert kept_of(*text_batches(path)).table.num_rows == text.count("\n") - 1
