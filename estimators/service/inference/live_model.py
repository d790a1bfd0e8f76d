"""A model that follows an arm live, and the window of its last states."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np

from limo_driver.errors import DivergedError
from limo_driver.runtime.compiled import compiled

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from estimators.service.inference.history import History, StateRows
    from estimators.stream import LiveEstimate, Stream, StreamState
    from limo_driver.types import FloatArray

_ROWS: Final = 1000  # copied at once, so that whoever answers the next state need not wait
_UNKNOWN: Final = np.empty(0)  # torque that was not measured


class Answer(NamedTuple):
    """Answer of the service to one state; arrays are (n,).

    The drives resist what pushes the arm, so that external torque is -Jᵀ F of the wrench F that the
    environment exerts.
    """

    torque: FloatArray  # [N m], physics and the learned part within its bound
    std: FloatArray  # [N m], NaN where the model does not say
    external: FloatArray  # [N m], measured less estimated; NaN without a measured torque
    outside: NDArray[np.bool_]  # the motion is unlike what was learned
    clipped: bool  # the learned part was beyond its bound


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

    def step(self, time: float, position: FloatArray, torque: FloatArray | None) -> Answer:
        """Take the next state and answer for `stream.delay` before it.

        Raises:
            DivergedError: The torque is not finite.
            LimoError: The state cannot follow the one before.
        """
        estimate, self.state = self.stream.step(self.state, time, position, torque)
        return bounded(estimate, self.bound)

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
            rows = history.since(first, _ROWS)
            self.follow(rows)
            first += len(rows.time)


def bounded(estimate: LiveEstimate, bound: FloatArray) -> Answer:
    """Return the estimate with the learned part clipped.

    Raises:
        DivergedError: The torque is not finite.
    """
    torque, external = np.empty_like(bound), np.empty_like(bound)
    measured = _UNKNOWN if estimate.measured is None else estimate.measured
    finite, clipped = _bound(
        estimate.simulation, estimate.learned, measured, bound, torque, external
    )
    if not finite:
        raise DivergedError(f"the torque is {torque} N m")
    return Answer(torque, estimate.std, external, estimate.outside, clipped)


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
        self,
        answer: Answer,
        in_contact: NDArray[np.bool_],
        unturned: NDArray[np.bool_],
        *,
        known: bool,
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
    outside: NDArray[np.bool_],
    in_contact: NDArray[np.bool_],
    unturned: NDArray[np.bool_],
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
