"""Numbers as C: constants of the preprocessor and tables, exact and of any locale."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Mapping

    from numpy.typing import ArrayLike, NDArray

SIDE_BY_SIDE: Final = 4  # doubles, of which what stands for each joint is filled up to a multiple
_WIDTH: Final = 98  # of a line
_TYPES: Final = {"f8": "double", "f4": "float", "i8": "int"}


def number(value: float) -> str:
    """Return a number that C reads back as the same one."""
    if np.isnan(value):
        return "NAN"
    if np.isinf(value):
        return "INFINITY" if value > 0 else "-INFINITY"
    return repr(float(value))


def table(name: str, values: ArrayLike, aligned: int | None = None) -> str:
    """Return the definition of a constant array of doubles, floats or ints, of any shape.

    Args:
        name: Of the array.
        values: Its entries.
        aligned: To so many bytes, if more than their type needs.
    """
    array = np.asarray(values)
    kind = array.dtype.str[1:]
    sizes = "".join(f"[{size}]" for size in array.shape)
    where = f"_Alignas({aligned}) " if aligned else ""
    return f"static {where}const {_TYPES[kind]} {name}{sizes} = {_entries(array, kind)};\n"


def defines(values: Mapping[str, float | bool]) -> str:
    """Return constants of the preprocessor."""
    return "".join(f"#define {name} {_constant(value)}\n" for name, value in values.items())


def _constant(value: float | bool) -> str:  # a value, not an option
    return str(int(value)) if isinstance(value, (bool, int, np.integer)) else number(value)


def _entries(array: NDArray[Any], kind: str) -> str:
    if array.ndim > 1:
        return "{" + ",\n".join(_entries(row, kind) for row in array) + "}"
    lines, line = list[str](), "{"
    for value in array:
        text = _entry(value, kind)
        if len(line) + len(text) > _WIDTH:
            lines.append(line)
            line = ""
        line += text + ", "
    return "\n".join([*lines, line.removesuffix(", ") + "}"])


def _entry(value: Any, kind: str) -> str:  # noqa: ANN401  # an entry of an array
    if kind == "i8":
        return str(value)
    if kind == "f8":
        return number(value)
    text = f"{value:.9g}"  # tells any two floats apart
    return (text if any(c in text for c in ".en") else text + ".0") + "F"
