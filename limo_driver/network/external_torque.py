"""External torque as far as it is known, for controllers that act on it at the rate of the states.

```python
with open_session() as session, ExternalListener(session, "iiwa14") as external:
    if not abs(external.of(3)) < 2.0:  # also where it is NaN: nobody knows
        slow_down()
```

`torque/external` says measured less estimated, whatever that is worth. This says it only where it
is worth something, and with it how sure it is and how long memory has gone on.
"""

from __future__ import annotations

import math
import struct
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np

from limo_driver.errors import WireFormatError
from limo_driver.network.claims import Keys
from limo_driver.network.contact_state import PATIENCE, NewsListener

if TYPE_CHECKING:
    import zenoh

    from limo_driver.types import FloatArray

_VERSION: Final = 1
_HEAD: Final = struct.Struct("<BBH4xqd")  # version, flags, joints, stamp, since the gap
_PHYSICS_ONLY: Final = 1  # flag; others are of later versions, and change none of the rest


@dataclass(frozen=True)
class ExternalTorque:
    """What is known of external torque at one instant, in one message.

    A joint is known where the filter is full, torque is measured, motion is as it was learned and
    the error of the estimate is known.
    """

    stamp_ns: int  # of the estimate that it is about, Unix time [ns]
    torque: FloatArray  # (n,) [N m], measured less estimated; NaN where nobody knows
    std: FloatArray  # (n,) [N m], one standard deviation; NaN where nobody knows
    model: str  # version that estimates
    physics_only: bool  # for want of a learned model
    since_gap: float  # stream's time since memory last began anew [s]

    def encode(self) -> bytes:
        """Return the message, as docs/messages.md has it."""
        flags, n = _PHYSICS_ONLY * self.physics_only, self.torque.size
        values = np.array((self.torque, self.std), "<f8").tobytes()
        head = _HEAD.pack(_VERSION, flags, n, self.stamp_ns, self.since_gap)
        return head + values + self.model.encode()

    @classmethod
    def decode(cls, payload: bytes) -> ExternalTorque:
        """Read what was sent.

        Raises:
            WireFormatError: It is no external torque, or of a version that is not known here.
        """
        try:
            version, flags, joints, stamp_ns, gap = _HEAD.unpack_from(payload)
            torque, std = np.frombuffer(payload, "<f8", 2 * joints, _HEAD.size).reshape(2, joints)
            model = payload[_HEAD.size + 16 * joints :].decode()
        except (struct.error, ValueError):
            raise WireFormatError(f"no external torque in {len(payload)} bytes", 0) from None
        if version != _VERSION:
            raise WireFormatError(f"external torque of version {version}, expected {_VERSION}", 0)
        if not (joints and 0.0 <= gap < math.inf):
            raise WireFormatError(f"{joints} joints, {gap} s since the last gap", 2)
        return cls(stamp_ns, torque, std, model, bool(flags & _PHYSICS_ONLY), gap)


class ExternalListener(NewsListener[ExternalTorque]):
    """Hears how large the external torque of an arm is, as far as it is known.

    Args:
        session: Open Zenoh session.
        arm: Name of the arm in keys.
        patience: Time without news after which nothing is known [s].

    Raises:
        ConfigError: The name cannot be part of a key, or `patience` is not above 0 and finite.
    """

    def __init__(self, session: zenoh.Session, arm: str, patience: float = PATIENCE) -> None:
        super().__init__(session, Keys(arm).known, ExternalTorque.decode, patience)

    def of(self, joint: int) -> float:
        """Return the external torque of a joint [N m]; NaN where nobody knows.

        Args:
            joint: 1-based.
        """
        news = self.current
        torque = () if news is None else news.torque
        return float(torque[joint - 1]) if 0 < joint <= len(torque) else math.nan
