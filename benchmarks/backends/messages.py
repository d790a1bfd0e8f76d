"""Messages and logs beside their peers: rosbags' serializer, and mcap's writer without our queue.

    python benchmarks/backends/messages.py

One core. Messages are of seven joints. All are timed in turn in one run, so that they suffer alike
from whatever else the machine does; wall time of each call. A log is written at 1 kHz, with joint
states and estimates, and timed twice: what `write` costs whoever calls it, and what the process
spends on a message in all, its thread included, beside mcap's own writer on the same messages.
"""

from __future__ import annotations

import argparse
import os
import sys
import tempfile
import time
from pathlib import Path
from typing import TYPE_CHECKING

os.environ.setdefault("OMP_NUM_THREADS", "1")

import numpy as np
from mcap.writer import Writer
from rosbags import typesys

from limo_driver.logs.mcap_log import LogLimits, McapLog
from limo_driver.network.messages import (
    JOINT_STATE,
    SCHEMAS,
    TORQUE_ESTIMATE,
    JointStateCodec,
    TorqueEstimateCodec,
    decode_joint_state,
    decode_torque_estimate,
)

if TYPE_CHECKING:
    from collections.abc import Callable

NAMES = [f"iiwa_joint_{j + 1}" for j in range(7)]
STAMP = 1_700_000_000_123_456_789
BAR = 5.0  # [µs], p50 of encoding a joint state
PERIOD = 1e-3  # [s] of the paced log


def quantiles(taken: list[float]) -> str:
    """Return p50 and p99 [µs]."""
    p50, p99 = np.percentile(1e6 * np.array(taken), [50, 99])
    return f"{p50:8.1f} {p99:8.1f}"


def in_turn(calls: dict[str, Callable[[], object]], rounds: int) -> dict[str, list[float]]:
    """Return the wall time of each call [s]; a burst of each, over and over."""
    taken: dict[str, list[float]] = {name: [] for name in calls}
    for _ in range(rounds):
        for name, call in calls.items():
            for _ in range(100):
                began = time.perf_counter()
                call()
                taken[name].append(time.perf_counter() - began)
    return taken


def messages(rounds: int) -> bool:
    """Time encoding and decoding; say whether the bar is kept."""
    random = np.random.default_rng(0)
    arrays, outside = random.standard_normal((3, 7)), random.random(7) < 0.1
    states, estimates = JointStateCodec(NAMES), TorqueEstimateCodec(NAMES)
    state = states.encode(STAMP, *arrays)
    estimate = estimates.encode(STAMP, *arrays, outside, model="12")

    store = typesys.get_typestore(typesys.Stores.ROS2_JAZZY)
    ours = typesys.get_types_from_msg(SCHEMAS[TORQUE_ESTIMATE], TORQUE_ESTIMATE)
    store.register({TORQUE_ESTIMATE: ours[TORQUE_ESTIMATE]})
    their_state = store.deserialize_cdr(state, JOINT_STATE)
    their_estimate = store.deserialize_cdr(estimate, TORQUE_ESTIMATE)
    assert bytes(store.serialize_cdr(their_state, JOINT_STATE)) == state
    assert bytes(store.serialize_cdr(their_estimate, TORQUE_ESTIMATE)) == estimate

    calls = {
        "joint state: encode": lambda: states.encode(STAMP, *arrays),
        "joint state: encode, rosbags": lambda: store.serialize_cdr(their_state, JOINT_STATE),
        "joint state: decode, of known joints": lambda: states.decode(state),
        "joint state: decode, of any": lambda: decode_joint_state(state),
        "joint state: decode, rosbags": lambda: store.deserialize_cdr(state, JOINT_STATE),
        "estimate: encode": lambda: estimates.encode(STAMP, *arrays, outside, model="12"),
        "estimate: encode, rosbags": lambda: store.serialize_cdr(their_estimate, TORQUE_ESTIMATE),
        "estimate: decode": lambda: decode_torque_estimate(estimate),
        "estimate: decode, rosbags": lambda: store.deserialize_cdr(estimate, TORQUE_ESTIMATE),
    }
    in_turn(calls, 1)  # fills the caches
    taken = in_turn(calls, rounds)
    print(f"{len(state)} and {len(estimate)} bytes                   p50 [µs] p99 [µs]")
    for name, values in taken.items():
        print(f"{name:38} {quantiles(values)}")
    return float(np.median(taken["joint state: encode"])) <= 1e-6 * BAR


def stream(count: int) -> list[tuple[str, str, bytes]]:
    """Return topic, schema and payload of joint states and their estimates, in turn."""
    random = np.random.default_rng(0)
    states, estimates = JointStateCodec(NAMES), TorqueEstimateCodec(NAMES)
    walk = np.cumsum(1e-4 * random.standard_normal((count, 3, 7)), axis=0)
    found: list[tuple[str, str, bytes]] = []
    for k, arrays in enumerate(walk):
        stamp = STAMP + k * 1_000_000
        found.append(("state", JOINT_STATE, states.encode(stamp, *arrays)))
        said = estimates.encode(stamp, *arrays, np.zeros(7, bool), model="12")
        found.append(("estimate", TORQUE_ESTIMATE, said))
    return found


def paced_log(folder: Path, seconds: float) -> None:
    """Write a log at 1 kHz and time each call."""
    rows = stream(int(seconds / PERIOD))
    taken: list[float] = []
    processor = time.process_time()
    began = time.perf_counter()
    with McapLog(folder) as log:
        for k, (topic, schema, payload) in enumerate(rows):
            wait = began + (k // 2) * PERIOD - time.perf_counter()
            if wait > 0:
                time.sleep(wait)
            now = time.perf_counter()
            log.write(topic, schema, payload, STAMP + k, STAMP + k, k)
            taken.append(time.perf_counter() - now)
    processor = time.process_time() - processor
    assert (log.written, log.dropped) == (len(rows), 0)
    print(f"{'log: write, at 1 kHz, two topics':38} {quantiles(taken)}")
    print(f"{'log: processor time of all at that rate':38} {1e6 * processor / len(rows):6.1f} mean")


def bulk_log(folder: Path, count: int) -> None:
    """Compare the processor time of a message with and without our queue and thread."""
    rows = stream(count // 2)
    began = time.process_time()
    with McapLog(folder / "ours", limits=LogLimits(queue=count)) as log:
        for k, (topic, schema, payload) in enumerate(rows):
            log.write(topic, schema, payload, STAMP + k, STAMP + k, k)
    ours = time.process_time() - began
    assert log.written == len(rows)

    began = time.process_time()
    with (folder / "theirs.mcap").open("wb") as file:
        writer = Writer(file)
        writer.start("ros2")
        channels = {
            topic: writer.register_channel(
                topic, "cdr", writer.register_schema(name, "ros2msg", SCHEMAS[name].encode())
            )
            for topic, name in (("state", JOINT_STATE), ("estimate", TORQUE_ESTIMATE))
        }
        for k, (topic, _, payload) in enumerate(rows):
            writer.add_message(channels[topic], STAMP + k, payload, STAMP + k, k)
        writer.finish()
    theirs = time.process_time() - began
    print(f"{'log: processor time, at once':38} {1e6 * ours / len(rows):6.1f} mean")
    print(f"{'mcap: processor time, at once':38} {1e6 * theirs / len(rows):6.1f} mean")


def main() -> None:
    """Print the figures; exit status 1 if the bar is missed."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--rounds", type=int, default=100, help="of 100 calls each")
    parser.add_argument("--seconds", type=float, default=10.0, help="of the log at 1 kHz")
    given = parser.parse_args()
    kept = messages(given.rounds)
    with tempfile.TemporaryDirectory() as folder:
        paced_log(Path(folder) / "paced", given.seconds)
        bulk_log(Path(folder), 40_000)
    print(f"bar: encode a joint state in {BAR:g} µs p50: {'kept' if kept else 'missed'}")
    sys.exit(0 if kept else 1)


if __name__ == "__main__":
    main()
