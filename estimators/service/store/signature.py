"""Ed25519 signatures of versions; needs the extra limo[secure].

A signature is over the bytes of version.json, which holds the SHA-256 of every other file. Keys are
PEM files, as `openssl genpkey -algorithm ed25519` and `openssl pkey -pubout` write them.
"""

from __future__ import annotations

import json
from typing import TYPE_CHECKING, Final, cast

from estimators.service.store.aliases import replace_file as replace
from limo_driver.errors import MissingPackageError, ModelStoreError
from limo_driver.runtime.given_files import read_bytes, read_json_file
from limo_driver.runtime.plugins import require_package

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable
    from pathlib import Path
    from types import ModuleType

    from cryptography.hazmat.primitives.asymmetric.ed25519 import (
        Ed25519PrivateKey,
        Ed25519PublicKey,
    )

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
    replace(record.with_name(SIGNATURE), (json.dumps(content) + "\n").encode())


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
