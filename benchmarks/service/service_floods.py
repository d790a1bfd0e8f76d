"""What a service answers while somebody floods it: forged joint states, or queries of its models.

    python benchmarks/service/service_floods.py --model model/ --seconds 20 --rate 250

One process publishes joint states and takes their estimates from `limo serve`, in another process;
a third one sends forged states under the same key, or asks for the index of models, as fast as it
can. Printed are the share of true states that is answered, that of honest queries (ten a second,
each answered within a second), and how often the flood came, beside the same without a flood. All
share this machine's cores, the flood with lower priority.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
import tempfile
import threading
import time
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from service_processes import (
    ARM,
    Answers,
    Driver,
    Motion,
    configurations,
    describe_machine,
    running,
    serve,
    wait_for,
)

from limo_driver.network.claims import Keys
from limo_driver.network.readiness import wait_until_serving
from limo_driver.network.streaming import open_session

if TYPE_CHECKING:
    import zenoh

BAR = 0.90  # share of the true states and of the honest queries that is answered
ASK, PATIENCE = 0.1, 1.0  # [s] between honest queries, and for an answer
START = 180.0  # [s] for the service to be there, at most
LEAD = 3.0  # [s] of states before any flood
FLOODS = ("none", "states", "queries")

STATES = """
import sys, time
import numpy as np, zenoh
from limo_driver.network.messages import Attachment, JointStateCodec
from limo_driver.network.streaming import declare_stream, open_session
config, key, seconds, names = sys.argv[1], sys.argv[2], float(sys.argv[3]), sys.argv[4].split(",")
with open_session(config=config) as session:
    publisher = declare_stream(session, key)
    source = zenoh.SourceInfo(publisher.id, 0)
    codec, values = JointStateCodec(names, "forged"), np.zeros(len(names))
    ends, k = time.monotonic() + seconds, 0
    while time.monotonic() < ends:
        stamp = time.time_ns()
        payload = codec.encode(stamp, values, values, values)
        publisher.put(payload, attachment=Attachment(k, stamp).encode(), source_info=source)
        k += 1
print(k)
"""
QUERIES = """
import sys, time, zenoh
from limo_driver.network.streaming import open_session
config, key, seconds = sys.argv[1], sys.argv[2], float(sys.argv[3])
with open_session(config=config) as session:
    ends, k = time.monotonic() + seconds, 0
    while time.monotonic() < ends:
        session.get(key, zenoh.handlers.RingChannel(1), timeout=0.5)  # a callback would be slower
        k += 1
print(k)
"""


def main() -> None:
    """Measure, and print beside the bar."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--model", type=Path, required=True, help="model folder of limo train")
    parser.add_argument("--seconds", type=float, default=20.0, help="of each flood [s]")
    parser.add_argument("--rate", type=float, default=250.0, help="of the true states [Hz]")
    arguments = parser.parse_args()
    motion, met = Motion(arguments.model), True
    print(f"{describe_machine()}, states at {arguments.rate:g} Hz")
    with tempfile.TemporaryDirectory() as folder:
        here, there = configurations(Path(folder), mode="router")
        with (
            running(serve(there, "--model", str(arguments.model))),
            open_session(config=here) as session,
        ):
            answers = Answers(session)
            with Driver(session, motion, rate=arguments.rate) as driver:
                wait_until_serving(session, ARM, until="serving", timeout=START)
                wait_for(lambda: bool(answers.sequences), START, "estimate")
                time.sleep(LEAD)
                print(f"{'flood':8} {'of it [1/s]':>12} {'states':>9} {'queries':>9} {'bar':>6}")
                for flood in FLOODS:
                    with Asker(session) as asker:
                        met &= _flooded(
                            flood, there, driver, answers, asker, motion, arguments.seconds
                        )
    sys.exit(not met)


class Asker:
    """Asks for the index of models now and then, as an operator does.

    Args:
        session: Open Zenoh session.
    """

    def __init__(self, session: zenoh.Session) -> None:
        self._session, self._ended = session, threading.Event()
        self.asked = self.answered = 0
        self._thread = threading.Thread(target=self._ask)

    def __enter__(self) -> Asker:
        """Begin to ask."""
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        """Ask no more."""
        self._ended.set()
        self._thread.join()

    def _ask(self) -> None:
        while not self._ended.wait(ASK):
            replies = self._session.get(Keys(ARM).model("index"), timeout=PATIENCE)
            self.answered += any(reply.ok is not None for reply in replies)
            self.asked += 1


def _flooded(
    flood: str,
    config: Path,
    driver: Driver,
    answers: Answers,
    asker: Asker,
    motion: Motion,
    seconds: float,
) -> bool:
    """Flood for some time; print the shares of states and of queries in it that were answered."""
    first = len(driver.sent)
    came = 0
    if flood == "none":
        time.sleep(seconds)
    else:
        code, key = (
            (STATES, Keys(ARM).joints) if flood == "states" else (QUERIES, Keys(ARM).model("index"))
        )
        names = ",".join(motion.names)
        # On a machine of its own it would take no core from the service.
        given = [
            "nice",
            "-n",
            "10",
            sys.executable,
            "-c",
            code,
            str(config),
            key,
            str(seconds),
            names,
        ]
        came = int(subprocess.run(given, capture_output=True, text=True, check=True).stdout)
    last, asked, got = len(driver.sent), max(asker.asked, 1), asker.answered
    time.sleep(1.0)
    numbers = np.unique(answers.sequences)
    share = np.isin(np.arange(first, last), numbers).mean()
    said = got / asked
    print(f"{flood:8} {came / seconds:12.0f} {share:9.1%} {said:9.1%} {BAR:6.0%}", flush=True)
    return bool(min(share, said) >= BAR)


if __name__ == "__main__":
    main()
