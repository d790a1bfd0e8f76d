"""Evaluate a model on motion it has not seen, against the rigid body and the noise floor."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np

from estimators.evaluation_result import EvaluationResult
from estimators.model_folder import provenance
from estimators.residual_model import ResidualModel
from limo_driver.recordings.filters.differentiation import ORDER
from limo_driver.recordings.recording import Recording
from limo_driver.runtime.outputs import require_folder, whole
from limo_driver.types import FloatArray

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


@dataclass(frozen=True, repr=False)
class Evaluation(EvaluationResult):
    """Torques measured and predicted over a recording, and their errors."""

    def save(self, folder: Path | str) -> None:
        """Write figures, pictures and the page, as `FILES` names them; the folder is made.

        Raises:
            ConfigError: The folder cannot be written to.
        """
        from estimators import evaluation_page as shown  # which takes long

        require_folder(Path(folder), "the evaluation")
        contents = (
            json.dumps(self.as_values(), indent=1).encode() + b"\n",
            shown.png(shown.torque_figure(self)),
            shown.png(shown.loop_figure(self)),
            shown.evaluation_page(self).html().encode(),
        )
        for name, content in zip(FILES, contents, strict=True):
            with whole(Path(folder) / name) as draft:
                draft.write_bytes(content)


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
