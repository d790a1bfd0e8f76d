"""Parquet of structures, lists of them, and texts that name the entries of lists."""

from decimal import Decimal

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from logged import arm, measured

import limo_driver as limo
from limo_driver.errors import RecordingError
from limo_driver.logs.readers.formats.reading import read_table

TIME, POSITION, _, TORQUE = measured(2.0)
NAMES = arm().joint_names
MIXED = [4, 2, 0, 6, 1, 3, 5]


def table_of(path, rows):
    pq.write_table(pa.Table.from_pylist(rows), path, row_group_size=100)
    return read_table(path)


def stamped(**fields):
    """Rows of messages as ROS has them: seconds, and the rest in nanoseconds."""
    return [
        {"stamp": {"sec": 1_700_000_000 + int(t), "nanosec": round(t % 1 * 1e9)}} | {
            name: of(k) for name, of in fields.items()
        }
        for k, t in enumerate(TIME.tolist())
    ]  # fmt: skip


def is_read(path):
    recording = limo.read(path, "iiwa14")
    np.testing.assert_allclose(recording.time - recording.time[0], TIME, atol=1e-7)
    np.testing.assert_allclose(recording.position, POSITION)
    np.testing.assert_allclose(recording.torque, TORQUE)


def test_a_structure_of_lists(tmp_path):
    state = lambda k: {"q": POSITION[k].tolist(), "tau": TORQUE[k].tolist()}  # noqa: E731
    found = table_of(tmp_path / "log.parquet", stamped(state=state))
    assert found.unread == {}
    assert "state.q[6]" in found.columns
    is_read(tmp_path / "log.parquet")


def test_names_in_each_row_name_the_entries(tmp_path):
    names = ["gripper", *(NAMES[j] for j in MIXED)]
    rows = stamped(
        name=lambda _: names,
        position=lambda k: [0.02, *POSITION[k, MIXED].tolist()],
        velocity=lambda _: [],
        effort=lambda k: [0.0, *TORQUE[k, MIXED].tolist()],
    )
    found = table_of(tmp_path / "log.parquet", rows)
    assert found.unread == {"velocity": "empty lists"}
    assert "position.gripper" in found.columns
    is_read(tmp_path / "log.parquet")


def test_texts_of_one_structure_do_not_name_what_is_beside_it(tmp_path):
    rows = stamped(
        left=lambda k: {"name": list(NAMES), "q": POSITION[k].tolist()},
        right=lambda k: {"q": TORQUE[k].tolist()},
    )
    columns = table_of(tmp_path / "log.parquet", rows).columns
    assert {"left.q.joint1", "right.q[0]"} <= columns.keys()


def test_lists_of_structures(tmp_path):
    def joints(k):
        return [
            {"name": name, "q": q, "tau": tau}
            for name, q, tau in zip(NAMES, POSITION[k].tolist(), TORQUE[k].tolist(), strict=True)
        ]

    assert "joints.q.joint7" in table_of(tmp_path / "log.parquet", stamped(joints=joints)).columns
    is_read(tmp_path / "log.parquet")


def test_lists_of_structures_that_come_and_go_are_said(tmp_path):
    rows = stamped(joints=lambda k: [{"q": 1.0}] * (1 + k % 2), none=lambda _: None)
    found = table_of(tmp_path / "log.parquet", rows)
    assert "of different lengths" in found.unread["joints.q"]


def test_a_structure_for_each_joint_with_numbers_as_text_or_decimals(tmp_path):
    rows = [
        {"t": t}
        | {
            name: {"pos": f"{POSITION[k, j]:.12f}", "tau": Decimal(f"{TORQUE[k, j]:.12f}")}
            for j, name in enumerate(NAMES)
        }
        for k, t in enumerate(TIME.tolist())
    ]
    table_of(tmp_path / "log.parquet", rows)
    is_read(tmp_path / "log.parquet")


def test_text_among_such_numbers_is_refused_with_its_row(tmp_path):
    rows = [{"t": t, "q0": "lost" if k == 7 else "1.5"} for k, t in enumerate(TIME.tolist())]
    with pytest.raises(RecordingError, match=r"q0 holds text in 1 of 500 cells; row 7 is 'lost'"):
        table_of(tmp_path / "log.parquet", rows)


def test_lists_in_parquet_are_columns(tmp_path):
    table = pa.table({"t": TIME, "state": list(POSITION), "odd": [[0.0]] * 499 + [[0.0, 1.0]]})
    pq.write_table(table, tmp_path / "log.parquet")
    read = read_table(tmp_path / "log.parquet")
    np.testing.assert_array_equal(read.columns["state[6]"], POSITION[:, 6])
    assert "different lengths" in read.unread["odd"]


@pytest.mark.parametrize("from_row", [1, 250])
def test_names_in_another_order_from_row_to_row_name_the_entries_of_their_row(tmp_path, from_row):
    order = lambda k: MIXED if k % 3 == 1 or k >= from_row else list(range(7))  # noqa: E731
    rows = stamped(
        name=lambda k: [NAMES[j] for j in order(k)],
        position=lambda k: POSITION[k, order(k)].tolist(),
        effort=lambda k: TORQUE[k, order(k)].tolist(),
    )
    table_of(tmp_path / "log.parquet", rows)
    is_read(tmp_path / "log.parquet")


def test_names_that_become_those_of_other_joints_are_refused(tmp_path):
    rows = stamped(
        name=lambda k: [*NAMES[:6], "tool" if k == 250 else NAMES[6]],
        position=lambda k: POSITION[k].tolist(),
        effort=lambda k: TORQUE[k].tolist(),
    )
    with pytest.raises(RecordingError, match="name names other joints from row 250 on"):
        table_of(tmp_path / "log.parquet", rows)
