"""Joint states as ROS 2 publishes and hears them over rmw_zenoh, without a bridge.

| part | what ROS 2 nodes expect, from Jazzy on |
|---|---|
| key | `<domain>/<topic>/<type>/<hash of the type>` |
| payload | sensor_msgs/JointState in CDR, the same bytes as on native keys |
| attachment | sequence, Unix time and identity of the publisher, 33 bytes |
| liveliness token | `@ros2_lv/...`, from which `ros2 topic list` knows the publisher |

Source: ros2/rmw_zenoh, docs/design.md and the liveliness tokens of rmw_zenoh_cpp.
"""

from __future__ import annotations

import hashlib
import re
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final, NamedTuple

from limo_driver.errors import ConfigError, WireFormatError
from limo_driver.network.messages import (
    Attachment,
    JointStateCodec,
    JointStateMessage,
    RosAttachment,
)
from limo_driver.network.messages.joint_state import GID_SIZE
from limo_driver.network.streaming import declare_stream
from limo_driver.runtime.processes import Closing

if TYPE_CHECKING:
    from collections.abc import Sequence

    import zenoh

TYPE: Final = "sensor_msgs::msg::dds_::JointState_"
TYPE_HASH: Final = "RIHS01_a13ee3a330e346c9d87b5aa18d24e11690752bd33a0350f11c5882bc9179260e"
NODE: Final = "limo"  # that the publisher belongs to
_KEEP_LAST_10: Final = "::,10:,:,:,,"  # quality of service; what is empty is the default
_TOPIC: Final = re.compile(r"/?[A-Za-z_][A-Za-z0-9_]*(/[A-Za-z_][A-Za-z0-9_]*)*")
_DOMAINS: Final = range(233)


@dataclass(frozen=True)
class RosTopic:
    """A topic of joint states in a ROS 2 domain.

    Args:
        name: Of the topic; a leading slash changes nothing.
        domain: ROS_DOMAIN_ID.

    Raises:
        ConfigError: ROS 2 has no such topic or domain.

    Example:
        >>> topic = limo.RosTopic("left/joint_states", domain=3)
        >>> with limo.serve("left", model="model/", ros=topic) as service:
        ...     service.wait(60.0)
    """

    name: str = "joint_states"  # a leading slash changes nothing
    domain: int = 0  # ROS_DOMAIN_ID

    def __post_init__(self) -> None:
        if not _TOPIC.fullmatch(self.name):
            raise ConfigError(
                f"the ROS topic is {self.name!r}, expected letters, digits and '_' between slashes"
            )
        if self.domain not in _DOMAINS:
            raise ConfigError(f"the ROS domain is {self.domain}, expected 0 to {_DOMAINS[-1]}")

    @property
    def key(self) -> str:
        """Key on which its messages are published."""
        return f"{self._stem}/{TYPE_HASH}"

    @property
    def key_of_any_hash(self) -> str:
        """Key expression that its messages match; releases of ROS 2 differ in the type's hash."""
        return f"{self._stem}/*"

    def token(self, session_id: str) -> str:
        """Return the liveliness token of a publisher in a session that has no other.

        Args:
            session_id: Of the Zenoh session.
        """
        topic = "%" + self._path.replace("/", "%")
        return (
            f"@ros2_lv/{self.domain}/{session_id}/0/1/MP/%/%/{NODE}/{topic}/{TYPE}/{TYPE_HASH}/"
            f"{_KEEP_LAST_10}"
        )

    @property
    def _path(self) -> str:
        return self.name.removeprefix("/")

    @property
    def _stem(self) -> str:
        return f"{self.domain}/{self._path}/{TYPE}"


class RosPublisher(Closing):
    """Publishes encoded joint states where ROS 2 nodes hear them.

    Args:
        session: Open Zenoh session.
        topic: Topic and domain.
    """

    def __init__(self, session: zenoh.Session, topic: RosTopic) -> None:
        token = topic.token(str(session.zid()))
        self._gid = hashlib.sha256(token.encode()).digest()[:GID_SIZE]
        self._publisher = declare_stream(session, topic.key)
        self._token = session.liveliness().declare_token(token)

    def publish(self, payload: bytes, sequence: int, stamp_ns: int) -> None:
        """Send a message, measured at `stamp_ns` in Unix time; it never waits for anyone."""
        attachment = RosAttachment(sequence, stamp_ns, self._gid)
        self._publisher.put(payload, attachment=attachment.encode())

    def close(self) -> None:
        """Take the publisher off the ROS graph."""
        self._token.undeclare()
        self._publisher.undeclare()


class RosState(NamedTuple):
    """A joint state as a driver of the arm would have published it."""

    payload: bytes
    about: Attachment
    source: str  # the publisher's identity


class RosReader:
    """Converts joint states of a ROS 2 node to those of a limo driver of this arm.

    Args:
        joint_names: Of the arm, in its order.
        arm: Its name in keys.
    """

    def __init__(self, joint_names: Sequence[str], arm: str) -> None:
        self._codec = JointStateCodec(joint_names, frame_id=arm)

    def read(self, payload: bytes, attachment: bytes) -> RosState:
        """Return the joint state in the order of the arm, without joints that it does not have.

        Raises:
            WireFormatError: One of the two is malformed, or joints of the arm are missing, by name.
        """
        about = RosAttachment.decode(attachment)
        state = self._codec.decode(payload)
        if state.names != self._codec.names:
            payload = self._in_order(state, len(payload))
        return RosState(payload, Attachment(about.sequence, about.stamp_ns), about.gid.hex())

    def _in_order(self, state: JointStateMessage, end: int) -> bytes:
        place = {name: j for j, name in enumerate(state.names)}
        missing = [name for name in self._codec.names if name not in place]
        if missing or len(place) < len(state.names):
            fault = f"without {', '.join(missing)}" if missing else "with a joint named twice"
            raise WireFormatError(
                f"joint states of {', '.join(state.names) or 'no joint'}, {fault}", end
            )
        order = [place[name] for name in self._codec.names]
        arrays = (state.position, state.velocity, state.torque)
        return self._codec.encode(
            state.stamp_ns, *(values[order] if values.size else values for values in arrays)
        )
