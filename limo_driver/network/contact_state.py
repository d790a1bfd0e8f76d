"""Something leans on a joint, nothing does, or nobody knows: for controllers that act on it.

```python
with open_session() as session, ContactListener(session, "iiwa14") as contacts:
    if contacts.of(3) is not Touch.FREE:
        slow_down()
```

A service says it ten times a second and whenever it changes. A listener that hears nothing knows
nothing: after a service was killed, a router died or a cable was pulled, every joint is unknown.
"""

from __future__ import annotations

import json
import math
import time
from dataclasses import asdict, dataclass
from enum import StrEnum
from typing import TYPE_CHECKING, Any, Final, Generic, TypeVar

from limo_driver.errors import ConfigError, WireFormatError
from limo_driver.network.claims import Keys
from limo_driver.network.streaming import to_json
from limo_driver.runtime.processes import Closing

if TYPE_CHECKING:
    from collections.abc import Callable

    import zenoh

PATIENCE: Final = 0.3  # [s] without news after which nothing is known
_LONGEST: Final = 65536  # bytes of a contact state
_T = TypeVar("_T")


class Touch(StrEnum):
    """Whether something leans on a joint."""

    FREE = "free"  # nothing does that the threshold would notice
    CONTACT = "contact"
    UNKNOWN = "unknown"  # no torque, no error of the estimate, or one as large as the threshold


@dataclass(frozen=True)
class ContactState:
    """What is known of contacts at one instant; one entry a joint."""

    stamp_ns: int  # of the estimate that it is about, Unix time [ns]
    joints: tuple[Touch, ...]
    since_ns: tuple[int, ...]  # stamps from which each joint has been so
    model: str  # version that estimates
    physics_only: bool  # for want of a learned model
    since_gap: float  # stream's time since memory last began anew [s]

    def encode(self) -> bytes:
        """Return it as it is sent, JSON."""
        return to_json(asdict(self))

    @classmethod
    def decode(cls, payload: bytes) -> ContactState:
        """Read what was sent.

        Raises:
            WireFormatError: It is no contact state.
        """
        try:
            if len(payload) > _LONGEST:
                raise ValueError
            given: dict[str, Any] = json.loads(payload)
            joints = tuple(Touch(name) for name in given["joints"])
            since = tuple(int(stamp) for stamp in given["since_ns"])
            gap = float(given["since_gap"])
            if len(since) != len(joints) or not math.isfinite(gap):
                raise ValueError
            return cls(
                int(given["stamp_ns"]), joints, since, str(given["model"]),
                bool(given["physics_only"]), gap,
            )  # fmt: skip
        except (ValueError, TypeError, KeyError, OverflowError, RecursionError):
            raise WireFormatError("no contact state", 0) from None


class NewsListener(Closing, Generic[_T]):
    """Hears the newest of what a service says, and forgets it where nothing follows.

    Args:
        session: Open Zenoh session.
        key: Of the news.
        decode: Reads them.
        patience: Time without news after which nothing is known [s].

    Raises:
        ConfigError: `patience` is not above 0 and finite.
    """

    def __init__(
        self, session: zenoh.Session, key: str, decode: Callable[[bytes], _T], patience: float
    ) -> None:
        if not 0.0 < patience < math.inf:
            raise ConfigError(f"`patience` is {patience:g} s, expected above 0 and finite")
        self._decode, self._patience = decode, patience
        self._heard: tuple[float, _T] | None = None  # when [s], and what
        self.malformed = 0
        self._subscriber = session.declare_subscriber(key, self._take)

    @property
    def latest(self) -> _T | None:
        """What was heard last, however long ago; None before anything was."""
        return None if self._heard is None else self._heard[1]

    @property
    def current(self) -> _T | None:
        """What was heard last; None before any news, and where they stay away."""
        heard = self._heard
        late = heard is not None and time.monotonic() - heard[0] > self._patience
        return None if heard is None or late else heard[1]

    def close(self) -> None:
        """Hear no more."""
        self._subscriber.undeclare()

    def _take(self, sample: zenoh.Sample) -> None:
        try:
            news = self._decode(sample.payload.to_bytes())
        except WireFormatError:
            self.malformed += 1
            return
        self._heard = time.monotonic(), news


class ContactListener(NewsListener[ContactState]):
    """Hears what the service of an arm says of contacts.

    Args:
        session: Open Zenoh session.
        arm: Name of the arm in keys.
        patience: Time without news after which nothing is known [s].

    Raises:
        ConfigError: The name cannot be part of a key, or `patience` is not above 0 and finite.
    """

    def __init__(self, session: zenoh.Session, arm: str, patience: float = PATIENCE) -> None:
        super().__init__(session, Keys(arm).contact, ContactState.decode, patience)

    def of(self, joint: int) -> Touch:
        """Say whether something leans on a joint now; before any news, and without, it is unknown.

        Args:
            joint: 1-based.
        """
        news = self.current
        joints = () if news is None else news.joints
        return joints[joint - 1] if 0 < joint <= len(joints) else Touch.UNKNOWN
