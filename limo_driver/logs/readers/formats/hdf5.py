"""HDF5 files, and MATLAB's .mat of version 7.3, which are such: trees of arrays.

h5py reads them. What points out of the file is left where it is.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any, Final

import numpy as np

from limo_driver.errors import RecordingError
from limo_driver.runtime.plugins import require_package

# h5py ships no type stubs.
# pyright: reportMissingTypeStubs=false
_CLASS: Final = "MATLAB_class"  # attribute of what MATLAB wrote
_LABELS: Final = 4096  # texts of one list, at most
_WIDEST: Final = 1 << 12  # columns of an array; images have more
_DEEPEST: Final = 8  # groups one in the other


def tree_of(path: Path) -> dict[str, Any]:
    """Return the arrays of a file by name, in this process, whatever they unpack to.

    Raises:
        MissingPackageError: h5py is not installed.
        RecordingError: It is no HDF5, or damaged.
    """
    require_package("h5py", "HDF5, as MATLAB writes with -v7.3,")
    import h5py

    try:
        with h5py.File(path, "r") as file:
            return _of_group(file, file, 0)
    except (OSError, RuntimeError, KeyError, ValueError, TypeError) as error:
        why = " ".join(str(error).split())
        raise RecordingError(f"cannot be read as HDF5: {why}", path=path) from None


def _of_group(group: Any, file: Any, depth: int) -> dict[str, Any]:  # noqa: ANN401
    """Return what a group holds, by name; of links, those within it."""
    import h5py

    found: dict[str, Any] = {}
    for name in group if depth < _DEEPEST else ():
        is_own = group.get(name, getlink=True, getclass=True) is h5py.HardLink
        if not is_own or name.startswith("#"):  # where MATLAB keeps what others refer to
            continue
        item = group[name]
        if isinstance(item, h5py.Group):
            found[name] = _of_group(item, file, depth + 1)
        elif isinstance(item, h5py.Dataset) and (values := _of_dataset(item, file)) is not None:
            found[name] = values
    return found


def _of_dataset(item: Any, file: Any) -> Any:  # noqa: ANN401
    """Return the numbers or texts of an array, by field where it has some; None of any other."""
    if item.shape is None or item.is_virtual or item.external:
        return None
    if item.dtype.kind in "fiu" and item.attrs.get(_CLASS) != b"char":
        is_plain = item.ndim in {1, 2} and (item.ndim == 1 or min(item.shape) <= _WIDEST)
        return item[()] if is_plain else None
    if item.dtype.names and item.ndim == 1:  # rows of fields, each an array of its own
        rows = item[()]
        fields = ((name, rows[name]) for name in item.dtype.names)
        return {name: own for name, own in fields if own.dtype.kind in "fiu" and own.ndim <= 2}  # noqa: PLR2004
    if item.ndim > 0 and 0 < item.size <= _LABELS:
        return _texts(item, file)
    return None


def _texts(item: Any, file: Any) -> Any:  # noqa: ANN401
    """Return texts as HDF5 has them, or as cells of MATLAB, which refer to rows of characters."""
    import h5py

    if h5py.check_string_dtype(item.dtype) is not None:
        return np.asarray(item.asstr()[()], dtype=object).ravel()
    if h5py.check_ref_dtype(item.dtype) is not h5py.Reference:
        return None
    cells = [file[each] if each else None for each in np.ravel(item[()])]
    if any(x is None or x.attrs.get(_CLASS) != b"char" or x.size > _LABELS for x in cells):
        return None
    rows = (np.ravel(cell[()]).tolist() for cell in cells if cell is not None)
    return np.array(["".join(map(chr, row)) for row in rows], dtype=object)
