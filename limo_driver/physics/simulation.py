"""Simulation: a robot and a list of effects, which together say what torque a motion needs."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field, fields, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from limo_driver.errors import ConfigError
from limo_driver.model import RobotModel
from limo_driver.model.descriptions.description import split_reference
from limo_driver.model.descriptions.reading import USD_ENDINGS
from limo_driver.physics.described import EffectGroups, described_effects
from limo_driver.physics.drives import channels_of_drives, described_drives, described_motors
from limo_driver.physics.effect import (
    ArmEffect,
    ArmMotion,
    BodyEffect,
    Effect,
    MotionEffect,
    SensedTorque,
    State,
    TorqueEffect,
)
from limo_driver.physics.effects.sensing import Sensors
from limo_driver.physics.effects.transmission import WINDS_UP
from limo_driver.physics.score import Score
from limo_driver.physics.simulation_file import SimulationFile, Tolerances, load, save, sections_of
from limo_driver.recordings.bandwidth import bandwidth_for
from limo_driver.recordings.filters.differentiation import SAFE_BANDWIDTH, differentiate
from limo_driver.recordings.recording import Recording
from limo_driver.runtime.display import Displayed
from limo_driver.runtime.parameters import JOINT

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from limo_driver.model.descriptions.geometry import Inertial
    from limo_driver.physics.drives import JointDrive
    from limo_driver.recordings.filters.differentiation import Derivatives
    from limo_driver.types import FloatArray, JointSample, Motion


_DESCRIPTIONS = (".urdf", ".xml", ".mjcf", *USD_ENDINGS)


@dataclass(frozen=True, repr=False)
class Simulation(Displayed):
    """A robot, the tolerances of its values, and the physics of its joints.

    tau = ID(q - Σ displacement, dq, ddq) + Σ torque of joints and arm; then the sensors, in order

    ID is the inverse dynamics of `body`: the nominal rigid body after all that changes it. The load
    that effects depend on is ID at the encoders' motion.

    Args:
        robot: Built-in name, or path of a URDF or MJCF.
        effects: Physics beyond the nominal rigid body; sensor effects act in this order.
        inertials: Inertias that replace the URDF's, by link.
        tolerances: How well inertia and friction are known.
        sensors: What the simulated robot's sensors do.
        drives: What turns commands into torque, for those who have no measured torque.
        bandwidth: Of the filter at which its values were found [Hz], where that is not the usual
            one; predictions are made and compared at the same.
        described: The robot as its description states it, which is read if it is not given; so
            `replace` does not read it again.

    Raises:
        ConfigError: The robot, a link or a joint does not exist, or a link has no mass.

    Example:
        >>> from limo_driver.physics import ViscousFriction
        >>> sim = limo.Simulation("iiwa14", (ViscousFriction(joint=2, f_v=1.5),))
        >>> sim.predict(limo.Recording.load("run.parquet"))
    """

    robot: str
    effects: tuple[Effect, ...] = ()
    inertials: Mapping[str, Inertial] = field(default_factory=dict)
    tolerances: Tolerances = field(default_factory=Tolerances)
    sensors: Sensors = field(default_factory=Sensors)
    drives: tuple[JointDrive, ...] = ()
    bandwidth: float | None = field(default=None, kw_only=True)
    described: RobotModel | None = field(default=None, kw_only=True, repr=False, compare=False)

    def __post_init__(self) -> None:
        if isinstance(self.robot, RobotModel):
            raise ConfigError(
                f"`robot` is a RobotModel, expected its name or path, as {self.robot.name!r}"
            )
        if self.described is None or self.described.name != self.robot:
            object.__setattr__(self, "described", RobotModel.load(self.robot))
        self.model.check_masses()
        self._check_drives()
        for effect in self.effects:
            named = [known.name for known in effect.parameters() if known.unit == JOINT]
            for joint in (*effect.joints, *(getattr(effect, name) for name in named)):
                if not 1 <= joint <= self.model.n:
                    raise ConfigError(
                        f"{effect.name}: joint {joint} does not exist; "
                        f"{self.robot} has joints 1 to {self.model.n}"
                    )
        for item in fields(self.sensors):
            self.sensors.for_joints(item.name, self.model.n)

    def _check_drives(self) -> None:
        places = [drive.place for drive in self.drives]
        for drive in self.drives:
            if drive.joint > self.model.n:
                raise ConfigError(
                    f"{drive.name}: joint {drive.joint} does not exist; "
                    f"{self.robot} has joints 1 to {self.model.n}"
                )
            if places.count(drive.place) > 1:
                raise ConfigError(f"drives: {drive.place} is given more than once")
        led = [drive for drive in self.drives if drive.channel is not None]
        for number, drive in enumerate(led):
            for other in led[:number]:
                if drive.joint == other.joint:
                    raise ConfigError(
                        f"drives: joint {drive.joint} has a {other.name} and a {drive.name}, "
                        "expected one of them"
                    )

    @cached_property
    def model(self) -> RobotModel:
        """The nominal rigid body, with the inertias of this simulation."""
        described = self.described or RobotModel.load(self.robot)
        return described.with_inertials(self.inertials)

    @property
    def channels(self) -> tuple[str | None, ...]:
        """What the drive of each joint takes, by name of its columns; None where it has none."""
        return channels_of_drives(self.drives, self.model.n)

    def with_motors(self, channels: Sequence[str]) -> Simulation:
        """Return the same with the drives that the description states of joints told torques.

        Actuators of torque are drives only where commands of torque are all that there is: beside
        measured torques, nothing is asked of a drive.

        Args:
            channels: What each joint is told, by name of its columns; stated drives stay.
        """
        pairs = zip(channels, self.channels, strict=True)
        told = [name if own is None else None for name, own in pairs]
        more = described_motors(self.model, told)
        return replace(self, drives=(*self.drives, *more)) if more else self

    def without_friction(self) -> Simulation:
        """Return the same without what joints take by friction alone."""
        return replace(self, effects=tuple(each for each in self.effects if not each.is_friction))

    @cached_property
    def body(self) -> RobotModel:
        """The rigid body after all effects on it: payload, direction of gravity."""
        body = self.model
        for effect in self.effects:
            if isinstance(effect, BodyEffect):
                body = effect.body(body)
        return body

    @classmethod
    def load(cls, path: Path | str) -> Simulation:
        """Read a `sim.yaml`, or take a robot as its description states it.

        Args:
            path: Of the file; friction, damping, armature and springs in a URDF, MJCF or USD
                file become effects.

        Raises:
            ConfigError: Names the line, what was given and what exists.
        """
        if split_reference(str(path))[0].lower().endswith(_DESCRIPTIONS):
            model = RobotModel.load(path)
            drives = described_drives(model)
            return cls(str(path), described_effects(model), drives=drives, described=model)
        read = load(Path(path))
        return Simulation(
            read.robot, read.effects, read.inertials, read.tolerances, read.sensors, read.drives,
            bandwidth=read.bandwidth,
        )  # fmt: skip

    def save(self, path: Path | str) -> None:
        """Write a `sim.yaml` that `load` reads back to an equal simulation.

        Args:
            path: To be written; a robot that is not built in is named relative to it.

        Raises:
            ConfigError: It cannot be written.
        """
        robot = self.model.reference(Path(path).parent)  # relative to the file, if it is one
        content = SimulationFile(
            robot, self.effects, self.inertials, self.tolerances, self.sensors, self.drives,
            self.bandwidth,
        )  # fmt: skip
        save(content, Path(path))

    def changes_from(self, other: Simulation) -> str:
        """Return which inertials, drives and effects are not in another, as in a `sim.yaml`.

        Args:
            other: What they are compared with.
        """
        inertials = {
            link: body for link, body in self.inertials.items() if other.inertials.get(link) != body
        }
        return sections_of(
            inertials,
            [effect for effect in self.effects if effect not in other.effects],
            [drive for drive in self.drives if drive not in other.drives],
        )

    def without_effects(self) -> Simulation:
        """Return the rigid body alone."""
        return replace(self, effects=())

    def predict(self, motion: Motion | Recording, bandwidth: float | None = None) -> FloatArray:
        """Predict the noise-free torque of a motion, or of a recorded one.

        Memory of hysteresis and the like starts relaxed; in a recording, anew after each gap.

        Args:
            motion: T samples of n joints in order of time. Of a recording only times and positions
                are used.
            bandwidth: Of the zero-phase differentiator of a recording's positions [Hz]; velocities
                are sharper, see `Recording.calm_motion`; if not given, that of the simulation or
                10, or what the recording can bear. Of no use to a motion, which has derivatives.

        Returns:
            Joint torques, (T, n) [N m].

        Raises:
            ShapeError: The motion has another number of joints.
            RecordingError: The bandwidth is too high for the sampling rate.
        """
        if isinstance(motion, Recording):
            width = bandwidth_for([motion], bandwidth, self.bandwidth)
            calm = motion.calm_motion(width)
            return self.predict_stretches(calm, motion.segments, width)
        torque, _ = self.advance(self.init(), motion)
        return torque

    def score(self, recording: Recording, bandwidth: float | None = None) -> Score:
        """Compare the torque predicted for a recording with the torque in it.

        Both go through the same zero-phase filter, so that what only the filter makes of a torque
        is no error. Give a recording that the simulation was not identified from: the errors are
        then those to expect of other motion.

        Args:
            recording: T samples of n joints of this robot.
            bandwidth: Of the filter on motion and torque [Hz]; if not given, that of the
                simulation or 10, or what the recording can bear.

        Returns:
            Errors of each joint, (n,) [N m], beside the torque that was measured; NaN for joints
            without one.

        Raises:
            RecordingError: It is of another robot, too short, or the bandwidth is too high for the
                sampling rate.
        """
        recording.check_robot(self.model)
        width = bandwidth_for([recording], bandwidth, self.bandwidth)
        scored, measured = recording.scored(width), recording.measured_torque(width)
        predicted = recording.filtered(self.predict(recording, width), width)
        error, measured = (measured - predicted)[scored], measured[scored]
        return Score(
            rmse=np.sqrt(np.mean(error**2, axis=0)),
            torque=np.sqrt(np.mean(measured**2, axis=0)),
            joint_names=self.model.joint_names,
            samples=int(scored.sum()),
            bandwidth=width,
            source=recording.source,
            sliding=self.model.sliding,
        )

    def headline(self) -> str:
        """Say which robot, and how many of which effects it has."""
        count = Counter(effect.name.replace("_", " ") for effect in self.effects)
        several = [f"{name} ({k})" if k > 1 else name for name, k in count.items()]
        return f"{self.robot}, " + (", ".join(several) or "rigid body alone")

    def has_body_of(self, other: Simulation) -> bool:
        """Return whether the rigid body is surely that of another simulation, without computing it.

        Args:
            other: One that was made of this one, or both of a third.
        """
        own, others = ([e for e in s.effects if isinstance(e, BodyEffect)] for s in (self, other))
        same = self.described is other.described and self.inertials is other.inertials
        return same and own == others

    def predict_stretches(
        self,
        motion: Motion,
        segments: Sequence[slice],
        bandwidth: float,
        load: FloatArray | None = None,
    ) -> FloatArray:
        """Predict contiguous stretches of a motion; each starts relaxed.

        Here, where past and future are known, links that are displaced from their encoders have
        their own velocity and acceleration, see `MotionEffect`: `predict`, which has to work sample
        by sample, takes the encoders'.

        Args:
            motion: T samples; time may start anew in each stretch.
            segments: Contiguous stretches that cover all samples.
            bandwidth: Of the motion's acceleration [Hz].
            load: Torque of the rigid body, where it is known, (T, n) [N m].

        Returns:
            Joint torques, (T, n) [N m].
        """
        if load is None:
            load = self.body.inverse_dynamics(motion.position, motion.velocity, motion.acceleration)
        parts = [self._advance(self.init(), motion[r], load[r], bandwidth)[0] for r in segments]
        return np.concatenate(parts)

    def init(self) -> tuple[State, ...]:
        """Return the memory of all effects before the first sample."""
        return tuple(effect.initial_state() for effect in self.effects)

    def step(
        self, state: tuple[State, ...], sample: JointSample
    ) -> tuple[FloatArray, tuple[State, ...]]:
        """Predict the torque of the next sample.

        Args:
            state: Memory after the sample before.
            sample: The next sample.

        Returns:
            Joint torques (n,) [N m] and the memory after this sample.
        """
        motion = sample.motion()
        torque, after = self.advance(state, motion)
        return torque[0], after

    def advance(
        self, state: tuple[State, ...], motion: Motion
    ) -> tuple[FloatArray, tuple[State, ...]]:
        """Predict T samples that follow `state`: `predict` and `step` in one.

        Args:
            state: Memory after the sample before, from `init` at first.
            motion: T samples of n joints.

        Returns:
            Joint torques (T, n) [N m] and the memory after the last sample.

        Raises:
            ShapeError: The motion has another number of joints.
        """
        load = self.body.inverse_dynamics(motion.position, motion.velocity, motion.acceleration)
        return self._advance(state, motion, load)

    def _advance(
        self,
        state: tuple[State, ...],
        motion: Motion,
        load: FloatArray,
        bandwidth: float | None = None,
    ) -> tuple[FloatArray, tuple[State, ...]]:
        """Advance; links are displaced quasi-statically where there is no bandwidth [Hz]."""
        after = list(state)
        terms = _Terms(motion)
        groups = self._groups
        groups.write_torques(terms.torque, motion, after)
        if groups.is_elastic:
            terms.displacement[WINDS_UP] = groups.wind_up(load)
        if groups.single:
            arm = ArmMotion(motion, load, self.body)
            for index, effect in groups.single:
                after[index] = terms.add(effect, state[index], arm)
        if terms.displacement:
            load = self.body.inverse_dynamics(*terms.links(bandwidth))
        torque = load + terms.torque
        for index, effect in groups.sensing:
            sensed = SensedTorque(motion.time, torque)
            values, after[index] = effect.advance(state[index], sensed)
            torque[:, effect.joint - 1] += values
        return torque, tuple(after)

    @cached_property
    def _groups(self) -> EffectGroups:
        return EffectGroups(self.effects, self.model.n)


class _Terms:
    """Adds up what effects displace and what torque they need."""

    def __init__(self, motion: Motion) -> None:
        self.motion = motion
        self.torque = np.zeros(motion.position.shape)  # (T, n) [N m]
        self.displacement: dict[float, FloatArray] = {}  # by agility, (T, n) each [rad]

    def add(self, effect: Effect, state: State, arm: ArmMotion) -> State:
        """Add an effect on motion or torque and return its memory."""
        if isinstance(effect, ArmEffect):
            values, state = effect.advance(state, arm)
            self.torque += values
        elif isinstance(effect, TorqueEffect):
            values, state = effect.evaluate(state, arm.of_joint(effect.joint - 1))
            self.torque[:, effect.joint - 1] += values
        elif isinstance(effect, MotionEffect):
            motion = arm.of_joint(effect.joint - 1, inertia=effect.needs_inertia)
            values, state = effect.advance(state, motion)
            total = self.torque
            if effect.displaces:
                nothing = np.zeros_like(self.torque)
                total = self.displacement.setdefault(effect.agility, nothing)
            total[:, effect.joint - 1] += values
        return state

    def links(self, bandwidth: float | None) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return position, velocity and acceleration of the links, (T, n) each."""
        motion = self.motion
        position, velocity, acceleration = motion.position, motion.velocity, motion.acceleration
        for agility, displacement in self.displacement.items():
            position = position - displacement
            if bandwidth is not None and agility:
                own = displaced(motion.time, displacement, agility * bandwidth)
                velocity, acceleration = velocity - own.first, acceleration - own.second
        return position, velocity, acceleration


def displaced(time: FloatArray, displacement: FloatArray, bandwidth: float) -> Derivatives:
    """Differentiate displacements (T, k) of links, within what the sampling allows."""
    rate = (time.size - 1) / float(time[-1] - time[0])
    highest = SAFE_BANDWIDTH * rate
    return differentiate(time, displacement, min(bandwidth, highest), [slice(0, time.size)])
