"""The folder that `limo secure` writes: an authority, and what each role needs to take part.

    authority/    certificate.pem, key.pem: stays where it was made
    driver/       zenoh.json5, authority.pem, certificate.pem, key.pem, users.txt
    service/      the same
    operator/     the same without users.txt, since nobody links to it
    viewer/       the same

A role's folder can be copied as it is; its paths are relative to it.
"""

from __future__ import annotations

import json
import os
import secrets
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final, TypeAlias

from limo_driver.errors import ConfigError
from limo_driver.network.trust.roles import ROLES, access_control
from limo_driver.runtime.outputs import reason, require_folder
from limo_driver.runtime.plugins import require_package

if TYPE_CHECKING:
    from collections.abc import Generator, Mapping
    from pathlib import Path

    from limo_driver.network.trust.roles import Host, Issued, Role

_Json: TypeAlias = dict[str, Any] | list[Any] | str | bool
CONFIGURATION: Final = "zenoh.json5"
_AUTHORITY: Final = "authority"
_USERS: Final = "users.txt"
_PASSWORD_BYTES: Final = 24
_PRIVATE: Final = 0o600
_PRIVATE_FOLDER: Final = 0o700
_MOST_DAYS: Final = 36500  # a certificate has no date beyond the year 9999


@dataclass(frozen=True)
class TrustFolder:
    """Files that were written."""

    path: Path
    configurations: dict[str, Path]  # by role


def write_trust(
    folder: Path, hosts: Mapping[str, Host], days: int = 365, *, force: bool = False
) -> TrustFolder:
    """Make an authority, a certificate and a password for each role, and their configurations.

    Args:
        folder: Where to write them.
        hosts: Where driver and service are reached.
        days: For which the certificates are valid.
        force: Write over what an earlier call wrote.

    Raises:
        MissingPackageError: The extra limo[secure] is not installed.
        ConfigError: Something is there already or cannot be written, or hosts or days cannot be
            used.
    """
    require_package("cryptography", "a certificate")
    from limo_driver.network.trust.roles import Authority

    reached = {name for role in ROLES.values() for name in role.links_to}
    if set(hosts) != reached:
        raise ConfigError(f"hosts of {', '.join(sorted(hosts))}, expected of {sorted(reached)}")
    if len(set(hosts.values())) < len(hosts):
        raise ConfigError(
            f"driver and service are both at {hosts['driver'].endpoint}; give one another port"
        )
    if not 1 <= days <= _MOST_DAYS:
        raise ConfigError(
            f"certificates would be valid for {days} days, expected 1 to {_MOST_DAYS}"
        )
    require_folder(folder, "certificates and configurations")
    authority = Authority.new(days)
    passwords = {name: secrets.token_urlsafe(_PASSWORD_BYTES) for name in ROLES}
    files = _pair(folder / _AUTHORITY, authority.issued)
    for role in ROLES.values():
        own = folder / role.name
        files |= _pair(own, authority.issue(role.name, hosts.get(role.name)))
        files[own / f"{_AUTHORITY}.pem"] = authority.issued.certificate
        files[own / CONFIGURATION] = _configuration(role, hosts, passwords[role.name]).encode()
        if users := [name for name, other in ROLES.items() if role.name in other.links_to]:
            files[own / _USERS] = "".join(f"{name}:{passwords[name]}\n" for name in users).encode()
    if not force and (there := [path for path in files if os.path.lexists(path)]):
        raise ConfigError(
            "is there already, and others trust it; give `force` to write it over", path=there[0]
        )
    with _opened(folder) as root:
        for path, content in files.items():
            _write_privately(root, path, content)
    return TrustFolder(folder, {name: folder / name / CONFIGURATION for name in ROLES})


def _pair(folder: Path, issued: Issued) -> dict[Path, bytes]:
    return {folder / "certificate.pem": issued.certificate, folder / "key.pem": issued.key}


@contextmanager
def _opened(folder: Path, within: int | None = None) -> Generator[int]:
    """Open a folder itself, not one that somebody's link in its place leads to.

    Raises:
        ConfigError: It is a link, or cannot be opened.
    """
    if folder.is_symlink():
        raise ConfigError("is a link, expected a folder: keys go where you say", path=folder)
    name = folder if within is None else folder.name
    try:
        handle = os.open(name, os.O_RDONLY | os.O_DIRECTORY | os.O_NOFOLLOW, dir_fd=within)
    except OSError as error:
        raise ConfigError(f"cannot be opened: {reason(error)}", path=folder) from None
    try:
        yield handle
    finally:
        os.close(handle)


def _write_privately(root: int, path: Path, content: bytes) -> None:
    """Write a file that only its owner can read, from its first byte on, and that is new.

    It takes the place of what has its name, also of a link, which nobody follows.

    Args:
        root: The folder that holds that of the file, opened.
        path: Of the file.
        content: Of it.

    Raises:
        ConfigError: It cannot be written.
    """
    draft = f".{path.name}.{secrets.token_hex(8)}"
    try:
        with suppress(FileExistsError):
            os.mkdir(path.parent.name, _PRIVATE_FOLDER, dir_fd=root)
        with _opened(path.parent, root) as folder:
            try:
                handle = os.open(
                    draft, os.O_WRONLY | os.O_CREAT | os.O_EXCL, _PRIVATE, dir_fd=folder
                )
                with open(handle, "wb") as file:
                    file.write(content)
                    file.flush()
                    os.fsync(handle)
                os.replace(draft, path.name, src_dir_fd=folder, dst_dir_fd=folder)
            finally:
                with suppress(FileNotFoundError):
                    os.unlink(draft, dir_fd=folder)
    except OSError as error:
        raise ConfigError(f"cannot be written: {reason(error)}", path=path) from None


def _configuration(role: Role, hosts: Mapping[str, Host], password: str) -> str:
    reached = role.name in hosts
    tls: dict[str, Any] = {
        "root_ca_certificate": f"{_AUTHORITY}.pem",
        "enable_mtls": True,
        "verify_name_on_connect": True,
    }
    for direction in ("listen", "connect") if reached else ("connect",):
        tls |= {f"{direction}_certificate": "certificate.pem"}
        tls |= {f"{direction}_private_key": "key.pem"}
    users = {"user": role.name, "password": password}
    if reached:
        users["dictionary_file"] = _USERS
    return _TEMPLATE.format(
        name=role.name,
        purpose=role.purpose,
        listen=_json([hosts[role.name].endpoint] if reached else []),
        connect=_json([hosts[name].endpoint for name in role.links_to]),
        tls=_json(tls, 6),
        users=_json(users, 6),
        access=_json(access_control(role), 2),
    )


def _json(value: _Json, indent: int = 0) -> str:
    """Return a value as JSON5, a short list on one line; `indent` is that of its first line."""
    inner = " " * (indent + 2)
    if isinstance(value, dict):
        items = [f"{name}: {_json(item, indent + 2)}" for name, item in value.items()]
        opening, closing = "{", "}"
    elif isinstance(value, list) and any(isinstance(item, dict) for item in value):
        items = [_json(item, indent + 2) for item in value]
        opening, closing = "[", "]"
    else:
        return json.dumps(value)
    lines = "".join(f"{inner}{item},\n" for item in items)
    return f"{opening}\n{lines}{' ' * indent}{closing}"


_TEMPLATE: Final = """\
// Zenoh configuration of the {name}, which {purpose}.
// It holds a password: keep it readable by its owner alone. Paths are relative to this file.
{{
  mode: "peer",

  // Exactly these links; a peer without a list would listen on any free port.
  listen: {{ endpoints: {{ peer: {listen} }} }},
  connect: {{ endpoints: {{ peer: {connect} }} }},

  // Nobody is sought, and nobody is told of others.
  scouting: {{ multicast: {{ enabled: false }}, gossip: {{ enabled: false }} }},
  adminspace: {{ enabled: false }},

  transport: {{
    link: {{
      // Nothing goes in the clear, whatever endpoint is given on the command line.
      protocols: ["tls"],
      // Both ends of a link show a certificate of the same authority.
      tls: {tls},
    }},
    auth: {{
      // Whoever opens a link gives a password besides; users.txt holds those that are accepted.
      usrpwd: {users},
    }},
  }},

  // Each session checks what comes in, by the common name of the certificate at the other end
  // and, where that end opened the link, by its user name. What is not listed is dropped.
  access_control: {access},
}}
"""
