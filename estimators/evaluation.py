"""Evaluate a model on motion it has not seen, beside the rigid body and the noise floor."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from estimators.base import DEVIATIONS
from estimators.model_folder import provenance
from limo_driver.display import Displayed
from limo_driver.outputs import require_folder, whole
from limo_driver.recordings.differentiation import ORDER

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from numpy.typing import NDArray

    from estimators.base import Estimate
    from estimators.residual_model import ResidualModel
    from limo_driver.model import RobotModel
    from limo_driver.recordings.recording import Recording
    from limo_driver.types import FloatArray, Motion

FILES: Final = (
    "evaluation.json",
    "torque.png",
    "loops.png",
    "report.html",
)  # of a saved evaluation
_NOISE_FROM: Final = 0.6  # of the Nyquist frequency; above, a torque is taken to be noise
_FLAT: Final = 3.0  # white noise is as dense in the lower half of that band as in the upper
_STOP_BAND: Final = 1.5  # [bandwidth], where the filter passes less than 4 % of the amplitude
_BEST_SENSOR: Final = 1e-5  # noise of the best sensor, as a part of what the torque varies by
_SEGMENT: Final = 32  # samples of a spectrum, so short that few hold a step of dry friction
_FREQUENCIES: Final = 2000  # of the filter's response


@dataclass(frozen=True)
class Errors:
    """Errors of one predictor, of each joint."""

    rmse: FloatArray  # (n,) [N m]; NaN for joints whose torque was not measured

    @property
    def mse(self) -> FloatArray:
        """Mean squared error, (n,) [(N m)²]."""
        return self.rmse**2

    @property
    def mean_mse(self) -> float:
        """Mean squared error over the joints whose torque was measured [(N m)²]."""
        return float(np.nanmean(self.mse))


@dataclass(frozen=True, repr=False)
class Evaluation(Displayed):
    """Torques measured and predicted over a recording, and their errors.

    All torques went through the zero-phase low-pass that the measured one went through in training:
    what only the filter makes of a torque is no error of who predicts it. Rows near the end of a
    stretch, whose derivatives are unsure, are not scored.
    """

    model: str  # name of the estimator
    recording: Recording
    motion: Motion
    measured: FloatArray  # (T, n) [N m], filtered; NaN for joints whose torque was not measured
    estimate: Estimate  # filtered
    frictionless: FloatArray  # (T, n) [N m], of the simulation without its joint physics, filtered
    scored: NDArray[np.bool_]  # (T,)
    bandwidth: float  # [Hz]
    robot: RobotModel
    joint_names: tuple[str, ...]
    noise_floor: FloatArray  # (n,) [N m], of the noise left in `measured`; NaN where unknown
    trained_on: bool  # the model, on this very file; its errors elsewhere are larger

    @property
    def rigid_body(self) -> Errors:
        """Errors of the simulation alone."""
        return self._errors(self.estimate.simulation)

    @property
    def contribution(self) -> FloatArray:
        """RMS of the torque that the network adds, (n,) [N m]."""
        return np.sqrt(np.mean(self.estimate.learned[self.scored] ** 2, axis=0))

    @property
    def hybrid(self) -> Errors:
        """Errors of the hybrid."""
        return self._errors(self.estimate.torque)

    @property
    def coverage(self) -> FloatArray:
        """Part of the rows within 1.96 standard deviations, (n,); NaN where these are unknown."""
        error = np.abs(self.measured - self.estimate.torque)[self.scored]
        std = self.estimate.std[self.scored]
        within = np.mean(error <= DEVIATIONS * std, axis=0)
        known = np.isfinite(std).all(axis=0) & self.recording.measured_joints
        return np.where(known, within, np.nan)

    @property
    def outside(self) -> FloatArray:
        """Part of the rows whose motion is unlike what was learned, (n,)."""
        return np.asarray(self.estimate.outside[self.scored].mean(axis=0), dtype=np.float64)

    @property
    def mse_ratio(self) -> FloatArray:
        """MSE of the rigid body over that of the hybrid, (n,)."""
        return self.rigid_body.mse / self.hybrid.mse

    @property
    def mean_mse_ratio(self) -> float:
        """The same with both MSE averaged over the joints first, as in the paper's table."""
        return self.rigid_body.mean_mse / self.hybrid.mean_mse

    def _errors(self, predicted: FloatArray) -> Errors:
        residual = (self.measured - predicted)[self.scored]
        return Errors(np.sqrt(np.mean(residual**2, axis=0)))

    def headline(self) -> str:
        """Say how much less the error is than that of the rigid body."""
        return (
            f"{self.model}: mean MSE {self.hybrid.mean_mse:.3g} (N m)², rigid body "
            f"{self.rigid_body.mean_mse:.3g} (N m)², over {int(self.scored.sum())} samples"
            + (f" of {self.recording.source}" if self.recording.source else "")
            + (", which it was trained on" if self.trained_on else "")
        )

    def figures(self) -> Mapping[str, Sequence[object]]:
        """Return the errors of each joint beside the noise floor."""
        return {
            "joint": self.joint_names,
            "RMSE of the rigid body [N m]": self.rigid_body.rmse.tolist(),
            "of the model [N m]": self.hybrid.rmse.tolist(),
            "noise floor [N m]": self.noise_floor.tolist(),
            "within the 95 % interval": [
                "-" if np.isnan(part) else f"{part:.0%}" for part in self.coverage
            ],
        }

    def save(self, folder: Path | str) -> None:
        """Write figures, pictures and the page, as `FILES` names them; the folder is made.

        Raises:
            ConfigError: The folder cannot be written to.
        """
        from estimators import evaluation_page, pictures  # which stand on this, and take long

        require_folder(Path(folder), "the evaluation")
        contents = (
            json.dumps(self.as_values(), indent=1).encode() + b"\n",
            pictures.png(pictures.torque_figure(self)),
            pictures.png(pictures.loop_figure(self)),
            evaluation_page.evaluation_page(self).html().encode(),
        )
        for name, content in zip(FILES, contents, strict=True):
            with whole(Path(folder) / name) as draft:
                draft.write_bytes(content)

    def as_values(self) -> dict[str, Any]:
        """Return the figures as JSON values."""
        per_joint = {
            "rmse_rigid_body": self.rigid_body.rmse,
            "rms_network": self.contribution,
            "rmse_hybrid": self.hybrid.rmse,
            "mse_rigid_body": self.rigid_body.mse,
            "mse_hybrid": self.hybrid.mse,
            "mse_ratio": self.mse_ratio,
            "noise_floor": self.noise_floor,
            "coverage_of_95_percent": self.coverage,
            "outside": self.outside,
        }
        return {
            "schema": 1,
            "model": self.model,
            "recording": self.recording.source,
            "trained_on": self.trained_on,
            "bandwidth": self.bandwidth,
            "samples": int(self.scored.sum()),
            "joints": list(self.joint_names),
            **{
                name: [float(v) if np.isfinite(v) else None for v in values]
                for name, values in per_joint.items()
            },
            "mean_mse_rigid_body": self.rigid_body.mean_mse,
            "mean_mse_hybrid": self.hybrid.mean_mse,
            "mean_mse_ratio": self.mean_mse_ratio,
        }


def evaluate(model: ResidualModel[Any], recording: Recording) -> Evaluation:
    """Predict a recording and compare with its torque, both behind one filter.

    Raises:
        NotFittedError: The model is not trained.
        ModelStoreError: The recording has another sampling rate than the model can take.
        RecordingError: The recording is of another robot, or too short.
    """
    bandwidth = model.bandwidth
    recording.check_robot(model.simulation.model)
    scored = recording.scored(bandwidth)
    motion, estimate = recording.motion(bandwidth), model.estimate(recording)
    return Evaluation(
        model.name,
        recording,
        motion,
        recording.measured_torque(bandwidth),
        estimate.filtered(recording, bandwidth),
        recording.filtered(model.simulation.without_effects().predict(motion), bandwidth),
        scored,
        bandwidth,
        model.simulation.model,
        model.simulation.model.joint_names,
        noise_floor(recording, bandwidth, estimate.simulation),
        trained_on(model, recording),
    )


def trained_on(model: ResidualModel[Any], recording: Recording) -> bool:
    """Say whether the model's folder states that it was trained on the file of a recording.

    Raises:
        NotFittedError: The model is not trained.
    """
    digest = provenance(recording)["sha256"]
    known = [item.get("sha256") for item in model.fitted.record.get("recordings", [])]
    return digest is not None and digest in known


def noise_floor(
    recording: Recording, bandwidth: float, predicted: FloatArray | None = None
) -> FloatArray:
    """Estimate the noise that the low-pass leaves in the measured torque, (n,) [N m].

    The level of the torque's spectrum above 0.6 of the Nyquist frequency is taken for the level of
    white noise, and multiplied with the equivalent width of the filter. Steps of dry friction reach
    up there as well; so the spectrum is the median of many short ones, most of which hold no step,
    and that of what a prediction leaves counts where it is lower. It is a floor: noise that grows
    towards low frequencies is not seen. NaN where that says nothing: the filter reaches up there,
    the spectrum still falls there, or hardly anything is left of it there, since the torque was
    filtered before it was recorded.

    Args:
        recording: The measured torque.
        bandwidth: Of the low-pass [Hz].
        predicted: Torque (T, n) [N m] that holds steps where the measured one does.

    Source: Welch, "The use of fast Fourier transform for the estimation of power spectra", IEEE
    TAU 1967, with the median in place of the mean.
    """
    nyquist = recording.rate / 2
    longest = max(recording.segments, key=lambda rows: rows.stop - rows.start)
    if _NOISE_FROM * nyquist < _STOP_BAND * bandwidth or (longest.stop - longest.start < _SEGMENT):
        return np.full(recording.n, np.nan)
    level = _white_level(recording.torque[longest], recording.rate)
    if predicted is not None:
        left = recording.torque[longest] - predicted[longest]
        level = np.fmin(level, _white_level(left, recording.rate))
    frequency = np.linspace(0.0, nyquist, _FREQUENCIES)
    amplitude = 1.0 / (1.0 + (frequency / bandwidth) ** (2 * ORDER))  # run forward and backward
    floor = np.sqrt(level * np.trapezoid(amplitude**2, frequency))
    swing = recording.torque[longest].std(axis=0)
    return np.where(floor > _BEST_SENSOR * swing, floor, np.nan)


def _white_level(torque: FloatArray, rate: float) -> FloatArray:
    """Return the density of the noise of torques (T, n), (n,) [N² m²/Hz]; NaN if it is not flat."""
    from scipy.signal import welch  # takes as long to import as the rest of the command

    frequency, density = welch(
        torque, rate, "blackmanharris", _SEGMENT, detrend="linear", axis=0, average="median"
    )
    part = frequency / (rate / 2)  # of the Nyquist frequency
    middle = (1.0 + _NOISE_FROM) / 2
    lower, upper = (part > _NOISE_FROM) & (part < middle), part >= middle
    falling = np.median(density[lower], axis=0) > _FLAT * np.median(density[upper], axis=0)
    return np.where(falling, np.nan, np.median(density[lower | upper], axis=0))
