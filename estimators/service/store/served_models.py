"""Models that can serve an arm, and those of a running service.

The physics alone, and the models of a store or of one folder, are what serves; over the network a
running service shows the versions of its store.
"""

from __future__ import annotations

import threading
from collections import deque
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, TypeAlias

from estimators.model_folder import load_model
from estimators.service.store.aliases import NAMES, Aliases, parsed_aliases
from estimators.service.store.version import RECORD, Version, check_record
from estimators.service.store.vetting import Demand, vet
from limo_driver.errors import ModelStoreError

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence
    from typing import Self

    from estimators.residual_model import ResidualModel
    from estimators.service.store.store import ModelStore
    from limo_driver.network.readiness import ModelClient
    from limo_driver.physics import Simulation


READY: Final = 4  # versions that are kept as they were loaded, should one be needed again


@dataclass(frozen=True)
class OneFolder:
    """A model folder without a store, called by its name."""

    version: str
    model: ResidualModel[Any]

    @classmethod
    def open(cls, folder: Path) -> Self:
        """Load a folder.

        Raises:
            ModelStoreError: It is incomplete or does not fit together, by name.
        """
        return cls(folder.resolve().name, load_model(folder))

    @property
    def physics(self) -> Simulation:
        """The simulation whose residual the model learned."""
        return self.model.simulation

    @property
    def candidates(self) -> Sequence[str]:
        """The folder's name."""
        return (self.version,)

    def number(self, which: str) -> str:
        """Return the name as it is: there are no aliases."""
        return which

    def load(self, version: str) -> ResidualModel[Any]:
        """Return the model.

        Raises:
            ModelStoreError: Another version is asked for.
        """
        if version != self.version:
            raise ModelStoreError(f"there is no version {version!r}; there is {self.version!r}")
        return self.model

    def vet(self, version: str, demand: Demand) -> None:  # noqa: ARG002  # it was loaded
        """Raise if another version is asked for."""
        self.load(version)

    def promote(self, version: str, reason: str, instead_of: str | None) -> None:  # noqa: ARG002
        """Raise: there is no store that could note it."""
        raise ModelStoreError(f"version {version} cannot be promoted: the service has no `store`")

    def rollback(self, reason: str, instead_of: str | None) -> None:  # noqa: ARG002
        """Raise: there is no store that could note it."""
        raise ModelStoreError("cannot roll back: the service has no `store`")

    def index(self) -> dict[str, Any]:
        """Return the only version."""
        return {"versions": [{"version": self.version}], "champion": self.version}

    def close(self) -> None:
        """Nothing is under way."""


@dataclass(frozen=True)
class StoreModels:
    """The versions of a store.

    Args:
        store: Of the arm's robot.
        simulation: Serves where no model does; that of a version if not given.
    """

    store: ModelStore
    simulation: Simulation | None = None
    _loaded: deque[tuple[Version, ResidualModel[Any]]] = field(
        default_factory=lambda: deque(maxlen=READY), init=False, repr=False
    )
    _fit: deque[tuple[Version, Demand]] = field(
        default_factory=lambda: deque(maxlen=READY), init=False, repr=False
    )  # that were vetted
    _stopped: threading.Event = field(default_factory=threading.Event, init=False, repr=False)

    @property
    def physics(self) -> Simulation:
        """The given simulation, or that of the first candidate that can be read.

        Raises:
            ModelStoreError: Nothing was given, and no version can be read.
        """
        return self._first.simulation if self.simulation is None else self.simulation

    @cached_property
    def _first(self) -> ResidualModel[Any]:
        """The first candidate that can be read."""
        reasons: list[str] = []
        for version in (*self.candidates, *map(str, reversed(self.store.numbers()))):
            try:
                return self.load(version)
            except ModelStoreError as error:
                reasons.append(str(error))
        raise ModelStoreError(
            f"{self.store.root}: no version gives the physics of the arm; give `simulation`"
            + (f" ({reasons[0]})" if reasons else "")
        )

    @property
    def candidates(self) -> Sequence[str]:
        """The champion, and the champions before it, the last one first."""
        aliases = self.store.aliases
        if aliases.champion is None:
            return ()
        return tuple(map(str, (aliases.champion, *reversed(aliases.previous))))

    def number(self, which: str) -> str:
        """Return the number of a version by number or alias.

        Raises:
            ModelStoreError: There is no such version.
        """
        return str(self.store.number(which))

    def load(self, version: str) -> ResidualModel[Any]:
        """Check the files of a version and read it; one of the latest few is not read again.

        Raises:
            ModelStoreError: There is no such version, or a file differs from what was added.
        """
        found = self.store.open(version)
        for known, model in tuple(self._loaded):  # others may load meanwhile
            if known == found:
                return model
        model = found.load()
        self._loaded.append((found, model))
        return model

    def vet(self, version: str, demand: Demand) -> None:
        """Check a version in a process of its own, unless it was found fit for the same before.

        Raises:
            ModelStoreError: It must not serve, and why.
        """
        known = self.store.open(version), demand
        if known in tuple(self._fit):
            return
        found = vet(self.store, version, demand, stopped=self._stopped)
        if not found.ok:
            raise ModelStoreError(f"version {version} is refused, {found.refused}: {found.reason}")
        self._fit.append(known)

    def promote(self, version: str, reason: str, instead_of: str | None) -> None:
        """Make a version the champion."""
        self.store.promote(version, reason, _numbered(instead_of))

    def rollback(self, reason: str, instead_of: str | None) -> None:
        """Make the champion before the champion again."""
        self.store.rollback(reason, _numbered(instead_of))

    def index(self) -> dict[str, Any]:
        """Return versions and aliases, and why versions are left out."""
        aliases, left_out = self.store.aliases, list[str]()
        return {
            "versions": [dict(x.record) for x in self.store.versions(left_out.append)],
            "left_out": left_out,
            "champion": aliases.champion,
            "challenger": aliases.challenger,
            "previous": list(aliases.previous),
            "history": [vars(change) for change in aliases.history],
        }

    def close(self) -> None:
        """End a vetting that is under way."""
        self._stopped.set()


# Versions are called by their numbers or names; the champion comes first among candidates.
ServedModels: TypeAlias = OneFolder | StoreModels


def _numbered(version: str | None) -> int | None:
    return None if version is None else int(version)


class RemoteStore:
    """`ModelStore` of a running service: its versions, asked over the network.

    Every call asks anew, since the service and others change it meanwhile.

    Args:
        client: Of the service.
    """

    def __init__(self, client: ModelClient) -> None:
        self._client = client

    @property
    def robot(self) -> str:
        """Whose versions these are."""
        return self.versions()[0].robot

    @property
    def serving(self) -> str | None:
        """The version that answers, `physics` where no model does; None before the first states."""
        return self._client.index()["serving"]

    @property
    def aliases(self) -> Aliases:
        """Champion, challenger, and how that came about.

        Raises:
            ModelStoreError: The service has no store, or its answer cannot be understood.
        """
        try:
            return parsed_aliases(self._index())
        except (KeyError, TypeError, ValueError) as error:
            raise ModelStoreError(
                f"the service's aliases cannot be understood: {error!r}"
            ) from None

    def versions(self, tell: Callable[[str], None] | None = None) -> tuple[Version, ...]:
        """Return all versions that the service can read, in order.

        Args:
            tell: Told why, of each that it cannot read.

        Raises:
            ModelStoreError: The service has no store, or no version in it.
        """
        index = self._index()
        records = index["versions"]
        if tell is not None:
            for reason in index.get("left_out", ()):
                tell(str(reason))
        if not records:
            raise ModelStoreError("the service's store holds no versions; add one first")
        for record in records:
            check_record(Path(str(record.get("version")), RECORD), record)
        return tuple(Version(Path(str(record["version"])), record) for record in records)

    def open(self, which: int | str) -> Version:
        """Return the record of a version.

        Args:
            which: Its number, `champion` or `challenger`.

        Raises:
            ModelStoreError: There is no such version.
        """
        number = getattr(self.aliases, str(which)) if which in NAMES else which
        versions = self.versions()
        for version in versions:
            if str(version.number) == str(number):
                return version
        known = ", ".join([*(str(version.number) for version in versions), *NAMES])
        raise ModelStoreError(f"the service has no version {which!r}; known: {known}")

    def promote(self, which: int | str, reason: str) -> Aliases:
        """Let a version serve, and make it the champion.

        Raises:
            ModelStoreError: The service refuses it, and why; the old one serves on.
        """
        self._client.promote(str(which), reason)
        return self.aliases

    def rollback(self, reason: str) -> Aliases:
        """Let the champion before serve again, and make it the champion.

        Raises:
            ModelStoreError: There is none, or the service refuses it; the old one serves on.
        """
        self._client.rollback(reason)
        return self.aliases

    def _index(self) -> dict[str, Any]:
        index = self._client.index()
        if "history" not in index:
            raise ModelStoreError(
                f"the service of arm {index['arm']} serves one model folder, "
                f"{index['champion']}; start it with a `store` to have versions"
            )
        return index
