"""Sensing: what torque sensor and encoder make of the truth."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, fields, replace
from typing import ClassVar, Final

import numpy as np

from limo_driver.errors import ConfigError
from limo_driver.physics.description import Confusion, Description
from limo_driver.physics.effect import (
    MOST_TORQUE,
    DiagnosisContext,
    Effect,
    Hypothesis,
    JointMotion,
    MotionEffect,
    SensedTorque,
    SensorEffect,
    SimulatedPlant,
    State,
    TorqueEffect,
)
from limo_driver.recordings.recording import Recording
from limo_driver.runtime.parameters import JOINT, Declared, parameter
from limo_driver.types import FloatArray

KNOTS = 6  # of drift over a recording
UNIT_ANGLE = 1e-3  # [rad]

FARTHEST_ZERO: Final = 0.5  # [rad], of an encoder whose joint is still the one described


@dataclass(frozen=True, kw_only=True)
class TorqueOffset(TorqueEffect):
    """A constant error of the torque sensor, tau = offset; also at rest.

    Args:
        offset: Offset.

    Source: Hollerbach, Khalil and Gautier, "Model identification", Handbook of Robotics, 2016.
    """

    name: ClassVar[str] = "torque_offset"
    sized_by: ClassVar[tuple[str, ...]] = ("offset",)
    description: ClassVar[Description] = Description(
        signature="the error is a constant, also at rest", shown_by="rest_holds"
    )
    offset: float = parameter("N m", lower=-MOST_TORQUE, upper=MOST_TORQUE, adds=True)

    def advance(self, state: State, motion: JointMotion) -> tuple[FloatArray, State]:
        """Return the offset [N m], (T,)."""
        return np.full(motion.position.shape, self.offset), state

    def realise(self, robot: SimulatedPlant) -> None:
        """Ask for the offset of the sensor."""
        robot.add_torque_offset(self.joint, self.offset)

    @classmethod
    def at_joint(cls, joint: int, recorded: DiagnosisContext) -> Iterator[Hypothesis]:  # noqa: ARG003
        """Yield it."""
        yield Hypothesis.of_one(cls(joint=joint, offset=1.0), "offset")


@dataclass(frozen=True, kw_only=True)
class TorqueDrift(TorqueEffect):
    """An offset that wanders with time: linear between the times, constant before and after.

    Args:
        times: Times.
        offset: Offset at each time.

    Raises:
        ConfigError: Times do not increase, or are not as many as the offsets.

    Source: Traversaro, Pucci and Nori, "In situ calibration of six-axis force-torque sensors using
    accelerometer measurements", ICRA 2015.
    """

    name: ClassVar[str] = "torque_drift"
    sized_by: ClassVar[tuple[str, ...]] = ("offset",)
    description: ClassVar[Description] = Description(
        signature="the same motion needs another torque later on",
        shown_by="revisit",
        confusions=(
            Confusion(
                "torque_offset", "the same poses later show the same offset, or another", "revisit"
            ),
        ),
    )
    persists: ClassVar[bool] = False
    times: tuple[float, ...] = parameter("s", lower=-1e12, upper=1e12, chosen=True)
    offset: tuple[float, ...] = parameter(
        "N m", lower=-MOST_TORQUE, upper=MOST_TORQUE, deviation="largest"
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        self._same_length("times", "offset")
        self._increasing("times")

    def advance(self, state: State, motion: JointMotion) -> tuple[FloatArray, State]:
        """Return the offset at the time of each sample [N m], (T,)."""
        return np.interp(motion.time, self.times, self.offset), state

    def realise(self, robot: SimulatedPlant) -> None:
        """Add it to the simulated sensor."""
        robot.sense(self)

    @classmethod
    def at_joint(cls, joint: int, recorded: DiagnosisContext) -> Iterator[Hypothesis]:
        """Yield it with knots from the first to the last sample, if those are far apart."""
        if not recorded.shows_slow_change:
            return
        times = tuple(np.linspace(recorded.start, recorded.end, KNOTS).tolist())
        terms = tuple(cls(joint=joint, times=times, offset=tuple(hat)) for hat in np.eye(KNOTS))
        yield Hypothesis(
            cls.name,
            (joint - 1,),
            terms,
            lambda c: (replace(terms[0], offset=tuple(float(x) for x in c)),),
        )

    def from_time(self, start: float, recording: Recording) -> Effect:  # noqa: ARG002
        """Return the drift in a time that begins at `start` [s]."""
        return replace(self, times=tuple(t - start for t in self.times))


@dataclass(frozen=True, kw_only=True)
class EncoderOffset(MotionEffect):
    """A wrong zero of the encoder, q_link = q - offset.

    Args:
        offset: Encoder minus link.

    Source: Hollerbach, Khalil and Gautier, "Model identification", Handbook of Robotics, 2016.
    """

    name: ClassVar[str] = "encoder_offset"
    sized_by: ClassVar[tuple[str, ...]] = ("offset",)
    description: ClassVar[Description] = Description(
        signature="the gravity torque is that of a shifted position",
        shown_by="wide_sweep",
        confusions=(
            Confusion(
                "link_inertia",
                "an offset shifts the gravity torque over position, inertia scales it",
                "wide_sweep",
            ),
            Confusion(
                "spring_load",
                "an offset acts in proportion to the load's slope, a spring at any load",
                "wide_sweep",
            ),
        ),
    )
    offset: float = parameter("rad", lower=-FARTHEST_ZERO, upper=FARTHEST_ZERO, adds=True)

    def advance(self, state: State, motion: JointMotion) -> tuple[FloatArray, State]:
        """Return the offset [rad], (T,)."""
        return np.full(motion.position.shape, self.offset), state

    def realise(self, robot: SimulatedPlant) -> None:
        """Ask for another zero of the encoder."""
        robot.add_encoder_offset(self.joint, self.offset)

    @classmethod
    def at_joint(cls, joint: int, recorded: DiagnosisContext) -> Iterator[Hypothesis]:  # noqa: ARG003
        """Yield it."""
        yield Hypothesis.of_one(cls(joint=joint, offset=UNIT_ANGLE), "offset")


@dataclass(frozen=True, kw_only=True)
class TorqueGain(SensorEffect):
    """A wrong scale of the torque sensor, which adds gain times the torque.

    Args:
        gain: Relative error of scale.

    Source: Hollerbach, Khalil and Gautier, "Model identification", Handbook of Robotics, 2016.
    """

    name: ClassVar[str] = "torque_gain"
    sized_by: ClassVar[tuple[str, ...]] = ("gain",)
    description: ClassVar[Description] = Description(
        signature="all of this joint's torque is scaled together",
        shown_by="wide_sweep",
        confusions=(
            Confusion(
                "link_inertia",
                "a gain scales all torques of the joint, friction too, in every pose alike",
                "wide_sweep",
            ),
            Confusion("payload", "only a known mass tells the gain of a sensor"),
        ),
    )
    gain: float = parameter("1", lower=-0.99, upper=10.0, scales=True, adds=True)

    def advance(self, state: State, sensed: SensedTorque) -> tuple[FloatArray, State]:
        """Return gain times the joint's torque [N m], (T,)."""
        return self.gain * sensed.torque[:, self.joint - 1], state

    @classmethod
    def at_joint(cls, joint: int, recorded: DiagnosisContext) -> Iterator[Hypothesis]:  # noqa: ARG003
        """Yield it."""
        yield Hypothesis.of_one(cls(joint=joint, gain=0.01), "gain")


@dataclass(frozen=True, kw_only=True)
class TorqueCrosstalk(SensorEffect):
    """Torque of another joint that leaks into the sensor, which adds gain times tau_source.

    Args:
        source: The other joint.
        gain: Share of its torque.

    Raises:
        ConfigError: The source is the joint itself, whose own gain is `torque_gain`.

    Source: Cao, Laws and Rodriguez y Baena, "Six-axis force/torque sensors for robotics
    applications: a review", IEEE Sensors Journal 21(24), 2021.
    """

    name: ClassVar[str] = "torque_crosstalk"
    sized_by: ClassVar[tuple[str, ...]] = ("gain",)
    description: ClassVar[Description] = Description(
        signature="the error follows another joint's torque",
        shown_by="apart",
        confusions=(
            Confusion(
                "torque_offset", "crosstalk changes when another joint alone is moved", "apart"
            ),
        ),
    )
    source: int = parameter(JOINT, lower=1, upper=64)
    gain: float = parameter("1", lower=-10.0, upper=10.0, scales=True)

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.source == self.joint:
            raise self._refused("source", "another joint, since torque_gain is for its own")

    def advance(self, state: State, sensed: SensedTorque) -> tuple[FloatArray, State]:
        """Return gain times the torque of the source [N m], (T,)."""
        return self.gain * sensed.torque[:, self.source - 1], state

    @classmethod
    def at_joint(cls, joint: int, recorded: DiagnosisContext) -> Iterator[Hypothesis]:
        """Yield it from every other joint."""
        for source in range(1, recorded.n + 1):
            if source != joint:
                yield Hypothesis.of_one(cls(joint=joint, source=source, gain=0.01), "gain")


@dataclass(frozen=True)
class Sensors(Declared):
    """Noise and resolution of the sensors; one value for all joints, or one each.

    They shape what the simulated robot measures. A prediction is free of them. Zero means ideal.

    Args:
        torque_noise: 1 sigma, white.
        torque_resolution: Of one step.
        encoder_resolution: Of one step.
    """

    _called = "sensors"
    torque_noise: tuple[float, ...] = parameter("N m", lower=0, default=(0.0,))
    torque_resolution: tuple[float, ...] = parameter("N m", lower=0, default=(0.0,))
    encoder_resolution: tuple[float, ...] = parameter("rad", lower=0, default=(0.0,))

    def __post_init__(self) -> None:
        super().__post_init__()
        for item in fields(self):
            if not getattr(self, item.name):
                raise self._refused(item.name, "one for all joints, or one each")

    def for_joints(self, name: str, n: int) -> FloatArray:
        """Return one sensor figure for each of n joints, (n,).

        Raises:
            ConfigError: Neither one value nor n.
        """
        values = np.array(getattr(self, name))
        if values.size not in {1, n}:
            raise ConfigError(f"sensors: {name} has {values.size} values for {n} joints")
        return np.broadcast_to(values, (n,))

    def measure_torque(self, torque: FloatArray, random: np.random.Generator) -> FloatArray:
        """Add noise and quantise; (..., n) [N m]."""
        n = torque.shape[-1]
        noise = random.standard_normal(torque.shape) * self.for_joints("torque_noise", n)
        return quantise(torque + noise, self.for_joints("torque_resolution", n))

    def measure_position(self, position: FloatArray) -> FloatArray:
        """Quantise to the encoder's resolution; (..., n) [rad]."""
        return quantise(position, self.for_joints("encoder_resolution", position.shape[-1]))


def quantise(values: FloatArray, resolution: FloatArray) -> FloatArray:
    """Round `values` (..., n) to multiples of `resolution` (n,); 0 leaves them as they are."""
    step = np.where(resolution > 0, resolution, 1.0)
    return np.where(resolution > 0, np.round(values / step) * step, values)
