"""How a session on the network is made."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any, Final

import zenoh

from limo_driver.errors import ConfigError

_TLS: Final = "transport/link/tls"
_PATHS: Final = (
    f"{_TLS}/root_ca_certificate",
    f"{_TLS}/listen_private_key",
    f"{_TLS}/listen_certificate",
    f"{_TLS}/connect_private_key",
    f"{_TLS}/connect_certificate",
    "transport/auth/usrpwd/dictionary_file",
)
_MESSAGE: Final = re.compile(  # as Zenoh's parser prints its errors, for programmers
    r'Message \{ msg: "((?:[^"\\]|\\.)*)", '
    r"location: (?:None|Some\(Location \{ line: (\d+), column: (\d+) \}\)) \}"
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


def require_passage(path: Path, key: str, flow: str, what: str) -> None:
    """Check that a configuration lets messages through, which nobody would miss otherwise.

    Args:
        path: The configuration.
        key: Key expression of the messages.
        flow: `ingress` for those that are heard, `egress` for those that are published.
        what: The argument that asks for it, for example `ros`, as messages name it.

    Raises:
        ConfigError: Its access control drops them.
    """
    access: dict[str, Any] = json.loads(read_config(path).get_json("access_control"))
    if not access["enabled"] or access["default_permission"] != "deny":
        return
    for rule in access["rules"] or ():
        flows, messages = rule["flows"] or (flow,), rule["messages"]
        allowed = rule["permission"] == "allow" and flow in flows and "put" in messages
        if allowed and any(zenoh.KeyExpr(own).includes(key) for own in rule["key_exprs"]):
            return
    raise ConfigError(
        f"its access control lets nothing of {key} {'in' if flow == 'ingress' else 'out'}, so that "
        f"{what} would reach nobody; add a rule for it, or leave {what} out",
        path=path,
    )


def explained(error: zenoh.ZError, *, located: bool = True) -> str:
    """Return what Zenoh says, in plain words and without the files of its own source.

    Args:
        error: That Zenoh raised.
        located: Say line and column, where it names them: they are of a file that a user wrote.
    """
    text = _SOURCE.sub("", str(error))
    found = _MESSAGE.search(text)
    if found is None:
        return text
    told, line, column = found.groups()
    place = f" (line {line}, column {column})" if located and line else ""
    return told.replace('\\"', '"') + place
