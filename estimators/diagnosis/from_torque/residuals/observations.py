"""Observations: recordings and simulation through one filter, on one slow grid of rows.

Torque, simulated torque and every column that could explain their difference pass the same
zero-phase low-pass. Otherwise the filter itself would look like physics: the sharp sign of a
friction has high frequencies that the filtered torque has lost.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from scipy.ndimage import binary_opening, maximum_filter1d

from estimators.diagnosis.from_torque.residuals.observed_recording import ObservedRecording
from estimators.diagnosis.settings import TINY
from estimators.diagnosis.settings.residuals import MISTAKES, NOISE, ROWS
from estimators.diagnosis.stages import end_if_late
from estimators.rigid_body.fitting.extent import Extents
from estimators.rigid_body.regressor import RegressorChain
from limo_driver.errors import RecordingError
from limo_driver.model.units import unit_of
from limo_driver.physics import TimeDelay
from limo_driver.physics.effect import ArmMotion, MotionEffect
from limo_driver.physics.effects.friction import SIGN_WIDTH
from limo_driver.recordings.filters.differentiation import FilteredStretch, smooth, stretch_of
from limo_driver.types import BoolArray, FloatArray, IntArray, Motion

if TYPE_CHECKING:
    from collections.abc import Sequence

    from limo_driver.physics import Simulation
    from limo_driver.physics.effect import JointMotion, TorqueEffect
    from limo_driver.recordings.recording import Recording

_OF_MOTION = (
    "chain", "in_time", "recorded", "recording", "segment", "since_reversal", "sign_width",
    "_filters",
)  # fmt: skip
_OF_REFERENCE = ("load", "arms", "_of_joints", "predicted", "regressor", "stiffness", "inertia")


@dataclass(frozen=True)
class Observations:
    """Recordings beside a simulation: T samples, K of them rows of the slow grid, n joints."""

    simulation: Simulation
    recordings: tuple[Recording, ...]
    bandwidth: float  # [Hz]
    motion: Motion  # (T,) all recordings, one after the other; each has its own time
    slow: Motion  # (K,) the same within the bandwidth, on the rows kept
    segments: tuple[slice, ...]  # contiguous stretches of those samples
    recording_of_sample: IntArray  # (T,) which recording each sample is from
    kept: IntArray  # (K,) samples that are rows of the slow grid
    measured: FloatArray  # (K, n) [N m]
    extents: Extents  # where mass may be, by the simulation that was given
    disturbed: BoolArray | None = None  # (K,) rows of pushes and jolts
    around: Simulation | None = None  # that columns are taken around, where not the given one
    unmeasured: BoolArray | None = None  # (K, n) torques that are no measurement

    @classmethod
    def of(
        cls, simulation: Simulation, recordings: Sequence[Recording], bandwidth: float
    ) -> Observations:
        """Filter the recordings.

        Raises:
            RecordingError: Too little is left, or the bandwidth does not suit a recording.
        """
        if not (np.isfinite(bandwidth) and bandwidth > 0):
            raise RecordingError(f"a bandwidth of {bandwidth:g} Hz, expected a positive number")
        parts = [ObservedRecording.of(recording, bandwidth) for recording in recordings]
        starts = np.cumsum([0, *(len(part.sharp) for part in parts)])[:-1]
        rows = np.concatenate(
            [start + part.kept for start, part in zip(starts, parts, strict=True)]
        )
        if rows.size < ROWS.least:
            raise RecordingError(
                f"the recordings leave {rows.size} independent rows at a bandwidth of "
                f"{bandwidth:g} Hz; a diagnosis needs {ROWS.least}: record for longer"
            )
        return cls(
            simulation,
            tuple(recordings),
            bandwidth,
            _joined([part.sharp for part in parts]),
            _joined([part.smooth for part in parts])[rows],
            tuple(
                slice(start + segment.start, start + segment.stop)
                for start, part in zip(starts, parts, strict=True)
                for segment in part.segments
            ),
            np.repeat(np.arange(len(parts)), [len(part.sharp) for part in parts]),
            rows,
            np.concatenate([part.measured for part in parts])[rows],
            Extents(simulation.model),
            unmeasured=np.concatenate([part.unmeasured for part in parts])[rows],
        )

    def part(self, recording: int) -> Observations:
        """Return the observations of one recording (0-based) alone."""
        first, last = np.flatnonzero(self.recording_of_sample == recording)[[0, -1]]
        rows = self.recording == recording
        inside = [rows for rows in self.segments if first <= rows.start <= last]
        return replace(
            self,
            recordings=(self.recordings[recording],),
            motion=self.motion[first : last + 1],
            slow=self.slow[rows],
            segments=tuple(slice(rows.start - first, rows.stop - first) for rows in inside),
            recording_of_sample=np.zeros(last + 1 - first, dtype=np.int64),
            kept=self.kept[rows] - first,
            measured=self.measured[rows],
            disturbed=None if self.disturbed is None else self.disturbed[rows],
            unmeasured=None if self.unmeasured is None else self.unmeasured[rows],
        )

    def under(self, simulation: Simulation, around: Simulation | None = None) -> Observations:
        """Return the same recordings beside another simulation of the robot.

        What does not depend on the change is not computed again.
        """
        other = replace(self, simulation=simulation, around=around)
        same = [*_OF_MOTION, "moving"]
        same += _OF_REFERENCE if other.reference is self.reference else ()
        same += ("simulated",) if simulation is self.simulation else ()
        return self._sharing(other, same)

    def without_torque_of(self, joints: Sequence[int]) -> Observations:
        """Return the same with no torque of some joints (0-based) taken for a measurement."""
        if not joints:
            return self
        none = np.zeros(self.measured.shape, dtype=bool)
        none[:, list(joints)] = True
        if self.unmeasured is not None:
            none |= self.unmeasured
        other = replace(self, unmeasured=none)
        return self._sharing(other, (*_OF_MOTION, *_OF_REFERENCE, "simulated"))

    def undisturbed(self, rows: BoolArray | None) -> Observations:
        """Return the same, where some rows (K,) are of pushes or jolts, or none."""
        other = replace(self, disturbed=rows)
        return self._sharing(other, (*_OF_MOTION, *_OF_REFERENCE, "simulated"))

    def _sharing(self, other: Observations, names: Sequence[str]) -> Observations:
        known = vars(self)
        vars(other).update({name: known[name] for name in names if name in known})
        return other

    def unit(self, unit: str, joint: int | None = None) -> str:
        """Return the unit of a joint (0-based), or of all, of what has this one at turning ones."""
        return unit_of(unit, self.simulation.model.sliding, joint)

    @property
    def n(self) -> int:
        """Number of joints."""
        return self.motion.n

    @cached_property
    def least_noise(self) -> float:
        """Deviation that any noise has: more than rounding makes of the arm's torque [N m]."""
        strongest = float(np.median(np.abs(self.measured), axis=0).max(initial=0.0))
        return max(NOISE.least * strongest, TINY)

    @cached_property
    def chain(self) -> RegressorChain:
        """The arm for regressors."""
        return RegressorChain.of(self.simulation.model)

    @cached_property
    def in_time(self) -> FloatArray:
        """Regressor of the rigid body on the slow rows, (n, K, 10 n)."""
        return self.chain.regressor(self.slow)

    @cached_property
    def regressor(self) -> FloatArray:
        """The same, as late as sensors tell it."""
        if not any(isinstance(effect, TimeDelay) for effect in self.reference.effects):
            return self.in_time
        return np.stack([self.sensed(Y, joint) for joint, Y in enumerate(self.in_time)])

    def sensed(self, torque: FloatArray, joint: int) -> FloatArray:
        """Return torques (K, ...) of a joint (0-based) as late as its sensor tells them."""
        late = [
            effect
            for effect in self.reference.effects
            if isinstance(effect, TimeDelay) and effect.joint == joint + 1
        ]
        if not late:
            return torque
        result = np.array(torque)
        for rows in self.stretches:
            for effect in late:
                result[rows] = effect.late(self.slow.time[rows], result[rows])
        return result

    @cached_property
    def recording(self) -> IntArray:
        """Recording of each kept row, 0-based, (K,)."""
        return self.recording_of_sample[self.kept]

    @cached_property
    def segment(self) -> IntArray:
        """Contiguous segment of each kept row, (K,)."""
        return np.searchsorted([rows.stop for rows in self.segments], self.kept, side="right")

    @property
    def stretches(self) -> list[slice]:
        """Kept rows of each contiguous segment that has some."""
        ends = [*(np.flatnonzero(np.diff(self.segment)) + 1).tolist(), self.segment.size]
        return [slice(a, b) for a, b in zip([0, *ends], ends, strict=False)]

    @property
    def row_period(self) -> float:
        """Median time between kept rows [s]."""
        steps = np.diff(self.motion.time[self.kept])
        return float(np.median(steps[steps > 0]))

    def filter(self, values: FloatArray) -> FloatArray:
        """Filter full-rate columns (T, ...) as the torque was and keep the slow rows, (K, ...)."""
        flat = values.reshape(values.shape[0], -1)
        return self.filter_together([flat]).reshape(self.kept.size, *values.shape[1:])

    def filter_together(self, signals: Sequence[FloatArray]) -> FloatArray:
        """Filter several signals (T, m) each, and keep the slow rows of all, side by side.

        One stretch after the other, since what of all signals is in one fits the processor's cache.
        """
        result = np.empty((self.kept.size, sum(values.shape[1] for values in signals)))
        for rows, (stretch, own) in zip(self.segments, self._filters, strict=True):
            some = self.kept[own] - rows.start
            if some.size:
                padded = stretch.filter(*(values[rows] for values in signals))
                result[own] = stretch.read(padded, some)
        return result

    @cached_property
    def _filters(self) -> tuple[tuple[FilteredStretch, slice], ...]:
        """The filter of each segment, and which of the slow rows are in it."""
        inside = (np.searchsorted(self.kept, [rows.start, rows.stop]) for rows in self.segments)
        return tuple(
            (stretch_of(self.motion.time[rows], self.bandwidth), slice(int(first), int(stop)))
            for rows, (first, stop) in zip(self.segments, inside, strict=True)
        )

    def predict(self, simulation: Simulation) -> FloatArray:
        """Return the torque that a simulation says was measured, unfiltered, (T, n) [N m]."""
        end_if_late()
        load = self.load if simulation.has_body_of(self.reference) else None
        return simulation.predict_stretches(self.motion, self.segments, self.bandwidth, load)

    @property
    def reference(self) -> Simulation:
        """The simulation that columns are taken around."""
        return self.around or self.simulation

    @cached_property
    def load(self) -> FloatArray:
        """Rigid-body torque of every sample, (T, n) [N m]."""
        motion = self.motion
        return self.reference.body.inverse_dynamics(
            motion.position, motion.velocity, motion.acceleration
        )

    @cached_property
    def arms(self) -> tuple[ArmMotion, ...]:
        """Motion and load of the arm in each segment."""
        body = self.reference.body
        return tuple(ArmMotion(self.motion[rows], self.load[rows], body) for rows in self.segments)

    @cached_property
    def _of_joints(self) -> tuple[tuple[JointMotion, ...], ...]:
        """The same of each joint, in each segment."""
        return tuple(tuple(arm.of_joint(j) for arm in self.arms) for j in range(self.n))

    def seen_by(self, effect: TorqueEffect | MotionEffect) -> Sequence[JointMotion]:
        """Return the motion and load of an effect's joint in each segment."""
        j = effect.joint - 1
        own = self._of_joints[j]
        if not (isinstance(effect, MotionEffect) and effect.needs_inertia):
            return own
        inertia = np.interp(np.arange(len(self.motion)), self.kept, self.inertia[j, j])
        starts = self.motion.position[[rows.start for rows in self.segments]]
        held = self.reference.body.gravity_torque(starts)[:, j].tolist()
        return [
            replace(motion, inertia=inertia[rows], held=start)
            for motion, rows, start in zip(own, self.segments, held, strict=True)
        ]

    @cached_property
    def predicted(self) -> FloatArray:
        """Torque of the simulation around which columns are computed, unfiltered, (T, n) [N m]."""
        return self.predict(self.reference)

    def predicted_without(self, place: str) -> FloatArray:
        """Return the same without the effect at a place (`Effect.place`), where it has one.

        The last is kept: a search for the settings of one effect asks for it hundreds of times.
        """
        others = tuple(effect for effect in self.reference.effects if effect.place != place)
        if len(others) == len(self.reference.effects):
            return self.predicted
        if place not in self._without:
            self._without.clear()
            self._without[place] = self.predict(replace(self.reference, effects=others))
        return self._without[place]

    @cached_property
    def _without(self) -> dict[str, FloatArray]:
        return {}

    @cached_property
    def simulated(self) -> FloatArray:
        """Torque of the given simulation, filtered, (K, n) [N m]."""
        given = self.predicted if self.around is None else self.predict(self.simulation)
        return self.filter(given)

    @cached_property
    def recorded(self) -> FloatArray:
        """Recorded torque of every sample, unfiltered, (T, n) [N m]."""
        result = np.empty_like(self.motion.position)
        for k, recording in enumerate(self.recordings):
            own = self.recording_of_sample == k
            time = self.motion.time[own]
            result[own] = np.stack(
                [np.interp(time, recording.time, torque) for torque in recording.torque.T], axis=1
            )
        return result

    def above(self, values: FloatArray) -> FloatArray:
        """Return what samples (T, k) have above the bandwidth."""
        return values - smooth(self.motion.time, values, self.bandwidth, self.segments)

    @property
    def residual(self) -> FloatArray:
        """Recorded minus simulated torque, (K, n) [N m]."""
        return self.measured - self.simulated

    @cached_property
    def beyond_load(self) -> FloatArray:
        """What the given simulation adds to load and friction: rotors, springs, ..., (K, n) [N m].

        Friction is left out, since it is known less well than all else.
        """
        simulation = self.simulation
        others = simulation.without_friction().effects
        if not others:
            return np.zeros_like(self.measured)
        motion = self.motion
        load = simulation.body.inverse_dynamics(
            motion.position, motion.velocity, motion.acceleration
        )
        return self.filter(self.predict(replace(simulation, effects=others)) - load)

    @cached_property
    def stiffness(self) -> FloatArray:
        """Derivative of the rigid-body torque by each position, (n by, n of, K) [N m/rad]."""
        body, slow = self.reference.body, self.slow
        result = np.empty((self.n, self.n, len(slow)))
        for j in range(self.n):
            step = np.zeros(self.n)
            step[j] = ROWS.difference
            ahead, behind = (
                body.inverse_dynamics(slow.position + sign * step, slow.velocity, slow.acceleration)
                for sign in (1, -1)
            )
            result[j] = (ahead - behind).T / (2 * ROWS.difference)
        return result

    @cached_property
    def inertia(self) -> FloatArray:
        """Mass matrix on the slow rows, (n by, n of, K) [kg m²]."""
        body, position = self.reference.body, self.slow.position
        return np.stack([body.inertia_of(position, j).T for j in range(self.n)])

    @cached_property
    def moving(self) -> BoolArray:
        """Mark the rows on which a joint is not near rest, without pushes and jolts, (K, n).

        Near rest friction takes any value in its band, and a sharp sign turns the noise of the
        velocity into torque: such rows say little and err much. The few rows of a joint that hardly
        moves count for nothing: they say as little of its errors as of its friction.
        """
        moving = self.faster(ROWS.rest)
        return moving & (moving.sum(axis=0) >= MISTAKES.least_moving)

    @cached_property
    def sign_width(self) -> FloatArray:
        """Speed over which each joint's friction changes its sign in the simulation, (n,) [rad/s].

        The widest of those stated: within it, the simulation does not claim to know friction.
        """
        width = np.full(self.n, SIGN_WIDTH)
        for effect in self.simulation.effects:
            smoothed = [known.name for known in effect.parameters() if known.smooths]
            widths = [own for name in smoothed if (own := getattr(effect, name)) is not None]
            for joint in effect.joints if widths else ():
                width[joint - 1] = max(width[joint - 1], *widths)
        return width

    def faster(self, widths: float) -> BoolArray:
        """Mark the rows, (K, n), on which a joint does not get slower than some sign widths.

        Nor does it within the reach of the filter, and nothing pushes. Where friction is stated
        over a wide range of speeds, a reversal passes through it and shows much; only where a
        joint dwells there does it hold anything.
        """
        speed = np.abs(self.motion.velocity)
        near = np.zeros(speed.shape, dtype=bool)
        for rows in self.segments:
            period = float(np.median(np.diff(self.motion.time[rows])))
            long = max(1, round(ROWS.dwell / self.bandwidth / period))
            slow = speed[rows] < widths * self.sign_width
            dwells = np.asarray(binary_opening(slow, np.ones((long, 1))), dtype=bool)
            still = dwells | (speed[rows] < widths * SIGN_WIDTH)
            reach = max(1, round(1.0 / self.bandwidth / period))
            near[rows] = maximum_filter1d(still, 2 * reach + 1, axis=0)
        moving = ~near[self.kept]
        if self.unmeasured is not None:
            moving &= ~self.unmeasured
        return moving if self.disturbed is None else moving & ~self.disturbed[:, None]

    def measured_on(self, rows: BoolArray) -> BoolArray:
        """Mark which torques of some rows (K,) are measurements, (K, n)."""
        every = np.broadcast_to(rows[:, None], self.measured.shape)
        return every if self.unmeasured is None else every & ~self.unmeasured

    @cached_property
    def since_reversal(self) -> FloatArray:
        """Distance that each joint has travelled since its last reversal, (T, n) [rad]."""
        result = np.zeros_like(self.motion.position)
        for rows in self.segments:
            result[rows] = _since_reversal(self.motion.position[rows], self.motion.velocity[rows])
        return result


def _since_reversal(position: FloatArray, velocity: FloatArray) -> FloatArray:
    sign = np.sign(velocity)
    result = np.empty_like(position)
    for j in range(position.shape[1]):
        turn = np.flatnonzero(np.diff(sign[:, j]) != 0) + 1
        last = np.zeros(position.shape[0], dtype=np.int64)
        last[turn] = turn
        last = np.maximum.accumulate(last)
        result[:, j] = np.abs(position[:, j] - position[last, j])
    return result


def _joined(motions: Sequence[Motion]) -> Motion:
    temperatures = [motion.temperature for motion in motions]
    known = [values for values in temperatures if values is not None]
    return Motion(
        np.concatenate([motion.time for motion in motions]),
        np.concatenate([motion.position for motion in motions]),
        np.concatenate([motion.velocity for motion in motions]),
        np.concatenate([motion.acceleration for motion in motions]),
        np.concatenate(known) if len(known) == len(motions) else None,
    )
