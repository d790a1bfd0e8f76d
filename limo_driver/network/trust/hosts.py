"""Network address of a role."""

from __future__ import annotations

import ipaddress
import re
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

from limo_driver.errors import ConfigError

if TYPE_CHECKING:
    from typing import Self

_HOST: Final = re.compile(r"(?P<name>[A-Za-z0-9.-]+|\[[0-9A-Fa-f:]+\])(:(?P<port>[0-9]{1,5}))?")
_PORTS: Final = range(1, 65536)


@dataclass(frozen=True)
class Host:
    """A host name or address, and a port."""

    name: str
    port: int

    @classmethod
    def parse(cls, text: str, port: int) -> Self:
        """Return `HOST` or `HOST:PORT`, an IPv6 address in brackets.

        Args:
            text: As written.
            port: Where none is written.

        Raises:
            ConfigError: It is neither.
        """
        match = _HOST.fullmatch(text)
        if match is None or int(match["port"] or port) not in _PORTS:
            raise ConfigError(f"the host is {text!r}, expected HOST or HOST:PORT")
        return cls(match["name"].strip("[]"), int(match["port"] or port))

    @property
    def address(self) -> ipaddress.IPv4Address | ipaddress.IPv6Address | None:
        """The name as an IP address, if it is one."""
        try:
            return ipaddress.ip_address(self.name)
        except ValueError:
            return None

    @property
    def endpoint(self) -> str:
        """Zenoh's endpoint."""
        name = f"[{self.name}]" if ":" in self.name else self.name
        return f"tls/{name}:{self.port}"
