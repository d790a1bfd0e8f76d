"""Zenoh's own configuration files, with paths that are relative to the file."""

from __future__ import annotations

import json
import re
from typing import TYPE_CHECKING, Final

import zenoh

from limo_driver.errors import ConfigError

if TYPE_CHECKING:
    from pathlib import Path

_TLS: Final = "transport/link/tls"
_PATHS: Final = (
    f"{_TLS}/root_ca_certificate",
    f"{_TLS}/listen_private_key",
    f"{_TLS}/listen_certificate",
    f"{_TLS}/connect_private_key",
    f"{_TLS}/connect_certificate",
    "transport/auth/usrpwd/dictionary_file",
)
_SOURCE: Final = re.compile(r" at /\S+\.rs:\d+\.?")  # where Zenoh was built


def read_config(path: Path) -> zenoh.Config:
    """Read a configuration (JSON5).

    Zenoh takes relative paths of certificates from where a program was started; here they are
    taken from where the configuration lies, so that the two can be moved together.

    Raises:
        ConfigError: It is no Zenoh configuration, or a file that it names is not there.
    """
    try:
        config = zenoh.Config.from_file(str(path))
        for key in _PATHS:
            named: object = json.loads(config.get_json(key))
            if isinstance(named, str):
                file = path.resolve().parent / named
                if not file.is_file():
                    raise ConfigError(f"{key} is {named}, which is no file", path=path)
                config.insert_json5(key, json.dumps(str(file)))
    except zenoh.ZError as error:
        raise ConfigError(f"is no Zenoh configuration: {explained(error)}", path=path) from None
    return config


def explained(error: zenoh.ZError) -> str:
    """Return what Zenoh says, without the files of its own source."""
    return _SOURCE.sub("", str(error))
