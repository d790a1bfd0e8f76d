"""LogMapping: which column is which quantity of which joint, in which unit, sign and zero.

```yaml
robot: iiwa14
joints: [joint_1, joint_2]
time: {columns: t_ms, unit: ms}
position: {columns: [q0, q1], unit: deg, sign: [1, -1], zero: [0, 90]}
torque: {columns: [tau0, tau1], unit: N m}
left_out: [gripper]
undecided: []
```
"""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np
import yaml

from limo_driver.errors import ConfigError, RecordingError
from limo_driver.logs.readers.columns import (
    CURRENT,
    CURRENTS,
    NO_COLUMN,
    OF_RATED,
    TORQUE,
    UNITS,
)
from limo_driver.logs.readers.table import TimeColumns, units_of
from limo_driver.recordings.channels import CHANNELS, POSITION, Columns
from limo_driver.runtime import written_by
from limo_driver.runtime.declarations import read_yaml
from limo_driver.runtime.display import Displayed
from limo_driver.runtime.outputs import whole
from limo_driver.runtime.parameters import Declared, parameter

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from limo_driver.logs.readers.table import LogTable
    from limo_driver.model import RobotModel
    from limo_driver.types import FloatArray

_MORE: Final = ("temperature", "estimate", "external_torque")
QUANTITIES: Final = ("position", "velocity", "torque", *CHANNELS, *_MORE)
_EVERY: Final = tuple(dict.fromkeys(unit for units in UNITS.values() for unit in units))
_DECIDE: Final = (
    "state it in a mapping, which `limo inspect` writes, and delete the question under `undecided:`"
)


@dataclass(frozen=True, kw_only=True)
class Channels(Declared):
    """One quantity of all joints: value = sign · factor · (column - zero), in SI units.

    Lists have one entry for each joint, or one for all of them.

    Args:
        unit: Of the columns.
        sign: 1 or -1.
        zero: What the column says at zero.
        factor: N m for each ampere or part of a rated torque, or a gear ratio.
    """

    columns: tuple[str, ...] = parameter(
        "", f"one for each joint, in their order; {NO_COLUMN} where the log has none of it"
    )
    unit: tuple[str, ...] = parameter("")
    sign: tuple[float, ...] = parameter("1", lower=-1, upper=1, default=(1.0,))
    zero: tuple[float, ...] = parameter("", default=(0.0,))
    factor: tuple[float, ...] = parameter("", default=(1.0,))

    def __post_init__(self) -> None:
        super().__post_init__()
        object.__setattr__(self, "unit", units_of(self.unit, _EVERY))
        for name in ("unit", "sign", "zero", "factor"):
            if len(getattr(self, name)) not in {1, len(self.columns)}:
                raise self._refused(name, f"one entry, or one for each of {len(self.columns)}")
        if any(abs(sign) != 1 for sign in self.sign):
            raise self._refused("sign", "1 or -1")

    def read(self, table: LogTable, quantity: str) -> FloatArray:
        """Return the values of T rows, (T, n), in SI units.

        Raises:
            ConfigError: They are currents or parts of a rated torque, and no factor says how many
                N m one makes.
            RecordingError: The log lacks a column, or one holds no numbers.
        """
        needy = [unit for unit in self.unit if unit in (*CURRENTS, *OF_RATED)]
        if needy and set(self.factor) == {1.0}:
            raise ConfigError(
                f"{quantity}: is in {'amperes' if needy[0] in CURRENTS else needy[0]}; its "
                "`factor:` has to say how many N m one makes"
            )
        values = np.empty((table.rows, len(self.columns)))
        n = len(self.columns)
        scale = np.resize([UNITS[quantity][unit] for unit in self.unit], n)
        scale = scale * np.resize(self.sign, n) * np.resize(self.factor, n)
        for j, (name, zero) in enumerate(zip(self.columns, np.resize(self.zero, n), strict=True)):
            column = values_of(table, name)
            if column.dtype.kind in "mM":
                raise RecordingError(
                    f"column {name} holds dates, expected numbers", path=table.source
                )
            values[:, j] = (column - zero) * scale[j]
        return values


@dataclass(frozen=True, kw_only=True, repr=False)
class LogMapping(Declared, Displayed):
    """Which columns of a log are the motion and torque of which joints.

    Args:
        joints: Names of the robot's joints, in their order.
        time: Where the time stands.
        position: Columns of the positions.
        torque: Columns of the torques; None where the log has none.
        velocity: Columns of velocities, where it has some.
        command: Columns of the set-points of the positions, likewise.
        command_velocity: Columns of the velocities that were commanded, likewise.
        command_torque: Columns of the torques that were commanded, likewise. Where one drive takes
            this and another that, each joint has a column of one of these three, and `-` in the
            others.
        temperature: Columns of temperatures, likewise.
        estimate: Columns of what the maker says the torque is, likewise.
        external_torque: Columns of what the maker says of it is external, likewise.
        robot: Name of the robot.
        topic: Of a bag's joint states; found by the joints' names if empty.
        left_out: Columns that are no part of the recording, on purpose.
        undecided: Questions of which two answers fit the log: nothing is read until they are gone.

    Raises:
        ConfigError: Numbers of columns and joints differ, or a unit is of another quantity.

    Example:
        >>> q = np.sin(0.004 * np.arange(500))[:, None] * np.ones(7)
        >>> log = {"t_ms": 4.0 * np.arange(500), "q_rad": q, "tau_nm": np.cos(q)}
        >>> limo.inspect(log, "iiwa14").mapping.save("mapping.yaml")
    """

    joints: tuple[str, ...] = parameter("")
    time: TimeColumns
    position: Channels
    torque: Channels | None = None
    velocity: Channels | None = None
    command: Channels | None = None
    command_velocity: Channels | None = None
    command_torque: Channels | None = None
    temperature: Channels | None = None
    estimate: Channels | None = None
    external_torque: Channels | None = None
    robot: str = parameter("", default="-")
    topic: str = parameter("", default="-")
    left_out: tuple[str, ...] = parameter("", default=())
    undecided: tuple[str, ...] = parameter("", default=())

    def __post_init__(self) -> None:
        super().__post_init__()
        for quantity in QUANTITIES:
            channels = getattr(self, quantity)
            if channels is None:
                continue
            if len(channels.columns) != len(self.joints):
                raise ConfigError(
                    f"{quantity}: has {len(channels.columns)} columns for {len(self.joints)} joints"
                )
            if quantity not in {"torque", *CHANNELS} and NO_COLUMN in channels.columns:
                raise ConfigError(
                    f"{quantity}: has no column of joint "
                    f"{self.joints[channels.columns.index(NO_COLUMN)]}; only torques may lack some"
                )
            if strange := [unit for unit in channels.unit if unit not in UNITS[quantity]]:
                exist = ", ".join(UNITS[quantity])
                raise ConfigError(f"{quantity}: unit is {strange[0]!r}, expected one of {exist}")
        self._check_told()
        if repeated := [name for name in self._columns() if self._columns().count(name) > 1]:
            raise ConfigError(f"column {repeated[0]} stands for two quantities or joints")

    def _check_told(self) -> None:
        """Check that each joint is told something, where some are."""
        told = self._told()
        for j, joint in enumerate(self.joints if told else ()):
            if all(channels.columns[j] == NO_COLUMN for channels in told.values()):
                raise ConfigError(
                    f"{' and '.join(told)}: no column of joint {joint}; only torques may lack some"
                )

    def _told(self) -> dict[str, Channels]:
        """Return the columns of commands, by channel."""
        every = {name: getattr(self, name) for name in CHANNELS}
        return {name: channels for name, channels in every.items() if channels is not None}

    def _columns(self) -> list[str]:
        every = [getattr(self, quantity) for quantity in QUANTITIES]
        names = (name for channels in every if channels is not None for name in channels.columns)
        return [name for name in names if name != NO_COLUMN]

    def headline(self) -> str:
        """Say what it maps."""
        open_ = f", {len(self.undecided)} questions open" if self.undecided else ""
        return f"{len(self.joints)} joints of {self.robot}{open_}"

    @classmethod
    def load(cls, path: Path | str) -> LogMapping:
        """Read a mapping.

        Args:
            path: Of the YAML file.

        Raises:
            ConfigError: Names the line, what was given and what exists.
        """
        given = read_yaml(Path(path), needs="at least `joints:`, `time:` and `position:`")
        parts: dict[str, Any] = {"time": given["time"].make(TimeColumns)} if "time" in given else {}
        for quantity in QUANTITIES:
            if quantity in given and (quantity == "position" or not given[quantity].is_empty):
                parts[quantity] = given[quantity].make(Channels)
        return given.make(cls, parts)

    def save(self, path: Path | str) -> None:
        """Write a mapping that `load` reads back.

        Args:
            path: To be written.

        Raises:
            ConfigError: It cannot be written.
        """
        with whole(path) as draft:
            draft.write_text(self.as_file, encoding="utf-8")

    @property
    def as_file(self) -> str:
        """The text that `save` writes."""
        known = {"robot": self.robot, "topic": self.topic, "joints": list(self.joints)}
        content: dict[str, Any] = {written_by.KEY: written_by.installed()}
        content |= {key: value for key, value in known.items() if value != "-"}
        for part in ("time", *QUANTITIES):
            if (value := getattr(self, part)) is not None:
                content[part] = _entries(value)
        content |= {"left_out": list(self.left_out), "undecided": list(self.undecided)}
        text = yaml.safe_dump(content, sort_keys=False, allow_unicode=True, width=96)
        head = "# value = sign * factor * (column - zero), in the unit; lists go joint by joint.\n"
        return head + text

    @np.errstate(over="ignore", invalid="ignore")  # of numbers that are no measurement
    def columns(
        self,
        table: LogTable,
        model: RobotModel | None = None,
        origin: tuple[Any, ...] | None = None,
    ) -> Columns:
        """Read a table as this mapping says, without judging the values.

        Args:
            table: Of the log, or of a block of it.
            model: The robot, whose joints have to be those of the mapping.
            origin: Of the log's time, of which a block does not know it.

        Returns:
            Columns in SI units, in the order of the joints.

        Raises:
            ConfigError: A question is still open, or the mapping is of other joints.
            RecordingError: The log lacks a column, or has no torque.
        """
        if self.undecided:
            raise ConfigError(
                f"undecided: {'; '.join(self.undecided)} - {_DECIDE}", path=table.source or None
            )
        mapping = self if model is None else self._for(model)
        time, told = mapping.time.read(table, origin)
        position = mapping.position.read(table, "position")
        command, led, extras = mapping._commands(table)
        more = ((name, getattr(mapping, name)) for name in _MORE)
        extras |= {name: own.read(table, name) for name, own in more if own is not None}
        torque, own = mapping._torques(table), mapping.torque
        if own is not None and not set(CURRENTS).isdisjoint(own.unit):
            extras[CURRENT] = torque / np.resize(own.factor, len(self.joints))
        return Columns(
            time=time,
            position=position,
            torque=torque,
            velocity=None if mapping.velocity is None else mapping.velocity.read(table, "velocity"),
            command=command,
            channels=led,
            extras=extras,
            warnings=(*table.notes, *told),
            robot="" if model is None else model.name,
            spread=table.spread,
        )

    def _commands(
        self, table: LogTable
    ) -> tuple[FloatArray | None, tuple[str, ...], dict[str, FloatArray]]:
        """Return what drives were told (T, n), each joint's channel, and all that was beside it.

        Beside torques, which need no drive, set-points of positions alone are taken for commands.
        """
        values = {name: own.read(table, name) for name, own in self._told().items()}
        has = [
            [name for name, own in self._told().items() if own.columns[j] != NO_COLUMN]
            for j in range(len(self.joints))
        ]
        led = tuple(names[0] for names in has if names)
        if not led or (self.torque is not None and set(led) != {POSITION.name}):
            return None, (), values
        command = np.stack([values[name][:, j] for j, name in enumerate(led)], axis=1)
        return command, led, {name: own for name, own in values.items() if set(led) != {name}}

    def _torques(self, table: LogTable) -> FloatArray:
        """Return the torques of T rows, (T, n) [N m]; NaN where there are commands instead."""
        if self.torque is None:
            if not self._told():
                none = ", ".join(table.lost(TORQUE, CURRENT))
                raise RecordingError(
                    f"has no measured torque{none and f' ({none})'}; motion alone says nothing of "
                    "friction and inertia",
                    path=table.source or None,
                )
            return np.full((table.rows, len(self.joints)), np.nan)
        return self.torque.read(table, "torque")

    def _for(self, model: RobotModel) -> LogMapping:
        """Return the mapping, if it is of the joints of a robot."""
        if self.joints == model.joint_names:
            return self
        if sorted(self.joints) == sorted(model.joint_names):
            return self._in_order(model.joint_names)
        raise ConfigError(
            f"the mapping is of the joints {', '.join(self.joints)}, but {model.name} has "
            f"{', '.join(model.joint_names)}"
        )

    def _in_order(self, names: tuple[str, ...]) -> LogMapping:
        order = [self.joints.index(name) for name in names]
        parts = {q: getattr(self, q) for q in QUANTITIES if getattr(self, q) is not None}
        return replace(self, joints=names, **{q: _ordered(c, order) for q, c in parts.items()})


def template_for(table: LogTable, model: RobotModel) -> str:
    """Return a mapping that is to be filled in: `load` refuses it before that."""
    listed = yaml.safe_dump(list(table.columns), width=92, default_flow_style=True)
    joints = yaml.safe_dump(list(model.joint_names), width=1000, default_flow_style=True)
    columns = "".join(f"#   {line}\n" for line in listed.splitlines())
    return f"""\
# Name a column for each joint, in their order, and its unit; delete what the log has none of.
# The log has the columns
{columns}robot: {model.name}
joints: {joints.strip()}
time: {{columns: [], unit: s}}      # or {{rate: 100}}, in Hz, if no column is a time
position: {{columns: [], unit: rad}}  # or deg, mrad, turn; m or mm of a slide
velocity: {{columns: [], unit: rad/s}}
torque: {{columns: [], unit: N m}}    # or A or %, with `factor:` in N m for each of them
command: {{columns: [], unit: rad}}   # set-points of positions
"""


def values_of(table: LogTable, name: str) -> NDArray[Any]:
    """Return a column of a log; NaN throughout where it has none."""
    return np.full(table.rows, np.nan) if name == NO_COLUMN else table.column(name)


def _ordered(channels: Channels, order: list[int]) -> Channels:
    n, values = len(order), {item.name: getattr(channels, item.name) for item in fields(channels)}
    return Channels(
        **{k: tuple(v[j] for j in order) if len(v) == n else v for k, v in values.items()}
    )


def _entries(part: TimeColumns | Channels) -> dict[str, Any]:
    """Return what is not the default, a list of one as its value."""
    found: dict[str, Any] = {}
    for item in fields(part):
        value = getattr(part, item.name)
        if value is None or value == () or (item.name != "unit" and value == item.default):
            continue
        is_one = isinstance(value, tuple) and len(set(value)) == 1 and item.name != "columns"
        several = list(value) if isinstance(value, tuple) else value
        found[item.name] = value[0] if is_one else several
    return found
