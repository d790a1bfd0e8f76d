"""Drives: what turns a command into torque at a joint.

A simulation with drives can be run forward from commands alone, and identified from recordings that
hold no torque: the torque of its drives takes the place of the measured one.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, ClassVar, Final

from limo_driver.errors import ParameterError
from limo_driver.model import RobotModel
from limo_driver.model.descriptions.description import StatedMotor, StatedServo
from limo_driver.physics.effect import FARTHEST, MOST_SLOPE, MOST_STIFFNESS, MOST_TORQUE
from limo_driver.recordings.channels import POSITION, TORQUE, VELOCITY, CommandChannel
from limo_driver.runtime.parameters import JOINT, Declared, Parameter, parameter, shown

LONGEST_DELAY: Final = 1.0  # [s]
LONGEST_HEATING: Final = 1e4  # [s]
MOST_GAIN: Final = 1e4  # of a torque, over the one that was commanded
MOST_SAG: Final = 10.0  # of a supply that one servo takes to a tenth of its voltage
TOLERANCE: Final = Parameter("tolerance", "1", lower=0.0, above=True)


@dataclass(frozen=True, kw_only=True)
class JointDrive(Declared):
    """What a drive declares: its kind, the joint that it moves, and how well it is known.

    Args:
        tolerances: Relative standard deviations of parameters, by name, of those `tolerated`; of
            others, the simulation has one.
        joint: The joint, 1-based.
    """

    name: ClassVar[str]  # the identifier in sim.yaml
    channel: ClassVar[CommandChannel | None] = None  # of its commands; None: it takes none
    tolerated: ClassVar[tuple[str, ...]] = ()  # parameters that are believed within a tolerance
    joint: int = parameter(JOINT)
    tolerances: Mapping[str, float] = field(default_factory=dict[str, float])

    @property
    def place(self) -> str:
        """Kind and joint, as they stand in messages."""
        return f"{self.name}, joint {self.joint}"

    def __post_init__(self) -> None:
        super().__post_init__()
        given: Any = self.tolerances
        if not isinstance(given, Mapping):
            raise ParameterError("tolerances", shown(given), "values by name", self.place)
        object.__setattr__(self, "tolerances", dict(given))  # what is given may change later
        for name, value in self.tolerances.items():
            if name not in self.tolerated:
                expected = f"parameters of {', '.join(self.tolerated)}"
                raise ParameterError("tolerances", shown(name), expected, self.place)
            try:
                TOLERANCE.checked(value)
            except ParameterError as error:
                called = f"tolerance of {name}"
                raise ParameterError(called, error.given, error.expected, self.place) from None
            if not getattr(self, name):
                expected = f"parameters that are stated: {name} is not"
                raise ParameterError("tolerances", shown(name), expected, self.place)


@dataclass(frozen=True, kw_only=True)
class PositionServo(JointDrive):
    """A position controller with the gear behind it.

    tau = kp e + ki ∫e dt + punch sign(e) - kd dq, within the torque limit, where e is the set-point
    in force `delay` ago, led by a profile of limited speed and acceleration, minus the position as
    the servo's encoder reads it; 0 inside the dead band, which is taken off outside of it.

    Gains are those seen at the joint: kd has the motor's back-EMF in it. With play, the servo's
    encoder is on the motor and the recorded one on the joint; a servo that looks at the joint
    itself corrects its play, and hardly shows it.

    All servos of an arm are on one supply, whose voltage, and with it all torque and limits but of
    damping, falls to 1 / (1 + sag d) as servos are driven: d is 1 for each that is stalled at its
    torque limit, and less for those that turn. Torque falls alike as the servo's own motor warms:
    to 1 / (1 + derating) in the end, where it is stalled.

    Args:
        kp: Proportional gain.
        kd: Derivative gain.
        ki: Integral gain.
        integral_limit: Most torque of the integral.
        dead_band: Error that is taken for none.
        punch: Least torque outside the dead band.
        speed: Most speed of the profile.
        acceleration: Most acceleration of the profile.
        straight: 1: a command that the next row repeats is followed at once, without the profile.
        torque_limit: Most torque.
        delay: From a command to its effect.
        resolution: Step of the servo's own encoder.
        play: From flank to flank of the gear between the servo's encoder and the joint.
        sag: Resistance of the arm's supply over that of a motor's winding.
        derating: Resistance that the winding gains as the servo is stalled for long, over its own.
        heating: In which it gains that.
    """

    name: ClassVar[str] = "position_servo"
    channel: ClassVar[CommandChannel | None] = POSITION
    tolerated: ClassVar[tuple[str, ...]] = (
        "kp",
        "kd",
        "ki",
        "dead_band",
        "punch",
        "speed",
        "acceleration",
        "torque_limit",
        "delay",
        "play",
    )
    kp: float = parameter("N m/rad", lower=0.0, upper=MOST_STIFFNESS)
    kd: float = parameter("N m s/rad", lower=0, upper=MOST_SLOPE, default=0.0)
    ki: float = parameter("N m/(rad s)", lower=0.0, upper=MOST_STIFFNESS, default=0.0)
    integral_limit: float | None = parameter("N m", lower=0.0, upper=MOST_TORQUE, default=None)
    dead_band: float = parameter("rad", lower=0, default=0.0)
    punch: float = parameter("N m", lower=0.0, upper=MOST_TORQUE, default=0.0)
    speed: float | None = parameter("rad/s", lower=0.0, above=True, default=None)
    acceleration: float | None = parameter("rad/s^2", lower=0.0, above=True, default=None)
    straight: float = parameter("1", lower=0.0, upper=1.0, default=0.0)
    torque_limit: float | None = parameter("N m", lower=0.0, upper=MOST_TORQUE, default=None)
    delay: float = parameter("s", lower=0.0, upper=LONGEST_DELAY, default=0.0)
    resolution: float = parameter("rad", lower=0, upper=FARTHEST, default=0.0)
    play: float = parameter("rad", lower=0.0, upper=FARTHEST, default=0.0)
    sag: float = parameter("1", lower=0.0, upper=MOST_SAG, default=0.0)
    derating: float = parameter("1", lower=0.0, upper=MOST_SAG, default=0.0)
    heating: float = parameter("s", lower=0.0, above=True, upper=LONGEST_HEATING, default=20.0)


@dataclass(frozen=True, kw_only=True)
class VelocityServo(JointDrive):
    """A velocity controller with the gear behind it, as of wheels.

    tau = kv e + ki ∫e dt, within the torque limit, where e is the velocity commanded `delay` ago
    minus that of the joint. As the arm is at rest at first, the integral holds it there.

    Gains are those seen at the joint.

    Args:
        kv: Proportional gain.
        ki: Integral gain.
        integral_limit: Most torque of the integral.
        torque_limit: Most torque.
        delay: From a command to its effect.
    """

    name: ClassVar[str] = "velocity_servo"
    channel: ClassVar[CommandChannel | None] = VELOCITY
    tolerated: ClassVar[tuple[str, ...]] = ("kv", "ki", "torque_limit", "delay")
    kv: float = parameter("N m s/rad", lower=0.0, above=True, upper=MOST_SLOPE)
    ki: float = parameter("N m/rad", lower=0.0, upper=MOST_STIFFNESS, default=0.0)
    integral_limit: float | None = parameter("N m", lower=0.0, upper=MOST_TORQUE, default=None)
    torque_limit: float | None = parameter("N m", lower=0.0, upper=MOST_TORQUE, default=None)
    delay: float = parameter("s", lower=0.0, upper=LONGEST_DELAY, default=0.0)


@dataclass(frozen=True, kw_only=True)
class TorqueDrive(JointDrive):
    """A drive that is told a torque, or a current times its constant, and closes no loop.

    tau = gain u, within the torque limit, where u is the torque commanded `delay` ago.

    Args:
        gain: Torque at the joint over the commanded one.
        torque_limit: Most torque.
        delay: From a command to its effect.
    """

    name: ClassVar[str] = "torque_drive"
    channel: ClassVar[CommandChannel | None] = TORQUE
    tolerated: ClassVar[tuple[str, ...]] = ("gain", "torque_limit", "delay")
    gain: float = parameter("1", lower=0.0, above=True, upper=MOST_GAIN, default=1.0)
    torque_limit: float | None = parameter("N m", lower=0.0, upper=MOST_TORQUE, default=None)
    delay: float = parameter("s", lower=0.0, upper=LONGEST_DELAY, default=0.0)


@dataclass(frozen=True, kw_only=True)
class DcMotor(JointDrive):
    """The motor behind a servo: its torque fades with the speed, as its voltage is limited.

    |tau + (kt gear)² dq / resistance| ≤ kt gear supply / resistance

    Motion shows its torque at rest and its speed without load alone, and of tolerances those of
    these two.

    Args:
        kt: Torque constant of the motor.
        resistance: Of the winding.
        supply: Voltage of the supply.
        gear: Turns of the motor in one of the joint.
    """

    name: ClassVar[str] = "dc_motor"
    tolerated: ClassVar[tuple[str, ...]] = ("kt", "resistance", "supply", "gear")
    kt: float = parameter("N m/A", lower=0.0, above=True)
    resistance: float = parameter("ohm", lower=0.0, above=True)
    supply: float = parameter("V", lower=0.0, above=True)
    gear: float = parameter("1", lower=0.0, above=True)

    @property
    def stall(self) -> float:
        """Torque at rest [N m]."""
        return self.kt * self.gear * self.supply / self.resistance

    @property
    def free_speed(self) -> float:
        """Speed without load [rad/s]."""
        return self.supply / (self.kt * self.gear)

    def tolerances_of_limits(self, usual: float) -> dict[str, float]:
        """Return how well `stall` and `free_speed` are known, as deviations of their logarithms.

        Args:
            usual: Tolerance of parameters that have none of their own.
        """
        known = {name: self.tolerances.get(name, usual) for name in self.tolerated}
        turned = math.hypot(known["kt"], known["gear"], known["supply"])
        return {"stall": math.hypot(turned, known["resistance"]), "free_speed": turned}

    @classmethod
    def of_limits(cls, joint: int, stall: float, free_speed: float) -> DcMotor:
        """Return a motor of known limits at the joint: of a supply of 1 V, and without a gear.

        Args:
            joint: 1-based.
            stall: Torque at rest [N m].
            free_speed: Speed without load [rad/s].
        """
        unit = cls(joint=joint, kt=1.0, resistance=1.0, supply=1.0, gear=1.0)
        return unit.limited(stall, free_speed)

    def limited(self, stall: float, free_speed: float) -> DcMotor:
        """Return the motor of the same supply and gear that has other limits at the joint.

        Args:
            stall: Torque at rest [N m].
            free_speed: Speed without load [rad/s].
        """
        kt = self.supply / (free_speed * self.gear)
        return replace(self, kt=kt, resistance=kt * self.gear * self.supply / stall)


DRIVES: Final[dict[str, type[JointDrive]]] = {
    kind.name: kind for kind in (PositionServo, VelocityServo, TorqueDrive, DcMotor)
}


def channels_of_drives(drives: Iterable[JointDrive], n: int) -> tuple[str | None, ...]:
    """Return what the drive of each joint takes, by name of the channel; None where it has none.

    Args:
        drives: Of an arm.
        n: Number of its joints.
    """
    known = {drive.joint: drive.channel.name for drive in drives if drive.channel is not None}
    return tuple(known.get(j) for j in range(1, n + 1))


def described_drives(model: RobotModel) -> tuple[JointDrive, ...]:
    """Return the servos that a robot's description states, of position and of velocity.

    Args:
        model: The robot.
    """
    stated = model.description.servos
    return tuple(
        _described(joint, stated[name])
        for joint, name in enumerate(model.joint_names, start=1)
        if name in stated
    )


def described_motors(model: RobotModel, channels: Sequence[str | None]) -> tuple[JointDrive, ...]:
    """Return the drives that a robot's description states of joints that are told torques.

    Its actuators of torque are no drives by themselves: beside measured torques nobody asks.

    Args:
        model: The robot.
        channels: What each joint is told, by name of the channel.
    """
    stated = model.description.motors
    return tuple(
        TorqueDrive(joint=j, gain=own.gain, torque_limit=own.limit, delay=own.delay)
        for j, (name, told) in enumerate(zip(model.joint_names, channels, strict=True), start=1)
        if told == TORQUE.name and (own := stated.get(name)) is not None
    )


def as_described(drive: JointDrive) -> StatedServo | StatedMotor | None:
    """Return a drive as descriptions state it; None of what no description has.

    Args:
        drive: Any drive; what a description has no number for is left out.
    """
    if isinstance(drive, PositionServo):
        return StatedServo(drive.kp, drive.kd, drive.torque_limit, drive.delay)
    if isinstance(drive, VelocityServo):
        return StatedServo(0.0, drive.kv, drive.torque_limit, drive.delay)
    if isinstance(drive, TorqueDrive):
        return StatedMotor(drive.gain, drive.torque_limit, drive.delay)
    return None


def _described(joint: int, stated: StatedServo) -> JointDrive:
    limit, delay = stated.limit, stated.delay
    if stated.kp == 0.0:
        return VelocityServo(joint=joint, kv=stated.kd, torque_limit=limit, delay=delay)
    return PositionServo(joint=joint, kp=stated.kp, kd=stated.kd, torque_limit=limit, delay=delay)
