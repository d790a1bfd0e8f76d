"""Network: normalised inputs to normalised torques, from weights alone."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from functools import cached_property
from typing import ClassVar

import numpy as np

from limo_driver.errors import ModelStoreError
from limo_driver.types import FloatArray, IntArray


class Network(ABC):
    """A trained network; a subclass writes the forward pass.

    It is G parts side by side. Part g sees the inputs `columns[g]` and gives m outputs; the
    network's outputs are those of the parts in order.

    Args:
        columns: Inputs that each part sees, (G, f).
        weights: Arrays by name, with the part as first index.

    Raises:
        ModelStoreError: The columns are no table of inputs; a weight is missing, has another shape
            or is not finite.
    """

    kind: ClassVar[str]
    recurrent: ClassVar[bool]

    def __init__(self, columns: IntArray, weights: Mapping[str, FloatArray]) -> None:
        # Columns that compiled code can be given, which checks no index
        if columns.ndim != 2 or not columns.size or columns.dtype.kind not in "iu":  # noqa: PLR2004  # (G, f)
            raise ModelStoreError(
                f"{self.kind}: columns are {columns.dtype} of shape {columns.shape}, expected "
                "integers of shape (parts, inputs of each)"
            )
        if columns.min() < 0:
            raise ModelStoreError(
                f"{self.kind}: columns go down to {columns.min()}, expected 0 or more"
            )
        self.columns = np.ascontiguousarray(columns, dtype=np.int64)
        self.weights: dict[str, FloatArray] = {}
        shapes = self.shapes(columns.shape[0], columns.shape[1], weights)
        for name, shape in shapes.items():
            if name not in weights:
                raise ModelStoreError(f"{self.kind}: no weight {name!r} among {sorted(weights)}")
            array = np.ascontiguousarray(weights[name], dtype=np.float64)
            if array.shape != shape or not array.size:
                raise ModelStoreError(
                    f"{self.kind}: weight {name!r} has shape {array.shape}, expected {shape}"
                )
            if not np.isfinite(array).all():
                raise ModelStoreError(f"{self.kind}: weight {name!r} is not finite")
            self.weights[name] = array

    @classmethod
    @abstractmethod
    def shapes(
        cls, parts: int, inputs: int, weights: Mapping[str, FloatArray]
    ) -> dict[str, tuple[int, ...]]:
        """Return the shape of each weight; sizes that are free are taken from the weights."""

    @cached_property
    def _arrays(self) -> tuple[FloatArray, ...]:
        """The weights in the order of `shapes`, for compiled code."""
        return tuple(self.weights.values())

    @property
    def hidden(self) -> int:
        """Hidden units of each part."""
        return self.weights["output_weight"].shape[1]

    @property
    def outputs(self) -> int:
        """Number of outputs."""
        parts, _, m = self.weights["output_weight"].shape
        return parts * m

    @abstractmethod
    def init(self, stride: int) -> FloatArray:
        """Return the memory before the first sample.

        Args:
            stride: Samples between two that follow each other in the network's memory.
        """

    @abstractmethod
    def advance(self, memory: FloatArray, x: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Evaluate T samples that follow `memory`.

        Args:
            memory: Memory after the sample before.
            x: Normalised inputs, (T, d).

        Returns:
            Normalised outputs (T, outputs) and the memory after the last sample.
        """


def free_size(weights: Mapping[str, FloatArray], name: str, axis: int) -> int:
    """Return the length of an axis of a weight, or 0 where the weight does not have it."""
    shape = np.shape(weights.get(name, 0.0))
    return shape[axis] if len(shape) > axis else 0
