"""Play a trajectory on any robot, one command a cycle, and record what it measures."""

from __future__ import annotations

import threading
import time
from collections import Counter
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any, ClassVar, Protocol

import numpy as np

from limo_driver.errors import ConfigError, LimoError
from limo_driver.recordings.files.recorder import Recorder
from limo_driver.robot.interrupts import interrupts
from limo_driver.robot.realtime import Realtime
from limo_driver.runtime.outputs import require_file, require_parquet
from limo_driver.trajectory import Trajectory
from limo_driver.types import FloatArray, ImpedanceCommand, PositionCommand

if TYPE_CHECKING:
    from collections.abc import Callable, Generator

    from limo_driver.recordings.recording import Recording
    from limo_driver.trajectory import Planned
    from limo_driver.types import JointCommand, JointState, RobotSpec, StatesAhead

DAMPING_PER_STIFFNESS = 0.1  # [s], of an impedance run: well damped at the inertia of such arms
_CYCLES = 256  # after which progress is told
_AHEAD = 1024  # cycles simulated at a time, a multiple of these
HOLD_TIMEOUT = 10.0  # [s] of robot time in which a hold has to come to rest


class Playable(Protocol):
    """What playing needs of a robot; `Robot` says what each does."""

    simulated: ClassVar[bool]
    spec: RobotSpec

    @property
    def standing(self) -> bool:
        """Whether the set-point is at rest."""
        ...

    @property
    def setpoint(self) -> FloatArray:
        """Position set-point, (n,) [rad]."""
        ...

    def receive(self) -> JointState:
        """Wait for the next cycle."""
        ...

    def send(self, command: JointCommand) -> JointCommand:
        """Answer the last state; return what the drives will apply."""
        ...

    def send_ahead(self, targets: FloatArray) -> StatesAhead | None:
        """Answer as many cycles with positions (T, n) [rad]; None where that changes something."""
        ...

    def stand_by(self) -> JointState:
        """Wait for the next cycle before the motion."""
        ...

    def wait_until_ready(self) -> None:
        """Wait until it takes commands."""

    def keep_time(self) -> None:
        """Run no faster than real time."""

    def hold(self, reason: str) -> None:
        """Slow down, then keep the pose."""

    def link_figures(self) -> dict[str, Any]:
        """Return what was counted on the link."""
        ...


@dataclass(frozen=True)
class PlaybackSummary:
    """Result of a run."""

    record: str
    samples: int  # rows of the recording
    duration: float  # of robot time [s]
    real_time_factor: float  # robot time over wall time
    tracking_rmse: FloatArray  # (n,) [rad], measured against commanded
    tracking_max: FloatArray  # (n,) [rad]
    limited: dict[str, int]  # cycles in which each limit changed the command
    interrupted: bool
    link: dict[str, Any]  # what was counted on the link to a real arm
    refused: tuple[str, ...]  # what the machine did not permit of what was asked for

    def as_json(self) -> dict[str, Any]:
        """Return plain values."""
        return {
            **vars(self),
            "tracking_rmse": self.tracking_rmse.tolist(),
            "tracking_max": self.tracking_max.tolist(),
        }


class NotBegunError(KeyboardInterrupt):
    """A run was interrupted before the arm moved; nothing was recorded."""


class _States:
    """Receives the states of a robot and publishes them, numbered so that only a loss is a gap.

    Args:
        robot: Open.
        publish: Told the states, if anybody is.
        every: Cycles for each state that is published.
    """

    def __init__(
        self, robot: Playable, publish: Callable[[JointState], None] | None, every: int
    ) -> None:
        self.robot, self._publish, self._every = robot, publish, every
        self._stood = 0  # cycles in which a simulated arm's own time stood
        self._last = -1  # number of the last state, as the robot has it

    def receive(self) -> JointState:
        """Wait for the next cycle and publish its state."""
        return self._put(self.robot.receive())

    def stand_by(self) -> JointState:
        """Wait for the next cycle before the motion, and publish its state."""
        state = self.robot.stand_by()
        self._stood += state.sequence == self._last
        return self._put(state)

    def _put(self, state: JointState) -> JointState:
        self._last = state.sequence
        sequence = state.sequence + self._stood
        if self._publish is not None and sequence % self._every == 0:
            now = state.time + self._stood * self.robot.spec.period
            self._publish(replace(state, sequence=sequence // self._every, time=now))
        return state


@dataclass(frozen=True)
class Playback:
    """One trajectory on one robot.

    Args:
        trajectory: The motion.
        record: Parquet file to write.
        record_every: Cycles for each row of the recording, and for each state that is published.
        stiffness: Follow as an impedance of this stiffness [N m/rad] instead of by position.
        provenance: What made this run, for the recording's header.
        publish: Told the states as they are measured, numbered so that only a lost one is a gap.
        fifo: Ask for SCHED_FIFO and locked memory while a real arm moves.
        start_when: Asked in every cycle before the motion, until it says yes; for example a
            `FirstEstimate`. Meanwhile the arm stands, in real time, and its states are published.
            What it raises ends the run; nothing has moved and nothing is recorded by then.
    """

    trajectory: Trajectory
    record: Path
    record_every: int = 1
    stiffness: float | None = None
    provenance: dict[str, Any] | None = None
    publish: Callable[[JointState], None] | None = None
    fifo: bool = False
    start_when: Callable[[], bool] | None = None

    def run(self, robot: Playable, progress: Callable[[int, int], None]) -> PlaybackSummary:
        """Move the arm along the trajectory; a signal that ends programs slows it down to a hold.

        Args:
            robot: Open, standing where the trajectory starts.
            progress: Told the cycles done and the cycles in all, now and then.

        Raises:
            JointLimitError: The arm does not stand where the trajectory starts.
            HoldingError: The arm went into a hold by itself; what was recorded is kept.
            NotBegunError: SIGINT or SIGTERM came before it moved.
        """
        if robot.simulated:
            return self._run(robot, progress, None)
        with Realtime(fifo=self.fifo) as realtime:
            return self._run(robot, progress, realtime)

    def _run(
        self, robot: Playable, progress: Callable[[int, int], None], realtime: Realtime | None
    ) -> PlaybackSummary:
        targets = self.trajectory.resample(robot.spec.period).position
        robot.wait_until_ready()
        states = _States(robot, self.publish, self.record_every)
        state = states.receive()
        errors = np.zeros((2, robot.spec.n))  # sum of squares, maximum
        limited: Counter[str] = Counter()
        done, reached = 0, 0.0
        interrupted = threading.Event()
        with interrupts(interrupted.set), ExitStack() as open_:
            if self.start_when is not None:
                state = self._stand_by(self.start_when, states, state, interrupted, realtime)
            while state.stale and not state.holding:  # which no stream can start from
                if interrupted.is_set():
                    raise NotBegunError
                state = states.receive()
            start, began = state.time, time.monotonic()
            recorder = open_.enter_context(self._recorder(robot, start))
            open_.enter_context(self._braking(robot, recorder))
            while done < len(targets):  # how far it came
                if done % _CYCLES == 1:  # the first goes as always, and the last
                    ahead = targets[done : done + _AHEAD - 1][:-1]
                    if len(ahead) and (found := self._ahead(robot, state, ahead)) is not None:
                        self._keep(found, state, ahead, done, recorder, errors)
                        done, state = done + len(ahead), found.last
                target = targets[done]
                done += 1
                sent = robot.send(self._command(target))
                limited.update(sent.limited_by)
                if (done - 1) % self.record_every == 0:
                    recorder.append(state, target)
                error = np.abs(state.position - target)
                errors[0] += error**2
                np.maximum(errors[1], error, out=errors[1])
                reached = state.time - start
                # What can wait comes between an answer and the next state, not the other way round.
                if realtime is not None:
                    realtime.tidy()
                if done % _CYCLES == 0:
                    progress(done, len(targets))
                state = states.receive()
                if interrupted.is_set():
                    break
            if interrupted.is_set():
                recorder.stopped = "interrupted"
                self._stop(states.receive, robot, recorder, recorder.stopped)
        progress(done, len(targets))
        return PlaybackSummary(
            record=str(self.record),
            samples=recorder.samples,
            duration=reached,
            real_time_factor=reached / max(time.monotonic() - began, 1e-9),
            tracking_rmse=np.sqrt(errors[0] / done),
            tracking_max=errors[1],
            limited=dict(limited),
            interrupted=interrupted.is_set(),
            link=robot.link_figures(),
            refused=() if realtime is None else tuple(realtime.refused),
        )

    def _ahead(self, robot: Playable, state: JointState, targets: FloatArray) -> StatesAhead | None:
        """Have as many cycles simulated in one call, where nobody hears of each."""
        heard = self.publish is not None or self.stiffness is not None or state.stale
        return None if heard else robot.send_ahead(targets)

    def _keep(
        self,
        found: StatesAhead,
        state: JointState,
        targets: FloatArray,
        done: int,
        recorder: Recorder,
        errors: FloatArray,
    ) -> None:
        """Record the states that T targets (T, n) answered, the first of which is `state`."""
        before, after = slice(None, -1), (found.time, found.position, found.velocity, found.torque)
        first = (np.array([state.time]), state.position, state.velocity, state.torque)
        answered = [
            np.concatenate([np.reshape(one, (1, *rows.shape[1:])), rows[before]])
            for one, rows in zip(first, after, strict=True)
        ]
        kept = slice(-done % self.record_every, None, self.record_every)
        time, position, velocity, torque = (rows[kept] for rows in answered)
        recorder.append_all(time, position, velocity, torque, targets[kept])
        error = np.abs(answered[1] - targets)
        # summed one after the other, as cycle by cycle
        errors[0] = np.add.reduce(np.concatenate([errors[:1], error**2]), axis=0)
        np.maximum(errors[1], error.max(axis=0), out=errors[1])

    def _stand_by(
        self,
        ready: Callable[[], bool],
        states: _States,
        state: JointState,
        interrupted: threading.Event,
        realtime: Realtime | None,
    ) -> JointState:
        """Stand and publish until the motion may begin; return the state from which it does."""
        require_file(self.record)  # rather than after a long wait
        states.robot.keep_time()
        # A stream cannot start from a lost measurement; an arm that holds says why when it is sent.
        while not state.holding and (not ready() or state.stale):
            if interrupted.is_set():
                raise NotBegunError
            if realtime is not None:
                realtime.tidy()
            state = states.stand_by()
        return state

    def _command(self, target: FloatArray) -> JointCommand:
        if self.stiffness is None:
            return PositionCommand(position=target)
        stiffness = np.full(target.size, self.stiffness)
        return ImpedanceCommand(
            position=target,
            stiffness=stiffness,
            damping=DAMPING_PER_STIFFNESS * stiffness,
            torque=np.zeros(target.size),
        )

    def _recorder(self, robot: Playable, start: float) -> Recorder:
        offset = start - float(self.trajectory.time[0])
        segments = [
            [
                segment.kind,
                float(self.trajectory.time[segment.start]) + offset,
                float(self.trajectory.time[min(segment.stop, len(self.trajectory)) - 1]) + offset,
            ]
            for segment in self.trajectory.segments
        ]
        header = {
            "robot": robot.spec.name,
            "joints": list(robot.spec.joint_names),
            "segments": segments,  # kind, first and last time [s]
            "provenance": self.provenance or {},
        }
        if (step := robot.spec.torque_resolution) is not None:
            header["torque_resolution"] = step.tolist()  # of each joint [N m]
        measured = robot.spec.measures_temperature
        return Recorder(self.record, robot.spec.n, header, temperature=measured)

    @contextmanager
    def _braking(self, robot: Playable, recorder: Recorder) -> Generator[None]:
        """Bring the arm to rest before anything that was raised leaves."""
        try:
            yield
        except BaseException as error:
            recorder.stopped = str(error) or type(error).__name__
            with suppress(LimoError):  # it cannot be reached, for example; the drives stop it then
                self._stop(robot.receive, robot, recorder, f"{type(error).__name__} in the run")
            raise

    def _stop(
        self, receive: Callable[[], JointState], robot: Playable, recorder: Recorder, why: str
    ) -> None:
        """Slow the arm down to a hold, recording on."""
        robot.hold(why)
        for cycle in range(int(HOLD_TIMEOUT / robot.spec.period)):
            if robot.standing:
                return
            state = receive()
            if cycle % self.record_every == 0:
                recorder.append(state, robot.setpoint)


def trajectory_of(planned: Trajectory | Planned | Path | str) -> Trajectory:
    """Return a trajectory, or the one in a file, or in what was planned around it.

    Raises:
        ConfigError: There is none, or the file cannot be read.
    """
    if isinstance(planned, (Path, str)):
        return Trajectory.load(planned)
    motion = getattr(planned, "trajectory", planned)
    if not isinstance(motion, Trajectory):
        raise ConfigError(
            f"`trajectory` is of type {type(planned).__name__}, expected a Trajectory, what `plan` "
            "or `excite` returned, or the path of a file"
        )
    return motion


def follow(
    robot: Playable,
    trajectory: Trajectory,
    record: Path | str | None,
    stiffness: float | None,
    progress: Callable[[int, int], None] | None,
) -> Recording:
    """Play a trajectory on an open robot, and return the recording; see `Robot.follow`."""
    provenance = {"backend": type(robot).__name__, "trajectory": trajectory.source}
    with kept_in(record) as path:
        playback = Playback(trajectory, path, stiffness=stiffness, provenance=provenance)
        summary = playback.run(robot, progress or (lambda _done, _all: None))
        return recorded(summary, "" if record is None else str(record))


@contextmanager
def kept_in(record: Path | str | None) -> Generator[Path]:
    """Give the file of a recording, or one that is there until the block ends."""
    if record is not None:
        require_parquet(record)
        yield Path(record)
        return
    with TemporaryDirectory(prefix="limo-") as folder:
        yield Path(folder) / "run.parquet"


def recorded(summary: PlaybackSummary, source: str) -> Recording:
    """Read what a run recorded, with warnings of all that slowed it.

    Args:
        summary: Of the run; its file is still there.
        source: What the recording is to call its file.

    Raises:
        KeyboardInterrupt: The run was interrupted.
    """
    from limo_driver.recordings.recording import Recording

    if summary.interrupted:
        raise KeyboardInterrupt
    recording = Recording.load(summary.record)
    limited = [f"limited by {name} in {count} cycles" for name, count in summary.limited.items()]
    warnings = (*recording.warnings, *limited, *summary.refused)
    return replace(recording, source=source, warnings=warnings)


def cycles_per_row(rate: float, period: float) -> int:
    """Return after how many control cycles to record a row.

    Args:
        rate: Of the rows [Hz], a part of the control rate.
        period: Of the control cycle [s].

    Raises:
        ConfigError: The rate is no part of the control rate; names the nearest that is.
    """
    control = 1 / period
    if not 0 < rate < float("inf"):
        raise ConfigError(f"rate is {rate:g} Hz, expected above 0 and up to {control:g} Hz")
    if rate > control * (1 + 1e-9):
        raise ConfigError(f"rate {rate:g} Hz is above the control rate of {control:g} Hz")
    every = round(control / rate)
    if abs(control / rate - every) > 1e-6 * every:
        raise ConfigError(
            f"rate {rate:.9g} Hz does not divide the control rate of {control:.9g} Hz; the nearest "
            f"that does is {control / every:.9g} Hz, {control:.9g} / {every}"
        )
    return every
