"""Text as people's own tools write it: lines above the names, units below, times of day."""

import numpy as np
import pytest
from logged import arm, measured

import limo_driver as limo
from limo_driver.errors import RecordingError
from limo_driver.logs.readers.formats.reading import read_table
from limo_driver.logs.readers.proposals.proposal import propose
from limo_driver.recordings.files import delimited
from limo_driver.recordings.files.delimited import dialect_of

TIME, POSITION, VELOCITY, TORQUE = (every[::8] for every in measured(16.0))
ABOVE = "Recorder 3.1\nRobot: iiwa, cell 4\n\nOperator: nobody\n"


def clock(seconds):
    """A time of day, with fractions."""
    whole = 23 * 3600 + 59 * 60 + 59 + seconds
    hours, rest = divmod(whole, 3600)
    return f"{int(hours) % 24:02d}:{int(rest // 60):02d}:{rest % 60:06.3f}"


def log(path, above="", units=None, separator=",", times=None, decimal="."):
    """Write a log of an iiwa in degrees."""
    names = ["time", *(f"q{j}" for j in range(1, 8)), *(f"tau{j}" for j in range(1, 8))]
    lines = [separator.join(names)]
    if units is not None:
        lines.append(separator.join(units))
    rows = np.column_stack([np.rad2deg(POSITION), TORQUE])
    for k, row in enumerate(rows):
        cells = [f"{TIME[k]:.4f}" if times is None else times[k], *(f"{x:.7f}" for x in row)]
        lines.append(separator.join(cells).replace(".", decimal))
    path.write_text(above + "\n".join(lines) + "\n", encoding="utf-8")
    return path


def read(path):
    """Table and columns, with nothing left open."""
    table = read_table(path, joints=arm().joint_names)
    mapping = propose(table, arm()).mapping
    assert [q for q in mapping.undecided if "do not name joints" not in q] == []
    return table, mapping.columns(table, arm())


def check(columns):
    np.testing.assert_allclose(columns.position, POSITION, atol=1e-8)
    np.testing.assert_allclose(columns.torque, TORQUE, atol=1e-6)
    np.testing.assert_allclose(columns.time - columns.time[0], TIME - TIME[0], atol=1e-3)


@pytest.mark.parametrize("separator", [",", ";", "\t"])
@pytest.mark.parametrize("above", [ABOVE, "KUKA,iiwa,14\n", "# made by hand\n" + ABOVE])
def test_lines_above_the_names_are_left_aside_and_said(tmp_path, above, separator):
    table, columns = read(log(tmp_path / "log.csv", above, separator=separator))
    check(columns)
    told = above.count("\n") - above.startswith("#")
    assert f"{told} line{'s' * (told > 1)} above the names left aside" in table.notes


@pytest.mark.parametrize(
    "units",
    [
        ["s", *["deg"] * 7, *["Nm"] * 7],
        ["[s]", *["[deg]"] * 7, *["[N m]"] * 7],
        ["(s)", *["(°)"] * 7, *["-"] * 7],
    ],
)
@pytest.mark.parametrize("above", ["", ABOVE])
def test_units_below_the_names_are_those_of_the_columns(tmp_path, units, above):
    path = log(tmp_path / "log.csv", above, units)
    table, columns = read(path)
    check(columns)
    assert "the line below the names has their units" in table.notes
    assert propose(table, arm()).mapping.position.unit == ("deg",)


def test_times_of_day_go_on_after_midnight(tmp_path):
    table, columns = read(log(tmp_path / "log.csv", times=[clock(t) for t in TIME]))
    check(columns)
    assert table.columns["time"].dtype.kind == "m"


def test_decimal_commas_stand_below_units_too(tmp_path):
    units = ["s", *["deg"] * 7, *["Nm"] * 7]
    _, columns = read(log(tmp_path / "log.csv", ABOVE, units, ";", decimal=","))
    check(columns)


def test_a_text_among_times_of_day_is_no_time(tmp_path):
    times = [clock(t) for t in TIME]
    times[7] = "soon"
    with pytest.raises(RecordingError, match="column time holds text in"):
        read_table(log(tmp_path / "log.csv", times=times), joints=arm().joint_names)


@pytest.mark.parametrize(
    ("text", "told", "named"),
    [
        ("a,b,c\n1,2,3\n4,5,6\n", 0, True),
        ("1,2,3\n4,5,6\n", 0, False),
        ("a,b\n1,2,3\n4,5,6\n", 0, True),  # a name is missing, which is said later
        ("title\na,b,c\n1,2,3\n4,5,6\n", 1, True),
        ("x;y\n1,5;2,5\n", 0, True),
        ("1.0\n2.0\n3.0\n", 0, False),
        ("state\nidle\nidle\n", 0, True),
    ],
)
def test_names_are_found(tmp_path, text, told, named):
    path = tmp_path / "log.csv"
    path.write_text(text, encoding="utf-8")
    dialect = dialect_of(path)
    assert (dialect.told, dialect.named) == (told, named)


NAMES = ["time", *(f"q{j} (deg)" for j in range(1, 8)), *(f"tau{j} (Nm)" for j in range(1, 8))]


def lines_of(apart, ends="", decimal=".", quote="", width=0):
    rows = np.column_stack([TIME, np.rad2deg(POSITION), TORQUE])
    cells = [[f"{quote}{x:{width}.7f}{quote}".replace(".", decimal) for x in row] for row in rows]
    cells[0][0] = f"{quote}{0:{width}d}{quote}"  # a whole number, without any comma
    return [apart.join(row) + ends for row in cells]


@pytest.mark.parametrize(
    ("apart", "ends", "decimal", "quote", "width"),
    [
        (", ", ", ", ".", "", 0),
        (",", ",", ".", "", 0),
        (";", ";", ",", "", 0),
        ("\t", "\t", ",", "", 0),
        (",", "", ",", '"', 0),
        (" ", "", ".", "", 16),
        (" ", " ", ",", "", 16),
    ],
)
@pytest.mark.parametrize("named", [True, False])
@pytest.mark.parametrize("long", [False, True])
def test_cells_as_people_write_them(
    tmp_path, monkeypatch, apart, ends, decimal, quote, width, named, long
):
    if long:
        monkeypatch.setattr(delimited, "LONG_TEXT", 0)
    names = [name.partition(" ")[0] for name in NAMES] if apart == " " else NAMES
    head = [apart.strip(" ").join(names) if apart != " " else "  ".join(names)] if named else []
    path = tmp_path / "log.csv"
    path.write_text("\n".join([*head, *lines_of(apart, ends, decimal, quote, width), ""]))
    values = list(read_table(path).without_empty().columns.values())
    np.testing.assert_allclose(values[0], TIME, atol=1e-7)
    np.testing.assert_allclose(np.stack(values[1:8], 1), np.rad2deg(POSITION), atol=1e-6)
    np.testing.assert_allclose(np.stack(values[8:], 1), TORQUE, atol=1e-6)


def test_a_value_behind_the_last_separator_is_kept(tmp_path):
    rows = ["0,1,", "1,2,", *(f"{k},{k},{k}" for k in range(2, 50))]
    path = tmp_path / "log.csv"
    path.write_text("\n".join(["t,q0", *["0,1,"] * 30, *rows]))
    assert read_table(path).columns["column_3"][-1] == 49


def test_names_alone_may_end_in_a_separator(tmp_path):
    path = tmp_path / "log.csv"
    path.write_text("\n".join(["t,q1,", *(f"{k},{k}" for k in range(30))]))
    assert list(read_table(path).columns) == ["t", "q1"]


def test_decimal_commas_between_commas_say_what_to_do(tmp_path):
    path = tmp_path / "log.csv"
    path.write_text("\n".join(["t,q1", *(f"{k},5,{k},5" for k in range(30))]))
    with pytest.raises(RecordingError, match="decimal commas need quotes, or another separator"):
        read_table(path)


def echoed(path, order, other=None):
    """Write joint states as `rostopic echo -p` does, each joint named in a column of its own."""
    names = [f"field.{kind}{k}" for kind in ("name", "position", "effort") for k in range(7)]
    rows = [
        [f"{1e18 + 1e9 * t:.0f}", "base", *(f"joint{j + 1}" for j in order)]
        + [f"{x:.7f}" for x in (*POSITION[k][order], *TORQUE[k][order])]
        for k, t in enumerate(TIME)
    ]
    if other is not None:
        rows[300][2:4] = other
    head = ",".join(["%time", "field.header.frame_id", *names])
    path.write_text("\n".join([head, *map(",".join, rows), ""]))
    return path


def test_texts_beside_numbered_columns_name_them_in_any_order(tmp_path):
    order = [3, 1, 0, 2, 6, 5, 4]
    read = limo.read(echoed(tmp_path / "log.csv", order), "iiwa14")
    np.testing.assert_allclose(read.position, POSITION, atol=1e-6)
    np.testing.assert_allclose(read.torque, TORQUE, atol=1e-6)


def test_texts_that_change_places_are_refused(tmp_path):
    path = echoed(tmp_path / "log.csv", list(range(7)), ["joint2", "joint1"])
    with pytest.raises(RecordingError, match="name0 is 'joint1' at first and 'joint2' in row 300"):
        read_table(path)


def test_a_text_that_is_numbered_alone_names_no_column(tmp_path):
    path = tmp_path / "log.csv"
    path.write_text("\n".join(["t,name1,q1,q2", *(f"{k},left,{k},{k}" for k in range(30))]))
    assert list(read_table(path).columns) == ["t", "q1", "q2"]


@pytest.mark.parametrize("other", [["time", "tau1"], ["time", "q1"], ["time", "tau1", "tau2"]])
def test_several_tables_in_one_file_are_named(tmp_path, other):
    rows = [",".join([str(k)] * 2) for k in range(30)]
    more = [",".join([str(k)] * len(other)) for k in range(30)]
    path = tmp_path / "log.csv"
    path.write_text("\n".join(["angles", "time,q1", *rows, "", ",".join(other), *more, ""]))
    said = rf"2 tables: one of time, q1 from line 2 on; one of {', '.join(other)} from line 34 on"
    with pytest.raises(RecordingError, match=said):
        read_table(path)
