"""What the model folder of a joint-physics model holds: weights and how well they are known."""

from __future__ import annotations

from dataclasses import asdict
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from estimators.joint_physics.calibration import Calibration
from estimators.joint_physics.model import FittedPhysics, JointPhysics
from estimators.model_folder import MANIFEST, WEIGHTS, ModelFolder, write_folder
from limo_driver.errors import ModelStoreError

if TYPE_CHECKING:
    from pathlib import Path

_REQUIRED: Final = frozenset(("families", "bandwidth"))
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
    write_folder(folder, entries, tensors, model.simulation, _PACKAGES)


def load(folder: Path | str) -> JointPhysics:
    """Read a model folder.

    Raises:
        ModelStoreError: A file is missing or does not fit the others; the message names it.
    """
    opened = ModelFolder.open(folder, JointPhysics.name, _REQUIRED)
    manifest = opened.manifest
    try:
        model = JointPhysics(opened.simulation, float(manifest["bandwidth"]))
        given = [(entry["name"], entry["size"]) for entry in manifest["families"]]
    except (KeyError, TypeError, ValueError) as error:
        raise ModelStoreError(
            f"{opened.path / MANIFEST}: cannot be understood: {error!r}"
        ) from None
    expected = [(family.name, family.size) for family in model.columns.families]
    if given != expected:
        raise ModelStoreError(
            f"{opened.path / MANIFEST}: has the families {given}, but this version computes "
            f"{expected}; train it again"
        )
    tensors = opened.tensors()
    n, K = model.columns.n, model.columns.count
    shapes = {"weights": (n, K), "root": (n, K, K), "noise": (n,), "factor": (n,), "farthest": (n,)}
    for name, shape in shapes.items():
        found = tensors.get(name, np.empty(0))
        if found.shape != shape or not np.isfinite(found).all():
            raise ModelStoreError(
                f"{opened.path / WEIGHTS}: {name} has shape {found.shape}, expected {shape} of "
                "finite numbers"
            )
    calibration = Calibration(*(tensors[name] for name in ("noise", "factor", "farthest")))
    record = manifest.get("training", {})
    model.fitted_ = FittedPhysics(tensors["weights"], tensors["root"], calibration, record)
    return model
