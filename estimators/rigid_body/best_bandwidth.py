"""The bandwidth at which a recording tells most of its torque, chosen by motion held out.

A wide filter lets the noise of positions through, twice differentiated; a narrow one takes away
motion that has torque. Which is worse is asked of the data: for each bandwidth B and joint, torque
is regressed on what the description and a joint's usual physics make of motion filtered at B,

    tau = a tau_RBD(q, dq, ddq) + b ddq + c dq + d tanh(dq / v) + e,

on three of four parts of each recording, and predicted on the fourth. All are scored behind one
filter, the widest, so that a bandwidth gains nothing by hearing less. The usual one stays unless it
surely errs a quarter more than the best: what this regression leaves out, such as ripple, is in
every error. Else it is the widest of those that hardly err more than the best.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from limo_driver.errors import LimoError, RecordingError
from limo_driver.model import RobotModel
from limo_driver.physics import Simulation
from limo_driver.recordings.bandwidth import bandwidth_for
from limo_driver.recordings.filters.differentiation import SAFE_BANDWIDTH
from limo_driver.recordings.recording import Recording
from limo_driver.runtime.display import Displayed
from limo_driver.types import FloatArray

WIDEST: Final = 100.0  # [Hz], beyond which robots tell little of their motion
_LADDER: Final = (1.25, 2.5, 5.0, 10.0, 20.0, 40.0, 80.0)  # [Hz]
_PARTS: Final = 4  # of a recording, of which each is predicted by the others
_TURNS: Final = 3  # that each part is made of, so that it is of more than one time
_BLOCKS: Final = 24  # of time, whose errors are taken for independent
_MOST: Final = 60_000  # rows that are looked at, which take some seconds
_SIGN_WIDTH: Final = 0.02  # [rad/s]
_WORTH: Final = 1.25  # times the best error, beyond which the usual bandwidth is left
_ALIKE: Final = 1.05  # times the best error, which is as good
_SURE: Final = 2.0  # standard errors
_SINGULAR: Final = 1e-3  # of the largest singular value, below which columns tell nothing more


@dataclass(frozen=True, repr=False)
class BandwidthChoice(Displayed):
    """A bandwidth, and how others compare."""

    bandwidth: float  # [Hz]
    scored_at: float  # [Hz], of the filter that all were scored behind
    errors: Mapping[float, float]  # by bandwidth, relative to the smallest; mean over joints
    unsure: Mapping[float, float]  # one standard error of that

    def headline(self) -> str:
        """Say which was chosen, and by how much others err more on motion held out."""
        others = ", ".join(
            f"{width:g} Hz {error - 1.0:+.0%}" for width, error in self.errors.items()
        )
        return (
            f"motion and torque are filtered at {self.bandwidth:g} Hz, by the error on motion held "
            f"out (more than the smallest: {others})"
        )


def choose_bandwidth(model: RobotModel, recordings: Sequence[Recording]) -> BandwidthChoice:
    """Return the bandwidth at which motion tells most of the torque of recordings.

    Args:
        model: Of the arm, with its masses.
        recordings: Of which those count that have torque of every joint.

    Raises:
        RecordingError: There is no such recording, or all are too short.
    """
    measured = [one for one in recordings if one.measured_joints.all()]
    if not measured:
        raise RecordingError("no recording has torque of every joint, to choose a bandwidth by")
    usual = bandwidth_for(recordings)
    rate = min(one.slowest_rate for one in measured)
    widest = max(min(SAFE_BANDWIDTH * rate, WIDEST), usual)
    parts = [one.at_most(_MOST // len(measured)) for one in measured]
    tried = sorted({*(width for width in _LADDER if width < widest), usual, widest})
    scored = {width: _errors(model, parts, width, widest) for width in tried}
    scored = {width: found for width, found in scored.items() if found is not None}
    if usual not in scored:
        raise RecordingError("the recordings are too short to choose a bandwidth by")
    best = min(scored, key=lambda width: float(np.mean(np.log(_rms(scored[width])))))
    errors, unsure = {}, {}
    for width, own in scored.items():
        ratio = np.log(own / scored[best]).mean(axis=1) / 2.0  # of squares, over joints
        overall = float(np.mean(np.log(_rms(own) / _rms(scored[best]))))
        errors[width] = float(np.exp(overall))
        unsure[width] = float(ratio.std(ddof=1) / np.sqrt(len(ratio)))
    chosen = usual
    if errors[usual] > _WORTH and np.log(errors[usual]) > _SURE * unsure[usual]:
        chosen = max(w for w in scored if np.log(errors[w]) <= max(unsure[w], np.log(_ALIKE)))
    return BandwidthChoice(chosen, widest, errors, unsure)


def fitting_bandwidth(
    arm: Simulation | RobotModel,
    recordings: Sequence[Recording],
    asked: float | None = None,
    most: float = np.inf,
) -> tuple[float, tuple[str, ...]]:
    """Return the bandwidth [Hz] at which something is fitted to recordings, and why, if unusual.

    Args:
        arm: The robot; or a simulation, whose own bandwidth is kept.
        recordings: To be fitted to.
        asked: What a user told; then it is this.
        most: Above which the usual one is taken [Hz]: slower samples would miss whole swings.

    Returns:
        What was asked, or that of the simulation; or else the one at which motion tells most of the
        torque, see `choose_bandwidth`, and the usual one where that cannot be judged.
    """
    own = arm.bandwidth if isinstance(arm, Simulation) else None
    usual = bandwidth_for(recordings)
    if asked is not None:
        return asked, ()
    if own is not None:
        width = bandwidth_for(recordings, found=own)
        return (width if width <= most else usual), ()
    model = arm.model if isinstance(arm, Simulation) else arm
    try:
        choice = choose_bandwidth(model, recordings)
    except LimoError:  # what it lacks is told by who fits
        return usual, ()
    if choice.bandwidth == usual or choice.bandwidth > most:
        return usual, ()
    return choice.bandwidth, (choice.headline(),)


def _errors(
    model: RobotModel, recordings: Sequence[Recording], width: float, widest: float
) -> FloatArray | None:
    """Return mean squares of held-out errors, (blocks, n) [(N m)²]; None of too short recordings.

    Args:
        model: Of the arm.
        recordings: With torque.
        width: Bandwidth of the motion [Hz].
        widest: That of the filter behind which errors are judged [Hz].
    """
    try:
        terms = [_terms(model, one, width) for one in recordings]
    except RecordingError:
        return None
    torques = [one.filtered_torque(widest) for one in recordings]
    parts = [np.arange(len(one)) * _PARTS * _TURNS // len(one) % _PARTS for one in recordings]
    errors = [np.zeros_like(torque) for torque in torques]
    for part in range(_PARTS):
        seen, left = ([kept(own, part) for own in parts] for kept in (np.not_equal, np.equal))
        for j in range(model.n):
            columns = np.concatenate([x[rows, j] for x, rows in zip(terms, seen, strict=True)])
            torque = np.concatenate([x[rows, j] for x, rows in zip(torques, seen, strict=True)])
            size = np.sqrt(np.mean(columns**2, axis=0)) + np.finfo(float).tiny
            weights = np.linalg.lstsq(columns / size, torque, rcond=_SINGULAR)[0] / size
            for error, x, tau, rows in zip(errors, terms, torques, left, strict=True):
                error[rows, j] = x[rows, j] @ weights - tau[rows, j]
    after = [one.filtered(error, widest) for one, error in zip(recordings, errors, strict=True)]
    squares = np.concatenate(after) ** 2 + np.finfo(float).tiny
    return np.array([block.mean(axis=0) for block in np.array_split(squares, _BLOCKS)])


def _terms(model: RobotModel, recording: Recording, width: float) -> FloatArray:
    """Return the columns of the regression of each joint, (T, n, 5)."""
    motion = recording.motion(width)
    torque = model.inverse_dynamics(motion.position, motion.velocity, motion.acceleration)
    sign = np.tanh(motion.velocity / _SIGN_WIDTH)
    one = np.ones_like(torque)
    return np.stack([torque, motion.acceleration, motion.velocity, sign, one], axis=-1)


def _rms(squares: FloatArray) -> FloatArray:
    """Return the RMS of each joint, (n,), from mean squares of blocks."""
    return np.sqrt(squares.mean(axis=0))
