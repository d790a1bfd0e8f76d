"""What a row of Parquet takes is known before rows are read, whichever of them is the widest."""

import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from limo_driver.recordings.files.parquet import parquet_rows

ROWS = 1000


@pytest.mark.parametrize("first", [[], [0.0]], ids=["an empty list", "one number"])
@pytest.mark.parametrize(("numbers", "is_read"), [(100, True), (10_000, False)])
@pytest.mark.parametrize("nested", [False, True], ids=["lists", "lists in a structure"])
def test_lists_that_are_longer_than_the_first_count_as_they_are(
    tmp_path, first, numbers, is_read, nested
):
    lists = [first, *([[0.0] * numbers] * (ROWS - 1))]
    column = pa.array([{"in": one} for one in lists] if nested else lists)
    path = tmp_path / "log.parquet"
    pq.write_table(pa.table({"t": [0.01 * k for k in range(ROWS)], "values": column}), path)
    rows = parquet_rows(path)
    assert rows.schema.names == (["t", "values"] if is_read else ["t"])
    assert ("values" in rows.aside) is not is_read
    if is_read:
        assert 8 * numbers <= rows.width <= 10 * numbers
    assert sum(batch.num_rows for batch in rows.batches) == ROWS
