"""Summaries of arrays, comparison of frozen values with new ones, and what machine made them.

Tolerances are relative to the scale of a value: its magnitude, and of a part of a whole the whole.
In a list of numbers, lists in it included, it is the greatest magnitude of the whole list, for a
component near zero says nothing about its own accuracy; nor does an estimate near zero, whose
scale is its standard deviation where that stands beside it and is larger.

`SAME_MACHINE`: where processor, BLAS kernels and packages are those that froze the values. There
two runs agree to the last bit, and the tolerance only lets code be written in another order of
sums.

`SUMS`, `FITS` and `TRAINED`: on any other processor. BLAS picks its kernels by it, and numba
compiles for it, so that sums are taken in another order and products are fused or not.

* What is predicted by given values are sums: of up to 1e5 terms, each rounded to 1e-16. Filters,
  which take differences, lose two digits more.
* What is fitted solves normal equations. Of columns with a condition number of 1e3, the worst
  that these recordings come near to, they pass on rounding 1e6 times as large: 1e-16 becomes 1e-10
  of what an estimate is known beside, and sums of 1e5 rows leave more of it. Fits of bodies and of
  settings that are not linear stop at 1e-10 nat from their best, which is 1e-5 of a standard
  deviation, and that is a tenth of an estimate at most: 1e-6.
* Networks are trained in single precision, each number rounded to 1e-7; dozens of Adam's steps,
  each a ratio of gradients, pass on some hundred times as much: 1e-4.

What is decided (names, order, numbers of things) has to be the same: no last bit decides. Texts are
compared without the figures in them, which are rounded values, and digests not at all.
"""

from __future__ import annotations

import hashlib
import math
import re
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numba
import numpy as np
import scipy.linalg  # noqa: F401  # brings a BLAS of its own, which the fingerprint names
import torch
from llvmlite.binding import get_host_cpu_name
from threadpoolctl import threadpool_info

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence

    from numpy.typing import NDArray

SAME_MACHINE = 1e-12  # of the scale
SUMS, FITS, TRAINED = 1e-9, 1e-6, 1e-4  # the same on another processor
WHOLE = {"share": 1.0, "confidence": 1.0, "lead": 1.0, "log_evidence": 1.0}  # parts, and nat

PACKAGES = ("llvmlite", "mujoco", "numba", "numpy", "pin", "scipy", "torch")
ZERO = 1e-14  # magnitude up to which a number is the rest of a difference

LISTED = 8  # values of an array up to which all of them are listed
BLOCKS = 4  # of consecutive values, of which the means are listed
SAMPLES = 8  # values that are listed of a longer array

_FIGURE = re.compile(r"\d+(\.\d+)?(e[+-]?\d+)?")


def fingerprint() -> dict[str, Any]:
    """Return what the last digits of a result depend on, beside the code."""
    kernels = sorted(
        f"{item['prefix']} {item['version']} {item.get('architecture', '')}".strip()
        for item in threadpool_info()
        if item["user_api"] == "blas"
    )
    return {
        "processor": _processor(),
        "compiled_for": numba.config.CPU_NAME or get_host_cpu_name(),
        "blas": kernels,
        "torch": torch.backends.cpu.get_cpu_capability(),
        "packages": {name: version(name) for name in PACKAGES},
    }


def _processor() -> list[str]:
    """Return name, family, model and stepping, as the kernel tells them."""
    try:
        text = Path("/proc/cpuinfo").read_text(encoding="utf-8")
    except OSError:
        return []
    told = ("model name", "cpu family", "model", "stepping")
    found = (re.search(rf"^{key}\s*:\s*(.*)$", text, re.MULTILINE) for key in told)
    return [match[1] for match in found if match]


def summary(array: NDArray[Any]) -> dict[str, Any]:
    """Return the digest of an array, figures over all of its values, and some of them.

    Args:
        array: Of numbers or truth values, any shape; what is not a number is counted.
    """
    flat = np.asarray(array).ravel()
    held = flat.astype(np.float64)
    held = held[np.isfinite(held)]
    told: dict[str, Any] = {
        "shape": list(np.shape(array)),
        "dtype": str(flat.dtype),
        "digest": hashlib.sha256(np.ascontiguousarray(flat).tobytes()).hexdigest(),
        "finite": held.size,
    }
    if held.size <= LISTED:
        return told | {"values": held.tolist()}
    return told | {
        "extremes": [float(held.min()), float(held.max())],
        "rms": math.sqrt(float(np.mean(held**2))),
        "means": [float(block.mean()) for block in np.array_split(held, BLOCKS)],
        "samples": held[np.linspace(0, held.size - 1, SAMPLES).astype(int)].tolist(),
    }


@dataclass(frozen=True)
class Difference:
    """One value that is not what was frozen.

    Args:
        place: Keys and indices that lead to it.
        frozen: What it was.
        new: What it is.
        size: Relative to the scale, for numbers; else infinite.
    """

    place: tuple[str | int, ...]
    frozen: Any
    new: Any
    size: float = math.inf

    def __str__(self) -> str:
        where = "/".join(map(str, self.place))
        by = f" ({self.size:.1e} of its scale)" if math.isfinite(self.size) else ""
        return f"{where}: was {_short(self.frozen)}, is {_short(self.new)}{by}"

    @property
    def of_text(self) -> bool:
        """Return whether only the words of a sentence differ; a name has no space in it."""
        both = isinstance(self.frozen, str) and isinstance(self.new, str)
        return (
            both
            and " " in self.frozen
            and _FIGURE.findall(self.frozen) == _FIGURE.findall(self.new)
        )


def _short(value: Any) -> str:
    text = repr(value)
    return text if len(text) <= 120 else f"{text[:117]}..."


def differences(
    frozen: Any, new: Any, tolerance: float, *, figures_in_texts: bool = True
) -> list[Difference]:
    """Return every value that is not what was frozen, in order.

    Args:
        frozen: What JSON holds: mappings, lists, texts, numbers, truth values, None.
        new: The same.
        tolerance: Of numbers, relative to their scale.
        figures_in_texts: Whether texts have to agree in their figures, too.
    """
    return list(_Comparison(tolerance, figures_in_texts).of(frozen, new, (), None))


@dataclass(frozen=True)
class _Comparison:
    tolerance: float
    figures_in_texts: bool

    def of(
        self,
        frozen: Any,
        new: Any,
        place: tuple[str | int, ...],
        scale: float | None,
        least: float = 0.0,
    ) -> Iterator[Difference]:
        if isinstance(frozen, dict) and isinstance(new, dict):
            yield from self._of_mappings(frozen, new, place)
        elif isinstance(frozen, list) and isinstance(new, list):
            yield from self._of_lists(frozen, new, place, scale, least)
        elif isinstance(frozen, float) and _is_number(new):
            yield from self._of_numbers(frozen, new, place, scale, least)
        elif isinstance(frozen, str) and isinstance(new, str) and not self.figures_in_texts:
            if _FIGURE.sub("#", frozen) != _FIGURE.sub("#", new):
                yield Difference(place, frozen, new)
        elif type(frozen) is not type(new) or frozen != new:
            yield Difference(place, frozen, new)

    def _of_mappings(
        self, frozen: Mapping[str, Any], new: Mapping[str, Any], place: tuple[str | int, ...]
    ) -> Iterator[Difference]:
        if list(frozen) != list(new):
            yield Difference(place, list(frozen), list(new))
            return
        if "digest" in frozen and frozen == new:
            return
        for key in frozen:
            if key != "digest":  # where it differs, figures and samples say by how much
                least = _least_scale(key, frozen)
                yield from self.of(frozen[key], new[key], (*place, key), None, least)

    def _of_lists(
        self,
        frozen: Sequence[Any],
        new: Sequence[Any],
        place: tuple[str | int, ...],
        scale: float | None,
        least: float,
    ) -> Iterator[Difference]:
        if len(frozen) != len(new):
            yield Difference(place, frozen, new)
            return
        scale = _scale(frozen) if scale is None else scale
        for index, (was, now) in enumerate(zip(frozen, new, strict=True)):
            yield from self.of(was, now, (*place, index), scale, least)

    def _of_numbers(
        self,
        frozen: float,
        new: float,
        place: tuple[str | int, ...],
        scale: float | None,
        least: float,
    ) -> Iterator[Difference]:
        if frozen == new or (math.isnan(frozen) and math.isnan(new)):
            return
        if max(abs(frozen), abs(new)) <= ZERO:
            return
        scale = max(abs(frozen) if scale is None else scale, least)
        size = abs(new - frozen) / scale if scale and math.isfinite(scale) else math.inf
        if not size <= self.tolerance:
            yield Difference(place, frozen, new, size)


def _least_scale(key: str, among: Mapping[str, Any]) -> float:
    """Return what a value counts beside: its whole, or its deviation if that stands with it."""
    deviation = among.get("deviation") if key == "value" else None
    return abs(deviation) if _is_number(deviation) else WHOLE.get(key, 0.0)


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)


def _scale(values: Sequence[Any]) -> float:
    """Return the greatest magnitude of numbers in a list, lists in it included."""
    sizes = [
        _scale(item) if isinstance(item, list) else abs(item)
        for item in values
        if isinstance(item, list) or (_is_number(item) and math.isfinite(item))
    ]
    return max(sizes, default=0.0)
