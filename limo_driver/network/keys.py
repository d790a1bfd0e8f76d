"""Keys of an arm on the network."""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

from limo_driver.errors import ConfigError

if TYPE_CHECKING:
    from typing import Self

_ANY: Final = "*"
_NAME: Final = re.compile(r"[A-Za-z0-9_.-]+")


@dataclass(frozen=True)
class Keys:
    """Keys of one arm on the network.

    Raises:
        ConfigError: The name cannot be part of a key.
    """

    arm: str

    def __post_init__(self) -> None:
        if self.arm != _ANY and not _NAME.fullmatch(self.arm):
            raise ConfigError(
                f"the arm's name is {self.arm!r}, expected letters, digits, '_', '-' and '.'"
            )

    @classmethod
    def of_any(cls) -> Self:
        """Return key expressions that are those of every arm."""
        return cls(_ANY)

    @property
    def root(self) -> str:
        """Prefix of all keys."""
        return f"limo/{self.arm}"

    @property
    def joints(self) -> str:
        """Measured joint states."""
        return f"{self.root}/state/joints"

    @property
    def estimate(self) -> str:
        """Torque estimates."""
        return f"{self.root}/torque/estimate"

    @property
    def external(self) -> str:
        """External torques, measured less estimated: -Jᵀ F of what pushes the arm."""
        return f"{self.root}/torque/external"

    @property
    def event(self) -> str:
        """Contacts, drift, swaps of models, and what else happens."""
        return f"{self.root}/event"

    def status(self, part: str) -> str:
        """Condition of a part: of the `service`."""
        return f"{self.root}/status/{part}"

    def alive(self, part: str, identity: str = _ANY) -> str:
        """Liveliness token of a part, `driver` or `service`; of any one that is it by default."""
        return f"{self.root}/alive/{part}/{identity}"

    def seen(self, part: str = _ANY) -> str:
        """Queryable of the tokens of a part that are seen from where it is answered."""
        return f"{self.root}/seen/{part}"

    def model(self, verb: str) -> str:
        """Queryable of the service's models."""
        return f"{self.root}/model/{verb}"
