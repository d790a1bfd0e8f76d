"""Processor time of one answer of the service, in process: before its estimate goes out, and after.

    python benchmarks/service/answer_time.py --model model/

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
from estimators.service.opening import Opening
from estimators.service.settings import ServiceSettings
from limo_driver.network.messages import Attachment, JointStateCodec

if TYPE_CHECKING:
    from estimators.service.inference.arm_service import ArmService

RATE = 100.0  # [Hz] of the stamps, whatever the waits are
START = 1_700_000_000_000_000_000  # [ns]
WAITS = (0.0, 1e-3, 5e-3)  # [s] before a state
NO_CONTACT = 1e3  # [N m]; the states say that no joint feels any torque
FULL = 300  # states, after which the filter is full and joints have turned


class Sent:
    """What the service sends, and what its thread had had of a core by then."""

    external_wanted = False

    def __init__(self) -> None:
        self.digest, self.at = hashlib.sha256(), 0

    def estimate(self, payload: bytes, attachment: bytes, stamp_ns: int) -> None:  # noqa: ARG002
        """Note the time first."""
        self.at = time.thread_time_ns()
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
    arguments = parser.parse_args()
    print(describe_machine())
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


def measure(
    served: ArmService, sent: Sent, given: argparse.Namespace, wait: float
) -> tuple[float, float]:
    """Return medians of the time before an estimate has gone out, and after [µs]."""
    motion, codec = Motion(given.model), JointStateCodec(served.arm.joint_names, ARM)
    still = np.zeros(len(motion.names))
    positions = motion.at(np.arange(given.states) / RATE)
    states = [
        (codec.encode(START + round(1e9 * k / RATE), q, still, still), Attachment(k, k).encode())
        for k, q in enumerate(positions)
    ]
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
