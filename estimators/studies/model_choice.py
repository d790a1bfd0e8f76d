"""Which model suits recordings: a quick comparison on motion held out.

Each recording is cut into as many stretches as there are folds; of as many recordings as folds,
each is held out whole. A model learns from the rest, and predicts the stretch that it did not see;
both torques go through the filter, as in an evaluation. Of each joint, the part of the learned
torque is found that these errors confirm (`confirmed_shares`), by the stretches of the other folds:
a joint of which they confirm nothing stays as the simulation has it. What is left of the error of
the simulation, in the geometric mean over joints, ranks the models.

The first one is joint physics of families that other poses confirm. Another takes its place where
it errs a quarter less: stretches of one motion are more alike than motion of use, and there the
first one extrapolates least. Where nothing is confirmed, the simulation stays as it is.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from importlib.util import find_spec
from typing import Any, Final

import numpy as np

from estimators.base import DEVIATIONS, Estimate, check_every_joint, check_recordings
from estimators.hybrid import Epoch, HybridModel
from estimators.hybrid.model import train
from estimators.hybrid.training.settings import usual_settings
from estimators.joint_physics import JointPhysics, Learning
from estimators.regression.empirical_bayes import confirmed_shares
from estimators.residual_model import ResidualModel
from limo_driver.errors import DivergedError, RecordingError
from limo_driver.physics import Simulation
from limo_driver.recordings.recording import Recording
from limo_driver.runtime.display import Displayed
from limo_driver.types import FloatArray, IntArray

SIMULATION: Final = "simulation"
CONFIRMED: Final = "joint-physics, confirmed families"
NETWORK: Final = "mlp7, drive features"
FOLDS: Final = 3
_MOST: Final = 120_000  # samples that are looked at, ten minutes at 200 Hz
_ADDS: Final = 0.99  # of the simulation's error, below which a model has to come
_BLOCKS: Final = 8  # of a fold, whose errors tell what could be luck
_WORTH: Final = 1.25  # times the error of another, beyond which a model gives way to it
_LEAST: Final = 1e-12  # [N² m²]


@dataclass(frozen=True)
class Tried:
    """A model on motion that it did not see."""

    name: str
    left: FloatArray  # (n,), error over the simulation's, of what is confirmed; NaN if it failed
    shares: FloatArray  # (n,) in [0, 1], part of the learned torque that is confirmed
    coverage: FloatArray  # (n,), part of the rows within the 95 % interval; NaN where unknown
    refused: str = ""  # why it could not be tried

    @property
    def mean(self) -> float:
        """Geometric mean over the joints; inf if it could not be tried."""
        return float("inf") if self.refused else float(np.exp(np.mean(np.log(self.left))))


@dataclass(frozen=True, repr=False)
class ModelChoice(Displayed):
    """The models that were tried, and the one that is chosen."""

    tried: tuple[Tried, ...]
    chosen: Tried
    simulation: FloatArray = field(repr=False)  # (n,) [N m], its error on the same motion

    def headline(self) -> str:
        """Say what was chosen and why, and what each model left of the simulation's error."""
        others = ", ".join(
            f"{one.name} {'not compared' if one.refused else f'{one.mean:.2f}'}"
            for one in self.tried
        )
        why = (
            "which another has to beat by a quarter" if self.chosen is self.tried[0] else "the best"
        )
        if self.chosen.name == SIMULATION:
            why = "since nothing that was learned is confirmed"
        return (
            f"chosen: {self.chosen.name}, {why}. Part of the simulation's error that is left on "
            f"motion held out, geometric mean over joints: {others}"
        )

    def figures(self) -> Mapping[str, Sequence[object]]:
        """Return the parts of the simulation's error, joint by joint."""
        return {
            "joint": [str(j + 1) for j in range(self.simulation.size)],
            "simulation [N m]": [f"{value:.4f}" for value in self.simulation],
        } | {
            one.name: [f"{value:.2f}" for value in one.left]
            for one in self.tried
            if not one.refused and one.name != SIMULATION
        }

    def as_values(self) -> dict[str, Any]:
        """Return the same as JSON values, for the manifest."""
        return {
            "chosen": self.chosen.name,
            "simulation": self.simulation.tolist(),
            "tried": [
                {"name": one.name, "refused": one.refused}
                if one.refused
                else {
                    "name": one.name,
                    "mean": one.mean,
                    "left": one.left.tolist(),
                    "shares": one.shares.tolist(),
                    "coverage": one.coverage.tolist() if np.isfinite(one.coverage).all() else None,
                }
                for one in self.tried
            ],
        }


def candidates(
    simulation: Simulation, bandwidth: float
) -> dict[str, Callable[[], ResidualModel[Any]]]:
    """Return the models that are compared, the first choice first; networks only with PyTorch."""
    found: dict[str, Callable[[], ResidualModel[Any]]] = {
        CONFIRMED: lambda: JointPhysics(simulation, bandwidth, Learning(confirmed=True)),
    }
    settings = usual_settings("drive")
    if find_spec("torch") and bandwidth <= settings.rate:
        alone = replace(settings, bandwidth=bandwidth, folds=1)
        found[NETWORK] = lambda: HybridModel(simulation, alone)
    return found


def fit_chosen(
    choice: ModelChoice,
    simulation: Simulation,
    recordings: Sequence[Recording],
    bandwidth: float,
    on_epoch: Callable[[Epoch], None] = lambda _: None,
) -> ResidualModel[Any]:
    """Fit the model that was chosen to all of the motion.

    Joints of which nothing is confirmed stay as the simulation has them; so do all where the
    simulation itself was chosen. The choice stands in the manifest.

    Args:
        choice: Of these recordings.
        simulation: Gives what is learned the rest of.
        recordings: Of its robot.
        bandwidth: Of the zero-phase filter on motion and torque [Hz].
        on_epoch: Told each epoch of a network's training.

    Raises:
        RecordingError: The recordings are too short.
        DivergedError: The loss of a network is no longer finite.
    """
    named = choice.chosen
    if named.name == SIMULATION:  # nothing is learned, by any that can be fitted
        named = replace(next(one for one in choice.tried if not one.refused), shares=named.shares)
    without = tuple(int(j) for j in np.flatnonzero(named.shares <= 0.0))
    record = {"choice": choice.as_values()}
    if named.name != NETWORK:
        learning = Learning(named.name == CONFIRMED, without)
        physics = JointPhysics(simulation, bandwidth, learning).fit(recordings)
        physics.fitted_ = replace(physics.fitted, record={**physics.fitted.record, **record})
        return physics
    settings = replace(usual_settings("drive"), bandwidth=bandwidth)
    network = HybridModel(simulation, settings)
    fitted = train(simulation, recordings, settings, on_epoch)
    rmse = {where: dict(errors) for where, errors in fitted.record["rmse"].items()}
    rmse["left_out"] = {"rigid_body": choice.simulation.tolist(), "hybrid": fitted.error.tolist()}
    for errors in rmse.values():
        alone = zip(errors["hybrid"], errors["rigid_body"], strict=True)
        errors["hybrid"] = [own[j in without] for j, own in enumerate(alone)]
    gain = np.where(named.shares > 0.0, fitted.gain, 0.0)
    network.fitted_ = replace(fitted, gain=gain, record={**fitted.record, "rmse": rmse, **record})
    return network


def best_model(
    simulation: Simulation,
    recordings: Sequence[Recording],
    bandwidth: float,
    on_epoch: Callable[[Epoch], None] = lambda _: None,
) -> ResidualModel[Any]:
    """Choose a model and fit it, see `choose_model` and `fit_chosen`."""
    choice = choose_model(simulation, recordings, bandwidth)
    return fit_chosen(choice, simulation, recordings, bandwidth, on_epoch)


def choose_model(
    simulation: Simulation,
    recordings: Sequence[Recording],
    bandwidth: float,
    progress: Callable[[str, float], None] = lambda _what, _part: None,
) -> ModelChoice:
    """Compare models on motion held out.

    Args:
        simulation: Gives what they learn the rest of.
        recordings: Of its robot.
        bandwidth: Of the zero-phase filter on motion and torque [Hz].
        progress: Told what is tried, and which part of the work is done.

    Raises:
        RecordingError: The recordings cannot be learned from.
    """
    check_recordings(recordings, simulation.model)
    check_every_joint(recordings)
    parts = [one.at_most(_MOST // len(recordings)) for one in recordings]
    folds = list(_folds(parts))
    models = candidates(simulation, bandwidth)
    tried: list[Tried] = []
    simulated = np.zeros(0)
    for number, (name, make) in enumerate(models.items()):

        def tell(part: float, name: str = name, number: int = number) -> None:
            progress(f"trying {name}", (number + part) / len(models))

        try:
            products, fold, coverage = _held_out(make, folds, bandwidth, tell)
        except (RecordingError, DivergedError) as error:
            unknown = np.full(simulation.model.n, np.nan)
            tried.append(Tried(name, unknown, unknown, unknown, str(error)))
            continue
        simulated = np.sqrt(products[:, :, 1, 1].mean(axis=0))
        tried.append(replace(_judge(name, products, fold), coverage=coverage))
    progress("done", 1.0)
    if not simulated.size:
        raise RecordingError(tried[0].refused)
    n = simulated.size
    nothing = Tried(SIMULATION, np.ones(n), np.zeros(n), np.full(n, np.nan))
    return ModelChoice((*tried, nothing), _best(tried) or nothing, simulated)


def _held_out(
    make: Callable[[], ResidualModel[Any]],
    folds: Sequence[tuple[list[Recording], list[Recording]]],
    bandwidth: float,
    tell: Callable[[float], None],
) -> tuple[FloatArray, IntArray, FloatArray]:
    """Return the products of all blocks (b, n, 2, 2), see `_judge`, folds (b,), coverage (n,)."""
    blocks: list[FloatArray] = []
    within: list[FloatArray] = []
    fold: list[int] = []
    for k, (rest, held) in enumerate(folds):
        tell(k / len(folds))
        model = make().fit(rest)
        for one in held:
            # What the simulation leaves of a stretch, (T, n) [N m], and the estimate of it
            estimate = model.estimate(one).filtered(one, bandwidth)
            scored = ~one.edges(bandwidth)
            residual = (one.filtered_torque(bandwidth) - estimate.simulation)[scored]
            parts = (getattr(estimate, item.name)[scored] for item in fields(estimate))
            error, estimate = (residual, Estimate(*parts))
            own = list(_blocks(error, estimate))
            within.append(_within(error, estimate))
            blocks += own
            fold += [k] * len(own)
    if len(set(fold)) < len(folds):
        raise RecordingError("the motion is too short to hold stretches of it out")
    return np.array(blocks), np.array(fold), np.concatenate(within).mean(axis=0)


def _best(tried: Sequence[Tried]) -> Tried | None:
    """Return the model that is chosen; None where none surely adds to the simulation."""
    best: Tried | None = None
    for one in tried:
        if one.mean < _ADDS and (best is None or _WORTH * one.mean < best.mean):
            best = one
    return best


def _judge(name: str, products: FloatArray, fold: IntArray) -> Tried:
    """Find the confirmed share of each joint, and the error that it leaves.

    Args:
        name: Of the model.
        products: Means of [[m², m r], [m r, r²]] of the learned torque m and the residual r of each
            block and joint, (b, n, 2, 2) [N² m²].
        fold: Of each block, (b,).
    """
    n = products.shape[1]
    left, shares = np.zeros(n), np.zeros(n)
    for j in range(n):
        own = products[:, j] / (products[:, j, 1, 1].mean() + _LEAST)
        shares[j] = confirmed_shares(own)[0]
        error = 0.0
        for k in np.unique(fold):
            share = confirmed_shares(own[fold != k])[0]
            judged = own[fold == k]
            error += np.sum(
                judged[:, 1, 1] - 2 * share * judged[:, 0, 1] + share**2 * judged[:, 0, 0]
            )
        left[j] = np.sqrt(max(error, _LEAST) / len(own))
    return Tried(name, left, shares, np.full(n, np.nan))


def _within(residual: FloatArray, estimate: Estimate) -> FloatArray:
    """Return 1 where a row is within the 95 % interval, else 0, (T, n); NaN where unknown."""
    within = np.abs(residual - estimate.learned) <= DEVIATIONS * estimate.std
    return np.where(np.isfinite(estimate.std), within, np.nan)


def _blocks(residual: FloatArray, estimate: Estimate) -> Iterator[FloatArray]:
    """Give the products of learned and residual torque of blocks of a stretch, (n, 2, 2) each."""
    learned = estimate.learned
    for rows in np.array_split(np.arange(len(residual)), _BLOCKS):
        if rows.size:
            both = np.stack([learned[rows], residual[rows]], axis=-1)
            yield np.einsum("tji,tjk->jik", both, both) / rows.size


def _folds(
    recordings: Sequence[Recording],
) -> Iterator[tuple[list[Recording], list[Recording]]]:
    """Give what is learned from and what is held out, fold by fold."""
    whole = len(recordings) >= FOLDS
    for k in range(FOLDS):
        rest: list[Recording] = []
        held: list[Recording] = []
        for i, one in enumerate(recordings):
            if whole:
                (held if i % FOLDS == k else rest).append(one)
                continue
            cuts = [len(one) * c // FOLDS for c in range(FOLDS + 1)]
            held.append(one[cuts[k] : cuts[k + 1]])
            rest += [one[a:b] for a, b in ((0, cuts[k]), (cuts[k + 1], len(one))) if b > a]
        yield rest, held
