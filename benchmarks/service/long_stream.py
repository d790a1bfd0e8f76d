"""Hours of one arm's states on a simulated clock, through what answers them: does memory grow?

    python benchmarks/service/long_stream.py --model model/ --hours 8

States come as fast as they are answered; their stamps are of so many hours. Once a simulated
minute they are lost for a second, once in ten the arm is touched for one, and once in half an hour
another version of the same model takes over. Each simulated second the service is asked for its
status, as `limo watch` has it.
"""

from __future__ import annotations

import argparse
import resource
import time
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import psutil
from service_processes import DELAY, Motion, describe_machine

from estimators.embedded.compiled_stream import fastest
from estimators.model_folder import load_model
from estimators.service.inference.arm_service import ArmService, ServedArm
from estimators.service.inference.contact import ContactWatchdog
from estimators.service.inference.live_model import LiveModel, Window
from estimators.stream import Stream
from limo_driver.network.messages import Attachment, JointStateCodec
from limo_driver.types import Motion as Moved

if TYPE_CHECKING:
    from limo_driver.network.contact_state import ContactState

BAR = 2.0  # MB an hour, from the second on
RATE, SECOND, MINUTE, HOUR = 50.0, 50, 3_000, 180_000  # [Hz], and states in each
START = 1_700_000_000_000_000_000  # [ns]
PUSH = 20.0  # [N m]


class Counted:
    """What would publish and log, and here counts."""

    external_wanted, known_wanted = True, False

    def __init__(self) -> None:
        self.estimates = self.externals = self.contacts = self.states = self.events = 0

    def estimate(self, _payload: bytes, _attachment: bytes, _stamp_ns: int) -> None:
        """Count an answer."""
        self.estimates += 1

    def external(self, _payload: bytes, _attachment: bytes) -> None:
        """Count an external torque."""
        self.externals += 1

    def contact(self, _state: ContactState) -> None:
        """Count a contact state."""
        self.contacts += 1

    def state(self, _payload: bytes, _stamp_ns: int, _sequence: int) -> None:
        """Count a state that was taken."""
        self.states += 1

    def event(self, _kind: str, _text: str, _level: int = 20, **_facts: object) -> None:
        """Count an event."""
        self.events += 1


def main() -> None:
    """Answer all of them, and print a row an hour."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--model", type=Path, required=True, help="model folder of limo train")
    parser.add_argument("--hours", type=int, default=8)
    given = parser.parse_args()
    model, motion = load_model(given.model), Motion(given.model)
    n = len(motion.names)

    def live(version: str) -> LiveModel:
        return LiveModel(version, fastest(Stream(model, RATE, DELAY)), np.full(n, np.inf))

    physics = Stream(model.simulation, RATE, DELAY)
    fallback = LiveModel("physics", physics, np.full(n, np.inf), physics_only=True)
    outlet = Counted()
    watchdog = ContactWatchdog(np.full(n, 4.0), np.full(n, 0.15))
    service = ArmService(ServedArm("arm", motion.names, RATE), fallback, watchdog, outlet)
    service.swap(live("1"))
    codec, still = JointStateCodec(motion.names, "arm"), np.zeros(n)
    seconds = np.arange(0.0, 10.0, 1.0 / RATE)  # three periods of the motion
    position = motion.at(seconds)
    velocity = np.gradient(position, seconds, axis=0)
    acceleration = np.gradient(velocity, seconds, axis=0)
    torque = model.simulation.predict(Moved(seconds, position, velocity, acceleration))
    heads = (("hours", 5), ("memory [MB]", 13), ("answered", 11), ("events", 9), ("contacts", 10))
    print("".join(f"{head:>{width}}" for head, width in (*heads, ("CPU [s]", 9))))
    memory = list[float]()
    for k in range(given.hours * HOUR + 1):
        if k % HOUR == 0:
            memory.append(psutil.Process().memory_info().rss / 1e6)
            cpu = resource.getrusage(resource.RUSAGE_SELF).ru_utime
            counts = f"{outlet.estimates:11}{outlet.events:9}{outlet.contacts:10}{cpu:9.0f}"
            print(f"{k // HOUR:5}{memory[-1]:13.1f}{counts}", flush=True)
        if k % (HOUR // 2) == HOUR // 4:
            service.swap(live(str(2 + k // HOUR)))
        if k % MINUTE < SECOND:
            continue
        touched = PUSH if k % (10 * MINUTE) // SECOND == 300 else 0.0
        at = k % len(seconds)
        payload = codec.encode(
            START + round(1e9 * k / RATE), position[at], still, torque[at] + touched
        )
        service.handle(payload, Attachment(k, round(1e9 * k / RATE)).encode())
        if k % SECOND == 0:
            window, service.window = service.window, Window(n)
            service.condition(window)
    slope = np.polyfit(np.arange(1.0, len(memory)), memory[1:], 1)[0] if given.hours > 1 else 0.0
    verdict = "flat" if slope <= BAR else "grows"
    print(f"{slope:+.2f} MB an hour from the second on, bar {BAR:g}: {verdict}")
    print(f"{time.process_time():.0f} s of processor; {describe_machine()}")


if __name__ == "__main__":
    main()
