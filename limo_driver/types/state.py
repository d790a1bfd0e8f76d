"""JointState: one measured sample; StatesAhead: those of many cycles in a row."""

from __future__ import annotations

from dataclasses import dataclass

from limo_driver.types.arrays import ArrayFields, FloatArray, settled_temperature


@dataclass(frozen=True)
class JointState(ArrayFields):
    """One measured sample of all n joints.

    Args:
        time: Of the robot's own clock [s], which never goes back.
        position: (n,) [rad].
        velocity: (n,) [rad/s].
        torque: Measured, (n,) [N m].
        sequence: Counts cycles; a gap is a lost sample.
        stale: There was no new measurement in this cycle; the values are the last known ones.
        holding: The arm holds its pose and takes no command.
        temperature: (n,) [°C], NaN before a joint's first reading; None where it is not measured.
        drives: Status of each joint's drive, in its own words; empty where it is not told.

    Raises:
        ShapeError: The arrays are not all (n,).

    Example:
        >>> with limo.open_robot("virtual", robot="iiwa14") as robot:
        ...     print(robot.receive().position)
    """

    time: float  # [s], monotonic, of the robot
    position: FloatArray  # (n,) [rad]
    velocity: FloatArray  # (n,) [rad/s]
    torque: FloatArray  # (n,) [N m], measured
    sequence: int  # counts cycles; a gap is a lost sample
    stale: bool = False  # no new measurement this cycle: values are the last known ones
    holding: bool = False  # the arm holds its pose and takes no command
    temperature: FloatArray | None = None  # (n,) [°C], where measured; NaN before its first reading
    drives: tuple[str, ...] = ()  # status of each joint's drive, in its own words, where it is told

    def __post_init__(self) -> None:
        super().__post_init__()
        kept = settled_temperature(self.temperature, self.position)
        object.__setattr__(self, "temperature", kept)

    @classmethod
    def trusted(
        cls,
        time: float,
        position: FloatArray,
        velocity: FloatArray,
        torque: FloatArray,
        sequence: int,
        temperature: FloatArray | None = None,
        drives: tuple[str, ...] = (),
    ) -> JointState:
        """Return a state that takes over its arrays, unchecked: for what runs at 1 kHz.

        Args:
            time: Of the robot's own clock [s].
            position: (n,) [rad]; all arrays are float64, and nobody else writes to them.
            velocity: (n,) [rad/s].
            torque: Measured, (n,) [N m].
            sequence: Counts cycles.
            temperature: (n,) [°C]; None where it is not measured.
            drives: Status of each joint's drive.
        """
        position.setflags(write=False)
        velocity.setflags(write=False)
        torque.setflags(write=False)
        if temperature is not None:
            temperature.setflags(write=False)
        state = object.__new__(cls)
        state.__dict__.update(
            time=time,
            position=position,
            velocity=velocity,
            torque=torque,
            sequence=sequence,
            stale=False,
            holding=False,
            temperature=temperature,
            drives=drives,
        )
        return state


@dataclass(frozen=True)
class StatesAhead:
    """States of T cycles in a row."""

    time: FloatArray  # (T,) [s]
    position: FloatArray  # (T, n) [rad]
    velocity: FloatArray  # (T, n) [rad/s]
    torque: FloatArray  # (T, n) [N m]
    last: JointState  # as `receive` returned it
