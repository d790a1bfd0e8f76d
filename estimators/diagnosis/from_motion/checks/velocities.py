"""Joints that do not follow: velocities that are not obeyed, and rest while commands move.

What is wrong with velocities that were commanded: units, joints, signs; joints that do not obey.

What a servo of velocity follows is not where its joint is, but how fast that changes.

A joint that rests for long while its command moves by more than friction can hold.

Where it then moves on as fast as no joint does, its rows were left out of the recording: a joint
that is stalled and let go looks there like an encoder that hangs.

Which unit positions are in, by the steps in which encoders tell them.

An encoder on a joint divides a turn into a power of two: 2π / 4096 rad at 12 bit. Normalised
positions have steps of their own, as each joint's range is another number of them.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Final

import numpy as np

from estimators.diagnosis.from_motion.simulation.free_run import MOVED, commands_of
from estimators.diagnosis.settings import CLEARLY, HALF, LEVEL, MATTERS, MOST, SOME
from estimators.diagnosis.settings.residuals import MISTAKES
from limo_driver.errors import RecordingError
from limo_driver.model.units import unit_of
from limo_driver.recordings.bandwidth import bandwidth_for
from limo_driver.recordings.channels import POSITION, VELOCITY, commanded_by
from limo_driver.recordings.gate.held_values import held_reason

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from limo_driver.recordings.recording import Recording
    from limo_driver.types import FloatArray

_LATE: Final = 0.3  # [s], by which a joint may follow
ALIKE, UNLIKE = MOST, HALF  # correlations
_STRAIGHT: Final = LEVEL  # correlation of commands and positions that are alike
_SAME: Final = 1e-6  # of the velocity, by which commands are the velocity itself
_LESS, MORE = MATTERS, 1.3  # times as fast as told, that a servo moves its joint
_UNITS: Final = {"deg/s": 180.0 / np.pi, "revolutions per minute": 30.0 / np.pi}  # in 1 rad/s
_NEAR: Final = (MOST, CLEARLY)  # of such a number, that a servo may lack or friction take
_LASTING: Final = 1.0  # [s] in which a joint does not obey
LOOSE: Final = 0.15  # [rad, rad/s] that a joint does not move away from where it is told to rest
AT_REST: Final = 0.002  # [rad] that a joint moves less than where it rests
FOLLOWED: Final = 0.1  # [rad] by which a servo in order may be behind its command
_TIMES: Final = 2.0  # what friction holds elsewhere in the recording, that it has to exceed
_LONG: Final = 0.5  # [s], beside which a command that acts late is short
_WHOLE: Final = 0.02  # of a step, by which changes are whole numbers of it, and steps alike
_FINEST: Final = 1e-6  # [rad], a step of no encoder: finer ones are of numbers of 32 bits


@dataclass(frozen=True)
class _Told:
    """Joints of a recording that are told velocities."""

    recording: Recording
    joints: tuple[int, ...]  # 0-based
    command: FloatArray  # (T, n) [rad/s]
    velocity: FloatArray  # (T, n) [rad/s], zero-phase

    def follows(self, j: int, k: int, late: bool = True) -> float:
        """Return how much the velocity of a joint is like a command, as it may follow later."""
        most = round(_LATE * self.recording.rate) if late else 0
        commanded, does = self.command[:, k], self.velocity[:, j]
        every = range(min(most, len(commanded) // 2) + 1)
        found = [correlation(commanded[: len(commanded) - m], does[m:]) for m in every]
        return max(found, key=abs)

    def moves(self, j: int) -> bool:
        """Say whether a joint moves enough to be judged."""
        return bool(np.ptp(self.recording.position[:, j]) > MOVED)

    def slope(self, j: int) -> float:
        """Return how fast a joint moves for each unit of its command: of the larger ones."""
        size = [float(np.quantile(np.abs(x[:, j]), LEVEL)) for x in (self.velocity, self.command)]
        return size[0] / size[1] if size[1] > 0.0 else np.inf


def check_velocities(recording: Recording, number: int, sliding: Sequence[bool]) -> tuple[str, ...]:
    """Refuse commands that are not the velocities of their joints in rad/s; tell what else is odd.

    Args:
        recording: With commands, of velocity or not.
        number: Of it among those given, by which it is told if it has no file.
        sliding: Which joints slide, (n,).

    Returns:
        One sentence for each joint that stalled, or moved while it was told to rest.

    Raises:
        RecordingError: Names what the commands seem to be.
    """
    joints = tuple(np.flatnonzero(commanded_by(VELOCITY, recording.channels)).tolist())
    if not joints:
        return ()
    velocity = recording.motion(bandwidth_for([recording])).velocity
    commanded = _Told(recording, joints, commands_of(recording), velocity)
    units = {j: unit_of("rad", sliding, j) for j in joints}
    for j in joints:
        if commanded.moves(j) and (mistake := _mistake(commanded, j, units[j])):
            raise RecordingError(mistake, path=recording.source or None)
    name = recording.source or f"recording {number}"
    return tuple(text for j in joints for text in _odd(commanded, j, name, units[j]))


def set_points_alone(recording: Recording) -> Recording:
    """Return a recording in which joints that are told velocities rest at 0, as do their commands.

    Args:
        recording: With commands.
    """
    own = commanded_by(POSITION, recording.channels)
    if own.all():
        return recording
    position, command = (
        np.where(own, x, 0.0) for x in (recording.position, commands_of(recording))
    )
    return replace(recording, position=position, command=command)


def _mistake(commanded: _Told, j: int, unit: str) -> str:
    """Say what is wrong with the commands of a joint that moves."""
    name, command = f"{VELOCITY.name}_{j + 1}", commanded.command[:, j]
    if not command.any():
        return (
            f"{name} is always 0 while joint {j + 1} moves; expected the velocity in force at "
            "each row; was the arm led by hand, or its torque disabled?"
        )
    if _is_measured(commanded, j):
        return (
            f"{name} is the velocity of joint {j + 1} itself; expected the one that was commanded; "
            "was what was measured recorded as command?"
        )
    own = commanded.follows(j, j)
    others = [k for k in commanded.joints if k != j and abs(own) < UNLIKE]
    if (k := next((k for k in others if commanded.follows(j, k) > ALIKE), None)) is not None:
        return f"joint {j + 1} follows {VELOCITY.name}_{k + 1}, not {name}; are joints exchanged?"
    position = commanded.recording.position[:, j]
    if correlation(command, position) > max(ALIKE, abs(own) + SOME):
        return (
            f"{name} follows position_{j + 1}, not its velocity; expected {unit}/s; are these "
            f"set-points of positions, {POSITION.name}_{j + 1}?"
        )
    if own < -ALIKE:
        return f"joint {j + 1} moves against {name}; has one of them the other sign?"
    return _unit_mistake(commanded, j, unit) if own > ALIKE else ""


def _is_measured(commanded: _Told, j: int) -> bool:
    """Say whether commands are what was measured, as the log has it or as positions change."""
    recording, command = commanded.recording, commanded.command[:, j]
    position, time = recording.position[:, j], recording.time
    known = [np.gradient(position, time), np.append(np.diff(position) / np.diff(time), command[-1])]
    if recording.velocity is not None:
        known.append(recording.velocity[:, j])
    size = float(np.abs(command).mean())
    return any(float(np.abs(own - command).mean()) < _SAME * size for own in known)


def _unit_mistake(commanded: _Told, j: int, unit: str) -> str:
    """Say which unit commands seem to have that a joint follows, if it is not SI."""
    slope, name = commanded.slope(j), f"{VELOCITY.name}_{j + 1}"
    if _LESS < slope < MORE:
        return ""
    by_row = commanded.recording.rate  # rad/s that a change of 1 rad by row is
    if slope > MORE and 1.0 / _NEAR[1] < slope / by_row < 1.0 / _NEAR[0]:
        what = "changes of the position by row"
    else:
        near = [other for other, many in _UNITS.items() if _NEAR[0] < 1.0 / slope / many < _NEAR[1]]
        what = f"in {near[0]}" if near else "in another unit, or normalised"
    return (
        f"joint {j + 1} moves by {slope:.3g} {unit}/s where {name} is 1; expected {unit}/s; are "
        f"the commands {what}?"
    )


def _odd(commanded: _Told, j: int, name: str, unit: str) -> Iterator[str]:
    """Yield what a joint did that no servo of velocity in order does."""
    recording = commanded.recording
    rows = max(2, round(_LASTING * recording.rate))
    for start in range(0, len(recording) - rows, rows):
        part, before = slice(start, start + rows), slice(max(0, start - rows), start + rows)
        command, moved = commanded.command[part, j], float(np.ptp(recording.position[part, j]))
        where = f"{name}, {recording.time[start]:.1f} s"
        slowest = float(np.abs(command).min())
        if moved < AT_REST and slowest > LOOSE and abs(float(np.sign(command).sum())) == rows:
            yield (
                f"joint {j + 1} is stalled: it rests while it is told {slowest:.2f} {unit}/s "
                f"({where})"
            )
            return
        if not commanded.command[before, j].any() and moved > LOOSE * _LASTING:
            yield (
                f"joint {j + 1} moves by {moved:.2f} {unit} while it is told to rest; was its "
                f"torque disabled? ({where})"
            )
            return


def stuck(
    time: FloatArray, command: FloatArray, position: FloatArray
) -> tuple[float, float, float]:
    """Return from when to when a joint is stuck [s], and how far its command moves then [rad].

    Dry friction holds each joint until its servo's torque exceeds it: by how much a command moves
    before, every rest of the joint shows. A stuck one rests while its command moves further.

    Args:
        time: (T,) [s].
        command: (T,) [rad].
        position: (T,) [rad].

    Returns:
        First and last time, and swing; a swing of 0 if it is not.
    """
    swings = list[tuple[float, float, float, float]]()
    for start, stop in _rests(position):
        last = int(np.searchsorted(time, time[stop - 1] - _LATE, "right"))
        if last - start > 1:
            lasting = float(time[last - 1] - time[start])
            ends = float(time[start]), float(time[stop - 1])
            swings.append((float(np.ptp(command[start:last])), lasting, *ends))
    if not swings:
        return 0.0, 0.0, 0.0
    swing, lasting, since, until = max(swings)
    usual = sorted(own for own, *_ in swings)[-2] if len(swings) > 1 else 0.0
    is_stuck = lasting > _LONG and swing > max(FOLLOWED, _TIMES * usual)
    return (since, until, swing) if is_stuck else (0.0, 0.0, 0.0)


def resting_around(time: FloatArray, position: FloatArray, rows: slice) -> tuple[float, float]:
    """Return from when to when a joint rests that does so over some rows [s].

    Args:
        time: (T,) [s].
        position: (T,) [rad].
        rows: Within which it rests.
    """
    middle = float(np.ptp(position[rows]) / 2.0 + position[rows].min())
    away = np.flatnonzero(np.abs(position - middle) > AT_REST)
    k = int(np.searchsorted(away, rows.start))
    first = int(away[k - 1]) + 1 if k else 0
    last = int(away[k]) - 1 if k < away.size else time.size - 1
    return float(time[first]), float(time[last])


def left_out_at_rest(recording: Recording, j: int, name: str, unit: str) -> Iterator[str]:
    """Yield that a recording lacks rows as a joint rested in them, and then jumped.

    Args:
        recording: With commands.
        j: The joint, 0-based.
        name: Of the recording.
        unit: Of its positions.
    """
    assert recording.rows is not None  # noqa: S101  # set as it is made
    lost = [row for out in recording.left_out if out.reason == held_reason(j) for row in out.rows]
    behind = np.unique(np.searchsorted(recording.rows, np.array(lost, dtype=np.int64)))
    for k in behind[(behind > 0) & (behind < len(recording))].tolist():
        since, until = map(float, recording.time[k - 1 : k + 1])
        if until - since > _LATE:
            jump = abs(float(recording.position[k, j] - recording.position[k - 1, j]))
            yield (
                f"joint {j + 1} is stalled, or its encoder hangs: its position repeats a value "
                f"while its command moves on, and then jumps by {jump:.2f} {unit}; these rows "
                f"are left out ({name}, {from_to(since, until)})"
            )


def from_to(since: float, until: float) -> str:
    """Return two times [s] in words."""
    return f"{since:.1f} s to {until:.1f} s"


def _rests(position: FloatArray) -> Iterator[tuple[int, int]]:
    """Yield the first row, and the one behind the last, of stretches in which a joint rests."""
    start, low, high = 0, position[0], position[0]
    for i, value in enumerate(position):
        low, high = min(low, value), max(high, value)
        if high - low >= AT_REST:
            yield start, i
            start, low, high = i, value, value
    yield start, position.size


def correlation(x: FloatArray, y: FloatArray) -> float:
    """Return the correlation of two series, (T,) each; 0 where one does not change."""
    x, y = x - x.mean(), y - y.mean()
    power = float(np.sqrt((x @ x) * (y @ y)))
    return float(x @ y) / power if power > 0 else 0.0


def odd_steps(recording: Recording, sliding: Sequence[bool] = ()) -> str:
    """Say which joints' positions come in steps of no encoder's, or nothing.

    Args:
        recording: Of n joints.
        sliding: Which joints slide, (n,), and so have steps of a length; empty if none does.
    """
    turns = [j for j in range(recording.n) if not any(sliding[j : j + 1])]
    steps = {j: _step(recording.position[:, j]) for j in turns}
    odd = [j for j, step in steps.items() if step > 0.0]
    if any(_of_a_turn(steps[j]) for j in odd):
        return ""
    different = [j for j in odd if abs(steps[j] / steps[odd[0]] - 1.0) > _WHOLE]
    if not different:
        return ""
    j, k = odd[0], different[0]
    return (
        f"position_{j + 1} comes in steps of {steps[j]:.3g}, position_{k + 1} of {steps[k]:.3g}; "
        "steps of an encoder on a joint are a turn over a power of two, 0.00153 rad at 12 bit; "
        "are positions and commands normalised, as -1 to 1?"
    )


def _step(position: FloatArray) -> float:
    """Return the step of which all changes of a position are multiples; 0 if there is none.

    By the changes, since `telemetry.resolution`, which goes by the values, needs each some times.
    """
    changes = np.abs(np.diff(position))
    changes = changes[changes > 0.0]
    if changes.size < MISTAKES.least_moving:
        return 0.0
    step = float(np.percentile(changes, 1, method="lower"))
    near = changes[changes < CLEARLY * step]
    step = float(np.median(near))
    times = changes / step
    off = np.abs(times - np.round(times)) / np.maximum(np.round(times), 1.0)
    return step if step > _FINEST and float((off < _WHOLE).mean()) > 1 - _WHOLE else 0.0


def _of_a_turn(step: float) -> bool:
    """Say whether a step [rad] is a turn over a power of two."""
    bits = np.log2(2.0 * np.pi / step)
    return bool(abs(bits - round(bits)) < np.log2(1.0 + _WHOLE))


def slope_of(command: FloatArray, position: FloatArray) -> float:
    """Return how far a joint moves for each unit of its command; 0 if they are not much alike."""
    if correlation(command, position) < _STRAIGHT:
        return 0.0
    target = command - command.mean()
    return float(target @ position) / float(target @ target)
