"""Processor time of one answer of the service, in process: before its estimate goes out, and after.

    python benchmarks/service/answer_time.py --model model/
    python benchmarks/service/answer_time.py --model model/ --early

States are handed to the service as they come off the wire. Network and log are left out, so that
what other programs do counts little, but for the caches: one state right after the other finds all
code and data at hand, and one after a wait does not. The digest is of all that was sent; it says
whether two versions of the code answer with the same bytes.
"""

from __future__ import annotations

import argparse
import gc
import hashlib
import time
from pathlib import Path
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any

import numpy as np
from service_processes import ARM, DELAY, Motion, describe_machine

from estimators.model_folder import load_model
from estimators.service.inference.forecast import Due, Forecast
from estimators.service.inference.warmth import Warmth
from estimators.service.opening import Opening
from estimators.service.settings import ServiceSettings
from limo_driver.network.messages import Attachment, JointStateCodec

if TYPE_CHECKING:
    from estimators.service.inference.arm_service import ArmService

RATE = 100.0  # [Hz] of the stamps, whatever the waits are
START = 1_700_000_000_000_000_000  # [ns]
WAITS = (0.0, 1e-3, 5e-3)  # [s] before a state
NO_CONTACT = 1e3  # [N m]; the states say that no joint feels any torque
LATEST, STEP = 1.2e-3, 0.2e-3  # [s] after a rehearsal began, when a state comes
FULL = 300  # states, after which the filter is full and joints have turned


class Sent:
    """What the service sends, and what its thread had had of a core by then."""

    external_wanted = False

    def __init__(self) -> None:
        self.digest, self.at, self.out = hashlib.sha256(), 0, 0.0

    def estimate(self, payload: bytes, attachment: bytes, stamp_ns: int) -> None:  # noqa: ARG002
        """Note the times first."""
        self.at, self.out = time.thread_time_ns(), time.perf_counter()
        self.digest.update(payload + attachment)

    def external(self, payload: bytes, attachment: bytes) -> None:
        """Nobody wants it."""

    def state(self, payload: bytes, stamp_ns: int, sequence: int) -> None:
        """Nothing is logged."""

    def event(self, kind: str, text: str, *_: object, **__: object) -> None:
        """Print it."""
        print(f"{kind}: {text}")


def main() -> None:
    """Measure, and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--model", type=Path, required=True, help="model folder of limo train")
    parser.add_argument("--states", type=int, default=1500, help="for each wait")
    parser.add_argument("--early", action="store_true", help="states that come during a rehearsal")
    arguments = parser.parse_args()
    print(describe_machine())
    if arguments.early:
        show_early(arguments)
        return
    print(f"{'processor time [µs], p50':28}{'before':>9}{'after':>9}   digest")
    for wait in WAITS:
        sent = Sent()
        before, after = measure(service(arguments.model, sent), sent, arguments, wait)
        name = f"{1e3 * wait:g} ms after the last"
        print(f"{name:28}{before:9.0f}{after:9.0f}   {sent.digest.hexdigest()[:12]}")


def service(folder: Path, sent: Sent) -> ArmService:
    """Return the service of a model that is ready to answer."""

    def load(_version: str) -> Any:  # noqa: ANN401  # of any estimator
        return load_model(folder)

    models: Any = SimpleNamespace(physics=load("").simulation, candidates=("1",), load=load)
    settings = ServiceSettings(delay=DELAY, contact_torque=NO_CONTACT)
    return Opening(ARM, models, settings, sent).service(RATE)


def states_of(model: Path, served: ArmService, count: int) -> list[tuple[bytes, bytes]]:
    """Return payloads and attachments of joint states."""
    motion, codec = Motion(model), JointStateCodec(served.arm.joint_names, ARM)
    still = np.zeros(len(motion.names))
    return [
        (codec.encode(START + round(1e9 * k / RATE), q, still, still), Attachment(k, k).encode())
        for k, q in enumerate(motion.at(np.arange(count) / RATE))
    ]


def show_early(given: argparse.Namespace) -> None:
    """Print how long answers take to states that come while the answer is rehearsed."""
    sent = Sent()
    served = service(given.model, sent)
    states = states_of(given.model, served, given.states)
    alarm, forecast, k = SimpleNamespace(rung=None, source=""), Forecast(), FULL
    warmth = Warmth(lambda: served.rehearse(*states[k - 1]), forecast, alarm)
    for state in states[:FULL]:
        served.handle(*state)
    gc.freeze()
    came = np.random.default_rng(0).uniform(0.0, LATEST, given.states)
    took = np.zeros(given.states)
    for k in range(FULL, given.states):
        time.sleep(1.0 / RATE - LATEST)
        now = time.perf_counter()
        arrives = now + came[k]
        if k % 2:
            alarm.rung = forecast.due = Due(now, now + 1.0, 1.0 / RATE)
            warmth.wait(lambda at=arrives: states if time.perf_counter() >= at else None)
        else:
            time.sleep(max(arrives - now, 0.0))
        served.handle(*states[k])
        took[k] = 1e6 * (sent.out - arrives)
    print(f"{'state comes [ms]':20}{'asleep [µs]':>16}{'rehearsing':>16}")
    rehearsed, number = np.arange(given.states) % 2 == 1, np.arange(given.states)
    for first in np.arange(0.0, LATEST, STEP):
        rows = (number >= FULL) & (came >= first) & (came < first + STEP)
        cells = [np.percentile(took[rows & of], (50, 90)) for of in (~rehearsed, rehearsed)]
        texts = [f"{p50:.0f} / {p90:.0f}" for p50, p90 in cells]
        print(f"{1e3 * first:.1f} to {1e3 * (first + STEP):.1f}{'':10}{texts[0]:>16}{texts[1]:>16}")


def measure(
    served: ArmService, sent: Sent, given: argparse.Namespace, wait: float
) -> tuple[float, float]:
    """Return medians of the time before an estimate has gone out, and after [µs]."""
    states = states_of(given.model, served, given.states)
    gc.freeze()  # as the service does
    took: list[tuple[int, int]] = []
    for payload, attachment in states:
        if wait:
            time.sleep(wait)
        began = time.thread_time_ns()
        served.handle(payload, attachment)
        took.append((sent.at - began, time.thread_time_ns() - sent.at))
    before, after = np.median(np.array(took)[FULL:], axis=0) / 1e3
    return float(before), float(after)


if __name__ == "__main__":
    main()
