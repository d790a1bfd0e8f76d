"""Telemetry: what a recording is worth before anything is found in it.

Sampling, dropouts, quantisation and noise of its channels; how far each joint moves; on which side
of the gear its torque was measured; which parameters of the arm its motion says nothing about.

Chatter: torque that swings to and fro at one frequency, above all that motion asks of it.

A controller that hunts, friction compensation that changes its sign at rest, or a gear that rings
make it. Filters take it away, and friction looks smaller than it is, as it does under dither.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Final

import numpy as np

from limo_driver.errors import ConfigError, LimoError
from limo_driver.logs.readers.inspection import WELL, ShownParameter
from limo_driver.physics.described import described_effects
from limo_driver.recordings.bandwidth import bandwidth_for

if TYPE_CHECKING:
    from collections.abc import Sequence

    from estimators.rigid_body.identification import Identification
    from limo_driver.model import RobotModel
    from limo_driver.physics import Simulation
    from limo_driver.recordings.recording import Recording
    from limo_driver.types import FloatArray

_JITTER: Final = 0.2  # of a period, above which steps of time are uneven
_EVEN: Final = 0.005  # of a period, up to which nothing is worth a figure
_SLOWER: Final = (
    0.5  # of the rows that repeat a value, above which a channel is slower than the log
)
_GRID: Final = 0.02  # of a step, by which values may lie beside their grid
_FEWEST_STEPS: Final = 3
_COARSE: Final = 0.02  # of a torque's standard deviation, above which its steps matter
# Friction over what the drive can do, median of the joints. Gears lose 5 to 10 % of it, which a
# torque from currents holds; a sensor behind the gear sees bearings and cables only. Measured:
# UR10e, currents: 0.077; LWR4+ and Panda, sensors behind the gear: 0.005 and 0.006.
MOTOR_SIDE: Final = 0.03
_LACKED: Final = 0.5  # of the friction that is stated, below which a torque lacks it
_LONGEST: Final = 600.0  # [s], beyond which more of the same motion is no advice
_LEGEND: Final = (
    "m is the mass of that link, mx, my, mz mass times centre, Ixx to Izz its inertia, inertia the "
    "drive's"
)
_LOST: Final = 1e-3  # of the samples, that nobody needs to be told of
_LISTED: Final = 10
_MOVES: Final = 0.05  # [rad], range of a joint whose friction shows
_CRAWLS: Final = 0.1  # of the mean speed, below which friction is that of rest
_STILL: Final = 2e-3  # [rad], range of one that never moves
_ABOVE: Final = 1.5  # times the bandwidth of motion, from which an oscillation is chatter
_FEWEST_RATES: Final = 4.0  # sampling rate over bandwidth; less shows nothing above
_PIECE: Final = 512  # samples of each spectrum
_FEWEST_PIECES: Final = 3
_AT_ONE: Final = 0.5  # of the power above, within `_WIDTH` of one frequency; noise has it nowhere
_WIDTH: Final = 0.1  # relative
_NARROW: Final = 3.0  # times the share that even noise would have there
_STANDS_OUT: Final = 4.0  # times the power just above motion
_MATTERS: Final = 0.03  # of a torque's standard deviation, and
_STEPS: Final = 2.0  # steps in which the torque comes, below which it is no news


@dataclass(frozen=True)
class Telemetry:
    """What was found, one sentence each; the most important first."""

    sampling: tuple[str, ...]
    channels: tuple[str, ...]
    side: str
    excitation: tuple[str, ...]
    parameters: tuple[ShownParameter, ...] = ()  # of the arm, where torques tell them

    def lines(self) -> tuple[str, ...]:
        """Return all sentences."""
        side = (self.side,) if self.side else ()
        return (*self.sampling, *self.channels, *side, *self.excitation)


def telemetry_of(recording: Recording, model: RobotModel) -> Telemetry:
    """Say what a recording of a robot is worth.

    Args:
        recording: T samples of n joints.
        model: The robot.
    """
    side, excitation, shown = "", list[str](), tuple["ShownParameter", ...]()
    if not recording.has_torque:
        sentences = "no torque: commands and positions identify and diagnose the drives instead"
        channels = tuple(channels_of(recording, model.sliding))
        return Telemetry(tuple(sampling_of(recording)), channels, "", (sentences,))
    from estimators.rigid_body.identifiability import shown_by

    try:
        from estimators.rigid_body import identify

        found = identify(model, [recording])
    except LimoError as error:
        excitation = [f"nothing of the arm can be found in it: {error}"]
    else:
        width = found.rows.bandwidth
        side = gear_side(
            friction_share(found.simulation, recording, width),
            friction_share(_as_described(found.simulation), recording, width),
        )
        excitation = _excitation(found, recording)
        shown = shown_by(found, recording)
    channels = tuple(channels_of(recording, model.sliding))
    return Telemetry(tuple(sampling_of(recording)), channels, side, tuple(excitation), shown)


def telemetry_in(simulation: Simulation, recording: Recording) -> tuple[str, ...]:
    """Say what a recording is worth that a simulation was made of already.

    Args:
        simulation: Identified from it, or diagnosed with it.
        recording: T samples of n joints.
    """
    pair = simulation, _as_described(simulation)
    side = gear_side(*(friction_share(each, recording) for each in pair))
    sliding = simulation.model.sliding
    return (*sampling_of(recording), *channels_of(recording, sliding), side)


def sampling_of(recording: Recording) -> list[str]:
    """Say how evenly and how completely the recording was sampled."""
    steps = np.diff(recording.time)
    period = float(np.median(steps))
    within = steps[steps < 3.0 * period]
    spread = float(np.ptp(np.quantile(within, (0.05, 0.95))) / period) if within.size else 0.0
    even = (
        f"unevenly: 90 % of the steps spread over {spread:.0%} of a period"
        if spread > _JITTER
        else "evenly" + (f" to {spread:.0%} of a period" if spread > _EVEN else "")
    )
    sentences = [f"sampled at {1 / period:.4g} Hz for {recording.duration:.4g} s, {even}"]
    gaps = len(recording.segments) - 1
    left = sum(len(item.rows) for item in recording.left_out)
    lost = max(recording.duration / period + 1 - len(recording) - left, 0.0)
    if recording.spread:
        sentences.append(
            f"judged by {gaps + 1} stretches spread over {recording.spread} rows; dropouts between "
            "them are not seen"
        )
    elif gaps or lost > _LOST * len(recording):
        many = f"{gaps} gap{'s' * (gaps != 1)}" if gaps else "no long gap"
        share = lost / (lost + left + len(recording))
        sentences.append(f"{many}; about {lost:.0f} samples were never recorded ({share:.1%})")
    out = recording.rows_total - len(recording)
    if out:
        reasons = ", ".join(f"{len(item.rows)} {item.reason}" for item in recording.left_out)
        sentences.append(f"{out} of {recording.rows_total} rows cannot be used: {reasons}")
    return sentences


def _by_joint(known: Sequence[tuple[int, float]], units: Sequence[str]) -> str:
    """Say the value of each joint, 1-based, or the one that all have, whose units are given."""
    texts = [(j, f"{value:.3g}") for j, value in known]
    if len(texts) == len(units) and len({(text, units[j - 1]) for j, text in texts}) == 1:
        return f"{texts[0][1]} {units[0]} on all joints"
    if len({units[j - 1] for j, _ in texts}) == 1:
        listed = ", ".join(f"{text} (joint {j})" for j, text in texts[:_LISTED])
        return f"{listed} {units[texts[0][0] - 1]}"
    return ", ".join(f"{text} {units[j - 1]} (joint {j})" for j, text in texts[:_LISTED])


def channels_of(recording: Recording, sliding: Sequence[bool] = ()) -> list[str]:
    """Say how finely and how often each quantity was measured.

    Args:
        recording: T samples of n joints.
        sliding: Whether each joint slides, (n,); none does if not given.
    """
    sentences: list[str] = []
    slides = sliding or (False,) * recording.n
    for name, turning, along in (("position", "rad", "m"), ("torque", "N m", "N")):
        if name == "torque" and not recording.has_torque:
            continue
        values: FloatArray = getattr(recording, name)
        steps = [resolution(column) for column in values.T]
        known = [(j + 1, step) for j, step in enumerate(steps) if step]
        least = _STILL if name == "position" else 0.0  # a joint at rest repeats its position
        units = [along if own else turning for own in slides]
        if known:
            sentences.append(f"{name} comes in steps of {_by_joint(known, units)}")
        if name == "torque":
            sentences += _coarse(values, steps)
            sentences += _chattering(recording, steps)
        slow = [
            j + 1
            for j, column in enumerate(values.T)
            if np.ptp(column) > least and not steps[j] and np.mean(np.diff(column) == 0) > _SLOWER
        ]
        if slow:
            sentences.append(
                f"{name} of {_joints(slow)} changes in fewer than half of the rows: it was "
                "measured more slowly than logged"
            )
    return sentences


def _coarse(torque: FloatArray, steps: Sequence[float]) -> list[str]:
    coarse = [
        j + 1
        for j, (column, step) in enumerate(zip(torque.T, steps, strict=True))
        if step > _COARSE * float(np.std(column)) > 0
    ]
    return [f"torque of {_joints(coarse)} is coarse beside what it varies by"] if coarse else []


def _chattering(recording: Recording, steps: Sequence[float]) -> list[str]:
    found = chatter_of(recording, bandwidth_for([recording]), tuple(steps))
    if not found:
        return []
    listed = ", ".join(map(str, found[:_LISTED]))
    return [
        f"torque chatters: {listed}; a controller that hunts or a gear that rings does so, and "
        "friction seems smaller while it lasts"
    ]


def resolution(values: FloatArray) -> float:
    """Return the step of a grid on which all values lie; 0 if they lie on none.

    Args:
        values: (T,), in any unit.
    """
    distinct = np.unique(values)
    if distinct.size < _FEWEST_STEPS or distinct.size > values.size // 2:
        return 0.0
    gaps = np.diff(distinct)
    step = float(np.min(gaps))
    if step <= 1e-12 * float(np.abs(distinct).max()):  # one value twice, but for rounding
        return 0.0
    fine = gaps[gaps < 1.5 * step]  # the mean of the smallest gaps, without their rounding
    step = float(np.mean(fine))
    counts = gaps / step
    few = counts < 1 / _GRID  # rounding of the step adds up over longer ones
    off = np.abs(counts - np.round(counts))[few]
    return step if np.mean(off < 5 * _GRID) > 1 - _GRID else 0.0


def gear_side(share: float, stated: float = 0.0) -> str:
    """Say on which side of the gear torques were measured, and why.

    Args:
        share: Friction in them, of what the drives can do; NaN where that is not known.
        stated: The same of what the robot's description states, which a link side lacks.
    """
    if np.isnan(share):
        return "side of the gear: not to be told without effort limits of the robot"
    why = f"friction is {share:.1%} of what the drives can do (median of the joints)"
    if share > MOTOR_SIDE:
        return (
            f"torque seems to be measured on the motor side of the gear: {why}; what is found as "
            "friction and armature is that of motor and gear, and rows at rest say little"
        )
    if share < _LACKED * stated:
        return (
            f"torque seems to be measured on the link side of the gear: {why}, and "
            f"{stated:.1%} is stated; friction and inertia of motor and gear are not in it"
        )
    return f"side of the gear: not to be told, since {why}"


def _as_described(simulation: Simulation) -> Simulation:
    return replace(simulation, effects=described_effects(simulation.model))


def friction_share(
    simulation: Simulation, recording: Recording, bandwidth: float | None = None
) -> float:
    """Return friction at usual speeds over what the drives can do, median of the joints.

    Args:
        simulation: Identified from the recording, or diagnosed with it.
        recording: T samples of n joints.
        bandwidth: Of the filter on motion [Hz]; if not given, 10, or what the recording can bear.

    Returns:
        The share [1]; NaN without a joint that moves and whose effort limit is known.
    """
    without = simulation.without_friction()
    width = bandwidth_for([recording], bandwidth)
    calm = recording.calm_motion(width)
    with_all, rest = (
        each.predict_stretches(calm, recording.segments, width) for each in (simulation, without)
    )
    torque = with_all - rest
    velocity = recording.motion(width).velocity
    moving = np.abs(velocity) > _CRAWLS * np.abs(velocity).mean(axis=0)
    along = np.sum(torque * np.sign(velocity), axis=0, where=moving)  # whatever its law
    friction = along / np.maximum(np.sum(moving, axis=0), 1)
    most = simulation.model.limits.torque
    use = (np.ptp(recording.position, axis=0) > _MOVES) & (np.ptp(recording.torque, axis=0) > 0)
    use &= (most > 0) & np.isfinite(most)
    return float(np.median(friction[use] / most[use])) if use.any() else float("nan")


def _excitation(found: Identification, recording: Recording) -> list[str]:
    """Say what the motion reveals, and what it does not."""
    from estimators.rigid_body.tables import base_estimates, known_of, sizes_of

    if np.isfinite(found.fit.condition):
        condition = f"condition number {found.fit.condition:.3g}"
    else:
        condition = "at least one is not in this motion at all (condition number infinite)"
    sentences = [f"{known_of(found)}; {condition}"]
    still = np.flatnonzero(np.ptp(recording.position, axis=0) < _STILL)
    if still.size:
        one = still.size == 1
        sentences.append(
            f"{_joints((still + 1).tolist())} never move{'s' * one}: nothing is said of "
            f"{'its' if one else 'their'} friction"
        )
    estimates = base_estimates(found)
    size = sizes_of(estimates)
    unknown = [x for x in estimates if x.deviation > size[x.name]]
    if unknown:
        names = ", ".join(x.name for x in unknown[:_LISTED])
        more = f" and {len(unknown) - _LISTED} more" if len(unknown) > _LISTED else ""
        sentences.append(f"this motion says nothing about {names}{more}; {_LEGEND}")
    known = (x.deviation / size[x.name] for x in estimates if x not in unknown)
    worst = max(known, default=0.0)
    if worst > WELL:
        needed = recording.duration * (worst / WELL) ** 2
        advice = (
            f"about {needed:.0f} s of such motion"
            if needed < _LONGEST
            else f"another motion ({_planner(found.simulation.model)}) rather than more of this one"
        )
        sentences.append(f"to know all the others to {WELL:.0%} takes {advice}")
    return sentences


def _planner(model: RobotModel) -> str:
    """Say what plans a motion of a robot, if anything does."""
    try:
        model.check_runnable()
    except ConfigError:
        return "`limo excite` plans one where ranges and limits of all joints are stated"
    return "`limo excite`"


def _joints(numbers: Sequence[int]) -> str:
    return f"joint{'s' * (len(numbers) > 1)} {', '.join(map(str, numbers))}"


@dataclass(frozen=True)
class Chatter:
    """An oscillation of one joint's torque."""

    joint: int  # 1-based
    frequency: float  # [Hz]
    rms: float  # [N m]

    def __str__(self) -> str:
        """Say it in a few words."""
        return f"joint {self.joint} by {self.rms:.2g} N m RMS at {self.frequency:.3g} Hz"


def chatter_of(
    recording: Recording, bandwidth: float, steps: tuple[float, ...]
) -> tuple[Chatter, ...]:
    """Return which torques oscillate, and how.

    Args:
        recording: T samples of n joints.
        bandwidth: Of motion [Hz].
        steps: In which each joint's torque comes, (n,) [N m]; 0 where it has none.
    """
    from scipy.signal import welch

    longest = max(recording.segments, key=lambda rows: rows.stop - rows.start)
    rate = recording[longest].rate if longest.stop - longest.start > 1 else 0.0
    many = longest.stop - longest.start
    if rate < _FEWEST_RATES * bandwidth or many < _FEWEST_PIECES * _PIECE:
        return ()
    found = list[Chatter]()
    for j, torque in enumerate(recording.torque[longest].T):
        frequency, density = welch(torque, rate, nperseg=_PIECE, detrend="linear")
        above = frequency > _ABOVE * bandwidth
        power = density[above] * (frequency[1] - frequency[0])
        total = float(power.sum())
        if not total:
            continue
        peak = float(frequency[above][power.argmax()])
        near = np.abs(frequency[above] - peak) <= max(_WIDTH * peak, 2 * frequency[1])
        share, even = float(power[near].sum()) / total, float(near.mean())
        rms = float(np.sqrt(power[near].sum()))
        least = max(_MATTERS * float(np.std(torque)), _STEPS * steps[j])
        stands_out = float(power.max()) > _STANDS_OUT * float(power[0])  # is no slope's foot
        if stands_out and share > max(_AT_ONE, min(_NARROW * even, 1.0)) and rms > least:
            found.append(Chatter(j + 1, peak, rms))
    return tuple(found)
