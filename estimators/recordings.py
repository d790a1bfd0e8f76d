"""Checks that every estimator makes of the recordings that it is fitted to."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np

from limo_driver.errors import RecordingError

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from limo_driver.model import RobotModel
    from limo_driver.recordings.recording import Recording

_STILL: Final = 2e-3  # [rad], range of an arm that does not move
WEIGHTLESS: Final = 0.05  # of a joint's load, below which no torque is that of the joint
_ROWS: Final = 2000  # of a recording, that tell the size of its load
_RUN: Final = 10  # samples alike, one after the other, that sensors do not give twice by chance
_SHARED: Final = 0.01  # of the shorter of two recordings, in such runs: cuts of one recording
_NEXT: Final = np.uint64(0x9E3779B97F4A7C15)  # odd: the key of a run depends on its order


def check_recordings(recordings: Sequence[Recording], model: RobotModel) -> None:
    """Check that recordings are of the robot and say anything, and none the same as another.

    Raises:
        RecordingError: There is none, one is of another robot or given twice, nothing moves, or no
            torque was measured.
    """
    if not recordings:
        raise RecordingError("no recording to fit to")
    for recording in recordings:
        recording.check_robot(model)
        recording.check_torque()
    _check_torque(recordings)
    moved = max(float(np.ptp(recording.position, axis=0).max()) for recording in recordings)
    if moved < _STILL:
        raise RecordingError(
            f"no joint moves (range {moved:.2g} rad); an arm at rest reveals neither inertia nor "
            "friction",
            path=_sources(recordings),
        )
    check_different(recordings)


def joints_with_torque(model: RobotModel, recording: Recording) -> NDArray[np.bool_]:
    """Mark the joints whose torque is a measurement of what the joint carries, (n,).

    One that never changes is none, nor is one that is next to nothing of what gravity asks for.

    Args:
        model: The robot.
        recording: Measured motion and torque.
    """
    rows = slice(None, None, max(1, len(recording) // _ROWS))
    torque, load = recording.torque[rows], model.gravity_torque(recording.position[rows])
    carries = np.sum(torque**2, axis=0) >= WEIGHTLESS**2 * np.sum(load**2, axis=0)
    return np.asarray(carries & recording.measured_joints)


def check_every_joint(recordings: Sequence[Recording]) -> None:
    """Check that the torque of every joint was measured: of none, a model would learn that it is 0.

    Raises:
        RecordingError: That of a joint was not.
    """
    for recording in recordings:
        silent = (np.flatnonzero(~recording.measured_joints) + 1).tolist()
        if silent:
            raise RecordingError(
                f"has no torque that changes at joint{'s' * (len(silent) > 1)} "
                f"{', '.join(map(str, silent))}, of which a model would learn that there is none; "
                "leave such joints out of recording and description. A simulation can be "
                "identified from the others",
                path=recording.source or None,
            )


def check_different(recordings: Sequence[Recording]) -> None:
    """Check that no recording holds samples of another, at the same times or at others.

    A copy would count as new evidence: its noise would repeat like physics, and errors on it would
    not be those of other motion. Clocks may start anywhere, so times are not looked at.

    Raises:
        RecordingError: Two hold the same samples, or are cuts of one recording that overlap.
    """
    keys: list[NDArray[np.uint64]] = []
    for second, recording in enumerate(recordings):
        own = _runs(recording)
        for first, known in zip(recordings[:second], keys, strict=True):
            if first.n != recording.n:
                continue
            same = _same(first, recording)
            both = np.intersect1d(own, known, assume_unique=True).size
            if same or both > _SHARED * min(len(first), len(recording)):
                part = (both + _RUN - 1) / len(recording)
                what = (
                    "holds the same samples as" if same else f"shares {part:.0%} of its rows with"
                )
                raise RecordingError(
                    f"{what} {first.source or 'another recording'}, and would count as new "
                    "evidence; give it once",
                    path=recording.source or None,
                )
        keys.append(own)


def _check_torque(recordings: Sequence[Recording]) -> None:
    if not any(np.any(recording.torque) for recording in recordings):
        raise RecordingError("every torque is 0 N m; was it measured?", path=_sources(recordings))
    if not any(np.ptp(recording.torque, axis=0).any() for recording in recordings):
        raise RecordingError(
            "no torque ever changes, expected that of a moving arm; was it measured?",
            path=_sources(recordings),
        )


def _sources(recordings: Sequence[Recording]) -> str | None:
    return ", ".join(recording.source for recording in recordings if recording.source) or None


def _same(first: Recording, second: Recording) -> bool:
    return all(
        np.array_equal(getattr(first, name), getattr(second, name))
        for name in ("position", "torque")
    )


def _runs(recording: Recording) -> NDArray[np.uint64]:
    """Return a key of each run of samples that the recording holds but once, in rising order.

    Single precision is enough to tell samples apart, and finds a copy that was kept in it. What
    occurs more than once, such as rest before coarse sensors, may well occur in another recording.
    """
    samples = np.concatenate([recording.position, recording.torque], axis=1)
    bits = (samples.astype(np.float32) + np.float32(0)).view(np.uint32).astype(np.uint64)  # no -0
    factor = np.random.default_rng(0).integers(0, 2**63, bits.shape[1], np.uint64)
    key = bits @ (2 * factor + 1)  # modulo 2^64
    run = np.zeros(max(len(recording) - _RUN + 1, 0), np.uint64)
    for back in range(_RUN if run.size else 0):
        run = run * _NEXT + key[back : back + run.size]
    keys, count = np.unique(run, return_counts=True)
    return keys[count == 1]
