"""The store of a running service, as far as it can be seen and changed over the network."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

from estimators.service.store.aliases import NAMES, Aliases, parsed_aliases
from estimators.service.store.version import RECORD, Version, check_record
from limo_driver.errors import ModelStoreError

if TYPE_CHECKING:
    from collections.abc import Callable

    from limo_driver.network.model_client import ModelClient


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
