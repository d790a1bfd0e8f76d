"""Topics as ROS 2 publishes and hears them over rmw_zenoh, without a ROS installation.

| part | what ROS 2 nodes expect, from Jazzy on |
|---|---|
| key | `<domain>/<topic>/<type>/<hash of the type>` |
| payload | the message in CDR, of joint states the same bytes as on native keys |
| attachment | sequence, Unix time and identity of the publisher, 33 bytes |
| liveliness tokens | `@ros2_lv/...` of node (NN), publishers (MP) and subscribers (MS) |
| transient local | an advanced publisher of Zenoh with a cache, whose tokens tell of it |

Source: ros2/rmw_zenoh, docs/design.md, liveliness_utils.cpp and rmw_publisher_data.cpp.
"""

from __future__ import annotations

import hashlib
import re
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Final, NamedTuple

import zenoh
import zenoh.ext

from limo_driver.errors import ConfigError, WireFormatError
from limo_driver.network.messages import (
    JOINT_STATE,
    LOG,
    MATRIX,
    WRENCH,
    Attachment,
    JointStateCodec,
    RosAttachment,
)
from limo_driver.network.messages.joint_state import GID_SIZE
from limo_driver.network.streaming import declare_history
from limo_driver.quoting import in_line
from limo_driver.runtime.processes import Closing

# As `rosidl` computes them of the definitions, the same from Jazzy to Kilted.
HASHES: Final = {
    JOINT_STATE: "RIHS01_a13ee3a330e346c9d87b5aa18d24e11690752bd33a0350f11c5882bc9179260e",
    WRENCH: "RIHS01_8dc3deaf06b2ab281f9f9a742a8961c328ca7cec16e3fd6586d3a5c83fa78f77",
    MATRIX: "RIHS01_1025ddc6b9552d191f89ef1a8d2f60f3d373e28b283d8891ddcc974e8c55397f",
    LOG: "RIHS01_e28ce254ca8abc06abf92773b74602cdbf116ed34fbaf294fb9f81da9f318eac",
}
NODE: Final = "limo"  # that the publishers belong to
# Quality of service, what is empty is the default: reliability, durability, history, depth, ...
_STREAM: Final = "::,10:,:,:,,"  # reliable, volatile, the last 10
_HISTORY: Final = ":1:,{}:,:,:,,"  # reliable, transient local
_TOKEN_PARTS: Final = 13  # of a publisher or subscriber
_TOPIC: Final = re.compile(r"/?[A-Za-z_][A-Za-z0-9_]*(/[A-Za-z_][A-Za-z0-9_]*)*")
_DOMAINS: Final = range(233)


@dataclass(frozen=True)
class RosTopic:
    """A topic in a ROS 2 domain, of joint states unless it says otherwise.

    Args:
        name: Of the topic; a leading slash changes nothing.
        domain: ROS_DOMAIN_ID.
        type: Of its messages, for example `geometry_msgs/msg/WrenchStamped`.
        kept: Messages that those who come late are given; none if 0.

    Raises:
        ConfigError: ROS 2 has no such topic or domain.

    Example:
        >>> topic = limo.RosTopic("left/joint_states", domain=3)
        >>> with limo.serve("left", model="model/", ros=topic) as service:
        ...     service.wait(60.0)
    """

    name: str = "joint_states"  # a leading slash changes nothing
    domain: int = 0  # ROS_DOMAIN_ID
    type: str = JOINT_STATE
    kept: int = 0

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
        return f"{self._stem}/{HASHES[self.type]}"

    @property
    def key_of_any_hash(self) -> str:
        """Key expression that its messages match; releases of ROS 2 differ in the type's hash."""
        return f"{self._stem}/*"

    def token(self, session_id: str, entity: int = 1) -> str:
        """Return the liveliness token of a publisher.

        Args:
            session_id: Of the Zenoh session.
            entity: Number of the publisher in the session.
        """
        quality = _HISTORY.format(self.kept) if self.kept else _STREAM
        return (
            f"@ros2_lv/{self.domain}/{session_id}/0/{entity}/MP/%/%/{NODE}/{self.mangled}/"
            f"{self._dds}/{HASHES[self.type]}/{quality}"
        )

    @property
    def mangled(self) -> str:
        """Its absolute name as tokens have it."""
        return "%" + self._path.replace("/", "%")

    @property
    def _path(self) -> str:
        return self.name.removeprefix("/")

    @property
    def _dds(self) -> str:
        package, _, name = self.type.split("/")
        return f"{package}::msg::dds_::{name}_"

    @property
    def _stem(self) -> str:
        return f"{self.domain}/{self._path}/{self._dds}"


class RosPublisher(Closing):
    """Publishes encoded messages on one topic where ROS 2 nodes hear them.

    Args:
        session: Open Zenoh session.
        topic: Topic and domain.
        entity: Number of the publisher in the session, from 1 on.
    """

    def __init__(self, session: zenoh.Session, topic: RosTopic, entity: int = 1) -> None:
        token = topic.token(str(session.zid()), entity)
        self._gid = hashlib.sha256(token.encode()).digest()[:GID_SIZE]
        self._token = session.liveliness().declare_token(token)
        self.wanted = True  # whether anyone listens; who comes late to a history may
        self._publisher: zenoh.Publisher | zenoh.ext.AdvancedPublisher
        if topic.kept:
            self._publisher = declare_history(session, topic.key, topic.kept)
            return
        # As rmw_zenoh does: dropped only where its queue is full, in which messages wait together.
        stream = session.declare_publisher(
            topic.key,
            encoding=zenoh.Encoding.APPLICATION_CDR,
            congestion_control=zenoh.CongestionControl.DROP,
        )
        self._publisher = stream
        status: Any = stream.matching_status  # a `bool` in the stubs, but no such thing
        self.wanted = bool(status.matching)
        stream.declare_matching_listener(self._match)  # ends with the publisher

    def publish(self, payload: bytes, sequence: int, stamp_ns: int) -> None:
        """Send a message of `stamp_ns` in Unix time; a stream never waits for anyone."""
        attachment = RosAttachment(sequence, stamp_ns, self._gid)
        self._publisher.put(payload, attachment=attachment.encode())

    def close(self) -> None:
        """Take the publisher off the ROS graph."""
        self._token.undeclare()
        self._publisher.undeclare()

    def _match(self, status: zenoh.MatchingStatus) -> None:
        self.wanted = bool(status.matching)


class RosNode(Closing):
    """A node of the ROS graph with publishers, one of a Zenoh session.

    With a token of its own, nodes of ROS forget it when it ends.

    Args:
        session: Open Zenoh session.
        topics: What it publishes, in one domain.
    """

    def __init__(self, session: zenoh.Session, topics: Sequence[RosTopic]) -> None:
        token = f"@ros2_lv/{topics[0].domain}/{session.zid()}/0/0/NN/%/%/{NODE}"
        self._token = session.liveliness().declare_token(token)
        self.publishers = [
            RosPublisher(session, topic, entity) for entity, topic in enumerate(topics, 1)
        ]

    def close(self) -> None:
        """Take the node off the ROS graph."""
        for publisher in self.publishers:
            publisher.close()
        self._token.undeclare()


def unlike(token: str, topics: Sequence[RosTopic]) -> str:
    """Say why a subscriber of one of the topics hears nothing; nothing where it does.

    Args:
        token: Liveliness token, of anything.
        topics: That are published.
    """
    parts = token.split("/")
    if len(parts) != _TOKEN_PARTS or parts[5] != "MS":
        return ""
    node, name, kind, found = parts[8:12]
    for topic in topics:
        gets = topic.key.split("/")[-2:]
        if name == topic.mangled and [kind, found] != gets:
            return (
                f"node {in_line(node)} hears nothing of {topic.name}: it expects "
                f"{in_line(kind)} of hash {in_line(found)}, and gets {gets[0]} of {gets[1]}"
            )
    return ""


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
            place = {name: j for j, name in enumerate(state.names)}
            missing = [name for name in self._codec.names if name not in place]
            if missing or len(place) < len(state.names):
                fault = f"without {', '.join(missing)}" if missing else "with a joint named twice"
                raise WireFormatError(
                    f"joint states of {', '.join(state.names) or 'no joint'}, {fault}", len(payload)
                )
            order = [place[name] for name in self._codec.names]
            arrays = (state.position, state.velocity, state.torque)
            payload = self._codec.encode(
                state.stamp_ns, *(values[order] if values.size else values for values in arrays)
            )
        return RosState(payload, Attachment(about.sequence, about.stamp_ns), about.gid.hex())
