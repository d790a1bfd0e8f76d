"""What shows what limo can: the demonstration, and the paper's Table I."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Final, cast

from limo_driver.app.library.executors import attempted, executor_of, run_all
from limo_driver.physics import (
    CoulombFriction,
    Payload,
    PreslidingHysteresis,
    Sensors,
    Simulation,
    ViscousFriction,
    display_name,
)
from limo_driver.runtime.outputs import require_folder

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence

    from estimators.diagnosis.from_torque.pipeline import Diagnosis
    from estimators.studies.table1_results import Trial, TrialResult, TrialStore
    from estimators.studies.table1_trials import Failed, TrialRunner
    from limo_driver.physics import Effect
    from limo_driver.recordings.recording import Recording

COULOMB: Final = (2.2, 2.4, 1.6, 1.7, 0.9, 0.45, 0.35)  # [N m]
VISCOUS: Final = (4.0, 4.2, 2.4, 2.6, 1.2, 0.7, 0.6)  # [N m s/rad]
NOISE: Final = (0.05, 0.05, 0.04, 0.04, 0.03, 0.02, 0.02)  # [N m]
BELIEVED: Final = Simulation(
    "iiwa14",
    effects=(
        *(CoulombFriction(joint=j, tau_c=c, v_eps=0.002) for j, c in enumerate(COULOMB, start=1)),
        *(ViscousFriction(joint=j, f_v=v) for j, v in enumerate(VISCOUS, start=1)),
    ),
    sensors=Sensors(torque_noise=NOISE),
)
CONCEALED: Final = (
    PreslidingHysteresis(joint=4, law="maxwell_slip", stiffness=(120.0, 40.0), width=(0.004, 0.02)),
    Payload(mass=0.8, com=(0.0, 0.02, 0.08), inertia=(2e-3, 0.0, 0.0, 2e-3, 0.0, 1e-3)),
)
SCAFFOLDS: Final = 3  # poses of the motion, which takes a minute
SEED: Final = 5
FILES: Final = ("believed.yaml", "true.yaml", "run.parquet")
_BASE: Final = 0.7e9  # [bytes] of a process that trains
_BY_SAMPLE: Final = 20e3  # [bytes] more for each sample that is trained on


@dataclass(frozen=True)
class Demonstration:
    """What was concealed, what was recorded of it, and what was found."""

    believed: Simulation
    true: Simulation
    recording: Recording
    found: Diagnosis

    def save(self, folder: Path | str) -> None:
        """Write believed and true simulation, recording, and the diagnosis.

        The report says what was concealed, too.

        Raises:
            ConfigError: The folder cannot be written to.
        """
        from estimators.diagnosis.report import write_report
        from estimators.diagnosis.verdict import REPORT

        out = Path(folder)
        require_folder(out, "the demonstration", FILES)
        for name, simulation in zip(FILES, (self.believed, self.true), strict=False):
            simulation.save(out / name)
        replace(self.recording, source="").save(out / FILES[-1])
        self.found.save(out)
        write_report(self.found, out / REPORT, self.concealed)

    @property
    def concealed(self) -> tuple[Effect, ...]:
        """What the arm has in it beyond what is believed of it."""
        return tuple(effect for effect in self.true.effects if effect not in self.believed.effects)

    def __str__(self) -> str:
        notes = [_describe(effect) for effect in self.concealed]
        return f"concealed: {'; '.join(notes)}\nfound:     {self.found.headline()}"


def demonstrate(progress: Callable[[str, float], None] | None = None) -> Demonstration:
    """Conceal a payload and hysteresis in a simulated iiwa 14, record it, and diagnose it.

    Args:
        progress: Told the stage and the part of the work that is done.

    Returns:
        All that was made on the way, and what was found.
    """
    from estimators.diagnosis.stages import quiet
    from limo_driver.app.library.diagnosing import diagnose
    from limo_driver.app.library.moving import plan, run
    from limopa import PlanRequest

    tell = progress or quiet
    true = replace(BELIEVED, effects=(*BELIEVED.effects, *CONCEALED))
    tell("planning motion", 0.0)
    motion = plan("iiwa14", PlanRequest(scaffolds=SCAFFOLDS), seed=SEED)
    tell("moving the simulated arm", _PLANNED)
    recording = run("mujoco", motion, simulation=true)
    tell("diagnosing", _RECORDED)
    found = diagnose(
        BELIEVED,
        recording,
        progress=lambda stage, part: tell(stage, _RECORDED + (1.0 - _RECORDED) * part),
    )
    return Demonstration(BELIEVED, true, recording, cast("Diagnosis", found))  # it tells torques


_PLANNED, _RECORDED = 0.05, 0.25  # of the work


def _describe(effect: object) -> str:
    if isinstance(effect, Payload):
        return f"payload of {effect.mass:g} kg at the flange"
    name, joints = display_name(getattr(effect, "name", "")), getattr(effect, "joints", ())
    return f"{name} at joint {', '.join(map(str, joints))}"


@dataclass(frozen=True)
class TrialJob:
    """What all trials share, data included: nodes need no folder of this machine."""

    runner: TrialRunner

    def do(
        self, trial: Trial, tell: Callable[[int], None] = lambda _: None
    ) -> TrialResult | Failed | str:
        """Train and score one trial.

        Args:
            trial: The row, the split and the run.
            tell: Told each epoch that it has gone through.
        """
        from estimators.studies.table1_trials import Failed

        return attempted(
            lambda: self.runner.run(trial, lambda epoch: tell(epoch.number)),
            lambda line: Failed(trial, line),
        )

    def memory_of(self, trial: Trial) -> float:  # noqa: ARG002  # the same data for all
        """Return how much memory a trial takes at most [bytes]."""
        return _BASE + _BY_SAMPLE * len(self.runner.data.limo)


def run_trials(
    runner: TrialRunner,
    store: TrialStore,
    trials: Sequence[Trial],
    where: tuple[int | None, str],
    advanced: Callable[[Trial, int], None],
) -> Iterator[TrialResult | Failed]:
    """Run trials side by side, each on one core, and keep what they give.

    Args:
        runner: Trains and scores them; its data are sent along.
        store: Where finished trials are kept.
        trials: In this order.
        where: How many run side by side at most, as many as there are cores if none; on "processes"
            or "ray".
        advanced: Told each epoch that a trial has gone through, by processes alone.

    Returns:
        Each trial as it ends; a process or node that is lost costs its trial one more try.

    Raises:
        ConfigError: The cluster cannot be used.
    """
    from estimators.studies.table1_trials import Failed

    for trial, outcome in run_all(executor_of(TrialJob(runner), *where, advanced), trials):
        if isinstance(outcome, str):
            yield Failed(trial, f"{outcome}, twice")
            continue
        if not isinstance(outcome, Failed):
            store.save(outcome)
        yield outcome
