"""The tree of questions, asked of simulated recordings whose answer is known."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
from lanes import sampled

from estimators.diagnosis.from_torque.fitting.problem import RegressionProblem, fitted
from estimators.diagnosis.from_torque.judgement.questions import tests_of as ask
from estimators.diagnosis.from_torque.residuals.noise import Noise
from estimators.diagnosis.from_torque.residuals.observations import Observations
from estimators.diagnosis.stages import quiet
from limo_driver.physics import (
    CoulombFriction,
    LoadDependentFriction,
    PositionDependentFriction,
    PreslidingHysteresis,
    Simulation,
    TorqueDrift,
)
from limo_driver.recordings.recording import Recording
from limo_driver.types import Motion

if TYPE_CHECKING:
    from pathlib import Path

    from estimators.diagnosis.result import Test as Answer
    from limo_driver.physics import Effect

RATE, DURATION = 100.0, 90.0
QUESTIONS = ("reversal", "speed", "load", "position of", "time")

UNMODELLED = {
    "reversal": PreslidingHysteresis(joint=1, stiffness=(20.0,), width=(0.02,)),
    "load": LoadDependentFriction(joint=1, coefficient=0.1, variant="absolute"),
    "position of": PositionDependentFriction(
        joint=1, positions=(-0.4, 0.0, 0.4, 0.8, 1.2), excess=(0.0, 0.6, -0.3, 0.6, 0.0)
    ),
    "time": TorqueDrift(joint=1, times=(0.0, 40.0, 90.0), offset=(0.0, 0.4, -0.2)),
}


def answers(arm: Path, *effects: Effect, not_held_out: int | None = None) -> tuple[Answer, ...]:
    """Ask about two joints with an unmodelled effect on the first, without naming anything."""
    known = tuple(CoulombFriction(joint=j, tau_c=1.0) for j in (1, 2))
    simulation, true = (Simulation(str(arm), known + more) for more in ((), effects))
    recordings = [_record(true, seed) for seed in (1, 2)]
    problem = RegressionProblem.of(Observations.of(simulation, recordings, 10.0), quiet)
    if not_held_out is not None:
        held_out = problem.split.held_out.copy()
        held_out[:, not_held_out] = False
        problem.split = replace(problem.split, held_out=held_out)
    named = [
        i
        for i, candidate in enumerate(problem.candidates)
        if any(candidate.place == (effect.name, (0,)) for effect in effects)
    ]
    noise = Noise.of(0.02 * _white(problem), problem.split.fitted, problem.observed.segment)
    return ask(fitted(problem, tuple(named[:1]), noise))


def _white(problem: RegressionProblem) -> np.ndarray:
    return np.random.default_rng(0).standard_normal(problem.target.shape)


def _record(true: Simulation, seed: int) -> Recording:
    random = np.random.default_rng(seed)
    t = np.arange(int(DURATION * RATE)) / RATE
    q = np.array([0.4, -0.8]) + np.zeros((t.size, 2))
    v, a = np.zeros_like(q), np.zeros_like(q)
    for size in (0.5, 0.2, 0.05):
        w, phase = 2 * np.pi * random.uniform(0.04, 0.3, 2), random.uniform(0, 6.3, 2)
        angle = t[:, None] * w + phase
        q += size * np.sin(angle)
        v += size * w * np.cos(angle)
        a -= size * w**2 * np.sin(angle)
    torque = true.predict(Motion(t, q, v, a)) + 0.02 * random.standard_normal(q.shape)
    return Recording.from_arrays(t, q, torque, source=f"seed {seed}")


@sampled("subject", UNMODELLED, "each grows a forest on a recording", first=2)
def test_the_question_of_the_effect_gets_the_largest_share(arm: Path, subject: str) -> None:
    found = answers(arm, UNMODELLED[subject])

    first = [test for test in found if test.joint == 1]
    assert len(first) == len(QUESTIONS)
    for test, word in zip(first, QUESTIONS, strict=True):
        assert word in test.question
    best = max(first, key=lambda test: test.share)
    assert subject in best.question
    assert best.yes
    assert all(0.0 <= test.share <= 1.0 for test in found)


def test_a_joint_at_its_noise_floor_is_asked_nothing(arm: Path) -> None:
    assert answers(arm) == ()


def test_a_joint_of_which_no_motion_is_held_out_is_asked_nothing(arm: Path) -> None:
    assert answers(arm, UNMODELLED["reversal"], not_held_out=0) == ()
