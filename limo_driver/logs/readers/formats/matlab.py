"""Variables of MATLAB, as `save` writes them (.mat)."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final

from limo_driver.errors import RecordingError
from limo_driver.logs.readers.formats.trees import table_of_tree
from limo_driver.runtime.given_files import apart

if TYPE_CHECKING:
    from pathlib import Path

    from limo_driver.logs.readers.table import LogTable

_KIND: Final = "MATLAB variables"


def read_mat(path: Path) -> LogTable:
    """Read the arrays of a file, those of its structures included.

    Raises:
        RecordingError: It is none, damaged, of version 7.3, or unpacks to more than a log does.
    """
    return table_of_tree(apart(variables_of, path, RecordingError), str(path), _KIND)


def variables_of(path: Path) -> dict[str, Any]:
    """Return the variables of a file by name, in this process, whatever they unpack to.

    Raises:
        RecordingError: It is none, damaged, or of version 7.3.
    """
    from scipy.io import loadmat  # slow to import
    from scipy.io.matlab import MatReadError

    try:
        found: dict[str, Any] = loadmat(path, simplify_cells=True)
    except NotImplementedError:
        raise RecordingError(
            "is HDF5, as MATLAB writes with -v7.3, which is not read; `save` it with -v7", path=path
        ) from None
    except (MatReadError, OSError, ValueError, TypeError, KeyError, EOFError) as error:
        raise RecordingError(f"cannot be read as .mat: {error}", path=path) from None
    return {name: values for name, values in found.items() if not name.startswith("__")}
