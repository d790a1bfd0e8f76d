"""The oracle: closure of what was hidden, as if its name were known, fitted to the same rows.

Eight seconds of motion leave much of a body and of friction as it was stated, and no name mends
that. So beside the closure that a diagnosis reaches stands that of the true effects, at their
joints, fitted by the same code; and what the posterior of that fit expects: the error of each
joint on motion held out, from the covariance of all that was fitted.
"""

from __future__ import annotations

import json
from typing import TYPE_CHECKING

import numpy as np
from diagnosis_closure import closure
from diagnosis_library import predict

if TYPE_CHECKING:
    from pathlib import Path

    from estimators.diagnosis.from_torque.fitting.problem import RegressionProblem, Solution
    from limo_driver.physics import Simulation
    from limo_driver.types import FloatArray

ORACLE = "oracle/oracle.json"


def write_oracle(case: Path) -> None:
    """Fit the hidden effects of a case, and write their closure and what was to be expected."""
    from threadpoolctl import threadpool_limits

    from limo_driver.physics import Simulation

    out = (case / ORACLE).parent
    out.mkdir(exist_ok=True)
    given = Simulation.load(case / "sim.yaml")
    with threadpool_limits(limits=1, user_api="blas"):
        simulation, expected = _fitted(case, given)
        for label, one in (("before", given), ("after", simulation)):
            for k in (1, 2):
                predict(one, case / f"held_out_{k}.parquet", out / f"{label}_{k}.parquet")
    simulation.save(out / "sim.yaml")
    reached = closure(case, out.name)
    if reached is None:
        raise RuntimeError(f"{case}: no prediction")
    said = {
        "closure": (reached.after / reached.floor).tolist(),
        "expected": np.sqrt(1.0 + (expected / reached.floor) ** 2).tolist(),
    }
    (case / ORACLE).write_text(json.dumps(said, indent=1))


def worst(case: Path) -> tuple[float, float] | None:
    """Return the worst joint's closure of the oracle, and the one expected; None where not run."""
    path = case / ORACLE
    if not path.exists():
        return None
    said = json.loads(path.read_text())
    return max(said["closure"]), max(said["expected"])


def _fitted(case: Path, given: Simulation) -> tuple[Simulation, FloatArray]:
    """Return the simulation with the hidden effects, and its expected error, (n,) [N m]."""
    from estimators.diagnosis.from_torque.fitting.linearised import linearised, polished
    from estimators.diagnosis.from_torque.fitting.problem import RegressionProblem, fitted
    from estimators.diagnosis.from_torque.fitting.settling import refined
    from estimators.diagnosis.from_torque.fitting.solving import noise_left, noise_of_everything
    from estimators.diagnosis.from_torque.judgement.judged_set import places_of
    from estimators.diagnosis.from_torque.pipeline import observe
    from estimators.diagnosis.from_torque.residuals.observations import Observations
    from estimators.diagnosis.stages import quiet
    from limo_driver.recordings.bandwidth import BANDWIDTH
    from limo_driver.recordings.recording import Recording

    recordings = [Recording.load(path) for path in sorted(case.glob("recording_*.parquet"))]
    truth = json.loads((case / "hidden" / "truth.json").read_text())
    problem = RegressionProblem.of(observe(given, recordings, BANDWIDTH), quiet)
    noise = noise_of_everything(problem)
    solution = fitted(problem, (), noise)
    solution = fitted(problem, _members(problem, solution, truth["effects"]), noise)
    for _ in range(2):
        solution = fitted(problem, solution.members, noise_left(problem, solution.fitted))
    solution = refined(solution, quiet)
    problem = solution.problem
    places = places_of(solution)
    best = polished(problem.under(solution), given, problem.observed.moving, places)
    others = [Recording.load(path) for path in sorted(case.glob("held_out_*.parquet"))]
    elsewhere = Observations.of(given, others, BANDWIDTH)
    root = linearised(best, given, places).root()
    around = linearised(elsewhere.under(best.simulation), given, places)
    entered, expected = around.entered, np.zeros(elsewhere.n)
    for joint in range(elsewhere.n):
        values, at = around.columns.of_joint(joint)
        own, rows = entered[at], elsewhere.moving[:, joint]
        spread = values[np.ix_(rows, own)] @ root[:, at[own]].T
        expected[joint] = np.sqrt(np.sum(spread**2) / max(len(spread), 1))
    return best.simulation, expected


def _members(
    problem: RegressionProblem, solution: Solution, effects: list[dict[str, object]]
) -> tuple[int, ...]:
    """Return the likeliest candidate of each hidden effect, or of the same, at its joints."""
    members: tuple[int, ...] = ()
    for effect in effects:
        names = [effect["effect"], *effect["equivalent"]]  # pyright: ignore
        joints = {j - 1 for j in effect["joints"]}  # pyright: ignore
        for name in names:
            found = [
                i
                for i, candidate in enumerate(problem.candidates)
                if candidate.effect == name and set(candidate.joints) <= joints
            ]
            if found:
                beside = members
                best = max(found, key=lambda i: solution.search.gain((*beside, i)))
                members = (*members, best)
                break
    return members
