"""What is wrong with commands: other units, joints or times, and drives that do not follow."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING, Final

import numpy as np

from estimators.diagnosis.from_motion.checks.timing import dropped_frames, moved_away
from estimators.diagnosis.from_motion.checks.velocities import (
    ALIKE,
    AT_REST,
    FOLLOWED,
    LOOSE,
    MORE,
    UNLIKE,
    check_velocities,
    correlation,
    from_to,
    left_out_at_rest,
    odd_steps,
    resting_around,
    set_points_alone,
    slope_of,
    stuck,
)
from estimators.diagnosis.from_motion.simulation.free_run import MOVED, commanded_range, commands_of
from estimators.diagnosis.settings import FEW, SOME
from limo_driver.errors import RecordingError
from limo_driver.model.units import unit_of
from limo_driver.recordings.checks import MOST_NORMALISED

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from limo_driver.recordings.recording import Recording
    from limo_driver.types import BoolArray, FloatArray

_TURNS: Final = 4 * np.pi  # [rad], that no joint behind a position servo reaches or spans
_NORMALISED: Final = 8.0  # times the positions' range, from which on commands are no angles
_ENDS: Final = 2  # joints, and rows of each, at exactly the end of a normalised range
_LAG: Final = 0.5  # [s], by which a joint may follow its command later
_STALLED: Final = (0.25, 1.0)  # [rad] of error that stays, for so long [s]
_GAP: Final = re.compile(r"\d+ gaps?;")  # as recordings warn of them
_SAME: Final = 1e-6  # [rad], mean distance of commands that are the positions themselves


def check_commands(
    recordings: Sequence[Recording], sliding: Sequence[bool] = ()
) -> tuple[str, ...]:
    """Do as `check_set_points` does, and refuse commands of which none moves a joint.

    Args:
        recordings: With commands.
        sliding: Which joints slide, (n,); empty if none does.

    Returns:
        What is odd about them.

    Raises:
        RecordingError: Names what the commands seem to be.
    """
    odd = check_set_points(recordings, sliding)
    if not (commanded_range(recordings) > MOVED).any():
        raise RecordingError(
            f"no command changes by more than {MOVED:g} {unit_of('rad', sliding)}; expected "
            "set-points that move the joints: nothing of a drive shows while it rests",
            path=recordings[0].source or None,
        )
    return odd


def check_set_points(recordings: Sequence[Recording], sliding: Sequence[bool]) -> tuple[str, ...]:
    """Refuse commands that are not set-points of their joints in rad; tell what is odd otherwise.

    Velocities that are commanded are judged by how fast joints move, in rad/s.

    Args:
        recordings: With commands.
        sliding: Which joints slide, (n,); empty if none does.

    Returns:
        One sentence for each joint that stalled, or moved although its command rested, and for
        rows that are missing.

    Raises:
        RecordingError: Names what the commands seem to be.
    """
    every = enumerate(recordings, start=1)
    velocities = [
        text for number, each in every for text in check_velocities(each, number, sliding)
    ]
    recordings = [set_points_alone(each) for each in recordings]
    for recording in recordings:
        mistake = (
            _unit_mistake(recording, sliding)
            or _no_commands(recording)
            or _exchange_mistake(recording)
            or _scale_mistake(recording, sliding)
            or _mistake(recording)
        )
        if mistake:
            raise RecordingError(mistake, path=recording.source or None)
    odd = [
        text
        for number, recording in enumerate(recordings, start=1)
        for text in _odd(recording, recording.source or f"recording {number}", sliding)
    ]
    return (*odd, *velocities)


def _unit_mistake(recording: Recording, sliding: Sequence[bool]) -> str:
    """Say which unit commands and positions alike seem to have, if it is not SI."""
    target, does = (_reach(each) for each in (commands_of(recording), recording.position))
    beyond = np.flatnonzero(np.minimum(target, does) > _TURNS)
    if not beyond.size:
        return _at_one(recording, sliding)
    j = int(beyond[0])
    other = "mm" if any(sliding[j : j + 1]) else "degrees, or normalised, as -100 to 100"
    return (
        f"position_{j + 1} and command_{j + 1} reach {does[j]:.3g} and {target[j]:.3g}; expected "
        f"{unit_of('rad', sliding, j)}; are both in {other}?"
    )


def _reach(values: FloatArray) -> FloatArray:
    """Return how far joints go from zero, or from one end to the other, (n,)."""
    return np.maximum(np.ptp(values, axis=0), np.abs(values).max(axis=0))


def _at_one(recording: Recording, sliding: Sequence[bool]) -> str:
    """Say whether all values end where joints do if they are normalised: at exactly one."""
    position = np.abs(recording.position)
    if max(float(position.max()), float(np.abs(commands_of(recording)).max())) > 1.0:
        return ""
    ends = np.flatnonzero((position == 1.0).sum(axis=0) >= _ENDS) + 1
    if ends.size < _ENDS:
        return ""
    return (
        f"no position and no command is beyond 1, and joints {', '.join(map(str, ends))} end at "
        f"exactly that; expected {unit_of('rad', sliding)}; are both normalised, as -1 to 1?"
    )


def _no_commands(recording: Recording) -> str:
    """Say why columns of commands cannot be set-points that a servo followed."""
    command, position = commands_of(recording), recording.position
    moves = np.ptp(position, axis=0) > MOVED
    if not moves.any():
        return ""
    if not np.ptp(command, axis=0).any():
        return (
            "no command changes while the joints move; expected the set-point in force at each "
            "row; was the arm led by hand, or its torque disabled?"
        )
    for ahead in range(min(FEW + 1, len(position) // 2)):
        target, did = command[: len(command) - ahead, moves], position[ahead:, moves]
        same = np.flatnonzero(moves)[np.abs(target - did).mean(axis=0) < _SAME]
        if same.size:
            j = int(same[0]) + 1
            later = f"of {ahead} row{'s' * (ahead > 1)} later" if ahead else "itself"
            return (
                f"command_{j} is position_{j} {later}; expected the set-point in force at each "
                "row; were positions recorded as commands?"
            )
    return ""


def _scale_mistake(recording: Recording, sliding: Sequence[bool]) -> str:
    """Say which unit the commands alone seem to have, if it is not SI."""
    command, position = commands_of(recording), recording.position
    target, does = np.ptp(command, axis=0), np.ptp(position, axis=0)
    judged = np.flatnonzero((does > MOVED) & (target > 0))
    beyond = judged[target[judged] > _NORMALISED * does[judged]]
    if any(correlation(command[:, j], position[:, j]) > UNLIKE for j in beyond.tolist()):
        j = int(beyond[0])
        own, unit = unit_of("rad", sliding, j), _unit(target[beyond], does[beyond], command)
        return (
            f"command_{j + 1} spans {target[j]:.3g} while position_{j + 1} spans {does[j]:.3g} "
            f"{own}; expected set-points in {own}; are the commands {unit}?"
        )
    far = np.flatnonzero((target > MOVED) & (does > _NORMALISED * target))
    if far.size and correlation(command[:, far[0]], position[:, far[0]]) > ALIKE:
        j = int(far[0])
        own, unit = unit_of("rad", sliding, j), _unit(does[far], target[far], position)
        return (
            f"position_{j + 1} spans {does[j]:.3g} while command_{j + 1} spans {target[j]:.3g} "
            f"{own}; expected positions in {own}; are the positions {unit}?"
        )
    for j in judged.tolist():
        slope = slope_of(command[:, j], position[:, j])
        if slope > MORE:
            small = float(np.abs(command).max()) <= 1.0
            what = "normalised, as -1 to 1" if small else "in another unit"
            own = unit_of("rad", sliding, j)
            return (
                f"position_{j + 1} moves {slope:.2f} {own} where command_{j + 1} moves 1; expected "
                f"set-points in {own}, which no servo exceeds; are the commands {what}?"
            )
    return ""


def _unit(other: FloatArray, rad: FloatArray, values: FloatArray) -> str:
    """Return the unit that joints speak for: one of degrees is the same for all of them.

    Args:
        other: Range of each judged joint in that unit.
        rad: Likewise in rad; those that move little lag by too much of it.
        values: All of them in that unit, (T, n); normalised ones end at 100.
    """
    normalised = "normalised, as -100 to 100"
    factors = (other / rad)[rad >= 0.5 * rad.max()]
    if not 1 / MORE < np.deg2rad(float(factors.min())) < MORE:  # joints move as far, or less
        return normalised
    beyond = float(np.abs(values).max()) > MOST_NORMALISED
    return "in degrees" if beyond else f"in degrees, or {normalised}"


def _exchange_mistake(recording: Recording) -> str:
    """Say whose command a joint follows, if it is another's.

    Joints that move alike, or one after the other, follow each other's commands, too. So each of
    two has to follow the other's better than its own, and to go as far as that says; or one rests
    as it is told in the other's column.
    """
    command, position = commands_of(recording), recording.position
    target, does = np.ptp(command, axis=0), np.ptp(position, axis=0)
    alike = _likeness(command, position)
    far = does[:, None] / np.maximum(target, _SAME)  # (n, n), of each joint by each command
    own, moved = np.diag(alike)[:, None], does > MOVED
    follows = (alike > ALIKE) & (far > SOME) & (far < MORE)
    better = follows & ((own < UNLIKE) | (alike > own + SOME))
    mutual = better & better.T
    ratio = np.diag(far)
    sized = (ratio[:, None] > MORE) & (ratio < 1.0 / MORE) & follows & follows.T
    resting = follows & (own < UNLIKE) & ~moved
    found = np.argwhere((mutual | sized | resting | _ringed(recording, better)) & moved[:, None])
    if not found.size:
        return ""
    j, k = max(found.tolist(), key=lambda pair: alike[pair[0], pair[1]])
    return f"position_{j + 1} follows command_{k + 1}, not command_{j + 1}; are joints exchanged?"


def _ringed(recording: Recording, better: BoolArray) -> BoolArray:
    """Say who follows whose command in a ring of three joints or more, (n, n).

    In a motion that runs along the arm as a wave, each joint follows its own command later.
    """
    command, position, n = commands_of(recording), recording.position, recording.n
    late = range(min(round(_LAG * recording.rate), len(recording) // 2) + 1)
    lost = [
        max(correlation(command[: len(command) - k, j], position[k:, j]) for k in late) < UNLIKE
        for j in range(n)
    ]
    step = better & np.array(lost)[:, None]
    reached = step.copy()
    for _ in range(n):
        reached = reached | (reached @ step)
    return step & reached.T


def _mistake(recording: Recording) -> str:
    """Say whether commands seem to be changes of positions, or of the other sign."""
    command, position = commands_of(recording), recording.position
    own = np.diag(_likeness(command, position))
    judged = np.flatnonzero((np.ptp(position, axis=0) > MOVED) & (np.ptp(command, axis=0) > 0))
    changes = [j for j in judged.tolist() if own[j] < UNLIKE and _is_change(command, position, j)]
    if changes and float(own[judged].max()) < ALIKE:  # all joints are told alike
        j = changes[0] + 1
        return (
            f"command_{j} follows the change of position_{j}, not the position; expected "
            "set-points; are the commands deltas?"
        )
    against = judged[own[judged] < -ALIKE]
    if against.size:
        j = int(against[0]) + 1
        return f"position_{j} moves against command_{j}; has one of them the other sign?"
    return ""


def _likeness(command: FloatArray, position: FloatArray) -> FloatArray:
    """Return the correlation of each position with each command, (n, n)."""
    return np.array([[correlation(target, did) for target in command.T] for did in position.T])


def _is_change(command: FloatArray, position: FloatArray, j: int) -> bool:
    """Say whether a command tells how a position changes: at once, or summed up."""
    target, did = command[:, j], position[:, j]
    at_once = correlation(target[:-1], np.diff(did))
    return max(at_once, correlation(np.cumsum(target), did)) > ALIKE


def _odd(recording: Recording, name: str, sliding: Sequence[bool]) -> Iterator[str]:
    """Yield what a joint did that no servo in order does."""
    if steps := odd_steps(recording, sliding):
        yield f"{steps} ({name})"
    for text in recording.warnings:
        if _GAP.match(text):
            yield f"rows are missing: {text} ({name})"
    yield from dropped_frames(recording, name)
    for j in range(recording.n):
        unit = unit_of("rad", sliding, j)
        yield from left_out_at_rest(recording, j, name, unit)
        yield from (
            list(_not_following(recording, j, name, unit))
            or list(_moved_by_hand(recording, j, name, unit))
            or _held(recording, j, name, unit)
        )


def _moved_by_hand(recording: Recording, j: int, name: str, unit: str) -> Iterator[str]:
    """Yield that a joint moves away from all that it was told, if it does."""
    command, position = commands_of(recording)[:, j], recording.position[:, j]
    since, far = moved_away(recording.time, command, position)
    if far > 0.0:
        yield (
            f"joint {j + 1} moves {far:.2f} {unit} away from all commands of the last seconds; was "
            f"its torque disabled, or the arm led by hand? ({name}, {since:.1f} s)"
        )


def _held(recording: Recording, j: int, name: str, unit: str) -> Iterator[str]:
    """Yield that a joint is stuck though its command hardly swings, if it is."""
    command, position = commands_of(recording)[:, j], recording.position[:, j]
    since, until, swing = stuck(recording.time, command, position)
    if swing > 0.0:
        yield (
            f"joint {j + 1} is stalled: it rests while its command moves {swing:.2f} {unit}, more "
            f"than friction lets it elsewhere ({name}, {from_to(since, until)})"
        )


def _not_following(recording: Recording, j: int, name: str, unit: str) -> Iterator[str]:
    """Yield the first stretch in which a joint does not follow its command, if there is one."""
    command, position, time = commands_of(recording)[:, j], recording.position[:, j], recording.time
    span, lasting = _STALLED
    rows = max(2, round(lasting * recording.rate))
    for start in range(0, time.size - rows, rows):
        part = slice(start, start + rows)
        asked, did = command[part], position[part]
        error, moved = np.abs(asked - did), float(np.ptp(did))
        where = f"{name}, {time[start]:.1f} s"
        rests = from_to(*resting_around(time, position, part)) if moved < AT_REST else ""
        if rests and float(error.min()) > span:
            if _left(command[: start + 1], position[: start + 1]):
                yield (
                    f"joint {j + 1} moved away from its command and rests {error.mean():.2f} "
                    f"{unit} from it; was its torque disabled? ({where})"
                )
            else:
                yield (
                    f"joint {j + 1} is stalled {error.mean():.2f} {unit} from its command "
                    f"({name}, {rests})"
                )
            return
        target = float(np.ptp(asked[: rows // 2]))  # later ones may not have come into force
        if rests and target > span:
            yield (
                f"joint {j + 1} is stalled: it rests while its command moves {target:.2f} {unit} "
                f"({name}, {rests})"
            )
            return
        if np.ptp(asked) == 0 and np.ptp(command[max(0, start - rows) : start + rows]) == 0:
            away = error[-1] - error[0]
            if moved > LOOSE and away > LOOSE:
                yield (
                    f"joint {j + 1} moves away from a command that rests; was its torque "
                    f"disabled? ({where})"
                )
                return


def _left(command: FloatArray, position: FloatArray) -> bool:
    """Say whether an error began as the joint moved from its command, and not the command from it.

    A soft servo was never near its command: there, the error has grown while that rested.

    Args:
        command: (T,) [rad], until the joint rests away from it.
        position: Likewise.
    """
    error = position - command
    changed = np.flatnonzero(np.diff(command))
    resting = np.abs(error[changed[-1] + 1 if changed.size else 0 :])
    if float(resting[-1] - resting.min()) > _STALLED[0]:
        return True
    near = np.flatnonzero(np.abs(error) < FOLLOWED)
    if not near.size:
        return False
    since = int(near[-1])
    side = np.sign(error[-1])
    return bool(side * (position[-1] - position[since]) > 0.5 * abs(error[-1]))
