"""Data for Table I from the simulated arm: excitation, LIMOPA motion and validation."""

from __future__ import annotations

import json
import shutil
from collections import defaultdict
from dataclasses import dataclass, replace
from importlib.metadata import version
from typing import TYPE_CHECKING, Final, Self

import numpy as np
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TaskID, TextColumn

from estimators.rigid_body.base_parameters import Conditioning
from estimators.studies.table1_data import DESCRIPTION, RBD, RECORDINGS, SCHEMA
from limo_driver import physics
from limo_driver.model import RobotModel
from limo_driver.robot.playback import Playback
from limo_driver.robot.registry import open_for
from limopa import PlanRequest, plan
from limopa.excitation.search import ExcitationRequest, excite
from limopa.planner import REACHING

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Sequence
    from pathlib import Path

    from rich.console import Console

    from estimators.studies.table1_results import Trial, TrialResult
    from limo_driver.trajectory import Trajectory

ROBOT: Final = "iiwa14"
MADE_BY: Final = "limo's MuJoCo simulation of joints with friction, hysteresis and elasticity"
_FRICTION: Final = (2.2, 2.4, 1.6, 1.7, 0.9, 0.45, 0.35)  # [N m], of each joint while it slides
_VISCOUS: Final = (4.0, 4.2, 2.4, 2.6, 1.1, 0.55, 0.4)  # [N m s/rad]
_ELASTIC: Final = (16e3, 16e3, 12e3, 12e3, 8e3, 6e3, 6e3)  # [N m/rad]
_NOISE: Final = (0.05, 0.05, 0.04, 0.04, 0.03, 0.02, 0.02)  # [N m], of the torque sensors
_PRESLIDING: Final = 0.7  # of the friction builds up after a reversal, the rest is Coulomb's
_STRIBECK: Final = 0.15  # of the friction, added at creep
_WIDTHS: Final = np.deg2rad([0.1, 0.3, 0.75, 1.5])  # rotation after which each element slips
_SHARES: Final = np.array([0.34, 0.3, 0.21, 0.15])  # of the presliding friction
_RECORDED: Final = 4  # control cycles of 1 ms for each row of a recording
_HOUR, _MINUTE = 3600, 60  # [s]


@dataclass(frozen=True)
class Size:
    """Amount of motion that is simulated."""

    scaffolds: int  # of the LIMOPA motion; 150 last about an hour
    excitation: ExcitationRequest
    validation: ExcitationRequest
    slower: tuple[float, ...]  # how often the validation is played, and how much slower each time


FULL: Final = Size(150, ExcitationRequest(), ExcitationRequest(duration=30.0), (1.0, 2.0, 4.0))
_DRAWN = ExcitationRequest(duration=20.0, starts=2, iterations=0)
QUICK: Final = Size(12, _DRAWN, _DRAWN, (1.0, 2.0))


def simulated_arm() -> physics.Simulation:
    """Return an iiwa 14 whose joints remember where they last reversed.

    Friction is of the size seen on such arms; the maker publishes none.
    """
    effects: list[physics.Effect] = []
    for joint, friction in enumerate(_FRICTION, start=1):
        sliding = (1.0 - _PRESLIDING) * friction
        stiffness = _SHARES * _PRESLIDING * friction / _WIDTHS
        effects += [
            physics.CoulombFriction(joint=joint, tau_c=sliding),
            physics.ViscousFriction(joint=joint, f_v=_VISCOUS[joint - 1]),
            physics.StribeckFriction(joint=joint, tau_s=_STRIBECK * friction, v_s=0.03, delta=2.0),
            physics.PreslidingHysteresis(
                joint=joint, stiffness=tuple(stiffness), width=tuple(_WIDTHS)
            ),
            physics.JointElasticity(joint=joint, stiffness=_ELASTIC[joint - 1]),
        ]
    sensors = physics.Sensors(torque_noise=_NOISE, encoder_resolution=(1e-5,))
    return physics.Simulation(ROBOT, tuple(effects), sensors=sensors)


def make(folder: Path, size: Size, tell: Callable[[str, float], None]) -> bool:
    """Make a data folder, whole or not at all.

    Args:
        folder: To be made.
        size: How much motion.
        tell: Called with what is being done and how much of it is.

    Returns:
        Whether it was made; an interrupt while the arm moves ends it before.
    """
    partial = folder.with_name(f"{folder.name}.partial")
    shutil.rmtree(partial, ignore_errors=True)
    partial.mkdir(parents=True)
    arm, model = simulated_arm(), RobotModel.load(ROBOT)
    conditioning = Conditioning(model)

    def excitation(request: ExcitationRequest, seed: int) -> Trajectory:
        return excite(
            model,
            conditioning,
            request,
            seed,
            lambda done, most, _: tell("searching excitation", done / most),
        ).trajectory

    limo = plan(
        model,
        PlanRequest(scaffolds=size.scaffolds),
        1,
        lambda done, wanted: tell("planning LIMOPA motion", done / wanted),
    ).trajectory
    motions = (
        excitation(size.excitation, 1),
        limo,
        repeated(excitation(size.validation, 2), size.slower),
    )
    for seed, (name, motion) in enumerate(zip(RECORDINGS, motions, strict=True)):
        with open_for("mujoco", motion, simulation=arm, robot=None, seed=seed) as robot:
            playback = Playback(
                motion, partial / name, _RECORDED, provenance={"limo": version("limo")}
            )
            summary = playback.run(
                robot, lambda done, all_, name=name: tell(f"recording {name}", done / all_)
            )
        if summary.interrupted:
            return False
    described = {
        "schema": SCHEMA,
        "robot": ROBOT,
        "made_by": MADE_BY,
        "scaffold_starts": scaffold_starts(limo),
    }
    (partial / DESCRIPTION).write_text(json.dumps(described, indent=1) + "\n")
    partial.replace(folder)
    return True


def scaffold_starts(limo: Trajectory) -> list[float]:
    """Return when the motion towards each scaffold starts [s]; it begins at the first of them."""
    reaches = [float(limo.time[s.start]) for s in limo.segments if s.kind == REACHING]
    return [float(limo.time[0]), *reaches]


def repeated(motion: Trajectory, slower: tuple[float, ...]) -> Trajectory:
    """Play a motion that returns to where it starts, at rest, again and again, ever slower.

    Args:
        motion: Starts and ends in one pose, at rest.
        slower: Factor of time of each repetition.
    """
    parts: list[tuple[np.ndarray, ...]] = []
    start = 0.0
    for factor in slower:
        rows = slice(1 if parts else 0, None)  # the pose between two repetitions counts once
        time = start + factor * (motion.time - motion.time[0])
        parts.append(
            (
                time[rows],
                motion.position[rows],
                motion.velocity[rows] / factor,
                motion.acceleration[rows] / factor**2,
            )
        )
        start = float(time[-1])
    time, position, velocity, acceleration = (
        np.concatenate(values) for values in zip(*parts, strict=True)
    )
    return replace(
        motion,
        time=time,
        position=position,
        velocity=velocity,
        acceleration=acceleration,
        segments=(),
    )


class TrialProgress:
    """Progress bars on a terminal, else one line for each trial.

    Args:
        console: Where to.
        trials: All of them.
        before: Those that were finished before.
        processes: How many run side by side.
    """

    def __init__(
        self,
        console: Console,
        trials: Sequence[Trial],
        before: Iterable[TrialResult],
        processes: int | None,
    ) -> None:
        self.console, self.processes = console, processes
        self.seconds: dict[str, list[float]] = defaultdict(list)  # of finished trials, by row
        self.rest = {trial.file_name: trial for trial in trials}
        self.total = len(trials)
        for result in before:
            self._done(result.trial, result.seconds)
        columns = (
            TextColumn("{task.description}", markup=False),
            BarColumn(),
            MofNCompleteColumn(),
            TextColumn("{task.fields[note]}", markup=False),
        )
        disable = not console.is_terminal
        self.progress = Progress(*columns, console=console, transient=True, disable=disable)
        self.bars: dict[str, TaskID] = {}
        self.all = self.progress.add_task("trials", total=self.total, note="")

    def __enter__(self) -> Self:
        self._count()
        self.progress.start()
        return self

    def __exit__(self, *_: object) -> None:
        self.progress.stop()

    def advanced(self, trial: Trial, epoch: int) -> None:
        """Show that a trial has gone through an epoch."""
        name = trial.file_name
        if name not in self.bars:
            self.bars[name] = self.progress.add_task(
                _title(trial), total=trial.settings.epochs, note="epochs"
            )
        self.progress.update(self.bars[name], completed=epoch)

    def finished(self, trial: Trial, seconds: float) -> None:
        """Show that a trial is done."""
        self._done(trial, seconds)
        self._close(trial, f"{_clock(seconds)}")

    def failed(self, trial: Trial, reason: str) -> None:
        """Show that a trial came to no end."""
        self.rest.pop(trial.file_name)
        self._close(trial, f"failed: {reason}")

    def _done(self, trial: Trial, seconds: float) -> None:
        del self.rest[trial.file_name]
        self.seconds[trial.row.name].append(seconds)

    def _close(self, trial: Trial, how: str) -> None:
        bar = self.bars.pop(trial.file_name, None)
        if bar is not None:
            self.progress.remove_task(bar)
        count = self.total - len(self.rest)
        self.console.print(f"{count}/{self.total}  {_title(trial)}: {how}{self._left()}")
        self._count()

    def _count(self) -> None:
        self.progress.update(
            self.all, completed=self.total - len(self.rest), note=self._left().lstrip("; ")
        )

    def _left(self) -> str:
        """Say how long the rest will take, if each row takes as long as it took before.

        Rows without any finished trial are taken to be like the others that are trained.
        """
        every = [s for name, own in self.seconds.items() if name != RBD.name for s in own]
        if not every or not self.rest or self.processes is None:
            return ""
        seconds = sum(
            _mean(self.seconds.get(trial.row.name) or every) for trial in self.rest.values()
        )
        return f"; about {_clock(seconds / self.processes)} left"


def _title(trial: Trial) -> str:
    return f"{trial.row.name}, {trial.split}, run {trial.run}"


def _mean(values: Sequence[float]) -> float:
    return sum(values) / len(values)


def _clock(seconds: float) -> str:
    if seconds < _MINUTE:
        return f"{seconds:.1f} s"
    if seconds < _HOUR:
        return f"{seconds / _MINUTE:.1f} min"
    return f"{seconds / _HOUR:.1f} h"
