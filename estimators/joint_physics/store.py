"""Save and load the model folder of joint physics: weights and their covariance."""

from __future__ import annotations

from dataclasses import asdict, fields
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from estimators.joint_physics.calibration import Calibration
from estimators.joint_physics.columns import WIDTHS
from estimators.joint_physics.model import FittedPhysics, JointPhysics
from estimators.joint_physics.prediction import UnknownMemory, any_moments
from estimators.model_folder import WEIGHTS, ModelFolder, write_folder
from limo_driver.errors import ModelStoreError

if TYPE_CHECKING:
    from pathlib import Path

    from limo_driver.types import FloatArray

_POSITIVE: Final = tuple(field.name for field in fields(Calibration))
_LEAST: Final = 1e-100  # of those
_NEVER: Final = 1e300  # [N² m²], a usual size beside which nothing fades
_ROUNDING: Final = 1e-9
_PACKAGES: Final = ("limo", "numpy", "numba", "safetensors", "pin")


def save(model: JointPhysics, folder: Path | str) -> None:
    """Write a model folder; it holds all that prediction needs.

    Raises:
        NotFittedError: Nothing was fitted.
        ModelStoreError: The folder cannot be written.
    """
    fitted = model.fitted
    entries: dict[str, Any] = {
        "estimator": model.name,
        "bandwidth": model.bandwidth,
        "families": [asdict(family) for family in model.columns.families],
        "training": dict(fitted.record),
    }
    tensors = {"weights": fitted.weights, "root": fitted.root, **asdict(fitted.calibration)}
    tensors["moments"] = fitted.unknown.moments
    write_folder(folder, entries, tensors, model.simulation, _PACKAGES)


def load(folder: Path | str) -> JointPhysics:
    """Read a model folder.

    Raises:
        ModelStoreError: A file is missing or does not fit the others; the message names it.
    """
    opened = ModelFolder.open(folder, JointPhysics.name)
    model = JointPhysics(opened.simulation, opened.bandwidth)
    families = opened.manifest["families"].sections()
    given = [(entry.text("name"), entry.number("size")) for entry in families]
    expected = [(family.name, family.size) for family in model.columns.families]
    if given != expected:
        opened.manifest.fail(
            f"has the families {given}, but this version computes {expected}; train it again"
        )
    n, K = model.columns.n, model.columns.count
    shapes = {"weights": (n, K), "root": (n, K, K)} | dict.fromkeys(_POSITIVE, (n,))
    # a folder from before learned torque faded estimates as it did
    tensors = {"growth": np.ones(n), "usual": np.full(n, _NEVER)} | opened.tensors()
    place = opened.path / WEIGHTS
    found = _arrays(tensors, place, shapes)
    calibration = Calibration(*(found[name] for name in _POSITIVE))
    record = opened.record("held_out")
    moments = _moments(tensors, place, n)
    unknown = UnknownMemory.of(model.columns, found["weights"], moments, opened.simulation)
    friction = model.columns.friction
    model.fitted_ = FittedPhysics(
        found["weights"], found["root"], friction, calibration, unknown, record
    )
    return model


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
