"""Errors of two versions, or of one, on a recording, with intervals and a picture."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from estimators.model_folder import load_model, provenance
from estimators.service.comparison.gate import LEVEL, accuracy, compare, plain
from limo_driver.errors import RecordingError

if TYPE_CHECKING:
    from pathlib import Path

    from estimators.residual_model import ResidualModel
    from estimators.service.comparison.gate import Comparison
    from estimators.service.store.version import Version
    from limo_driver.recordings.recording import Recording
    from limo_driver.types import FloatArray

SECONDS: Final = 5.0  # of a block; longer than a slow motion takes to change its direction


def compare_versions(
    champion: Version, challenger: Version, recording: Recording, seconds: float = SECONDS
) -> Comparison:
    """Compare two versions on a recording.

    Both are held against the measured torque behind the filter of the model that keeps more of it:
    what the other does not follow is its error.

    Args:
        champion: The one to be beaten.
        challenger: The other one.
        recording: That neither was trained on.
        seconds: Length of a block [s].

    Raises:
        ModelStoreError: A file of a version differs, or the recording has a rate that it cannot
            take.
        RecordingError: The recording is of another robot, or too short.
    """
    models = [champion.load(), challenger.load()]
    first, second = _errors(models, recording)
    return compare(first, second, _block(recording, seconds, len(first)))


def metrics(folder: Path, recording: Recording, seconds: float = SECONDS) -> dict[str, Any]:
    """Return the RMSE of a model folder on a recording with its interval, as JSON values.

    Raises:
        ModelStoreError: The folder does not fit together, or cannot take the recording's rate.
        RecordingError: The recording is of another robot, or too short.
    """
    model = load_model(folder)
    (errors,) = _errors([model], recording)
    found = accuracy(errors, _block(recording, seconds, len(errors)))
    return {
        "recording": provenance(recording),
        "bandwidth": model.bandwidth,
        "rmse": plain(found.value),
        "low": plain(found.low),
        "high": plain(found.high),
        "level": LEVEL,
    }


def difference_figure(comparison: Comparison, joints: tuple[str, ...], names: list[str]) -> Figure:
    """Draw the change of each joint's RMSE, in per cent of the champion's, with its interval.

    Args:
        comparison: Of n joints.
        joints: Their names.
        names: Of champion and challenger.
    """
    figure = Figure(figsize=(7.0, 0.42 * len(joints) + 1.5), layout="constrained")
    FigureCanvasAgg(figure)
    ax = figure.subplots()
    scale = 100.0 / comparison.champion
    found = comparison.difference
    value, low, high = (v * scale for v in (found.value, found.low, found.high))
    rows = np.arange(len(joints))
    colours = np.where(low > 0, "#D55E00", np.where(high < 0, "#0072B2", "0.55"))
    ax.hlines(rows, low, high, color=colours.tolist(), linewidth=2.2)
    ax.scatter(value, rows, color=colours.tolist(), zorder=3)
    ax.axvline(0.0, color="0.3", linewidth=0.8)
    ax.set_yticks(rows, joints)
    ax.invert_yaxis()
    ax.set_xlabel(f"RMSE of {names[1]} less that of {names[0]} [% of {names[0]}]")
    ax.set_title(
        f"{LEVEL:.0%} intervals from {comparison.blocks} blocks; blue better, orange worse, "
        "grey undecided",
        fontsize="small",
        loc="left",
    )
    ax.grid(axis="x", linewidth=0.4, alpha=0.5)
    ax.spines[["top", "right"]].set_visible(False)
    return figure


def _errors(models: list[ResidualModel[Any]], recording: Recording) -> list[FloatArray]:
    """Return the errors of each model at the instants that all can be judged at, (T, n) [N m]."""
    for model in models:
        recording.check_robot(model.simulation.model)
    bandwidths = [model.bandwidth for model in models]
    measured = recording.filtered_torque(max(bandwidths))
    scored = ~recording.edges(min(bandwidths))
    return [(model.predict(recording) - measured)[scored] for model in models]


def _block(recording: Recording, seconds: float, scored: int) -> int:
    """Return the samples of a block.

    Raises:
        RecordingError: There is not one block.
    """
    block = max(1, round(seconds * recording.rate))
    if scored < block:
        raise RecordingError(
            f"has {scored} samples to judge by, expected at least a block of {seconds:g} s, "
            f"{block} samples",
            path=recording.source or None,
        )
    return block
