"""Play a trajectory on any robot, one command a cycle, and record what it measures."""

from __future__ import annotations

import threading
import time
from collections import Counter
from dataclasses import dataclass, replace
from inspect import signature
from typing import TYPE_CHECKING, Any

import numpy as np

from limo_driver.errors import ConfigError
from limo_driver.interrupts import interrupts
from limo_driver.realtime import Realtime
from limo_driver.recorder import Recorder
from limo_driver.registry import ROBOTS, find
from limo_driver.types import FloatArray, ImpedanceCommand, PositionCommand

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping
    from pathlib import Path

    from limo_driver.physics import Simulation
    from limo_driver.robot import Robot
    from limo_driver.trajectory import Trajectory
    from limo_driver.types import JointCommand, JointState

DAMPING_PER_STIFFNESS = 0.1  # [s], of an impedance run: well damped at the inertia of such arms
HOLD_TIMEOUT = 10.0  # [s] of robot time in which a hold has to come to rest


@dataclass(frozen=True)
class PlaybackSummary:
    """How a run went."""

    record: str
    samples: int  # rows of the recording
    duration: float  # of robot time [s]
    real_time_factor: float  # robot time over wall time
    tracking_rmse: FloatArray  # (n,) [rad], measured against commanded
    tracking_max: FloatArray  # (n,) [rad]
    limited: dict[str, int]  # cycles in which each limit changed the command
    interrupted: bool
    link: dict[str, Any]  # what was counted on the link to a real arm
    refused: tuple[str, ...]  # what the machine did not permit of what was asked for

    def as_json(self) -> dict[str, Any]:
        """Return plain values."""
        return {
            **vars(self),
            "tracking_rmse": self.tracking_rmse.tolist(),
            "tracking_max": self.tracking_max.tolist(),
        }


@dataclass(frozen=True)
class Playback:
    """One trajectory on one robot.

    Args:
        trajectory: The motion.
        record: Parquet file to write.
        record_every: Cycles for each row of the recording, and for each state that is published.
        stiffness: Follow as an impedance of this stiffness [N m/rad] instead of by position.
        provenance: What made this run, for the recording's header.
        publish: Told the states as they are measured, numbered so that only a lost one is a gap.
        fifo: Ask for SCHED_FIFO and locked memory while a real arm moves.
    """

    trajectory: Trajectory
    record: Path
    record_every: int = 1
    stiffness: float | None = None
    provenance: dict[str, Any] | None = None
    publish: Callable[[JointState], None] | None = None
    fifo: bool = False

    def run(self, robot: Robot, progress: Callable[[int, int], None]) -> PlaybackSummary:
        """Move the arm along the trajectory; SIGINT or SIGTERM slows it down to a hold.

        Args:
            robot: Open, standing where the trajectory starts.
            progress: Told the cycles done and the cycles in all, now and then.

        Raises:
            JointLimitError: The arm does not stand where the trajectory starts.
            HoldingError: The arm went into a hold by itself; what was recorded is kept.
        """
        if robot.simulated:
            return self._run(robot, progress, None)
        with Realtime(fifo=self.fifo) as realtime:
            return self._run(robot, progress, realtime)

    def _run(
        self, robot: Robot, progress: Callable[[int, int], None], realtime: Realtime | None
    ) -> PlaybackSummary:
        targets = self.trajectory.resample(robot.spec.period).position
        robot.wait_until_ready()
        state = self._receive(robot)
        start, began = state.time, time.monotonic()
        errors = np.zeros((2, robot.spec.n))  # sum of squares, maximum
        limited: Counter[str] = Counter()
        done, reached = 0, 0.0
        interrupted = threading.Event()
        with interrupts(interrupted.set), self._recorder(robot, start) as recorder:
            for done, target in enumerate(targets, start=1):  # how far it came
                sent = robot.send(self._command(target))
                limited.update(sent.limited_by)
                if (done - 1) % self.record_every == 0:
                    recorder.append(state, target)
                error = np.abs(state.position - target)
                errors[0] += error**2
                np.maximum(errors[1], error, out=errors[1])
                reached = state.time - start
                # What can wait comes between an answer and the next state, not the other way round.
                if realtime is not None:
                    realtime.tidy()
                if done % 256 == 0:
                    progress(done, len(targets))
                state = self._receive(robot)
                if interrupted.is_set():
                    break
            if interrupted.is_set():
                self._stop(robot, recorder)
        progress(done, len(targets))
        return PlaybackSummary(
            record=str(self.record),
            samples=recorder.samples,
            duration=reached,
            real_time_factor=reached / max(time.monotonic() - began, 1e-9),
            tracking_rmse=np.sqrt(errors[0] / done),
            tracking_max=errors[1],
            limited=dict(limited),
            interrupted=interrupted.is_set(),
            link=robot.link_figures(),
            refused=() if realtime is None else tuple(realtime.refused),
        )

    def _receive(self, robot: Robot) -> JointState:
        state = robot.receive()
        if self.publish is not None and state.sequence % self.record_every == 0:
            self.publish(replace(state, sequence=state.sequence // self.record_every))
        return state

    def _command(self, target: FloatArray) -> JointCommand:
        if self.stiffness is None:
            return PositionCommand(position=target)
        stiffness = np.full(target.size, self.stiffness)
        return ImpedanceCommand(
            position=target,
            stiffness=stiffness,
            damping=DAMPING_PER_STIFFNESS * stiffness,
            torque=np.zeros(target.size),
        )

    def _recorder(self, robot: Robot, start: float) -> Recorder:
        offset = start - float(self.trajectory.time[0])
        segments = [
            [
                segment.kind,
                float(self.trajectory.time[segment.start]) + offset,
                float(self.trajectory.time[min(segment.stop, len(self.trajectory)) - 1]) + offset,
            ]
            for segment in self.trajectory.segments
        ]
        header = {
            "robot": robot.spec.name,
            "joints": list(robot.spec.joint_names),
            "segments": segments,  # kind, first and last time [s]
            "provenance": self.provenance or {},
        }
        if (step := robot.spec.torque_resolution) is not None:
            header["torque_resolution"] = step.tolist()  # of each joint [N m]
        measured = robot.spec.measures_temperature
        return Recorder(self.record, robot.spec.n, header, temperature=measured)

    def _stop(self, robot: Robot, recorder: Recorder) -> None:
        """Slow the arm down to a hold, recording on."""
        robot.hold("interrupted")
        for cycle in range(int(HOLD_TIMEOUT / robot.spec.period)):
            if robot.standing:
                return
            state = self._receive(robot)
            if cycle % self.record_every == 0:
                recorder.append(state, robot.setpoint)


def open_for(
    backend: str,
    trajectory: Trajectory,
    *,
    simulation: Simulation | None,
    robot: str | None,
    seed: int,
    link: Mapping[str, Any] | None = None,
) -> Robot:
    """Open a robot for a trajectory; a simulated one stands where the trajectory starts.

    Args:
        backend: Registered name.
        trajectory: What the robot will be asked to do.
        simulation: Of a simulated robot.
        robot: Built-in name or URDF, where the backend can be of several.
        seed: Of a simulated robot's noise.
        link: How to reach a real robot: arguments of the backend; those that are None are left out.

    Raises:
        BackendNotFoundError: Names the known backends.
        ConfigError: Another robot than the trajectory's, or options that the backend does not
            have.
    """
    opener: type[Robot] = find(ROBOTS, backend)
    given = {name: value for name, value in (link or {}).items() if value is not None}
    if not opener.simulated:
        given |= {} if robot is None else {"robot": robot}
        given |= {} if simulation is None else {"sim": simulation}
    known = signature(opener).parameters
    if unknown := [f"--{name.replace('_', '-')}" for name in given if name not in known]:
        raise ConfigError(f"backend {backend!r} takes no {' or '.join(unknown)}")
    if not opener.simulated:
        return _checked(opener(**given), trajectory)
    arm = _arm_of(simulation, robot, trajectory)
    trajectory.check_robot(arm.model.n, arm.model.name)
    options: dict[str, Any] = {
        "simulation": arm,
        "initial_position": trajectory.position[0],
        "seed": seed,
    }
    return opener(**options)


def _arm_of(simulation: Simulation | None, robot: str | None, trajectory: Trajectory) -> Simulation:
    from limo_driver.physics import Simulation

    if simulation is not None and robot is not None:
        raise ConfigError("give --sim or --robot; the simulation names its robot")
    if simulation is not None:
        return simulation
    if not (robot or trajectory.robot):
        raise ConfigError("the trajectory names no robot; give --sim or --robot")
    return Simulation(robot=robot or trajectory.robot)


def _checked(robot: Robot, trajectory: Trajectory) -> Robot:
    try:
        trajectory.check_robot(robot.spec.n, robot.spec.name)
    except ConfigError:
        robot.close()
        raise
    return robot
