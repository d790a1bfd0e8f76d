"""Packages that limo does without until something asks for them, and its own four."""

from __future__ import annotations

import os
import re
from functools import cache
from importlib.util import find_spec
from typing import Final

from limo_driver.errors import HiddenPackageError, MissingPackageError

_OWN: Final = ("backends", "estimators", "limopa")  # next to `limo_driver`
_DISTRIBUTION: Final = {"pxr": "usd-core", "rerun": "rerun-sdk"}  # of a module called otherwise


def require_package(module: str, purpose: str) -> None:
    """Check that a package is there that not every installation has; nothing is imported.

    Args:
        module: Its name, for example `onnx`.
        purpose: What needs it, for example "an export to ONNX".

    Raises:
        MissingPackageError: It is not; the message says what to install.
    """
    try:
        found = find_spec(module)
    except ImportError:
        found = None
    if found is None:
        raise MissingPackageError(purpose, module, _requirement(module))


def _requirement(module: str) -> str:
    """Return the requirement by which limo declares a package, without its extra.

    It is what to install, since an extra would bring all else that limo depends on, torch too.
    """
    from importlib.metadata import requires

    name = _DISTRIBUTION.get(module, module)
    declared = (text.partition(";")[0].strip() for text in requires("limo") or ())
    return next((text for text in declared if re.match(rf"{name}\b(?!-)", text)), name)


@cache
def require_own_packages() -> None:
    """Check that no folder of the user hides a package of limo.

    Raises:
        HiddenPackageError: One does.
    """
    home = os.path.dirname(os.path.dirname(os.path.dirname(os.path.realpath(__file__))))
    for name in _OWN:
        spec = find_spec(name)
        found = "" if spec is None or spec.origin is None else os.path.realpath(spec.origin)
        if found != os.path.join(home, name, "__init__.py"):
            raise HiddenPackageError(name, found or "nowhere")
