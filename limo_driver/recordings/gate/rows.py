"""Data gate: find the usable rows of a recording, and report those that are left out.

Rows are left out, never repaired. A file in which the fault is systematic (units, a clock that
starts again) is refused, since leaving rows out would hide it.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from limo_driver.errors import RecordingError
from limo_driver.recordings.channels import (
    POSITION,
    RATES,
    VELOCITY,
    by_channel,
    commanded_by,
    unit_of,
)
from limo_driver.recordings.gate import held_values
from limo_driver.recordings.gate.doubts import (
    FEWEST_LATE,
    STILL,
    SYSTEMATIC,
    LeftOut,
    UsableRows,
    doubts_about_rows,
)
from limo_driver.types import BoolArray, FloatArray, IntArray

if TYPE_CHECKING:
    from limo_driver.recordings.channels import Columns

Mask = BoolArray

FEWEST_SAMPLES = 20
SHORTEST = 0.5  # [s]
SHORTEST_PIECE = 0.2  # [s] between two gaps, in which a low-pass of 2.5 Hz can settle
FEWEST_CONTIGUOUS = 10  # samples; fewer between two gaps cannot be differentiated
_BACKWARDS = 0.1  # share of steps back in time above which no time can be relied on
# rad (a hundred turns are 628), rad/s, N m: what no arm does. What this arm cannot do is seen once
# the arm is known, by `Recording.check_robot`. A joint that is told how fast to turn turns on.
_IMPOSSIBLE = {
    "position": 1e3,
    "command": 1e3,
    "command_velocity": 1e3,
    "command_torque": 1e6,
    "velocity": 1e3,
    "torque": 1e6,
}
_IMPOSSIBLE_TORQUE = (1e3, 1e3)  # times a joint's median torque, and at least so many N m
_IMPOSSIBLE_TIME = 10.0  # of the recording's length, from its middle
_IMPOSSIBLE_EXTRA = 1e6  # of any other quantity
_UNIT_HINT = {
    "position": "rad; is it in degrees or encoder counts?",
    "command": "rad; is it in degrees or encoder counts?",
    "velocity": "rad/s; is it in degrees or counts?",
    "command_velocity": "rad/s; is it in degrees or counts?",
    "torque": "N m; is it in N mm or mA?",
    "command_torque": "N m; is it in N mm or mA?",
}
_DEGREES = (30.0, 90.0)  # ratio of difference quotient to velocity that says degrees (57.3)
_SWEPT = 0.1  # [rad] by velocity alone, more than its noise makes
_SPIKE_WINDOW = 7  # samples
_SPIKE_FACTOR = 20.0  # over the 99th percentile of the deviation from the median
_SPIKE_FLOOR = {"position": 0.05, "torque": 5.0}  # rad, N m
_FRAGMENT = f"fewer than {FEWEST_CONTIGUOUS} rows between gaps"


def inspect(columns: Columns) -> UsableRows:
    """Judge every row of a recording.

    Raises:
        RecordingError: Too little is left, or the fault is systematic.
    """
    if columns.command is not None and np.isnan(columns.torque).all():  # drives that tell none
        columns = replace(columns, torque=np.zeros_like(columns.position))
    gate = _Gate(columns)
    gate.check_rows()
    for j, held in enumerate(gate.held_torques().T):
        reason = f"torque_{j + 1} is saturated or repeats a value in motion"
        gate.leave_out(reason, held[gate.rows])
    gate.check_rest()
    return UsableRows(gate.rows, gate.left_out(), doubts_about_rows(gate.columns, gate.rows))


def inspect_commands(columns: Columns) -> UsableRows:
    """Judge every row of a recording by time and commands alone.

    A set-point may step, and rest for as long as it likes.

    Args:
        columns: With commands.

    Raises:
        RecordingError: Too little is left, or the fault is systematic.
    """
    assert columns.command is not None  # noqa: S101
    none = np.zeros_like(columns.command)
    gate = _Gate(replace(columns, position=none, torque=none, velocity=None, extras={}))
    gate.check_values()
    gate.check_times()
    gate.leave_out("the time does not increase", gate.backwards())
    gate.check_amount()
    return UsableRows(gate.rows, gate.left_out(), ())


def inspect_by_joint(columns: Columns) -> tuple[Columns, UsableRows, Mask] | None:
    """Judge the rows again where a torque that is no measurement costs its own joint alone.

    Returns:
        The columns with missing torques led over linearly; the usable rows; and which torques are
        none (all rows, n): those that are missing, saturated or held. None where there is none.

    Raises:
        RecordingError: Too little is left, or the fault is systematic.
    """
    missing = ~np.isfinite(columns.torque)
    torque = np.array(columns.torque)
    row = np.arange(columns.time.size)
    for known, values in zip(~missing.T, torque.T, strict=True):
        if known.any():
            values[:] = np.interp(row, row[known], values[known])
    columns = replace(columns, torque=torque)
    gate = _Gate(columns)
    gate.check_rows()
    none = missing | gate.held_torques()
    if not none[gate.rows].any():
        return None
    gate.leave_out("no torque is a measurement", np.asarray(none[gate.rows].all(axis=1)))
    gate.check_rest()
    notes = [
        f"torque_{j + 1} is missing, saturated or held in {many} rows; nothing is said of that "
        "joint there"
        for j, many in enumerate(none[gate.rows].sum(axis=0).tolist())
        if many
    ]
    return (
        columns,
        UsableRows(
            gate.rows, gate.left_out(), (*doubts_about_rows(gate.columns, gate.rows), *notes)
        ),
        none,
    )


class _Gate:
    """The rows that are still in, and the reasons of those that are out."""

    def __init__(self, columns: Columns) -> None:
        self.columns = columns
        self.rows = np.arange(columns.time.size)
        self._reasons: dict[str, list[IntArray]] = {}

    @property
    def time(self) -> FloatArray:
        return self.columns.time[self.rows]

    def leave_out(self, reason: str, among: Mask) -> None:
        """Take out the rows marked among those still in."""
        if among.any():
            self._reasons.setdefault(reason, []).append(self.rows[among])
            self.rows = self.rows[~among]

    def left_out(self) -> tuple[LeftOut, ...]:
        return tuple(
            LeftOut(reason, tuple(np.sort(np.concatenate(rows)).tolist()))
            for reason, rows in self._reasons.items()
        )

    def check_rows(self) -> None:
        """Leave out what is wrong with a row, whichever joint it is of, and held positions."""
        self.check_values()
        self.leave_out(_FRAGMENT, self.check_times())
        self.leave_out("the time does not increase", self.backwards())
        self.leave_out("a spike that no motion makes", self.spikes())
        for reason, rows in self.held_positions().items():
            self.leave_out(reason, np.isin(self.rows, rows))
        if self.columns.command is not None:  # a drive may be told to step, which is judged later
            return
        for j, position in enumerate(self.columns.position.T):
            among = held_values.near_jumps(self.time, position[self.rows])
            self.leave_out(f"position_{j + 1} jumps as no joint moves: cut there", among)

    def check_values(self) -> None:
        """Leave out rows with a value that is none."""
        # Only what a fit needs counts; a hole in the temperature costs no row
        finite = np.isfinite(self.columns.time)
        for values in (self.columns.position, self.columns.torque, self.columns.command):
            if values is not None:
                finite &= np.isfinite(values).all(axis=1)
        self.leave_out("a value is missing or not finite", ~finite[self.rows])
        self.leave_out("a value is impossible", self.impossible())

    def check_times(self) -> Mask:
        """Leave out single rows out of time; return which of the others are in short fragments."""
        # Refuse rows in no order of time: no run of them would be left to be judged
        back = np.flatnonzero(np.diff(self.time) < 0)
        if back.size > _BACKWARDS * max(self.time.size - 1, 1):
            first, second = self.rows[back[0]], self.rows[back[0] + 1]
            raise RecordingError(
                f"the time runs backwards in {back.size} of {self.time.size} rows, at row {second} "
                f"from {self.columns.time[first]:.6g} s to {self.columns.time[second]:.6g} s; "
                "expected rows in order of time",
                rows=[int(second)],
            )
        self.leave_out("the time repeats that of the row before", self.repeated())
        self.leave_out("a value is impossible", self.impossible_time())
        self.leave_out("the time does not increase", self.astray())
        fragments = self.fragments()
        misplaced = self.misplaced(fragments)
        self.leave_out("the time does not increase", misplaced)
        return fragments[~misplaced]

    def check_rest(self) -> None:
        """Leave out what is too short by now, and refuse what is left where it says too little."""
        self.leave_out(f"less than {SHORTEST_PIECE:g} s between gaps", self.short())
        self.check_amount()
        self.check_units()

    def empty(self) -> str:
        """Name the columns that a fit needs and that hold no number at all."""
        columns = self.columns
        if not columns.time.size:
            return ""
        kinds = {"position": columns.position, "torque": columns.torque}
        if columns.command is not None:
            kinds |= by_channel(columns.command, columns.led)
        named = [
            f"{kind}_{j + 1}"
            for kind, values in kinds.items()
            for j in np.flatnonzero(~np.isfinite(values).any(axis=0)).tolist()
        ]
        return f"; no number in {', '.join(named)}" if named else ""

    def impossible(self) -> Mask:
        bad = np.zeros(self.rows.size, dtype=bool)
        for quantity, values in self.columns.quantities().items():
            # How large a quantity of each joint may be, (n,)
            usual = _IMPOSSIBLE.get(quantity, _IMPOSSIBLE_EXTRA)
            turning = commanded_by(VELOCITY, self.columns.led) & (quantity == "position")
            limit = np.where(turning, _IMPOSSIBLE_EXTRA, usual)
            size = np.abs(values[self.rows])
            self._refuse_systematic(quantity, size > limit, limit)  # NaN compares false
            if quantity == "torque" and size.size:
                factor, least = _IMPOSSIBLE_TORQUE
                limit = np.minimum(limit, np.maximum(factor * np.median(size, axis=0), least))
            bad |= (size > limit).any(axis=1)
        return bad

    def _refuse_systematic(self, quantity: str, beyond: Mask, limit: FloatArray) -> None:
        share = beyond.mean(axis=0) if beyond.size else np.zeros(1)
        j = int(share.argmax())
        if share[j] > SYSTEMATIC and quantity in _UNIT_HINT:
            raise RecordingError(
                f"{quantity}_{j + 1} is beyond ±{limit[j]:g} in {share[j]:.0%} of the rows, "
                f"expected {_UNIT_HINT[quantity]}",
                rows=self.rows[np.flatnonzero(beyond[:, j])[:1]].tolist(),
            )

    def repeated(self) -> Mask:
        return np.append(False, np.diff(self.time) == 0)[: self.rows.size]

    def fragments(self) -> Mask:
        """Mark runs of even progress that are too short to be differentiated."""
        lengths = np.array([rows.stop - rows.start for rows in held_values.even_runs(self.time)])
        return np.repeat(lengths < FEWEST_CONTIGUOUS, lengths)

    def impossible_time(self) -> Mask:
        """Mark rows of fragments whose time is far from where the recording can reach.

        Longer runs far away are another session, not a corrupt value.
        """
        time = self.time
        if time.size < FEWEST_SAMPLES:
            return np.zeros(time.size, dtype=bool)
        steps = np.abs(np.diff(time))
        length = time.size * float(np.median(steps))
        return self.fragments() & (np.abs(time - np.median(time)) > _IMPOSSIBLE_TIME * length)

    def astray(self) -> Mask:
        """Mark a row or two out of time, without which the time goes on evenly.

        That are those with the wrong stamps, whether these are before or after their time.
        """
        time, marked = self.time, np.zeros(self.rows.size, dtype=bool)
        forward = np.diff(time)
        period = float(np.median(forward[forward > 0])) if (forward > 0).any() else 0.0
        for many in range(1, min(FEWEST_LATE, time.size - 1)):
            before, first = time[: -many - 1], time[1:-many]
            last, after = time[many:-1], time[many + 1 :]
            goes_on = np.abs(after - before - (many + 1) * period) < period / 2
            out = goes_on & ((first <= before) | (last >= after))
            near = [marked[k : k + out.size] for k in range(many + 2)]
            out &= ~np.any(near, axis=0)  # where one is enough, two are not
            for k in range(1, many + 1):
                marked[k : k + out.size] |= out
        return marked

    def misplaced(self, fragments: Mask) -> Mask:
        """Mark rows of fragments whose time does not lie between that of their neighbours."""
        time = self.time
        lower = np.maximum.accumulate(np.where(fragments, -np.inf, time))
        upper = np.minimum.accumulate(np.where(fragments, np.inf, time)[::-1])[::-1]
        return fragments & ~((time > lower) & (time < upper))

    def backwards(self) -> Mask:
        time = self.time
        if not time.size:
            return np.zeros(0, dtype=bool)
        late = np.append(False, time[1:] <= np.maximum.accumulate(time)[:-1])
        bounds = [0, *(np.flatnonzero(np.diff(late)) + 1).tolist(), late.size]
        lengths = np.diff(bounds)
        single = late & np.repeat(lengths < FEWEST_LATE, lengths)  # whose stamp alone is wrong
        if np.mean(late & ~single) > SYSTEMATIC:
            at = int(np.flatnonzero(late)[0])
            raise RecordingError(
                f"the time runs backwards at row {self.rows[at]}, from {time[at - 1]:.6g} s to "
                f"{time[at]:.6g} s; are these two recordings in one file?",
                rows=[int(self.rows[at])],
            )
        return late

    def spikes(self) -> Mask:
        """Mark single values far from the median of their neighbours, against what is usual."""
        bad = np.zeros(self.rows.size, dtype=bool)
        for quantity, floor in _SPIKE_FLOOR.items():
            every = getattr(self.columns, quantity)[self.rows].T
            turned = self._turned() if quantity == "position" else np.zeros(len(every))
            for values, further in zip(every, turned.tolist(), strict=True):
                bad |= self._far_from_neighbours(values, floor + further)
        return bad

    def _turned(self) -> FloatArray:
        """Return how far each joint is told to turn in half a window at most, (n,) [rad].

        So far from its neighbours is a wheel where it begins to turn the other way.
        """
        command, own = self.columns.command, commanded_by(VELOCITY, self.columns.led)
        if command is None or not own.any() or self.rows.size < FEWEST_CONTIGUOUS:
            return np.zeros(own.size)
        fastest = np.abs(command[self.rows]).max(axis=0)
        return own * (_SPIKE_WINDOW // 2) * fastest * float(np.median(np.diff(self.time)))

    def _far_from_neighbours(self, values: FloatArray, floor: float) -> Mask:
        from scipy.ndimage import median_filter  # slow to import, and a live stream needs it not

        half = _SPIKE_WINDOW // 2
        if np.abs(np.diff(values)).max(initial=0.0) * half < floor:  # no value can be farther
            return np.zeros(values.size, dtype=bool)
        deviation = np.zeros_like(values)
        for rows in held_values.contiguous(self.time):
            near = median_filter(values[rows], size=_SPIKE_WINDOW, mode="nearest")
            deviation[rows] = np.abs(values[rows] - near)
        return deviation > max(_SPIKE_FACTOR * float(np.percentile(deviation, 99)), floor)

    def short(self) -> Mask:
        """Mark stretches between gaps that are too short for any low-pass, (T,)."""
        time = self.time
        pieces = held_values.contiguous(time)
        lasts = [float(time[rows.stop - 1] - time[rows.start]) for rows in pieces]
        short = np.array([len(pieces) > 1 and last < SHORTEST_PIECE for last in lasts], dtype=bool)
        return np.repeat(short, [rows.stop - rows.start for rows in pieces])

    def held_positions(self) -> dict[str, IntArray]:
        """Return the rows with a position that an encoder repeats in motion, by reason."""
        led = commanded_by(POSITION, self.columns.led)
        command = self.columns.command
        return {
            held_values.held_reason(j): self.rows[
                held_values.held_position(
                    self.time,
                    position,
                    command[self.rows, j] if command is not None and led[j] else None,
                )
            ]
            for j, position in enumerate(self.columns.position[self.rows].T)
        }

    def held_torques(self) -> Mask:
        """Mark torques that a sensor repeats in motion, (all rows, n)."""
        columns, rows = self.columns, self.rows
        result = np.zeros_like(columns.torque, dtype=bool)
        for j in range(columns.position.shape[1]):
            position, torque = columns.position[rows, j], columns.torque[rows, j]
            result[rows, j] = held_values.held_torque(self.time, position, torque)
        return result

    def check_amount(self) -> None:
        total = self.columns.time.size
        if self.rows.size < FEWEST_SAMPLES:
            reasons = "; ".join(f"{sum(map(len, r))} rows: {k}" for k, r in self._reasons.items())
            raise RecordingError(
                f"has {self.rows.size} usable rows of {total}, expected at least {FEWEST_SAMPLES}"
                + (f"; left out: {reasons}" if reasons else "")
                + self.empty(),
                rows=[row for item in self.left_out() for row in item.rows],
            )
        duration = float(np.ptp(self.time))
        rate = 1.0 / float(np.median(np.diff(self.time)))
        if not RATES[0] <= rate <= RATES[1]:
            unit = unit_of(1.0 / rate)
            hint = f"; is the time in {unit}, with steps of {1 / rate:.4g}?" if unit else ""
            raise RecordingError(
                f"is sampled at {rate:.4g} Hz, expected 10 to 5000 Hz and time in seconds{hint}"
            )
        if duration < SHORTEST:
            raise RecordingError(f"lasts {duration:.3g} s, expected at least {SHORTEST:g} s")

    def check_units(self) -> None:
        position = self.columns.position[self.rows]
        factors = held_values.velocity_factors(self.columns, self.rows)
        usual = float(np.median(list(factors.values()))) if factors else 1.0
        if 1 / _DEGREES[1] < abs(usual) < 1 / _DEGREES[0]:
            raise RecordingError(
                f"positions change {1 / usual:.3g} times as fast as the velocities say; expected "
                "rad and rad/s; are the positions in degrees?"
            )

        for j in np.flatnonzero(np.ptp(position, axis=0) < STILL).tolist():
            if (swing := held_values.swept(self.columns, self.rows, j)) > _SWEPT:
                raise RecordingError(
                    f"position_{j + 1} never changes, but velocity_{j + 1} makes the joint swing "
                    f"over {swing:.2g} rad; expected both of the same motion"
                )
