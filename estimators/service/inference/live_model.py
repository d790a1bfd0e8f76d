"""A model that follows an arm live: the last states, how fast they come, sums over its answers."""

from __future__ import annotations

from collections import deque
from ctypes import c_void_p
from math import sqrt
from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np

from estimators.embedded.compiled_stream import CompiledStream
from limo_driver.errors import DivergedError
from limo_driver.recordings.filters.causal_differentiation import RATE_TOLERANCE
from limo_driver.runtime.compiled import compiled

if TYPE_CHECKING:
    from estimators.stream import LiveEstimate, Stream, StreamState
    from limo_driver.types import BoolArray, FloatArray

_STATES: Final = 101  # from which the rate is found
_MOST: Final = 90  # % of steps, which are no stall, however uneven
_APART: Final = 25  # states whose stamps are compared, so that uneven ones count for less
_FEW: Final = 10  # steps from which a rate is doubted
_GAP: Final = 0.5  # periods more than one, from which a step is a gap
_MANY_GAPS: Final = 3  # in a row
_REMEMBERED: Final = 200  # steps that say how uneven stamps are
_DEVIATIONS: Final = 4.0
_PER_SECOND: Final = 1e9  # [ns]
_SHORTEST, _LONGEST = 1e5, 1e9  # [ns] between states, of any arm


class StateRows(NamedTuple):
    """T states that follow each other."""

    time: FloatArray  # (T,) [s]
    position: FloatArray  # (T, n) [rad]
    torque: FloatArray | None  # (T, n) [N m], measured; None where it is not

    def part(self, first: int, stop: int) -> StateRows:
        """Return some of them."""
        rows = slice(first, stop)
        torque = None if self.torque is None else self.torque[rows]
        return StateRows(self.time[rows], self.position[rows], torque)


_SPARE: Final = 4096  # rows that may be overwritten while others are copied


class History:
    """A ring of the latest states of n joints; one thread appends, others copy.

    Args:
        n: Number of joints.
        capacity: States kept.
    """

    def __init__(self, n: int, capacity: int) -> None:
        self.capacity = capacity
        # Written at once: memory that is only promised would grow for as long as the ring fills.
        self._time = np.full(capacity + _SPARE, np.nan)
        self._values = np.full((capacity + _SPARE, 2, n), np.nan)
        self.count = 0  # ever appended
        self.began = 0  # count at which the present memory began
        self._measured = False  # torque came with all states of the present memory

    def append(self, time: float, position: FloatArray, torque: FloatArray | None) -> None:
        """Keep a state; the oldest goes when there is no room.

        Torque comes with all states of a memory, or with none.
        """
        row = self.count % self._time.size
        self._time[row] = time
        self._values[row, 0] = position
        self._measured = torque is not None
        if torque is not None:
            self._values[row, 1] = torque
        self.count += 1

    def restart(self) -> None:
        """Note that memory is reset before the next state."""
        self.began = self.count

    @property
    def first(self) -> int:
        """Number of the oldest state of the present memory that is still here."""
        return max(self.began, self.count - self.capacity)

    def since(self, first: int, most: int | None = None) -> StateRows:
        """Copy the states from number `first` on, or the first `most` of them.

        Raises:
            IndexError: They are no longer all here.
        """
        if first < self.count - self._time.size:
            raise IndexError(f"state {first} is no longer kept")
        stop = self.count if most is None else min(self.count, first + most)
        rows = np.arange(first, stop) % self._time.size
        torque = self._values[rows, 1] if self._measured else None
        return StateRows(self._time[rows], self._values[rows, 0], torque)


class RateFinder:
    """Finds the rate from stamps and numbers; a lost state widens both alike, a stall none."""

    def __init__(self) -> None:
        self._taken: list[tuple[int, int]] = []

    def take(self, sequence: int, stamp: int) -> float | None:
        """Take a state.

        Args:
            sequence: Its number.
            stamp: When it was measured [ns].

        Returns:
            The rate [Hz] to three digits, once enough states are known.
        """
        if self._taken and not (sequence > self._taken[-1][0] and stamp > self._taken[-1][1]):
            self._taken.clear()
        self._taken.append((sequence, stamp))
        if len(self._taken) < _STATES:
            return None
        steps = np.diff(self._taken, axis=0).T.astype(np.float64)  # of numbers, of stamps
        self._taken.clear()
        each = steps[1] / steps[0]
        steps[:, each > (1.0 + _GAP) * np.percentile(each, _MOST)] = 0.0
        numbers, times = (np.convolve(of, np.ones(_APART), "valid") for of in steps)
        interval = float(np.median(times / numbers))
        return float(f"{1e9 / interval:.3g}") if _SHORTEST <= interval <= _LONGEST else None


class RateWatch:
    """Finds out when joint states come at another rate than the one that is served.

    To be sure takes a hundred states or more. Meanwhile `doubtful` says whether the last few came
    so fast or slowly that velocities from them may be wrong, beyond how uneven stamps usually are.

    Args:
        rate: That is served [Hz].
    """

    def __init__(self, rate: float) -> None:
        self._rate, self._finder = rate, RateFinder()
        self._period = _PER_SECOND / rate  # [ns]
        self._latest: deque[tuple[int, int]] = deque(maxlen=_FEW + 1)
        self._scatter, self._steps = 0.0, 0  # mean square of steps less 1 [periods²], of so many
        self._gaps = 0  # in a row
        self.doubtful = False

    def take(self, sequence: int, stamp: int) -> float | None:
        """Take a state, and return the rate of the last hundred [Hz] if it is another one."""
        self._doubt(sequence, stamp)
        found = self._finder.take(sequence, stamp)
        if found is None or abs(found / self._rate - 1.0) <= RATE_TOLERANCE:
            return None
        return found

    def _doubt(self, sequence: int, stamp: int) -> None:
        latest = self._latest
        number, before = latest[-1] if latest else (sequence, stamp)
        latest.append((sequence, stamp))
        if sequence <= number or stamp <= before:  # the first, or a source that began anew
            latest.clear()
            latest.append((sequence, stamp))
            self._gaps, self.doubtful = 0, False
            return
        step = (stamp - before) / (self._period * (sequence - number)) - 1.0
        if step > _GAP:  # cycles that nobody numbered; only many say that they are longer ones
            latest.clear()
            latest.append((sequence, stamp))
            self._gaps += 1
            self.doubtful = self._gaps >= _MANY_GAPS
            return
        self._gaps = 0
        self._steps = min(self._steps + 1, _REMEMBERED)
        self._scatter += (step * step - self._scatter) / self._steps
        number, before = latest[0]
        mean = (stamp - before) / (self._period * (sequence - number)) - 1.0
        usual = _DEVIATIONS * sqrt(self._scatter) / (len(latest) - 1)  # of two stamps, not of steps
        self.doubtful = len(latest) > _FEW and abs(mean) > RATE_TOLERANCE + usual


_COPIED: Final = 1000  # copied at once, so that whoever answers the next state need not wait
_UNKNOWN: Final = np.empty(0)  # torque that was not measured


class Answer:
    """Answer of the service to one state, in arrays (n,) that each is written into.

    The drives resist what pushes the arm, so that external torque is -Jᵀ F of the wrench F that the
    environment exerts.

    Args:
        torque: Physics and the learned part within its bound [N m].
        std: NaN where the model does not say [N m].
        external: Measured less estimated; NaN without a measured torque [N m].
        outside: Whether the motion is unlike what was learned.
    """

    def __init__(
        self, torque: FloatArray, std: FloatArray, external: FloatArray, outside: BoolArray
    ) -> None:
        self.torque, self.std, self.external, self.outside = torque, std, external, outside
        self.clipped = False  # the learned part was beyond its bound
        arrays = torque, std, external, outside
        self.places = tuple(c_void_p(values.ctypes.data) for values in arrays)

    @classmethod
    def of(cls, n: int) -> Answer:
        """Return an answer of n joints to be written into."""
        return cls(np.empty(n), np.empty(n), np.empty(n), np.empty(n, np.bool_))


class LiveModel:
    """One model that answers state after state.

    Args:
        version: What its estimates are labelled with.
        stream: The model at the rate and delay of the service.
        bound: Largest torque that the learned part may add, (n,) [N m].
        physics_only: It serves for want of a learned model.
    """

    def __init__(
        self, version: str, stream: Stream, bound: FloatArray, *, physics_only: bool = False
    ) -> None:
        self.version, self.stream, self.bound = version, stream, bound
        self.physics_only = physics_only
        self.delay_ns = round(stream.delay / 1e-9)
        self.state: StreamState = stream.init()
        self._most = c_void_p(bound.ctypes.data)

    def step(
        self, time: float, position: FloatArray, torque: FloatArray | None, answer: Answer
    ) -> None:
        """Take the next state and write the answer for `stream.delay` before it.

        Raises:
            DivergedError: The torque is not finite.
            LimoError: The state cannot follow the one before.
        """
        stream = self.stream
        if isinstance(stream, CompiledStream):
            places = self._most, *answer.places
            finite, answer.clipped = stream.answer(self.state, time, position, torque, places)
        else:
            estimate, self.state = stream.step(self.state, time, position, torque)
            finite, answer.clipped = bounded(estimate, self.bound, answer)
        if not finite:
            raise DivergedError(f"the torque is {answer.torque} N m")

    @property
    def compiled(self) -> bool:
        """Whether it runs as C."""
        return isinstance(self.stream, CompiledStream)

    def prime(self, rows: StateRows) -> None:
        """Set memory as if the model had answered these states from the first on."""
        self.state = self.stream.init()
        self.follow(rows)

    def follow(self, rows: StateRows) -> None:
        """Take states without answering."""
        if len(rows.time):
            _, self.state = self.stream.advance(self.state, rows.time, rows.position, rows.torque)

    def errors(self, rows: StateRows) -> FloatArray:
        """Take states, and return the measured torque less the bounded answers, (T, n) [N m].

        NaN where no torque was measured.

        Raises:
            LimoError: The model cannot follow the states.
        """
        late, self.state = self.stream.advance(self.state, rows.time, rows.position, rows.torque)
        torque = late.simulation + np.clip(late.learned, -self.bound, self.bound)
        return np.full(torque.shape, np.nan) if late.measured is None else late.measured - torque

    def catch_up(self, history: History, close: int) -> int:
        """Take what came until at most `close` states are left, and return the next one's number.

        States keep coming meanwhile; memory that began anew on the way is begun anew here, too.
        """
        first = -1
        while True:
            began = history.first
            if first < began:
                first, self.state = began, self.stream.init()
            if history.count - first <= close:
                return first
            rows = history.since(first, _COPIED)
            self.follow(rows)
            first += len(rows.time)


def bounded(estimate: LiveEstimate, bound: FloatArray, answer: Answer) -> tuple[bool, bool]:
    """Write an estimate with the learned part clipped; say whether all is finite, and any was."""
    answer.std[:], answer.outside[:] = estimate.std, estimate.outside
    measured = _UNKNOWN if estimate.measured is None else estimate.measured
    return _bound(
        estimate.simulation, estimate.learned, measured, bound, answer.torque, answer.external
    )


@compiled(reads=("simulation", "learned", "measured", "bound"))
def _bound(
    simulation: FloatArray,
    learned: FloatArray,
    measured: FloatArray,
    bound: FloatArray,
    torque: FloatArray,
    external: FloatArray,
) -> tuple[bool, bool]:
    """Write torque and external torque, (n,); say whether all is finite, and any was clipped.

    `measured` is of no joint where no torque was measured.
    """
    finite, clipped = True, False
    for j in range(bound.size):
        value, most = learned[j], bound[j]
        if value > most or value < -most:
            value, clipped = np.copysign(most, value), True
        torque[j] = simulation[j] + value
        external[j] = measured[j] - torque[j] if measured.size else np.nan
        finite = finite and np.isfinite(torque[j])
    return finite, clipped


class Window:
    """Sums over the answers since they were last looked at, of n joints."""

    def __init__(self, n: int) -> None:
        self.count = 0
        self.squares = np.zeros(n)  # [(N m)²], of external torque without contact
        self.samples = np.zeros(n)  # that went into `squares`
        self.outside = np.zeros(n)
        self.clipped = 0
        self.contacts = 0  # that began or ended

    def add(
        self, answer: Answer, in_contact: BoolArray, unturned: BoolArray, *, known: bool
    ) -> None:
        """Add an answer.

        Args:
            answer: Of n joints.
            in_contact: Which of them are, (n,).
            unturned: Whose friction may stand anyhow, (n,).
            known: Whether velocities are; else nothing is said of the external torque.
        """
        self.count += 1
        self.clipped += answer.clipped
        _sum_up(
            answer.external,
            answer.outside,
            in_contact,
            unturned,
            known,
            self.squares,
            self.samples,
            self.outside,
        )

    @property
    def rms(self) -> FloatArray:
        """Of the external torque without contact, (n,) [N m]; NaN where there was none."""
        with np.errstate(invalid="ignore", divide="ignore"):
            return np.sqrt(self.squares / self.samples)


@compiled(reads=("external", "outside", "in_contact", "unturned"))
def _sum_up(
    external: FloatArray,
    outside: BoolArray,
    in_contact: BoolArray,
    unturned: BoolArray,
    known: bool,
    squares: FloatArray,
    samples: FloatArray,
    outsides: FloatArray,
) -> None:
    """Add the external torque of free joints, and the flags, to the sums of a window."""
    for j in range(external.size):
        outsides[j] += outside[j]
        if known and not (in_contact[j] or unturned[j]) and np.isfinite(external[j]):
            squares[j] += external[j] * external[j]
            samples[j] += 1.0
