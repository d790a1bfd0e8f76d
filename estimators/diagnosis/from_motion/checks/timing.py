"""Whether commands stand at the rows from which on they act: fits that may look ahead tell.

Frames that were dropped: rows that are missing, whether or not times of the others say so.
"""

from __future__ import annotations

from itertools import combinations
from typing import TYPE_CHECKING, Final

import numpy as np
from scipy.ndimage import maximum_filter1d, minimum_filter1d

from estimators.diagnosis.from_motion.checks.velocities import FOLLOWED, LOOSE, UNLIKE
from estimators.diagnosis.from_motion.fitting.joint import GLANCE, GLANCED, errors, fit_joint
from estimators.diagnosis.from_motion.fitting.starts import (
    choose_start,
    most_of,
    regressed,
    typical_start,
)
from estimators.diagnosis.from_motion.simulation.constants import (
    DAMPING,
    GAIN,
    value_in,
    with_values,
)
from estimators.diagnosis.from_motion.simulation.free_run import MOVED, busiest, commands_of
from estimators.diagnosis.from_motion.simulation.loads import ArmChange, ArmLoads
from estimators.diagnosis.from_motion.simulation.plant import rows_of
from estimators.diagnosis.settings import CLEARLY, FAR, FEW, MATTERS, MOST, NEARLY_ALL, SOME, TINY
from estimators.diagnosis.settings.residuals import REPEATS
from limo_driver.errors import RecordingError
from limo_driver.recordings.channels import TORQUE, VELOCITY, commanded_by

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from numpy.typing import NDArray

    from estimators.diagnosis.from_motion.fitting.joint import JointFit
    from estimators.diagnosis.from_motion.simulation.one_joint import LoadedJoint
    from limo_driver.physics import Simulation
    from limo_driver.recordings.recording import Recording
    from limo_driver.types import BoolArray, FloatArray

_FARTHEST: Final = 0.5  # [s] of looking ahead
_TRIED: Final = 50  # delays, of torques
_OF_ONE_SIZE: Final = 2.0  # times the least, that lags of joints differ if they have one cause
_NONE: Final = 1e-3  # [s], a delay that is none


def check_timing(simulation: Simulation, recordings: Sequence[Recording]) -> tuple[str, ...]:
    """Refuse commands that come later than what they cause; tell where all delay is missing.

    A servo lags by its delay and by damping over gain. Where a fit takes no delay, and gets better
    as it looks ahead, no servo has made the motion from these rows. The recording
    of most motion is judged, and others in which positions seem to come before commands: a soft
    servo under a weight swings ahead of its commands at times, so that this alone proves nothing.

    Args:
        simulation: With a position servo for each joint.
        recordings: With commands.

    Returns:
        A sentence, if no joint of that recording has a delay although one is stated, or lags by as
        much as its stated damping makes it.

    Raises:
        RecordingError: Joints follow commands of later rows.
    """
    first = busiest(recordings)
    others = (each for each in recordings if each is not first and _seems_early(each))
    judged = [first, *others][:GLANCED]
    (delays, short), *_ = [_judge(simulation, each) for each in judged]
    believed = float(np.median([value_in(row, "delay") for row in rows_of(simulation)]))
    if delays and max(delays) <= _NONE < believed:
        return (
            f"No joint has a delay, although {believed:.3g} s are stated: commands may be recorded "
            "later than they came into force, and damping found here is then too small.",
        )
    return _about_lags(delays, short, 1.0 / first.rate)


def _about_lags(delays: Sequence[float], short: Sequence[float], period: float) -> tuple[str, ...]:
    """Say by how much commands came late that damping over gain hides.

    It lets each joint lag as a delay does, and less of it looks like a delay below zero.

    Args:
        delays: Of each joint [s].
        short: By how much each lags less than stated, by damping over gain [s].
        period: Of the rows [s].
    """
    least = min(short, default=0.0)
    if least <= period or max(short) > _OF_ONE_SIZE * least or max(delays) > MATTERS * least:
        return ()
    return (
        f"No joint has a delay, and all follow their commands {np.median(short):.2g} s sooner than "
        "damping over gain, as stated, lets them: commands may be recorded so much later than they "
        "came into force, and damping found here is then too small.",
    )


def _judge(simulation: Simulation, recording: Recording) -> tuple[list[float], list[float]]:
    """Return the delay of each joint that moves and has a servo, or refuse the recording.

    Returns:
        The delays [s]; and by how much joints lag less than stated, by damping over gain [s].
    """
    stated, load = rows_of(simulation), ArmLoads(simulation.body, [recording])
    parts = load.parts(ArmChange.none(load.n))
    period = 1.0 / recording.rate
    ahead = (-period * np.arange(round(_FARTHEST / period) + 1)).tolist()
    leads, gains = list[float](), list[float]()
    delays, short = list[float](), list[float]()
    for j in np.flatnonzero(np.ptp(recording.position, axis=0) > MOVED).tolist():
        if stated[j, GAIN] > 0.0:
            lead, gain = _lead(parts[j], stated[j], ahead[:: max(1, len(ahead) // _TRIED)])
            leads.append(lead)
            gains.append(gain)
            continue
        begun = choose_start(parts[j], typical_start(stated[j]))
        fit = fit_joint(parts[j], begun, evaluations=GLANCE)
        delays.append(fit.value("delay"))
        short.append(_damped(stated[j]) - _damped(fit.row))
        if delays[-1] > _NONE:
            leads.append(0.0)
            gains.append(1.0)
            continue
        scores = [
            float(np.abs(errors(parts[j], with_values(fit.row, {"delay": delay}))).mean())
            for delay in ahead
        ]
        best = int(np.argmin(scores))
        if scores[best] < MOST * fit.mean_error:
            fit = min(fit, _limited(parts[j], fit), key=lambda own: own.mean_error)
        leads.append(-ahead[best])
        gains.append(scores[best] / max(fit.mean_error, TINY))
    if leads and np.median(leads) > 0.0 and np.median(gains) < MOST:
        raise RecordingError(
            f"commands come {float(np.median(leads)):.3g} s or more later than the positions that "
            "follow them; expected the set-point in force at each row",
            path=recording.source or None,
        )
    return delays, short


def _damped(row: FloatArray) -> float:
    """Return the lag of a servo by damping over gain [s]; one of velocity has none."""
    gain = value_in(row, "kp")
    return (value_in(row, "kd") + value_in(row, DAMPING)) / gain if gain > 0.0 else 0.0


def _lead(
    parts: Sequence[LoadedJoint], row: FloatArray, ahead: Sequence[float]
) -> tuple[float, float]:
    """Return by how much torques seem to come late [s], and what is left of the load by that.

    What a joint needs is known of its motion, without a simulation that drifts: of what it is told,
    this follows the torque that was in force.

    Args:
        parts: Recorded stretches of a joint that is told torques.
        row: The constants of the joint.
        ahead: Delays that are tried, from 0 down [s].

    Returns:
        The lead, and the unexplained torque there, over the least of those that were no lead.
    """
    scores = [regressed(parts, row, delay)[0] for delay in ahead]
    behind = min(regressed(parts, row, -delay)[0] for delay in ahead)
    best = int(np.argmin(scores))
    if not np.isfinite(behind):
        return 0.0, 1.0
    return -ahead[best], scores[best] / max(behind, TINY)


def _limited(parts: Sequence[LoadedJoint], fit: JointFit) -> JointFit:
    """Return the fit of a servo that is driven beyond its torque, behind a gear that load holds.

    What these do is no look ahead, and is explained by one in part.
    """
    limit = MOST * most_of("torque_limit", parts, fit.row)
    begun = with_values(fit.row, {"torque_limit": limit, "by_load": MATTERS})
    names = (*fit.names, "torque_limit", "by_load")
    return fit_joint(parts, begun, names)


def _seems_early(recording: Recording) -> bool:
    """Say whether most joints that move seem to do so before their commands.

    Nobody sees that of torques: those that hold a joint back come before it turns, too.
    """
    command, position = commands_of(recording), recording.position
    period = np.diff(recording.time, append=recording.time[-1])[:, None]
    commanded = np.cumsum(command * period, axis=0)  # where velocities would lead
    command = np.where(commanded_by(VELOCITY, recording.channels), commanded, command)
    moves = np.minimum(np.ptp(position, axis=0), np.ptp(command, axis=0)) > MOVED
    moving = np.flatnonzero(moves & ~commanded_by(TORQUE, recording.channels))
    shifts = [_shift(command[:, j], position[:, j], recording.rate) for j in moving.tolist()]
    return bool(shifts) and float(np.median(shifts)) < -1.0 / recording.rate


def _shift(command: FloatArray, position: FloatArray, rate: float) -> float:
    """Return by how much a position seems later than its command [s]."""
    reach = max(1, round(_FARTHEST * rate))
    mean = np.ones(FEW) / FEW
    commanded, did = (np.convolve(np.diff(x), mean, "same") for x in (command, position))
    if commanded.size < 4 * reach:
        return 0.0
    ahead = commanded[reach:-reach]
    scores = [
        float(np.corrcoef(ahead, did[reach + k : did.size - reach + k])[0, 1])
        if np.ptp(ahead) and np.ptp(did[reach + k : did.size - reach + k])
        else 0.0
        for k in range(-reach, reach + 1)
    ]
    best = int(np.argmax(scores))
    return (best - reach) / rate if scores[best] > UNLIKE else 0.0


_AROUND: Final = 2  # rows before a leap and behind it, that have to agree
_TOGETHER: Final = 0.5  # of what joints jump, that their commands do in the same row
_PAST: Final = 2.0  # [s], in which a servo in order has come to where it was told


def dropped_frames(recording: Recording, name: str) -> Iterator[str]:
    """Yield what says that frames were dropped, if anything does.

    Args:
        recording: With commands.
        name: Of the recording, as it is told.
    """
    time = recording.time
    if (late := _late(recording)).size >= FEW:
        yield (
            f"rows are missing: {late.size} times the next one came two periods later or more "
            f"({name}, first at {time[late[0]]:.1f} s)"
        )
    if len(rows := _leaps(recording)) >= FEW:
        yield (
            f"in {len(rows)} rows joints move much further than in the rows around; "
            f"were frames dropped and the others stamped evenly? ({name}, first at "
            f"{time[rows[0]]:.1f} s)"
        )
    elif (row := _jump(recording)) is not None:
        yield (
            f"joints and their commands jump within one row, faster than anywhere else; were many "
            f"frames dropped and the others stamped evenly? ({name}, {time[row]:.1f} s)"
        )


def _late(recording: Recording) -> NDArray[np.intp]:
    """Return the rows behind which one or two are missing, by even times of the others.

    More of them are a gap, which is told as one; rows that were left out are not missing.
    """
    steps = np.diff(recording.time)
    period = float(np.median(steps))
    if float(np.quantile(np.abs(steps - period), NEARLY_ALL)) > SOME * period:
        return np.array([], dtype=np.intp)
    left_out = [row for item in recording.left_out for row in item.rows]
    given = np.setdiff1d(np.arange(len(recording) + len(left_out)), left_out)
    return np.flatnonzero((steps > CLEARLY * period) & (np.diff(given) == 1))


def _jump(recording: Recording) -> int | None:
    """Return the row at which the arm and its commands are elsewhere at once, if there is one.

    A command that steps is followed later. Where all joints that move are elsewhere in the same row
    as their commands, time is amiss: two of them at least, if two ever move.
    """
    position, command, time = recording.position, commands_of(recording), recording.time
    row = int(np.argmax(np.linalg.norm(_paces(position, time), axis=1)))
    moved, commanded = (x[row + 1] - x[row] for x in (position, command))
    jumped = (
        _fastest(position, time, row)
        & _fastest(command, time, row)
        & (commanded * moved > _TOGETHER * moved**2)
        & (np.abs(moved) > REPEATS.near)
    )
    least = min(2, int((np.ptp(position, axis=0) > REPEATS.near).sum()))
    return row + 1 if 0 < least <= int(jumped.sum()) else None


def _paces(values: FloatArray, time: FloatArray) -> FloatArray:
    """Return how fast joints move to each next row, (T - 1, n) [rad/s]."""
    return np.abs(np.diff(values, axis=0) / np.diff(time)[:, None])


def _fastest(values: FloatArray, time: FloatArray, row: int) -> BoolArray:
    """Say which joints move much faster behind a row than anywhere else, (n,)."""
    pace = _paces(values, time)
    return pace[row] > FAR * np.delete(pace, row, axis=0).max(axis=0, initial=0.0)


def _leaps(recording: Recording) -> list[int]:
    """Return rows to which all joints leap, from a steady pace to the same one.

    No motor does that, nor a row that is read late: the next one would be short. Paces of all
    joints together are one vector; its change in a row is told in units of the encoders' steps.
    Steady is what two rows before and two behind agree on: a joint that speeds up and slows down
    within few rows, as all do at slow rates, is fastest in the middle, too.
    """
    step = np.diff(recording.position, axis=0)
    size = np.where(step == 0.0, np.inf, np.abs(step))
    ticks = np.percentile(size, 1, axis=0, method="lower")
    tick = float(np.median(ticks[np.isfinite(ticks)])) if np.isfinite(ticks).any() else 0.0
    period = np.diff(recording.time)[:, None]
    pace = step / period
    if len(pace) < 2 * _AROUND + 1:
        return []
    last = len(pace) - _AROUND
    here, least = pace[_AROUND:last], tick / period[_AROUND:last, 0]
    around = [pace[_AROUND + k : last + k] for k in (*range(-_AROUND, 0), *range(1, _AROUND + 1))]
    mean = np.mean(around, axis=0)
    length = np.linalg.norm(mean, axis=1)
    fast = length > FAR * least
    length = np.where(fast, length, 1.0)
    times = (here * mean).sum(axis=1) / length**2
    apart = np.max([np.linalg.norm(a - b, axis=1) for a, b in combinations(around, 2)], axis=0)
    uneven = np.maximum(apart - 2.0 * least, 0.0) / length
    leap = (times > CLEARLY) & (times - 1.0 > FAR * uneven) & (uneven < 1.0)
    return (np.flatnonzero(leap & fast) + _AROUND).tolist()


def moved_away(time: FloatArray, command: FloatArray, position: FloatArray) -> tuple[float, float]:
    """Return since when a joint is led away from its commands [s], and how far [rad].

    A servo lags, sags and swings; what it never does is leave the range of all that it was told in
    the last seconds by a lot, from near it, by moving itself.

    Args:
        time: (T,) [s].
        command: (T,) [rad].
        position: (T,) [rad].

    Returns:
        Time and distance; a distance of 0 if it is not.
    """
    rows = max(1, round(_PAST / float(np.median(np.diff(time)))))
    low, high = (
        of(command, rows + 1, origin=rows // 2, mode="nearest")
        for of in (minimum_filter1d, maximum_filter1d)
    )
    beyond = np.where(position > high, position - high, np.minimum(position - low, 0.0))
    near = -1
    for i, far in enumerate(beyond.tolist()):
        if abs(far) < FOLLOWED:
            near = i
        elif abs(far) > FAR * FOLLOWED and near >= 0:
            if np.sign(far) * (position[i] - position[near]) > LOOSE:
                return float(time[near]), float(np.abs(beyond[near : i + rows]).max())
            near = -1  # its command went away from it
    return 0.0, 0.0
