"""Replay: the simulated robot follows a recorded motion, and its torque is compared like for like.

A prediction puts recorded motion into equations. A replay closes the loop the other way: the robot
that a `sim.yaml` describes, with its drives and servo, is told to move as the recorded arm did, and
what its torque sensors measure goes through the filter that the recorded torque went through.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from backends.mujoco_sim.robot import MujocoRobot
from backends.virtual import DEFAULT_PERIOD
from limo_driver.errors import PathError
from limo_driver.model import RobotModel
from limo_driver.physics import Simulation
from limo_driver.physics.effects.sensing import Sensors
from limo_driver.recordings.filters.differentiation import smooth
from limo_driver.recordings.recording import Recording
from limo_driver.trajectory import Trajectory
from limo_driver.types import FloatArray

LEAD_IN = 1.0  # [s] in which the arm gets from rest into the recorded motion
WARM_UP = 2.0  # [s] of recorded motion before a stretch: memory of reversals and filter settle
_LEAD = 1  # cycles by which the measured motion leads the set-points, which are fed forward


@dataclass(frozen=True)
class FreeRun:
    """Measurements of the simulated robot while it followed a recorded motion, T samples."""

    time: FloatArray  # (T,) [s], of the recording
    position: FloatArray  # (T, n) [rad]
    torque: FloatArray  # (T, n) [N m], filtered as the recorded torque
    tracking: FloatArray  # (n,) RMS distance from the recorded position [rad]


def follow(
    simulation: Simulation, recording: Recording, start: float, stop: float, bandwidth: float
) -> FreeRun:
    """Let the simulated robot follow a stretch of a recording.

    Args:
        simulation: Arm and effects; its sensors are taken as ideal, so that nothing but physics
            differs.
        recording: The recorded motion.
        start: First instant of the stretch [s], of the recording.
        stop: Last instant [s].
        bandwidth: Of the zero-phase filter on motion and torque [Hz].

    Returns:
        Its measurements at the recorded instants.

    Raises:
        PathError: The stretch has a gap, or the arm's limits do not allow the recorded motion.
        BackendError: The simulation diverged.
        ConfigError: The simulation cannot be integrated.
    """
    turns = simulation.model.whole_turns(recording.position[np.searchsorted(recording.time, start)])
    recording = replace(recording, position=recording.position - turns)
    path = recorded_path(recording, start, stop, bandwidth, simulation.model)
    able = simulation.model.allowing(path.resample(DEFAULT_PERIOD))
    arm = _from(replace(simulation, described=able), recording, float(path.time[0]))
    with MujocoRobot(arm, initial_position=path.position[0]) as robot:
        robot.receive()
        run = robot.run(path.resample(DEFAULT_PERIOD).position)
    if run.limited_by:
        raise PathError(
            f"the motion recorded from {start:.6g} to {stop:.6g} s exceeds the "
            f"{' and '.join(run.limited_by)} limits of {simulation.model.name}"
        )
    cycles = np.arange(len(run.time), dtype=np.float64) + _LEAD
    time: FloatArray = float(path.time[0]) + cycles * DEFAULT_PERIOD
    torque = smooth(time, run.torque, bandwidth, (slice(0, len(time)),))
    rows = (recording.time >= start) & (recording.time <= stop)
    at = recording.time[rows]
    position = _at(at, time, run.position)
    reference = path.evaluate(at - path.time[0]).position
    return FreeRun(
        time=at,
        position=position + turns,
        torque=_at(at, time, torque),
        tracking=np.sqrt(np.mean((position - reference) ** 2, axis=0)),
    )


def recorded_path(
    recording: Recording, start: float, stop: float, bandwidth: float, model: RobotModel
) -> Trajectory:
    """Return the smoothed recorded motion as a trajectory that begins and ends at rest.

    The stretch is preceded by up to two seconds of what was recorded before it and followed by half
    a second of what came after; quintics lead from rest into the first of these samples, and from
    the last to rest.

    Args:
        recording: The recorded motion.
        start: First instant of the stretch [s].
        stop: Last instant [s].
        bandwidth: Of the zero-phase filter [Hz].
        model: The robot, for the ends of its joints' ranges.

    Raises:
        PathError: The stretch is not within one contiguous part of the recording.
    """
    motion = recording.motion(bandwidth)
    for rows in recording.segments:
        time = motion.time[rows]
        if time[0] <= start and stop <= time[-1]:
            break
    else:
        raise PathError(f"the recording has a gap between {start:.6g} and {stop:.6g} s")
    here = motion[rows]
    kept = here[np.flatnonzero((time >= start - WARM_UP) & (time <= stop + 1 / bandwidth + 0.5))]
    half = LEAD_IN / 2
    ends = kept.position[[0, -1]] + kept.velocity[[0, -1]] * np.array([[-half], [half]])
    ends = np.clip(ends, model.limits.position_min, model.limits.position_max)
    zero = np.zeros((1, kept.n))
    return Trajectory(
        np.concatenate([[kept.time[0] - LEAD_IN], kept.time, [kept.time[-1] + LEAD_IN]]),
        np.concatenate([ends[:1], kept.position, ends[1:]]),
        np.concatenate([zero, kept.velocity, zero]),
        np.concatenate([zero, kept.acceleration, zero]),
        robot=model.name,
    )


def _from(simulation: Simulation, recording: Recording, start: float) -> Simulation:
    """Return a simulation whose time 0 is `start` [s] of the recording, with ideal sensors."""
    effects = tuple(effect.from_time(start, recording) for effect in simulation.effects)
    return replace(simulation, effects=effects, sensors=Sensors())


def _at(at: FloatArray, time: FloatArray, values: FloatArray) -> FloatArray:
    return np.stack([np.interp(at, time, column) for column in values.T], axis=1)
