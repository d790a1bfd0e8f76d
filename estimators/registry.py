"""Estimators by name: limo's own and those of other distributions, through entry points."""

from __future__ import annotations

from inspect import isabstract
from typing import TYPE_CHECKING, Any, Final

from estimators.residual_model import ResidualModel
from limo_driver.errors import ConfigError
from limo_driver.runtime.plugins import ESTIMATORS, OWN, names, plug_in

if TYPE_CHECKING:
    from collections.abc import Collection

# limo's own that are not trained by their name, and what is given instead
_OTHERWISE: Final = {
    "hybrid": "by the name of its network",
    "rigid-body": "by `limo identify`",
}


def known_estimators() -> tuple[str, ...]:
    """Return all names that are registered, in order; those of plug-ins may prove unusable."""
    return names(ESTIMATORS)


def trained_by_name() -> tuple[str, ...]:
    """Return the names of those that are trained by their own name."""
    return tuple(name for name in names(ESTIMATORS) if name not in _OTHERWISE)


def estimator_called(name: str, own: Collection[str] = ()) -> type[ResidualModel[Any]]:
    """Return an estimator that keeps its models in folders.

    Args:
        name: As it stands in manifests and after `--model`.
        own: Names that limo gives to something else.

    Raises:
        ConfigError: There is none of that name, or it keeps no models in folders.
        PlugInError: It is of another distribution and cannot be used.
    """
    found = plug_in(ESTIMATORS, name, own)
    if found is None:
        raise ConfigError(f"no estimator is called {name!r}; known: {', '.join(names(ESTIMATORS))}")
    estimator: Any = found.load()
    if not (isinstance(estimator, type) and issubclass(estimator, ResidualModel)):
        if found.distribution == OWN:
            raise ConfigError(f"estimator {name!r} keeps no model folder")
        raise found.unusable("is no subclass of estimators.residual_model.ResidualModel")
    if isabstract(estimator):
        lacking = ", ".join(sorted(estimator.__abstractmethods__))
        raise found.unusable(f"{estimator.__name__} does not define {lacking}")
    if getattr(estimator, "name", None) != name:
        given = getattr(estimator, "name", None)
        raise found.unusable(f"{estimator.__name__} calls itself {given!r}, not {name!r}")
    return estimator


def to_train(name: str, own: Collection[str] = ()) -> type[ResidualModel[Any]]:
    """Return an estimator that is trained by its own name.

    Args:
        name: As it stands after `--model`.
        own: Names that limo gives to something else.

    Raises:
        ConfigError: There is none of that name, or it is trained in another way.
        PlugInError: It is of another distribution and cannot be used.
    """
    if name in _OTHERWISE:
        raise ConfigError(f"estimator {name!r} is trained {_OTHERWISE[name]}")
    return estimator_called(name, own)
