import numpy as np
import pytest
from logged import arm

from limo_driver.errors import ConfigError, LimoError, RecordingError
from limo_driver.logs.readers.mapping import Channels, LogMapping, TimeColumns
from limo_driver.logs.readers.table import table_of

JOINTS = arm().joint_names
COLUMNS = tuple(f"q[{j}]" for j in range(7))
TORQUE_COLUMNS = tuple(f"tau[{j}]" for j in range(7))
ROWS = 50
LOG = {
    "t": np.arange(ROWS) * 4.0,
    "q": np.random.default_rng(1).normal(size=(ROWS, 7)),
    "tau": np.random.default_rng(2).normal(size=(ROWS, 7)),
}


def mapping(**other):
    known = {
        "joints": JOINTS,
        "time": TimeColumns(columns=("t",), unit=("ms",)),
        "position": Channels(columns=COLUMNS, unit=("deg",)),
        "torque": Channels(columns=TORQUE_COLUMNS, unit=("N m",)),
    }
    return LogMapping(**(known | other))


def test_sign_zero_unit_and_factor():
    sign = (1.0, -1.0, 1.0, 1.0, 1.0, 1.0, -1.0)
    zero = (0.0, 90.0, 0.0, 0.0, 0.0, 0.0, -5.0)
    factor = tuple(1.0 + j for j in range(7))
    found = mapping(
        position=Channels(columns=COLUMNS, unit=("deg",), sign=sign, zero=zero),
        torque=Channels(columns=TORQUE_COLUMNS, unit=("A",), factor=factor),
    ).columns(table_of(LOG), arm())
    np.testing.assert_allclose(found.position, np.deg2rad(np.array(sign) * (LOG["q"] - zero)))
    np.testing.assert_allclose(found.torque, np.array(factor) * LOG["tau"])
    np.testing.assert_allclose(found.extras["current"], LOG["tau"])  # which they are made of
    np.testing.assert_allclose(found.time, np.arange(ROWS) * 0.004)


@pytest.mark.parametrize("unit", ["Nm", "N*m", "N·m", "N m"])
def test_units_may_be_written_as_people_do(unit):
    assert Channels(columns=TORQUE_COLUMNS, unit=(unit,)).unit == ("N m",)
    assert Channels(columns=TORQUE_COLUMNS, unit=("Nmm",)).unit == ("N mm",)
    assert TimeColumns(columns=("t",), unit=("sec",)).unit == ("s",)
    with pytest.raises(ConfigError, match=r"unit is 'bar', expected one of rad, deg"):
        Channels(columns=TORQUE_COLUMNS, unit=("bar",))


def test_joints_may_stand_in_another_order():
    order = [3, 1, 0, 2, 6, 5, 4]
    given = mapping(
        joints=tuple(JOINTS[j] for j in order),
        position=Channels(
            columns=tuple(COLUMNS[j] for j in order),
            unit=("rad",),
            zero=tuple(float(j) for j in order),
        ),
        torque=Channels(columns=tuple(TORQUE_COLUMNS[j] for j in order), unit=("N m",)),
    )
    found = given.columns(table_of(LOG), arm())
    np.testing.assert_allclose(found.position, LOG["q"] - np.arange(7.0))
    np.testing.assert_array_equal(found.torque, LOG["tau"])


def test_what_is_saved_is_read_back(tmp_path):
    given = mapping(
        position=Channels(
            columns=COLUMNS, unit=("deg",) * 3 + ("rad",) * 4, sign=(1.0, -1.0) * 3 + (1.0,)
        ),
        velocity=Channels(columns=tuple(f"dq[{j}]" for j in range(7)), unit=("deg/s",)),
        robot="iiwa14",
        left_out=("gripper", "comment: odd, name"),
        undecided=("position: rad or deg?",),
    )
    given.save(tmp_path / "mapping.yaml")
    assert LogMapping.load(tmp_path / "mapping.yaml") == given


def test_rows_without_time_have_a_rate():
    found = mapping(time=TimeColumns(rate=250.0)).columns(table_of(LOG), arm())
    np.testing.assert_allclose(found.time, np.arange(ROWS) / 250)


def test_an_open_question_is_refused():
    with pytest.raises(ConfigError, match=r"rad or deg.*undecided"):
        mapping(undecided=("position: rad or deg?",)).columns(table_of(LOG), arm())


REFUSED = [
    (lambda: mapping(joints=JOINTS[:6]), "position: has 7 columns for 6 joints"),
    (
        lambda: mapping(position=Channels(columns=COLUMNS, unit=("N m",))),
        "position: unit is 'N m', expected one of rad, deg",
    ),
    (
        lambda: mapping(torque=Channels(columns=COLUMNS, unit=("N m",))),
        r"column q\[0\] stands for two quantities",
    ),
    (lambda: Channels(columns=COLUMNS, unit=("furlong",)), "unit .*expected"),
    (lambda: Channels(columns=COLUMNS, unit=("deg",), sign=(0.5,)), "sign is .* expected 1 or -1"),
    (lambda: Channels(columns=COLUMNS, unit=("deg",), zero=(1.0, 2.0)), "one for each of 7"),
    (TimeColumns, "neither `columns:` nor a `rate:`"),
    (lambda: TimeColumns(columns=("a", "b"), unit=("s",)), "each entry needs all of them"),
    (
        lambda: mapping(joints=tuple("abcdefg")).columns(table_of(LOG), arm()),
        "the mapping is of the joints a, b, .* but iiwa14 has",
    ),
    (
        lambda: mapping(torque=None).columns(table_of(LOG), arm()),
        "has no measured torque",
    ),
    (
        lambda: mapping(torque=Channels(columns=TORQUE_COLUMNS, unit=("A",))).columns(
            table_of(LOG), arm()
        ),
        "`factor:` has to say how many N m",
    ),
]


@pytest.mark.parametrize(("make", "said"), REFUSED)
def test_what_cannot_be_meant_is_refused(make, said):
    with pytest.raises(LimoError, match=said):
        make()


def test_a_column_that_is_not_there_is_named():
    log = {name: values for name, values in LOG.items() if name != "tau"}
    with pytest.raises(RecordingError, match=r"has no column 'tau\[0\]'; it has t, q\[0\]"):
        mapping().columns(table_of(log), arm())


def test_mistakes_in_a_file_have_a_line(tmp_path):
    path = tmp_path / "mapping.yaml"
    path.write_text("joints: [a]\ntime: {columns: t}\nposition:\n  columns: [q]\n  unit: yard\n")
    with pytest.raises(ConfigError, match=r"mapping.yaml, line 5: position: .*yard"):
        LogMapping.load(path)


def told(*joints):
    """Return columns of commands of some joints, 0-based."""
    return Channels(columns=tuple(f"c{j}" if j in joints else "-" for j in range(7)), unit=("rad",))


def test_velocities_that_are_told_are_commands_of_their_joints():
    log = LOG | {f"c{j}": np.full(ROWS, 10.0 * j) for j in range(7)}
    speeds = Channels(columns=told(5, 6).columns, unit=("deg/s",))
    given = mapping(torque=None, command=told(0, 1, 2, 3, 4), command_velocity=speeds)

    found = given.columns(table_of(log), arm())

    assert found.led == ("command",) * 5 + ("command_velocity",) * 2
    np.testing.assert_allclose(found.command[0], [0, 10, 20, 30, 40, *np.deg2rad([50.0, 60.0])])
    assert np.isnan(found.torque).all()


def test_velocities_of_joints_that_are_told_positions_as_well_are_kept():
    log = LOG | {f"c{j}": np.full(ROWS, 10.0 * j) for j in range(7)}
    log |= {"goal": np.zeros(ROWS)}
    speeds = Channels(columns=tuple(f"c{j}" for j in range(7)), unit=("rad/s",))
    goals = Channels(columns=("goal", *("-",) * 6), unit=("rad",))

    found = mapping(torque=None, command=goals, command_velocity=speeds).columns(
        table_of(log), arm()
    )

    assert found.led == ("command",) + ("command_velocity",) * 6
    np.testing.assert_allclose(found.extras["command_velocity"][0], 10.0 * np.arange(7))


def test_beside_torques_they_are_kept():
    log = LOG | {f"c{j}": np.full(ROWS, 10.0 * j) for j in range(7)}
    speeds = Channels(columns=tuple(f"c{j}" for j in range(7)), unit=("rad/s",))

    found = mapping(command_velocity=speeds).columns(table_of(log), arm())

    assert found.command is None
    np.testing.assert_allclose(found.extras["command_velocity"][0], 10.0 * np.arange(7))


def test_a_joint_that_is_told_nothing_is_named():
    with pytest.raises(ConfigError, match=f"command: no column of joint {JOINTS[6]}"):
        mapping(torque=None, command=told(0, 1, 2, 3, 4, 5))


def test_torques_that_are_told_are_commands_and_currents_need_a_factor():
    log = LOG | {f"c{j}": np.full(ROWS, 10.0 * j) for j in range(7)}
    columns = tuple(f"c{j}" for j in range(7))

    def given(**how):
        torques = Channels(columns=columns, **how)
        return mapping(torque=None, command_torque=torques).columns(table_of(log), arm())

    found = given(unit=("mA",), factor=(2.0,))
    assert found.led == ("command_torque",) * 7
    np.testing.assert_allclose(found.command[0], 0.02 * np.arange(7))
    with pytest.raises(ConfigError, match=r"command_torque: is in amperes; its `factor:`"):
        given(unit=("A",))


def test_what_the_maker_says_of_the_torque_is_kept():
    own = np.full(ROWS, 2.0)
    log = table_of({**LOG, **{f"ext{j}": own for j in range(7)}})
    names = tuple(f"ext{j}" for j in range(7))
    found = mapping(external_torque=Channels(columns=names, unit=("mN m",), sign=(-1.0,)))
    np.testing.assert_allclose(found.columns(log, arm()).extras["external_torque"], -2e-3)


def test_a_mapping_whose_positions_are_left_empty_is_refused(tmp_path):
    path = tmp_path / "mapping.yaml"
    path.write_text("joints: [a]\ntime: {columns: [t]}\nposition:\n")
    with pytest.raises(ConfigError, match=r"position: lacks columns"):
        LogMapping.load(path)
