"""What a ROS 2 peer of others receives of `limo bridge`, and limo of it: share, rate, latency.

    pip install zenoh-ros2-sdk
    python benchmarks/service/ros_topics.py --rate 1000 --seconds 30

This process publishes joint states and estimates as `limo serve` does, `limo bridge` makes topics
of them, and a third process, which is zenoh-ros2-sdk and shares no code with limo, hears all under
the type hashes that it computes itself. Latency is from the stamp of an estimate to the peer's
callback. Events that were told before the peer came are
asked for as zenoh-ros2-sdk does, which takes the last one, and as rmw_zenoh does, by an advanced
subscriber of Zenoh under the peer's own key. Then the peer
publishes joint states, which limo hears.
"""

# ruff: noqa: ANN401  # the peer's library has no types

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import tempfile
import threading
import time
from contextlib import contextmanager
from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Generator, Sequence

ARM, ROBOT = "iiwa14", "iiwa14"
EVENTS = 5  # that are told before the peer comes
ALL = "events, advanced"  # as rmw_zenoh subscribes to them
LOG, STATES = "rcl_interfaces/msg/Log", "joint_states"
JOINT_STATE = "sensor_msgs/msg/JointState"


def main() -> None:
    """Measure, and print a line for each topic."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rate", type=float, default=1000.0, help="of the estimates [Hz]")
    parser.add_argument("--seconds", type=float, default=30.0, help="of each direction")
    parser.add_argument("--peer", nargs="+", help=argparse.SUPPRESS)
    given = parser.parse_args()
    if given.peer:
        port, folder, *topics = given.peer
        peer(int(port), Path(folder), topics)
        return
    from service_processes import LIMO, configurations, describe_machine, running

    print(describe_machine())
    with tempfile.TemporaryDirectory() as folder:
        here, there = configurations(Path(folder), "router")
        listen = json.loads(here.read_text())["listen"]["endpoints"][0]
        options = ["--arm", ARM, "--robot", ROBOT, "--namespace", "/", "--zenoh-config", str(there)]
        with _session(here) as session, running([*LIMO, "bridge", *options]):
            measure(session, int(listen.rpartition(":")[2]), Path(folder), given)
    print(describe_machine())


def measure(session: Any, port: int, folder: Path, given: argparse.Namespace) -> None:
    """Let the peer hear estimates, then limo the peer."""
    from service_processes import wait_for

    from limo_driver.app.live.ros_bridge import EVENTS as LATE
    from limo_driver.app.live.ros_bridge import STREAMS
    from limo_driver.network.ros import RosReader, RosTopic

    source = Source(session)
    for number in range(EVENTS):
        source.tell(number)
    topics = [f"{name}:{kind}" for name, kind in {**STREAMS, LATE: LOG}.items()]
    wait_for(source.wanted, 60.0, "bridge")
    with foreign_peer(port, folder, [*topics, f"+{STATES}"]) as ask:
        wait_for(lambda: ask("heard")[ALL]["count"] == EVENTS, 60.0, "late events")
        late = ask("heard")
        for name in (LATE, ALL):
            print(f"{name:20}{EVENTS:8}{late[name]['count']:10}  told before the peer came")
        every_stream = lambda: all(ask("heard")[name]["count"] for name in STREAMS)  # noqa: E731
        with source.at(given.rate):
            wait_for(every_stream, 60.0, "topics")
        ask("forget")
        with source.at(given.rate):
            time.sleep(given.seconds)
        time.sleep(1.0)
        heard = ask("heard")
        print(
            f"{'topic':20}{'sent':>8}{'received':>10}{'Hz':>9}{'p50':>8}{'p99':>8}{'max [ms]':>10}"
        )
        for name in STREAMS:
            _show(name, source.sent, **heard[name])
        taken: list[float] = []
        reader = RosReader(source.names, ARM)

        def take(sample: Any) -> None:
            came = time.time_ns()
            reader.read(sample.payload.to_bytes(), sample.attachment.to_bytes())
            stamp = int.from_bytes(sample.attachment.to_bytes()[8:16], "little")
            taken.append(1e-6 * (came - stamp))

        hears = session.declare_subscriber(RosTopic(STATES).key_of_any_hash, take)
        sent = ask(f"publish {given.rate} {given.seconds}")["sent"]
        time.sleep(1.0)
        hears.undeclare()
        _show(f"{STATES}, to limo", sent, len(taken), sent / given.seconds, *_spread(taken))


def _show(name: str, sent: int, count: int, rate: float, *spread: float, **more: Any) -> None:
    middle, high, most = spread or more["latency"]
    share = 100.0 * count / sent
    print(f"{name:20}{sent:8}{share:9.2f}%{rate:9.1f}{middle:8.2f}{high:8.2f}{most:10.2f}")


def _spread(values: Sequence[float] | np.ndarray) -> list[float]:
    return [
        float(v) for v in np.percentile(values if len(values) else [np.nan], [50.0, 99.0, 100.0])
    ]


def _session(config: Path) -> Any:
    from limo_driver.network.streaming import open_session

    return open_session(config=config)


class Source:
    """Publishes joint states and estimates of an arm, as a driver and a service do.

    Args:
        session: Open Zenoh session.
    """

    def __init__(self, session: Any) -> None:
        from limo_driver.model import RobotModel
        from limo_driver.network.messages import JointStateCodec, TorqueEstimateCodec
        from limo_driver.network.streaming import Keys, declare_history, declare_stream

        self.names = RobotModel.load(ROBOT).joint_names
        keys, n = Keys(ARM), len(self.names)
        self._states = JointStateCodec(self.names, ARM)
        self._estimates = TorqueEstimateCodec(self.names, ARM)
        self._of_states = declare_stream(session, keys.joints)
        self._of_estimates = declare_stream(session, keys.estimate)
        self._of_events = declare_history(session, keys.event)
        self.pose = np.linspace(0.1, 0.7, n)
        self.external = np.linspace(-1.0, 2.0, n)
        self.std = np.linspace(0.2, 0.5, n)
        self.sent = 0

    def wanted(self) -> bool:
        """Say whether a bridge listens."""
        return bool(self._of_estimates.matching_status.matching)

    def tell(self, number: int) -> None:
        """Publish an event."""
        from limo_driver.network.messages import Event, Level

        event = Event(time.time_ns(), Level.INFO, "contact", f"event {number}")
        self._of_events.put(event.encode())

    def publish(self) -> None:
        """Publish a state and the estimate of its instant."""
        from limo_driver.network.messages import Attachment

        stamp, nothing = time.time_ns(), np.empty(0)
        attachment = Attachment(self.sent, stamp).encode()
        state = self._states.encode(stamp, self.pose, nothing, nothing)
        self._of_states.put(state, attachment=attachment)
        outside = np.zeros(len(self.names), dtype=np.bool_)
        estimate = self._estimates.encode(
            stamp, 10.0 * self.external, self.std, self.external, outside, model="3"
        )
        self._of_estimates.put(estimate, attachment=attachment)
        self.sent += 1

    @contextmanager
    def at(self, rate: float) -> Generator[None]:
        """Publish on a thread until the block ends, and count anew."""
        done, self.sent = threading.Event(), 0

        def run() -> None:
            began = time.perf_counter()
            while not done.is_set():
                self.publish()
                time.sleep(max(began + self.sent / rate - time.perf_counter(), 0.0))

        thread = threading.Thread(target=run)
        thread.start()
        try:
            yield
        finally:
            done.set()
            thread.join()


@contextmanager
def foreign_peer(port: int, folder: Path, topics: Sequence[str]) -> Generator[Any]:
    """Run the peer, and give what asks it.

    Args:
        port: Of a session on this machine.
        folder: Into which definitions of messages are written.
        topics: `name:type` to be heard, `name:type:hash` under a hash of its own, or `+name` of
            joint states to be published.
    """
    _write_definitions(folder / "messages")
    command = [sys.executable, __file__, "--peer", str(port), str(folder / "messages"), *topics]
    pipe = subprocess.PIPE
    with subprocess.Popen(command, stdin=pipe, stdout=pipe, text=True) as process:
        assert process.stdin is not None
        assert process.stdout is not None
        to_peer, from_peer = process.stdin, process.stdout

        def ask(question: str) -> Any:
            print(question, file=to_peer, flush=True)
            return json.loads(from_peer.readline())

        try:
            ask("heard")  # once it is there
            yield ask
        finally:
            process.kill()  # its library leaves threads behind


def _write_definitions(folder: Path) -> None:
    """Write the messages of ROS 2 Jazzy as files, for a peer without ROS."""
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS2_JAZZY)
    names = (JOINT_STATE, LOG, "geometry_msgs/msg/WrenchStamped", "std_msgs/msg/Float64MultiArray")
    for name in names:
        first, *others = store.generate_msgdef(name, ros_version=2)[0].split("=" * 80 + "\nMSG: ")
        parts = {name: first}
        for other in others:
            own, _, text = other.partition("\n")
            parts[own.replace("/", "/msg/")] = text
        for own, text in parts.items():
            file = folder / f"{own}.msg"
            file.parent.mkdir(parents=True, exist_ok=True)
            file.write_text(text)


def peer(port: int, folder: Path, topics: Sequence[str]) -> None:
    """Hear and publish topics by zenoh-ros2-sdk, and answer questions on standard input."""
    import zenoh.ext
    from zenoh_ros2_sdk import ROS2Publisher, ROS2Subscriber
    from zenoh_ros2_sdk.message_registry import get_registry
    from zenoh_ros2_sdk.qos import QosDurability, QosProfile

    get_registry(str(folder))
    heard: dict[str, list[tuple[int, Any]]] = {}
    publishers, subscribers = [], []
    for topic in topics:
        if topic.startswith("+"):
            publishers.append(ROS2Publisher(f"/{topic[1:]}", JOINT_STATE, router_port=port))
            continue
        name, kind, *hash_ = topic.split(":")
        came = heard[name] = []
        history = QosProfile(durability=QosDurability.TRANSIENT_LOCAL, history_depth=100)
        subscriber = ROS2Subscriber(
            f"/{name}",
            kind,
            lambda message, came=came: came.append((time.time_ns(), message)),
            qos=history if kind == LOG else None,
            type_hash=hash_[0] if hash_ else None,
            router_port=port,
        )
        subscribers.append(subscriber)
        if kind == LOG:
            session, heard[ALL] = subscriber.session_mgr, []

            def take(sample: Any, session: Any = session) -> None:
                event = session.store.deserialize_cdr(sample.payload.to_bytes(), LOG)
                heard[ALL].append((time.time_ns(), event))

            history = zenoh.ext.declare_advanced_subscriber(
                session.session,
                subscriber.keyexpr,
                take,
                history=zenoh.ext.HistoryConfig(detect_late_publishers=True, max_samples=100),
            )
            subscribers.append(history)
    for line in sys.stdin:
        verb, *words = line.split()
        if verb == "forget":
            [came.clear() for came in heard.values()]
        answer: Any = {name: _summary(came) for name, came in heard.items()}
        if verb == "publish":
            rate, seconds = map(float, words)
            answer = {"sent": _publish(publishers[0], rate, seconds)}
        print(json.dumps(answer), flush=True)


def _publish(publisher: Any, rate: float, seconds: float) -> int:
    from zenoh_ros2_sdk import get_message_class

    header, stamp = map(get_message_class, ("std_msgs/msg/Header", "builtin_interfaces/msg/Time"))
    names = [f"joint{j}" for j in range(1, 8)]
    values, began, count = np.zeros(7), time.perf_counter(), round(rate * seconds)
    for k in range(count):
        now = header(stamp=stamp(*divmod(time.time_ns(), 10**9)), frame_id="")
        publisher.publish(header=now, name=names, position=values, velocity=values, effort=values)
        time.sleep(max(began + (k + 1) / rate - time.perf_counter(), 0.0))
    return count


def _summary(came: list[tuple[int, Any]]) -> dict[str, Any]:
    if not came:
        return {"count": 0}
    times = np.array([at for at, _ in came])
    stamps = [m.header.stamp for _, m in came if hasattr(m, "header")]
    sent = np.array([10**9 * s.sec + s.nanosec for s in stamps])
    return {
        "count": len(came),
        "rate": 1e9 * (len(came) - 1) / max(int(times[-1] - times[0]), 1),
        "latency": _spread(1e-6 * (times - sent) if len(sent) else []),
        "last": _plain(came[-1][1]),
    }


def _plain(value: Any) -> Any:
    if is_dataclass(value):
        return {f.name: _plain(getattr(value, f.name)) for f in fields(value)}
    if isinstance(value, np.ndarray):
        return value.tolist()
    return [_plain(v) for v in value] if isinstance(value, list) else value


if __name__ == "__main__":
    main()
