"""Aliases of model versions: champion, challenger, former champions, and their history.

Ed25519 signatures of versions; needs the extra limo[secure].

A signature is over the bytes of version.json, which holds the SHA-256 of every other file. Keys are
PEM files, as `openssl genpkey -algorithm ed25519` and `openssl pkey -pubout` write them.
"""

from __future__ import annotations

import fcntl
import json
import os
from contextlib import contextmanager
from dataclasses import asdict, dataclass, fields, replace
from datetime import UTC, datetime
from shutil import rmtree
from typing import TYPE_CHECKING, Any, Final, cast
from uuid import uuid4

from limo_driver.errors import MissingPackageError, ModelStoreError
from limo_driver.runtime.declarations import read_json
from limo_driver.runtime.given_files import read_bytes, read_json_file
from limo_driver.runtime.outputs import replacing, sync
from limo_driver.runtime.plugins import require_package

if TYPE_CHECKING:
    from collections.abc import Callable, Generator, Iterable
    from pathlib import Path
    from types import ModuleType

    from cryptography.hazmat.primitives.asymmetric.ed25519 import (
        Ed25519PrivateKey,
        Ed25519PublicKey,
    )

ALIASES: Final = "aliases.json"
NAMES: Final = ("champion", "challenger")
_SCHEMA: Final = 1
_LOCK: Final = ".lock"
_DRAFT: Final = ".adding-"


@dataclass(frozen=True)
class Change:
    """An alias that was given to a version."""

    time: str  # UTC, ISO 8601
    action: str  # promote, rollback, challenge
    alias: str
    before: int | None  # version that had the alias
    after: int | None
    reason: str


@dataclass(frozen=True)
class Aliases:
    """The versions that have a name, and every change of them, oldest first."""

    champion: int | None = None
    challenger: int | None = None
    previous: tuple[int, ...] = ()  # champions to roll back to, the last one first in line
    history: tuple[Change, ...] = ()

    def promote(self, number: int, reason: str) -> Aliases:
        """Make a version the champion.

        Raises:
            ModelStoreError: It is already.
        """
        if number == self.champion:
            raise ModelStoreError(f"version {number} is the champion already")
        before = () if self.champion is None else (self.champion,)
        return replace(
            self,
            champion=number,
            challenger=None if self.challenger == number else self.challenger,
            previous=self.previous + before,
            history=self._with("promote", "champion", number, reason),
        )

    def rollback(self, reason: str) -> Aliases:
        """Make the champion before the champion again.

        Raises:
            ModelStoreError: There is none.
        """
        if not self.previous:
            raise ModelStoreError("there is no champion before this one to roll back to")
        *previous, number = self.previous
        return replace(
            self,
            champion=number,
            previous=tuple(previous),
            history=self._with("rollback", "champion", number, reason),
        )

    def challenge(self, number: int | None, reason: str) -> Aliases:
        """Make a version the challenger; None: there is none any more.

        Raises:
            ModelStoreError: It is the champion.
        """
        if number is not None and number == self.champion:
            raise ModelStoreError(f"version {number} is the champion, it cannot challenge itself")
        return replace(
            self,
            challenger=number,
            history=self._with("challenge", "challenger", number, reason),
        )

    def check_champion(self, number: int | None) -> None:
        """Check that a version is the champion still; None: any may be.

        Raises:
            ModelStoreError: Somebody else made another one the champion.
        """
        if number is not None and number != self.champion:
            raise ModelStoreError(f"{self.champion} is the champion by now, not {number}")

    def of(self, number: int) -> tuple[str, ...]:
        """Return the aliases of a version."""
        return tuple(name for name in NAMES if getattr(self, name) == number)

    def as_json(self) -> bytes:
        """Return the content of the file."""
        return (json.dumps({"schema": _SCHEMA, **asdict(self)}, indent=1) + "\n").encode()

    def _with(self, action: str, alias: str, number: int | None, reason: str) -> tuple[Change, ...]:
        now = datetime.now(UTC).isoformat(timespec="milliseconds")
        change = Change(now, action, alias, getattr(self, alias), number, reason)
        return (*self.history, change)


def read_aliases(folder: Path) -> Aliases:
    """Read the aliases of a robot's versions; none, if the file is not there yet.

    Raises:
        ModelStoreError: The file cannot be understood.
    """
    path = folder / ALIASES
    if not path.exists():
        return Aliases()
    given = read_json(path, ModelStoreError, _SCHEMA)
    try:
        return parsed_aliases(given.content)
    except (KeyError, TypeError, ValueError) as error:
        given.fail(f"cannot be understood: {error!r}")


def parsed_aliases(content: dict[str, Any]) -> Aliases:
    """Return aliases from JSON values.

    Raises:
        KeyError, TypeError, ValueError: They are no aliases.
    """
    names = tuple(field.name for field in fields(Change))
    return Aliases(
        champion=_number(content["champion"]),
        challenger=_number(content["challenger"]),
        previous=tuple(int(number) for number in content["previous"]),
        history=tuple(
            Change(**{name: entry[name] for name in names}) for entry in content["history"]
        ),
    )


def _number(value: object) -> int | None:
    if value is not None and not isinstance(value, int):
        raise TypeError(f"{value!r} is no version")
    return value


@contextmanager
def locked(folder: Path) -> Generator[None]:
    """Be the only writer of a folder; the lock goes with the process that holds it."""
    with (folder / _LOCK).open("w") as file:
        fcntl.flock(file, fcntl.LOCK_EX)
        yield


@contextmanager
def draft(folder: Path) -> Generator[Path]:
    """Make a hidden folder in `folder` to write in, which is gone afterwards unless renamed.

    What writers left that were killed is removed first: each holds a lock on its own draft, so that
    one that nobody holds is of no one.
    """
    with locked(folder):
        _remove_abandoned(folder)
        path = folder / f"{_DRAFT}{uuid4().hex}"
        path.mkdir()
        handle = os.open(path, os.O_RDONLY)
        fcntl.flock(handle, fcntl.LOCK_EX)
    try:
        yield path
    finally:
        rmtree(path, ignore_errors=True)
        os.close(handle)


def write(path: Path, data: bytes) -> None:
    """Write a file through to the disk."""
    with path.open("wb") as file:
        file.write(data)
        file.flush()
        os.fsync(file.fileno())


def replace_file(path: Path, data: bytes) -> None:
    """Write a file so that readers see the old one or the new one; needs the folder's lock."""
    with replacing(path) as beside:
        beside.write_bytes(data)
    sync(path.parent)


def _remove_abandoned(folder: Path) -> None:
    for path in folder.glob(f"{_DRAFT}*"):
        handle = os.open(path, os.O_RDONLY)
        try:
            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
            rmtree(path)
        except BlockingIOError:
            pass  # its writer lives
        finally:
            os.close(handle)


SIGNATURE: Final = "signature.json"
_ALGORITHM: Final = "ed25519"


def sign(record: Path, key: Path) -> None:
    """Write the signature of a version beside it.

    Args:
        record: The version.json.
        key: Private key, PEM, not encrypted.

    Raises:
        ModelStoreError: The key cannot be used, or the extra is not installed.
    """
    signer = _private_key(key)
    content = {"algorithm": _ALGORITHM, "signature": signer.sign(record.read_bytes()).hex()}
    replace_file(record.with_name(SIGNATURE), (json.dumps(content) + "\n").encode())


def check_signing(key: Path, trusted_keys: Iterable[Path] = ()) -> None:
    """Check, before anything is to be signed, that a private key can be used and will be trusted.

    Raises:
        ModelStoreError: It cannot be used, or is of none of the trusted keys.
    """
    _library()
    from cryptography.exceptions import InvalidSignature

    trusted, probe = tuple(trusted_keys), b"limo"
    signature = _private_key(key).sign(probe)
    for public in trusted:
        try:
            _public_key(public).verify(signature, probe)
        except InvalidSignature:
            continue
        return
    if trusted:
        raise ModelStoreError(f"{key}: what it signs is trusted by none of the trusted keys")


def check_signature(record: bytes, folder: Path, trusted_keys: Iterable[Path]) -> None:
    """Check that one of the trusted keys signed a version.

    Args:
        record: Bytes of the version.json.
        folder: Of the version.
        trusted_keys: Public keys, PEM.

    Raises:
        ModelStoreError: It is not signed, or by none of them, or a key cannot be used.
    """
    _library()
    from cryptography.exceptions import InvalidSignature

    path = folder / SIGNATURE
    signature = _signature(path)
    for key in trusted_keys:
        try:
            _public_key(key).verify(signature, record)
        except InvalidSignature:
            continue
        return
    raise ModelStoreError(f"{path}: is of none of the trusted keys, or version.json was changed")


def _signature(path: Path) -> bytes:
    if not path.exists():
        raise ModelStoreError(f"{path}: the version is not signed, expected a signature")
    content = read_json_file(path, ModelStoreError)
    try:
        if content["algorithm"] != _ALGORITHM:
            raise ModelStoreError(
                f"{path}: is of {content['algorithm']!r}, expected {_ALGORITHM!r}"
            )
        return bytes.fromhex(content["signature"])
    except (KeyError, TypeError, ValueError) as error:
        raise ModelStoreError(f"{path}: cannot be understood: {error!r}") from None


def _private_key(path: Path) -> Ed25519PrivateKey:
    keys, ed25519 = _library()
    key = _key(path, lambda data: keys.load_pem_private_key(data, password=None))
    if not isinstance(key, ed25519.Ed25519PrivateKey):
        raise ModelStoreError(f"{path}: expected a private Ed25519 key")
    return cast("Ed25519PrivateKey", key)


def _public_key(path: Path) -> Ed25519PublicKey:
    keys, ed25519 = _library()
    key = _key(path, keys.load_pem_public_key)
    if not isinstance(key, ed25519.Ed25519PublicKey):
        raise ModelStoreError(f"{path}: expected a public Ed25519 key")
    return cast("Ed25519PublicKey", key)


def _key(path: Path, parse: Callable[[bytes], object]) -> object:
    from cryptography.exceptions import UnsupportedAlgorithm

    data = read_bytes(path, ModelStoreError)
    try:
        return parse(data)
    except (ValueError, TypeError, UnsupportedAlgorithm):
        raise ModelStoreError(f"{path}: no PEM file of such a key without a password") from None


def _library() -> tuple[ModuleType, ModuleType]:
    """Import what an optional extra installs.

    Raises:
        ModelStoreError: It is not installed.
    """
    try:
        require_package("cryptography", "a signature")
    except MissingPackageError as error:
        raise ModelStoreError(str(error)) from None
    from cryptography.hazmat.primitives import serialization
    from cryptography.hazmat.primitives.asymmetric import ed25519

    return serialization, ed25519
