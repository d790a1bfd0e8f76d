"""JointPhysics: torque linear in the physics of each joint, with a standard deviation.

Prior standard deviations of those weights that are tolerances of a sensor, encoder or gear.

Evidence judges weights by what they do in the motion at hand. A column that hardly moved there, as
that of a deflection near one pose, could have any weight: one that says nothing where it was fitted
and N m elsewhere. But sensors, encoders and gears are off by about as much on any arm:

    gain         0.05 of the own torque, 0.01 of every other joint's
    placement    5 mrad
    elasticity   5 mrad of deflection under the load that there usually is
"""

from __future__ import annotations

from dataclasses import asdict, dataclass, field, fields
from functools import cached_property, partial
from typing import TYPE_CHECKING, Any, Final, NamedTuple, Self, TypeAlias

import numpy as np
from threadpoolctl import threadpool_limits

from estimators.base import Estimate
from estimators.joint_physics.calibration import Calibration, calibrate, confirmed_fit
from estimators.joint_physics.change import fit_change
from estimators.joint_physics.columns import WIDTHS, JointColumns
from estimators.joint_physics.normal_equations import MotionEquations
from estimators.joint_physics.prediction import (
    Prediction,
    UnknownMemory,
    any_moments,
    estimate,
    moments_of,
)
from estimators.model_folder import WEIGHTS, ModelFolder, provenance, write_folder
from estimators.regression.empirical_bayes import RegionalFit, WeightPosterior, fit
from estimators.residual_model import ResidualModel
from limo_driver.errors import ModelStoreError
from limo_driver.recordings.bandwidth import BANDWIDTH

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence
    from pathlib import Path

    from numpy.typing import NDArray

    from limo_driver.physics import Simulation
    from limo_driver.recordings.recording import Recording
    from limo_driver.types import FloatArray, IntArray, Motion

    Whole: TypeAlias = IntArray
    Constants: TypeAlias = tuple[
        Whole, Whole, Whole, FloatArray, NDArray[np.float32], Whole,
        FloatArray, FloatArray, int, FloatArray,
    ]  # fmt: skip

_GAIN: Final = 0.05
_CROSSTALK: Final = 0.01
_ANGLE: Final = 0.005  # [rad]
_LEAST_TORQUE: Final = 1e-6  # [N m], so that a joint that bears none has finite deviations


@dataclass(frozen=True)
class Learning:
    """What joint physics learn.

    Args:
        confirmed: Of each joint the families that other poses confirm, see `confirmed`; else what
            is most probable of all of them.
        without: Joints (0-based) that stay as the simulation has them.
    """

    confirmed: bool = False
    without: tuple[int, ...] = ()

    def as_record(self, n: int) -> dict[str, Any]:
        """Return what the manifest says of it; nothing where all is learned."""
        if self == EVERYTHING:
            return {}
        learned = [j not in self.without for j in range(n)]
        return {"learning": {"confirmed": self.confirmed, "joints": learned}}


EVERYTHING: Final = Learning()


@dataclass(frozen=True)
class FittedPhysics:
    """Posterior of the weights of K columns for each of n joints."""

    weights: FloatArray  # (n, K)
    root: FloatArray  # (n, K, K), R with covariance Rᵀ R of the weights
    friction: IntArray  # its columns, (families, states and dq)
    calibration: Calibration
    unknown: UnknownMemory  # what nobody knows of the torque before the joints turned
    record: Mapping[str, Any] = field(default_factory=dict)  # data and errors, as JSON

    @classmethod
    def of(
        cls,
        sums: MotionEquations,
        columns: JointColumns,
        simulation: Simulation,
        recordings: Sequence[Recording],
        learning: Learning,
        before: FittedPhysics | None = None,
    ) -> FittedPhysics:
        """Fit the weights, or how they differ from those before, and calibrate their uncertainty.

        That is done on motion that was left out.
        """
        fit = partial(_fit_joint, columns=columns, learning=learning)
        if before is None:
            given, fits = sums, [fit(sums, joint=j) for j in range(columns.n)]
        else:
            given, fits = fit_change(before.posteriors, sums, columns, fit)
        rmse = {
            "simulation": _rmse(simulation, recordings, columns.bandwidth).tolist(),
            "held_out": [float(np.sqrt(found.held_out)) for found in fits],
        }
        weights = np.stack([found.posterior.weights for found in fits])
        moments = moments_of(sums.folds.gram.sum(axis=0), sums.folds.count.sum(axis=0), columns)
        return cls(
            weights,
            np.stack([found.posterior.root for found in fits]),
            columns.friction,
            calibrate(given, columns, fits, sums.usual),
            UnknownMemory.of(columns, weights, moments, simulation),
            {"recordings": [provenance(recording) for recording in recordings], "rmse": rmse}
            | learning.as_record(columns.n),
        )

    @classmethod
    def read(cls, opened: ModelFolder, columns: JointColumns) -> FittedPhysics:
        """Read the tensors of a model folder.

        Raises:
            ModelStoreError: One is missing, or is none of such a fit, by name.
        """
        n, K = columns.n, columns.count
        shapes = {"weights": (n, K), "root": (n, K, K)} | dict.fromkeys(_POSITIVE, (n,))
        # folders from before learned torque faded, or faded as now, estimate as they did
        before = {"growth": 1.0, "usual": _NEVER, "power": 1.0, "fastest": _NEVER}
        tensors = {name: np.full(n, value) for name, value in before.items()} | opened.tensors()
        place = opened.path / WEIGHTS
        found = _arrays(tensors, place, shapes)
        moments = _moments(tensors, place, n)
        return cls(
            found["weights"],
            found["root"],
            columns.friction,
            Calibration(*(found[name] for name in _POSITIVE)),
            UnknownMemory.of(columns, found["weights"], moments, opened.simulation),
            opened.record("held_out"),
        )

    @property
    def posteriors(self) -> list[WeightPosterior]:
        """The weights of each joint."""
        return [WeightPosterior(*own) for own in zip(self.weights, self.root, strict=True)]

    @cached_property
    def prediction(self) -> Prediction:
        """The same for compiled code."""
        return Prediction.of(self.weights, self.root, self.friction)

    @cached_property
    def constants(self) -> Constants:
        """Everything that `estimate` takes of it, in order."""
        own, unknown = self.prediction, self.unknown
        return (
            own.kept,
            own.less,
            own.sizes,
            own.weights,
            own.roots,
            own.root_sizes,
            unknown.heights,
            unknown.moments,
            unknown.place,
            self.calibration.rows,
        )


class JointPhysicsState(NamedTuple):
    """Memory after a sample."""

    simulation: tuple[Any, ...]
    columns: FloatArray


class JointPhysics(ResidualModel[FittedPhysics]):
    """Predict tau_j = tau_S,j + k_j x_j · w_j, x_j the physics of joint j, and how sure that is.

    tau_S is the prediction of a simulation, normally an identified one. What it leaves is fitted by
    Bayesian linear regression in columns that physics suggests, so that little data is enough and
    motion larger than that of the data is predicted as physics continues (`JointColumns`). k_j is
    1 where the data tell the weights and falls to 0 where they do not, see `Calibration`.

    Args:
        simulation: Gives tau_S, and with its rigid body the columns.
        bandwidth: Of the zero-phase filters on motion and torque [Hz].
        learning: What of it is learned.
    """

    name = "joint-physics"
    held_out_is = "in each eighth of the poses, by a fit to the rest"

    def __init__(
        self,
        simulation: Simulation,
        bandwidth: float = BANDWIDTH,
        learning: Learning = EVERYTHING,
    ) -> None:
        super().__init__(simulation)
        self.learning = learning
        self.before: FittedPhysics | None = None
        self.columns = JointColumns(simulation.body, bandwidth)

    @classmethod
    def load(cls, folder: Path | str) -> Self:
        """Read a model folder, see `ResidualModel`."""
        opened = ModelFolder.open(folder, cls.name)
        model = cls(opened.simulation, opened.bandwidth)
        families = opened.manifest["families"].sections()
        given = [(entry.text("name"), entry.number("size")) for entry in families]
        expected = [(family.name, family.size) for family in model.columns.families]
        if given != expected:
            opened.manifest.fail(
                f"has the families {given}, but this version computes {expected}; train it again"
            )
        model.fitted_ = FittedPhysics.read(opened, model.columns)
        return model

    def save(self, folder: Path | str) -> None:
        """Write a model folder, see `ResidualModel`."""
        fitted = self.fitted
        entries: dict[str, Any] = {
            "estimator": self.name,
            "bandwidth": self.bandwidth,
            "families": [asdict(family) for family in self.columns.families],
            "training": dict(fitted.record),
        }
        tensors = {"weights": fitted.weights, "root": fitted.root, **asdict(fitted.calibration)}
        tensors["moments"] = fitted.unknown.moments
        write_folder(folder, entries, tensors, self.simulation, _PACKAGES)

    def going_on_from(self, other: ResidualModel[Any]) -> Self:
        """Fit how weights differ from those of another, which stay where the data show nothing."""
        if isinstance(other, type(self)) and other.memory == self.memory:
            self.before = other.fitted
        return self

    @property
    def bandwidth(self) -> float:
        """Bandwidth of the zero-phase filters on motion and torque [Hz]."""
        return self.columns.bandwidth

    @property
    def memory(self) -> object:
        """The values besides the motion that determine memory: no weight is among them."""
        return type(self), self.simulation, self.bandwidth

    @threadpool_limits.wrap(limits=1, user_api="blas")  # its matrices are small; more only wait
    def fit(self, recordings: Sequence[Recording]) -> Self:
        """Fit the weights to the simulation's residual of the filtered torque.

        Raises:
            RecordingError: There is none, one is of another robot, or they are too short.
        """
        sums = MotionEquations.of(self.simulation, self.columns, recordings)
        self.fitted_ = FittedPhysics.of(
            sums, self.columns, self.simulation, recordings, self.learning, self.before
        )
        return self

    def init(self, rate: float | None = None) -> JointPhysicsState:  # noqa: ARG002  # any will do
        """Return the memory before the first sample.

        Raises:
            NotFittedError: Nothing was fitted or loaded.
        """
        _ = self.fitted
        return JointPhysicsState(self.simulation.init(), self.columns.init())

    def _advance(
        self, state: JointPhysicsState, motion: Motion
    ) -> tuple[Estimate, JointPhysicsState]:
        torque, simulation = self.simulation.advance(state.simulation, motion)
        columns = state.columns.copy()
        learned, std = np.empty_like(torque), np.empty_like(torque)
        outside = np.empty(torque.shape, np.bool_)
        estimate(
            columns,
            np.ascontiguousarray(motion.position),
            np.ascontiguousarray(motion.velocity),
            np.ascontiguousarray(motion.acceleration),
            np.ascontiguousarray(torque),
            *self.columns.constants,
            *self.fitted.constants,
            learned,
            std,
            outside,
        )
        return Estimate(torque, learned, std, outside), JointPhysicsState(simulation, columns)


def _fit_joint(
    sums: MotionEquations, joint: int, columns: JointColumns, learning: Learning
) -> RegionalFit:
    everything = sums.regions.equations(joint)
    known = tolerances(columns, joint, everything.rms)
    if learning.confirmed or joint in learning.without:
        return confirmed_fit(sums, columns, joint, known, learns=joint not in learning.without)
    return fit(everything, sums.regions.each_left_out(joint), columns.family, known)


def _rmse(simulation: Simulation, recordings: Sequence[Recording], bandwidth: float) -> FloatArray:
    """Return what the simulation alone is off, filtered as the measured torque is, (n,) [N m]."""
    errors: list[FloatArray] = []
    for recording in recordings:
        motion = recording.motion(bandwidth)
        torque = np.concatenate([simulation.predict(motion[rows]) for rows in recording.segments])
        error = recording.filtered(recording.torque - torque, bandwidth)
        errors.append(error[~recording.edges(bandwidth)])
    return np.sqrt(np.mean(np.concatenate(errors) ** 2, axis=0))


def tolerances(columns: JointColumns, joint: int, rms: FloatArray) -> FloatArray:
    """Return the standard deviations of the weights of a joint before any data, (K,).

    Args:
        columns: The columns.
        joint: 0-based.
        rms: Root mean square of each column, (K,).

    Returns:
        Deviations of the weights, of columns as they come; NaN where the data have to decide.
    """
    found = np.full(columns.count, np.nan)
    gain = columns.of_family("gain")
    found[gain] = np.where(np.arange(columns.n) == joint, _GAIN, _CROSSTALK)
    found[columns.of_family("placement")] = _ANGLE
    torque = np.maximum(rms[gain], _LEAST_TORQUE)  # (n,) [N m], of every joint
    found[columns.of_family("elasticity")] = _ANGLE / torque  # [rad/(N m)]
    return found


_POSITIVE: Final = tuple(field.name for field in fields(Calibration))
_LEAST: Final = 1e-100  # of those
_NEVER: Final = 1e300  # [N² m²], a usual size beside which nothing fades
_ROUNDING: Final = 1e-9
_PACKAGES: Final = ("limo", "numpy", "numba", "safetensors", "pin")


def _moments(tensors: dict[str, FloatArray], place: Path, n: int) -> FloatArray:
    """Return the moments of the stops; those of any motion for a folder from before they were kept.

    Raises:
        ModelStoreError: They are no moments.
    """
    if "moments" not in tensors:
        return any_moments(n)
    moments = _arrays(tensors, place, {"moments": (n, WIDTHS.size, WIDTHS.size)})["moments"]
    if np.linalg.eigvalsh(moments).min() < -_ROUNDING:
        raise ModelStoreError(f"{place}: moments are not positive, as those of states are")
    return moments


def _arrays(
    tensors: dict[str, FloatArray], place: Path, shapes: dict[str, tuple[int, ...]]
) -> dict[str, FloatArray]:
    """Return the tensors of these names and shapes."""
    found: dict[str, FloatArray] = {}
    for name, shape in shapes.items():
        if name not in tensors:
            raise ModelStoreError(f"{place}: no {name} among {', '.join(sorted(tensors))}")
        given = tensors[name]
        if given.shape != shape or given.dtype != np.float64:
            raise ModelStoreError(
                f"{place}: {name} is {given.dtype} of shape {given.shape}, expected float64 of "
                f"shape {shape}"
            )
        if not np.isfinite(given).all():
            raise ModelStoreError(f"{place}: {name} is not finite")
        if name in _POSITIVE and not (given >= _LEAST).all():
            raise ModelStoreError(
                f"{place}: {name} goes down to {given.min():g}, expected at least {_LEAST:g}"
            )
        found[name] = given
    return found
