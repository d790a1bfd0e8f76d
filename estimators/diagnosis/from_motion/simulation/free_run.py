"""Closed loops simulated forward from commands alone, compiled.

    M(q) ddq + c(q, dq) + friction + offset = torque of the drives(command, q, dq)

Each step solves for the velocities of all joints by sweeps of Gauss and Seidel over them, each
joint by `next_velocity`: the mass matrix is positive definite, so the sweeps converge. Where they
have not after many, as of links whose inertia is far above that of their drives, that is refused.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Final

import numpy as np

from estimators.diagnosis.from_motion.simulation import constants as c
from estimators.diagnosis.from_motion.simulation import joint_step as step
from estimators.diagnosis.from_motion.simulation.one_joint import FIT_STEP
from estimators.diagnosis.from_motion.simulation.plant import ServoArm
from estimators.diagnosis.settings.residuals import ROWS
from estimators.rigid_body.regressor import inverse_dynamics
from limo_driver.errors import ConfigError
from limo_driver.recordings.bandwidth import bandwidth_for
from limo_driver.recordings.channels import TORQUE, VELOCITY, commanded_by, drifting
from limo_driver.recordings.commanded import set_points
from limo_driver.runtime.compiled import compiled

if TYPE_CHECKING:
    from collections.abc import Sequence

    from limo_driver.physics import Simulation
    from limo_driver.recordings.commanded import Commanded
    from limo_driver.recordings.recording import Recording
    from limo_driver.types import FloatArray

LONGEST_STEP: Final = FIT_STEP / 2  # [s]
_SWEEPS: Final = 5000
_CONVERGED: Final = 1e-7  # [rad/s]
_RESTS: Final = 60.0  # [s] of one command, after which an arm moves no more
ROUNDING: Final = 1e-9  # [s], of sums of steps
MOVED: Final = ROWS.travel  # [rad], range of its commands from which on a joint is identified
_ARM: Final = ("rotation", "translation", "axis", "gravity", "links", "rows")
_ENOUGH: Final = 0.5  # [rad], beyond which more range says little more


def free_run(simulation: Simulation, recording: Recording) -> FloatArray:
    """Simulate a recorded motion forward from its commands alone.

    It starts at rest at the first recorded position, and after each gap at the first one behind it.

    Args:
        simulation: With a servo for each joint.
        recording: T samples of n joints, with commands; of its positions only the first is used.

    Returns:
        Positions as the encoders would read them, (T, n) [rad].

    Raises:
        ConfigError: The simulation lacks a drive, has an effect that cannot be run forward, or a
            step does not settle.
        RecordingError: The recording is of another robot, or has no commands.
    """
    recording.check_robot(simulation.model)
    simulation = simulation.with_motors(recording.channels)
    commanded = recording.led(simulation.channels)
    return run_forward(ServoArm.of(simulation).without_restarts(), commanded)


def restarted_run(simulation: Simulation, recording: Recording) -> FloatArray:
    """Do as `free_run` does, but begin anew where each joint was, as often as its drive asks for.

    What is told by velocity or torque drifts from where it was, and the longer a run, the less its
    position says of the drive; joints behind position servos are never put back.
    """
    recording.check_robot(simulation.model)
    return run_forward(ServoArm.of(simulation), recording.led(simulation.channels))


def commanded_run(simulation: Simulation, commands: Commanded) -> FloatArray:
    """Simulate an arm forward from commands, from where it was at the first of them.

    What it was told before a gap stays in force; after a minute of that it rests, unless it is
    told velocities or torques.

    Args:
        simulation: With a servo for each joint.
        commands: T set-points of n joints, and the first position.

    Returns:
        Positions as the encoders would read them, (T, n) [rad].

    Raises:
        ConfigError: As for `free_run`.
    """
    simulation = simulation.with_motors(commands.channels)
    commands, arm = commands.led(simulation.channels), ServoArm.of(simulation).without_restarts()
    rests = np.inf if drifting(commands.channels) else _RESTS  # what is told to turn, turns on
    steps = np.minimum(np.diff(commands.time), rests)
    time = commands.time[0] + np.concatenate([[0.0], np.cumsum(steps)])
    return follow(arm, time, commands.command, commands.start[None, :], np.zeros((1, commands.n)))


def run_forward(arm: ServoArm, recording: Recording) -> FloatArray:
    """Do as `restarted_run` does, with an arm that is taken apart already."""
    command, velocity = commands_of(recording), np.zeros_like(recording.position)
    if np.isfinite(arm.rows[:, c.RESTART]).any():
        velocity = recording.motion(bandwidth_for([recording])).velocity
    position = np.empty_like(recording.position)
    for rows in recording.segments:
        recorded = recording.position[rows], velocity[rows]
        position[rows] = follow(arm, recording.time[rows], command[rows], *recorded)
    return position


def follow(
    arm: ServoArm,
    time: FloatArray,
    command: FloatArray,
    position: FloatArray,
    velocity: FloatArray,
) -> FloatArray:
    """Simulate an arm forward from commands, at rest at first but where joints are put back.

    Args:
        arm: Of n joints.
        time: Increasing, (T,) [s].
        command: Each in force until the next, (T, n) [rad]; [rad/s] of servos of velocity, [N m]
            of drives without a servo.
        position: Where the arm is, as its encoders read it, (T, n) [rad]; the first row is enough
            where no joint is put back.
        velocity: Likewise, (T, n) [rad/s].

    Returns:
        Positions as the encoders would read them, (T, n) [rad].

    Raises:
        ConfigError: A step does not settle.
    """
    chain = arm.chain
    position, converged = _advance(
        chain.rotation,
        chain.translation,
        chain.axis,
        chain.gravity,
        arm.links,
        arm.rows,
        time,
        np.ascontiguousarray(command),
        np.ascontiguousarray(position),
        np.ascontiguousarray(velocity),
        min(step.longest_step(row, LONGEST_STEP) for row in arm.rows),
    )
    if not converged:
        raise ConfigError(
            f"the velocities of the joints did not agree within {_CONVERGED:g} rad/s after "
            f"{_SWEEPS} sweeps of a step; is the armature of a joint far below the inertia "
            "that it moves?"
        )
    return position


def commands_of(recording: Recording) -> FloatArray:
    """Return the commands of a recording, (T, n) [rad], or in the unit of what is told.

    Raises:
        RecordingError: It has none.
    """
    return set_points(recording.command, recording.source)


@compiled(nogil=True)
def _load(
    bias: FloatArray, M: FloatArray, after: FloatArray, before: FloatArray, h: float, j: int
) -> float:
    """Return the torque that the rigid body needs at a joint as velocities change so [N m]."""
    load = bias[j]
    for k in range(before.size):
        load += M[j, k] * (after[k] - before[k]) / h
    return load


@compiled(nogil=True)
def _drive(
    rows: FloatArray,
    volts: FloatArray,
    heat: FloatArray,
    error: FloatArray,
    velocity: FloatArray,
    h: float,
) -> None:
    """Write the voltages that one supply drives motors by, and warm these by a step."""
    sag, drawn, returned = rows[:, c.SAG].max(), 0.0, 0.0
    if sag > 0.0:
        for j in range(error.size):
            more, less = step.driven(rows[j], error[j], velocity[j])
            drawn += more
            returned += less
    supply = step.sagged(sag, drawn, returned)
    for j in range(error.size):
        volts[j], heat[j] = step.warm_motor(rows[j], supply, heat[j], error[j], velocity[j], h)


@compiled(nogil=True)
def _inertia(
    rotation: FloatArray,
    translation: FloatArray,
    axis: FloatArray,
    links: FloatArray,
    q: FloatArray,
    M: FloatArray,
) -> None:
    """Write the mass matrix of a pose into `M`."""
    n = q.size
    still, weightless, unit, column = np.zeros(n), np.zeros(3), np.zeros(n), np.empty(n)
    for j in range(n):
        unit[j] = 1.0
        inverse_dynamics(rotation, translation, axis, weightless, links, q, still, unit, column)
        for i in range(n):  # M[:, j] = column would compile the message of its error
            M[i, j] = column[i]
        unit[j] = 0.0


@compiled(nogil=True)
def _solve_velocities(
    rows: FloatArray,
    position: FloatArray,
    v: FloatArray,
    error: FloatArray,
    integral: FloatArray,
    M: FloatArray,
    bias: FloatArray,
    volts: FloatArray,
    h: float,
    after: FloatArray,
    mean: FloatArray,
) -> bool:
    """Write the velocities behind a step and within it; say whether those of all joints agree."""
    for _ in range(_SWEEPS):
        moved = 0.0
        for j in range(v.size):
            load = _load(bias, M, after, v, h, j) - M[j, j] * (after[j] - v[j]) / h
            new, mean[j] = step.next_velocity(
                rows[j],
                position[j],
                v[j],
                error[j],
                integral[j],
                M[j, j],
                load,
                volts[j],
                h,
            )
            moved = max(moved, abs(new - after[j]))
            after[j] = new
        if moved < _CONVERGED:
            return True
    return False


@compiled(reads=(*_ARM, "time", "command", "position", "velocity"), nogil=True)
def _advance(
    rotation: FloatArray,
    translation: FloatArray,
    axis: FloatArray,
    gravity: FloatArray,
    links: FloatArray,
    rows: FloatArray,
    time: FloatArray,
    command: FloatArray,
    position: FloatArray,
    velocity: FloatArray,
    longest: float,
) -> tuple[FloatArray, bool]:
    """Return the positions (T, n) [rad] of one stretch, and whether all steps converged."""
    # to set rows of arrays whole would compile the message of its error, as long as all of this
    T, n = command.shape
    result = np.empty((T, n))
    zero, begun = rows[:, c.ZERO], np.full(n, -math.inf)
    q, v, place = np.empty(n), np.zeros(n), np.empty(n)  # of the rigid body, and as it is measured
    target, pace, integral = command[0].copy(), np.zeros(n), np.zeros(n)
    at = np.zeros(n, dtype=np.int64)
    bias, error, after, mean = np.empty(n), np.empty(n), np.zeros(n), np.zeros(n)
    still, M, fresh = np.zeros(n), np.empty((n, n)), -math.inf
    ahead = np.zeros(n)  # drives, within their play
    heat, volts = np.zeros(n), np.ones(n)
    for j in range(n):
        result[0, j] = position[0, j]
        q[j] = position[0, j] - zero[j]
    inverse_dynamics(rotation, translation, axis, gravity, links, q, v, still, bias)
    for j in range(n):
        integral[j] = step.held(rows[j], q[j] + zero[j], bias[j])
        ahead[j] = step.slack(rows[j], bias[j])
        q[j] += ahead[j]
    for i in range(T - 1):
        for j in range(n):
            if step.begins_anew(rows[j], begun[j], time[i]):
                q[j], begun[j] = position[i, j] - zero[j] + ahead[j], time[i]
                if i == 0 or not step.keeps_pace(rows[j]):
                    v[j] = velocity[i, j]
        steps = max(1, math.ceil((time[i + 1] - time[i]) / longest - ROUNDING))
        h = (time[i + 1] - time[i]) / steps
        for s in range(steps):
            now = time[i] + h * s
            if now - fresh >= LONGEST_STEP - ROUNDING:
                fresh = now
                _inertia(rotation, translation, axis, links, q, M)
            inverse_dynamics(rotation, translation, axis, gravity, links, q, v, still, bias)
            for j in range(n):
                target[j], pace[j], at[j] = step.follow_command(
                    rows[j],
                    time,
                    command[:, j],
                    at[j],
                    now - rows[j, c.DELAY],
                    h,
                    target[j],
                    pace[j],
                )
                place[j] = q[j] + zero[j]
                error[j] = step.error_of(rows[j], target[j], place[j])
                integral[j] = step.position_integral(rows[j], integral[j], error[j], h)
            _drive(rows, volts, heat, error, v, h)
            if not _solve_velocities(
                rows, place, v, error, integral, M, bias, volts, h, after, mean
            ):
                return result, False
            for j in range(n):
                integral[j] = step.velocity_integral(rows[j], integral[j], error[j], mean[j], h)
                ahead[j] = step.slack(rows[j], _load(bias, M, after, v, h, j))
                q[j] += h * mean[j]
            for j in range(n):
                v[j], result[i + 1, j] = after[j], q[j] - ahead[j] + zero[j]
    return result, True


def commanded_range(recordings: Sequence[Recording]) -> FloatArray:
    """Return the largest range of each joint's commands within a recording, (n,) [rad].

    Of velocities that are told [rad/s], that from rest: one that never changes moves a joint, too.
    Of torques, where there are any, how far the joint moved [rad].

    Args:
        recordings: With commands.
    """
    return np.max([_range(each) for each in recordings], axis=0)


def _range(recording: Recording) -> FloatArray:
    command = commands_of(recording)
    rest = np.where(commanded_by(VELOCITY, recording.channels), 0.0, command[0])
    commands = np.ptp(np.vstack([command, rest]), axis=0)
    pushed = commanded_by(TORQUE, recording.channels)
    return np.where(pushed & command.any(axis=0), np.ptp(recording.position, axis=0), commands)


def busiest(recordings: Sequence[Recording]) -> Recording:
    """Return the recording in which most joints are told to move.

    Args:
        recordings: With commands.
    """
    return max(recordings, key=lambda r: float(commanded_range([r]).clip(max=_ENOUGH).sum()))
