"""What a service says of an arm, as topics of ROS 2: torques, the wrench on its flange, events."""

from __future__ import annotations

import threading
import time
from collections import Counter, deque
from collections.abc import Callable, Sequence
from typing import Final

import numpy as np
import zenoh
from zenoh.handlers import RingChannel

from limo_driver.errors import ConfigError, WireFormatError
from limo_driver.model import RobotModel
from limo_driver.model.kinematics import FlangeWrench
from limo_driver.network import messages
from limo_driver.network.ros import RosNode, RosPublisher, RosReader, RosTopic, unlike
from limo_driver.network.streaming import KEPT_EVENTS, Keys, follow_history
from limo_driver.quoting import in_line
from limo_driver.runtime.processes import Closing
from limo_driver.types import FloatArray

# What is published as well as events, by the last part of its name.
STREAMS: Final = {
    "torque": messages.JOINT_STATE,  # effort: estimated [N m]
    "torque_std": messages.JOINT_STATE,  # effort: one standard deviation of its error [N m]
    "external_torque": messages.JOINT_STATE,  # effort: measured minus estimated [N m]
    "wrench": messages.WRENCH,  # of the environment on the arm [N, N m]
    "wrench_std": messages.WRENCH,  # one standard deviation of it
    "wrench_covariance": messages.MATRIX,  # (6, 6), in the same frame
}
EVENTS: Final = "events"
_WAITING: Final = 8  # estimates; older ones are lost rather than late
_STATES: Final = 4096


def topics(namespace: str, domain: int) -> list[RosTopic]:
    """Return what is published: the streams in their order, then events.

    Raises:
        ConfigError: ROS 2 has no such namespace or domain.
    """
    prefix = namespace.strip("/") + "/" * bool(namespace.strip("/"))
    streams = [RosTopic(prefix + name, domain, kind) for name, kind in STREAMS.items()]
    return [*streams, RosTopic(prefix + EVENTS, domain, messages.LOG, KEPT_EVENTS)]


class RosBridge(Closing):
    """Publishes estimates of one arm as topics of ROS 2, each where somebody listens to it.

    Args:
        session: Open Zenoh session, of both sides.
        keys: Of the arm.
        model: Of the arm.
        published: What `topics` returns.
        frame: Of the wrench, a link or site fixed to the last link; the flange if empty.
        states: Topic of ROS 2 with its joint states, where no driver of limo's publishes them.
        tell: Called once for each ROS node that hears nothing, for it expects another type.

    Raises:
        ConfigError: The arm has no such frame.
    """

    def __init__(
        self,
        session: zenoh.Session,
        keys: Keys,
        model: RobotModel,
        published: Sequence[RosTopic],
        frame: str = "",
        states: RosTopic | None = None,
        tell: Callable[[str], None] = lambda _text: None,
    ) -> None:
        self.wrench = FlangeWrench(model, frame)
        self.counts: Counter[str] = Counter(estimates=0, malformed=0, without_pose=0)
        self.ended = threading.Event()  # and why, unless it was closed
        self.error: ConfigError | None = None
        self._model, self._topics, self._tell = model, published, tell
        self._warned = set[str]()
        self._codec = messages.JointStateCodec(model.joint_names, keys.arm)
        self._reader = None if states is None else RosReader(model.joint_names, keys.arm)
        self._poses: deque[tuple[int, FloatArray]] = deque(maxlen=_STATES)  # by stamp [ns]
        self._node, self._events = RosNode(session, published), 0
        of_states = keys.joints if states is None else states.key_of_any_hash
        estimates = session.declare_subscriber(keys.estimate, RingChannel(_WAITING))
        states_subscriber = session.declare_subscriber(of_states, RingChannel(_STATES))
        self._states = states_subscriber.handler
        *_, events = self._node.publishers
        liveliness = session.liveliness()
        graph = f"@ros2_lv/{published[0].domain}/**"
        self._followed = [
            estimates,
            states_subscriber,
            liveliness.declare_subscriber(graph, self._look, history=True),
            follow_history(session, keys.event, lambda sample: self._put_event(events, sample)),
        ]
        self._thread = threading.Thread(target=self._follow, args=(estimates.handler,), daemon=True)
        self._thread.start()

    def close(self) -> None:
        """Take the topics off the ROS graph."""
        while self._followed:
            self._followed.pop().undeclare()
        self._thread.join()
        self._node.close()

    def _look(self, sample: zenoh.Sample) -> None:
        why = unlike(str(sample.key_expr), self._topics)
        if why and why not in self._warned and sample.kind == zenoh.SampleKind.PUT:
            self._warned.add(why)
            self._tell(why)

    def _put_event(self, events: RosPublisher, sample: zenoh.Sample) -> None:
        self._events += 1
        events.publish(sample.payload.to_bytes(), self._events, time.time_ns())

    def _follow(self, estimates: zenoh.Handler[zenoh.Sample]) -> None:
        while True:
            try:
                sample = estimates.recv()
            except zenoh.ZError:  # closed
                return
            try:
                self._publish(sample)
            except WireFormatError:
                self.counts["malformed"] += 1
            except ConfigError as error:
                self.error = error
                self.ended.set()
                return

    def _publish(self, sample: zenoh.Sample) -> None:
        attachment = b"" if sample.attachment is None else sample.attachment.to_bytes()
        sequence = messages.Attachment.decode(attachment).sequence
        estimate = messages.decode_torque_estimate(sample.payload.to_bytes())
        if estimate.names != self._model.joint_names:
            raise ConfigError(
                f"estimates are of joints {in_line(', '.join(estimate.names))}, those of "
                f"{self._model.name} are {in_line(', '.join(self._model.joint_names))}: name the "
                "arm's robot with `robot`"
            )
        self.counts["estimates"] += 1
        self._take_states()
        now = time.time_ns()
        nothing = estimate.torque[:0]
        for values, stream in zip(
            (estimate.torque, estimate.std, estimate.external), self._node.publishers, strict=False
        ):
            if stream.wanted:
                payload = self._codec.encode(estimate.stamp_ns, nothing, nothing, values)
                stream.publish(payload, sequence, now)
        self._publish_wrench(estimate, sequence)

    def _publish_wrench(self, estimate: messages.TorqueEstimate, sequence: int) -> None:
        wrench, std, covariance = self._node.publishers[3:6]
        if not (wrench.wanted or std.wanted or covariance.wanted):
            return
        position = self._position(estimate.stamp_ns)
        if (
            position is None
            or not np.isfinite(estimate.external).all()
            or not estimate.external.size
        ):
            self.counts["without_pose"] += 1
            return
        found, now = self.wrench.of(position, estimate.external, estimate.std), time.time_ns()
        frame, stamp = self.wrench.frame, estimate.stamp_ns
        if wrench.wanted:
            wrench.publish(messages.encode_wrench(stamp, frame, found.value), sequence, now)
        if std.wanted:
            deviation = np.sqrt(np.diag(found.covariance))
            std.publish(messages.encode_wrench(stamp, frame, deviation), sequence, now)
        if covariance.wanted:
            covariance.publish(messages.encode_matrix(frame, found.covariance), sequence, now)

    def _take_states(self) -> None:
        """Keep the poses of the states that came; those of ROS in the order of the arm."""
        while (sample := self._states.try_recv()) is not None:
            payload = sample.payload.to_bytes()
            try:
                if self._reader is not None:
                    attachment = sample.attachment
                    about = b"" if attachment is None else attachment.to_bytes()
                    payload = self._reader.read(payload, about).payload
                state = messages.decode_joint_state(payload)
            except WireFormatError:
                self.counts["malformed"] += 1
                continue
            if state.names == self._model.joint_names and state.position.size:
                self._poses.append((state.stamp_ns, state.position))

    def _position(self, stamp: int) -> FloatArray | None:
        """Return the pose at a time, between the two states around it; None where there are none.

        Poses of before are let go, since estimates come in order.
        """
        poses = self._poses
        while len(poses) > 1 and poses[1][0] <= stamp:
            poses.popleft()
        if not poses or not poses[0][0] <= stamp <= poses[-1][0]:
            return None
        (first, before), (second, after) = poses[0], poses[min(1, len(poses) - 1)]
        if first == second:
            return before
        part = (stamp - first) / (second - first)
        return before + part * (after - before)
