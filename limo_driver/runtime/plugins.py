"""Plug-ins: classes by name in groups of entry points; and packages that may not be installed.

Nothing is looked for until a name is asked for, and then once in a process. A plug-in that cannot
be used is an error for who asks for its name, and for nobody else. limo does without some packages
until something asks for them, and never without its own four.
"""

from __future__ import annotations

import os
import re
import sys
from dataclasses import dataclass
from functools import cache
from importlib import import_module
from importlib.util import find_spec
from typing import TYPE_CHECKING, Any, Final

from limo_driver.errors import (
    BackendNotFoundError,
    HiddenPackageError,
    LimoError,
    MissingPackageError,
    PlugInError,
)

if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Mapping
    from importlib.metadata import EntryPoint

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


ROBOTS: Final = "limo.robots"
ESTIMATORS: Final = "limo.estimators"
EFFECTS: Final = "limo.effects"
OWN: Final = "limo"  # the distribution whose names no other may take


@dataclass(frozen=True)
class PlugIn:
    """A class that a distribution registers by name; nothing of it is imported yet."""

    group: str
    name: str
    target: str  # module:class
    distribution: str
    entry: EntryPoint

    @property
    def kind(self) -> str:
        """Kind of object that the group holds, in the singular."""
        return self.group.removeprefix("limo.").removesuffix("s")

    def load(self) -> Any:  # noqa: ANN401  # the class behind the entry point
        """Import the class.

        Raises:
            PlugInError: Whatever went wrong with one of another distribution.
        """
        if self.distribution == OWN:  # whose errors say what they mean
            return self.entry.load()
        try:
            return self.entry.load()
        except Exception as error:  # foreign code may raise anything
            what = "" if isinstance(error, LimoError) else f"{type(error).__name__}: "
            raise self.unusable(f"{what}{error}") from error

    def unusable(self, reason: str) -> PlugInError:
        """Return the error that names distribution and entry point."""
        return PlugInError(self.group, self.name, self.target, self.distribution, reason)


def names(group: str) -> tuple[str, ...]:
    """Return all names that are registered in a group, in order; nothing is imported."""
    return tuple(sorted(_registered().get(group, {})))


def plug_in(group: str, name: str, own: Collection[str] = ()) -> PlugIn | None:
    """Return the object registered as `name` in a group, None if there is none.

    Args:
        group: Of entry points.
        name: In the group.
        own: Names of limo itself that no entry point tells.

    Raises:
        PlugInError: Another distribution uses a name of limo's own, or two use the same.
    """
    found = _registered().get(group, {}).get(name, ())
    foreign = [item for item in found if item.distribution != OWN]
    if foreign and (name in own or len(foreign) < len(found)):
        raise foreign[0].unusable(
            f"{name!r} is a name of limo's own; it has to take another, or to be uninstalled"
        )
    if len(foreign) > 1:
        others = " and ".join(item.distribution for item in foreign[1:])
        raise foreign[0].unusable(f"{others} registers that name, too; uninstall one of them")
    return found[0] if found else None


def find(group: str, name: str) -> Any:  # noqa: ANN401  # the class behind an entry point
    """Return the class registered as `name` in an entry point group.

    Raises:
        BackendNotFoundError: No such name; the message lists the known ones.
        PlugInError: The name is taken twice, or what it stands for cannot be imported.
    """
    found = plug_in(group, name)
    if found is None:
        raise BackendNotFoundError(
            group.removeprefix("limo.").removesuffix("s"), name, names(group)
        )
    return found.load()


@cache
def _registered() -> Mapping[str, Mapping[str, tuple[PlugIn, ...]]]:
    """Return what each of limo's groups holds, by name."""
    from importlib.metadata import entry_points

    everything = entry_points()
    found: dict[str, dict[str, tuple[PlugIn, ...]]] = {}
    for group in (ROBOTS, ESTIMATORS, EFFECTS):
        named = found.setdefault(group, {})
        for entry in everything.select(group=group):
            owner = "" if entry.dist is None else entry.dist.name
            item = PlugIn(group, entry.name, entry.value, owner, entry)
            named[entry.name] = (*named.get(entry.name, ()), item)
    return found


def lazily(package: str, home: Mapping[str, str]) -> Callable[[str], object]:
    """Return the `__getattr__` of a package.

    Args:
        package: Its name.
        home: Module of each name.
    """

    def get(name: str) -> object:
        if name not in home:
            raise AttributeError(f"module {package!r} has no attribute {name!r}")
        value = getattr(import_module(home[name]), name)
        setattr(sys.modules[package], name, value)
        return value

    return get
