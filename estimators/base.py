"""Interface of all torque estimators, and what each checks of the recordings it is fitted to."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cache
from typing import TYPE_CHECKING, Any, Final, Protocol, Self, TypeAlias, runtime_checkable

import numpy as np

from limo_driver.errors import RecordingError
from limo_driver.runtime.display import Displayed

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from limo_driver.model import RobotModel
    from limo_driver.recordings.recording import Recording
    from limo_driver.types import BoolArray, FloatArray, JointSample, Motion

DEVIATIONS: Final = 1.959964  # of a normal distribution, that hold 95 %

State: TypeAlias = Any  # each estimator's own; only passed back to its `step`
_STILL: Final = 2e-3  # [rad], range of an arm that does not move
WEIGHTLESS: Final = 0.05  # of a joint's load, below which no torque is that of the joint
_ROWS: Final = 2000  # of a recording, that tell the size of its load
_RUN: Final = 10  # samples alike, one after the other, that sensors do not give twice by chance
_SHARED: Final = 0.01  # of the shorter of two recordings, in such runs: cuts of one recording
_NEXT: Final = np.uint64(0x9E3779B97F4A7C15)  # odd: the key of a run depends on its order


@dataclass(frozen=True, repr=False)
class Estimate(Displayed):
    """Torque of n joints and how sure it is, for T samples (T, n) or for one (n,).

    95 % of measured torques, filtered as those of training were, are meant to lie within
    `DEVIATIONS` standard deviations. An estimator that does not know its errors says NaN, and flags
    nothing as outside.
    """

    simulation: FloatArray  # [N m], of the physics that was known beforehand
    learned: FloatArray  # [N m], what data add to that
    std: FloatArray  # [N m]
    outside: BoolArray  # the motion is unlike what was learned; `std` is a guess there

    def headline(self) -> str:
        """Say how many samples, and how sure they are."""
        rows, n = (1, *self.torque.shape)[-2:]
        text = f"torque of {rows} samples of {n} joints"
        if np.isnan(self.std).all():
            return text + ", errors unknown"
        return text + f", {np.mean(self.outside):.0%} of it unlike what was learned"

    @property
    def torque(self) -> FloatArray:
        """The whole torque [N m], of the shape of its parts."""
        return self.simulation + self.learned

    def filtered(self, recording: Recording, bandwidth: float) -> Self:
        """Return the estimate of a recording with its torque low-passed as the measured one is.

        Where dry friction changes its sign, a torque as it is differs from one behind a filter by
        as much as that friction, though both are right: errors are judged behind the filter.
        """
        both = np.concatenate([self.simulation, self.learned], axis=1)
        simulation, learned = np.split(recording.filtered(both, bandwidth), 2, axis=1)
        return replace(self, simulation=simulation, learned=learned)

    @classmethod
    def unsure(cls, simulation: FloatArray) -> Estimate:
        """Return torque to which nothing was learned, and whose errors nobody knows."""
        rows, n = simulation.shape
        return cls(simulation, *(_nothing(rows, n) if rows > 1 else _nothing_once(n)))

    @classmethod
    def joined(cls, parts: Sequence[Estimate]) -> Estimate:
        """Return estimates (T, n) that follow each other as one."""
        return cls(
            np.concatenate([part.simulation for part in parts]),
            np.concatenate([part.learned for part in parts]),
            np.concatenate([part.std for part in parts]),
            np.concatenate([part.outside for part in parts]),
        )


def _nothing(rows: int, n: int) -> tuple[FloatArray, FloatArray, BoolArray]:
    """Return torque, deviation and flags of who learned nothing, (rows, n) each."""
    return np.zeros((rows, n)), np.full((rows, n), np.nan), np.zeros((rows, n), np.bool_)


@cache
def _nothing_once(n: int) -> tuple[FloatArray, FloatArray, BoolArray]:
    """Return these of one row, as a stream needs them a thousand times a second."""
    kept = _nothing(1, n)
    for values in kept:
        values.setflags(write=False)
    return kept


class LiveEstimator(Protocol):
    """Interface of an estimator for a stream of samples."""

    @property
    def n(self) -> int:
        """Number of joints."""
        ...

    @property
    def bandwidth(self) -> float:
        """Of the filters on motion and torque that it was fitted behind [Hz]."""
        ...

    @property
    def memory(self) -> object:
        """The values besides the motion that determine memory: equal where memory is the same."""
        ...

    def init(self, rate: float | None = None) -> State:
        """Return the memory before the first sample, see `InverseDynamics`."""
        ...

    def advance(self, state: State, motion: Motion) -> tuple[Estimate, State]:
        """Estimate T samples that follow `state`: a whole recording and a `step` in one.

        Args:
            state: Memory after the sample before; not changed.
            motion: T samples of n joints without a gap.

        Returns:
            The torque, (T, n), and the memory after the last sample.

        Raises:
            NotFittedError: `fit` has not been called.
            ShapeError: The motion has another number of joints.
        """
        ...


@runtime_checkable
class InverseDynamics(Protocol):
    """Maps joint motion to joint torque.

    Constructors store; `fit` checks and returns self; fitted attributes end in `_`. Memory goes in
    and out of `step` explicitly, so that one estimator serves several arms.
    """

    def fit(self, recordings: Sequence[Recording]) -> Self:
        """Fit to measured torques.

        Raises:
            RecordingError: The recordings do not suit the robot, or say too little.
        """
        ...

    def predict(self, recording: Recording) -> FloatArray:
        """Predict the torque of a recorded motion.

        Memory is reset at the start of every contiguous segment of the recording.

        Args:
            recording: T samples of n joints; its torque is not looked at.

        Returns:
            Joint torques, (T, n) [N m].

        Raises:
            NotFittedError: `fit` has not been called.
        """
        ...

    def init(self, rate: float | None = None) -> State:
        """Return the memory before the first sample.

        Args:
            rate: Rate at which `step` will be called [Hz]; the estimator's own if not given.

        Raises:
            NotFittedError: `fit` has not been called.
        """
        ...

    def step(self, state: State, sample: JointSample) -> tuple[FloatArray, State]:
        """Predict the torque of the next sample; scanning `step` equals `predict`.

        Args:
            state: Memory after the sample before.
            sample: Motion at the next instant.

        Returns:
            Joint torques (n,) [N m] and the memory after this sample.

        Raises:
            NotFittedError: `fit` has not been called.
        """
        ...


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
    if not any(np.any(recording.torque) for recording in recordings):
        raise RecordingError("every torque is 0 N m; was it measured?", path=_sources(recordings))
    if not any(np.ptp(recording.torque, axis=0).any() for recording in recordings):
        raise RecordingError(
            "no torque ever changes, expected that of a moving arm; was it measured?",
            path=_sources(recordings),
        )
    moved = max(float(np.ptp(recording.position, axis=0).max()) for recording in recordings)
    if moved < _STILL:
        raise RecordingError(
            f"no joint moves (range {moved:.2g} rad); an arm at rest reveals neither inertia nor "
            "friction",
            path=_sources(recordings),
        )
    check_different(recordings)


def joints_with_torque(model: RobotModel, recording: Recording) -> BoolArray:
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
            same = all(
                np.array_equal(getattr(first, name), getattr(recording, name))
                for name in ("position", "torque")
            )
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


def _sources(recordings: Sequence[Recording]) -> str | None:
    return ", ".join(recording.source for recording in recordings if recording.source) or None


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
