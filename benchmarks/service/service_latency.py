"""Joint state in, estimate out, over Zenoh between processes, beside a bare echo in the same run.

    python benchmarks/service/service_latency.py --model model/ --minutes 10

One process publishes joint states at 1 kHz and takes the time until their estimates come back from
`limo serve`, in another process. Half a cycle later it sends as many bytes to a third process,
which does nothing but send them back: the bar is a ratio to that. All share this machine's cores.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
import time
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from service_processes import (
    ARM,
    RATE,
    Answers,
    Driver,
    Motion,
    configurations,
    describe_machine,
    running,
    serve,
    wait_for,
)
from zenoh.handlers import Callback

from limo_driver.network.messages import Attachment
from limo_driver.network.readiness import wait_until_serving
from limo_driver.network.streaming import declare_stream, open_session

if TYPE_CHECKING:
    import zenoh

BARS = (0.6, 1.5, 2.0)  # p50 [ms], p99 [ms], ratio to the echo
ECHO_IN, ECHO_OUT = "limo/bench/echo/in", "limo/bench/echo/out"
START = 180.0  # [s] for service and echo to be there, at most
LEAD = 20.0  # [s] that do not count: until the stream has settled


def main() -> None:
    """Measure, and print beside the bars."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--model", type=Path, required=True, help="model folder of limo train")
    parser.add_argument("--minutes", type=float, default=10.0)
    parser.add_argument("--echo", metavar="CONFIG", help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    if arguments.echo:
        echo(Path(arguments.echo))
        return
    with tempfile.TemporaryDirectory() as folder:
        here, there = configurations(Path(folder))
        commands = (
            serve(there, "--model", str(arguments.model)),
            [sys.executable, __file__, "--model", str(arguments.model), "--echo", str(there)],
        )
        with open_session(config=here) as session, running(*commands):
            measure(session, Motion(arguments.model), arguments.minutes)


def measure(session: zenoh.Session, motion: Motion, minutes: float) -> None:
    """Drive for some minutes, and print how long estimates and echoes took."""
    estimates, echoes = Answers(session), Answers(session, ECHO_OUT)
    publisher, sent = declare_stream(session, ECHO_IN), []
    payload = bytes(60 + 24 * len(motion.names) + sum(len(name) + 8 for name in motion.names))

    def send(k: int) -> None:
        sent.append(time.perf_counter())
        publisher.put(payload, attachment=Attachment(k, 0).encode())

    wait_until_serving(session, ARM, until="waiting", timeout=START)
    wait_for(lambda: bool(publisher.matching_status.matching), START, "echo")
    with Driver(session, motion, between=send) as driver:
        time.sleep(LEAD + 60.0 * minutes)
    time.sleep(1.0)
    print(f"round trip [ms]             p50      p99      max   ({minutes:g} min)")
    ours, bare = show("estimate", estimates, driver.sent), show("bare echo", echoes, sent)
    print(f"  bar                      {BARS[0]:8.3f} {BARS[1]:8.3f}")
    print(
        f"  ratio to the echo        {ours[0] / bare[0]:8.2f} {ours[1] / bare[1]:8.2f}   bar "
        f"{BARS[2]:g}"
    )
    print(describe_machine())


def show(name: str, answers: Answers, sent: list[float]) -> tuple[float, float]:
    """Print percentiles and what went missing; return p50 and p99 [ms]."""
    answers.close()
    took = answers.round_trips(sent, int(LEAD * RATE))
    p50, p99, most = np.nanpercentile(took, (50, 99, 100))
    twice, disordered = answers.order()
    print(
        f"  {name:24}{p50:9.3f}{p99:9.3f}{most:9.1f}   {took.size} sent, "
        f"{np.isnan(took).sum()} lost, {twice} twice, {disordered} out of order"
    )
    return p50, p99


def echo(config: Path) -> None:
    """Send back whatever comes."""
    with open_session(config=config) as session:
        publisher = declare_stream(session, ECHO_OUT)

        def back(sample: zenoh.Sample) -> None:
            publisher.put(sample.payload.to_bytes(), attachment=sample.attachment)

        session.declare_subscriber(ECHO_IN, Callback(back, indirect=True))
        while True:
            time.sleep(1.0)


if __name__ == "__main__":
    main()
