"""Joint state in, estimate out, over Zenoh between processes, beside a bare echo in the same run.

    python benchmarks/service/service_latency.py --model model/ --minutes 10
    python benchmarks/service/service_latency.py --model model/ --rates 1000,100,30 --minutes 1
    python benchmarks/service/service_latency.py --model slow/ --rates 10 --delay 0.5 --minutes 1
    nice -n -1 python benchmarks/service/service_latency.py --model model/ --busy 1 --minutes 2

One process publishes joint states and takes the time until their estimates come back from `limo
serve`, in another process. Half a cycle later it sends the same state, encoded in the same way, to
a third process, which does nothing but send its bytes back: the bar is a ratio to that. All share
this machine's cores. With `--busy`, so do processes that compute without end at the least priority.
Each rate has a service of its own, since one serves the rate with which it began. States as slow as
10 Hz take a delay of three of them at least, and a model of at most 4 Hz of bandwidth (`limo train
--bandwidth 2`).
"""

from __future__ import annotations

import argparse
import os
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
import zenoh
from service_processes import (
    ARM,
    DELAY,
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

from limo_driver.network.messages import Attachment, JointStateCodec
from limo_driver.network.readiness import wait_until_serving
from limo_driver.network.streaming import declare_stream, open_session
from limo_driver.robot.realtime import PRIORITY

BARS = (1.3, 2.0)  # ratios to the echo: of p50, of p99
BUSY = "import os; os.nice(19)\nwhile True: sum(i * i for i in range(100_000))"
ECHO_IN, ECHO_OUT = "limo/bench/echo/in", "limo/bench/echo/out"
START = 180.0  # [s] for service and echo to be there, at most
LEAD = 5.0  # [s] of the served stream that do not count


def main() -> None:
    """Measure, and print beside the bars."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--model", type=Path, required=True, help="model folder of limo train")
    parser.add_argument("--minutes", type=float, default=10.0, help="at each rate")
    parser.add_argument("--rates", default=f"{RATE:g}", help="of the states [Hz], in turn")
    parser.add_argument("--delay", type=float, default=DELAY, help="of the service [s]")
    parser.add_argument("--busy", type=int, default=0, help="processes that compute, at nice 19")
    parser.add_argument("--fifo", action="store_true", help="service and echo under SCHED_FIFO")
    parser.add_argument("--echo", metavar="CONFIG", help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    if arguments.echo:
        if arguments.fifo:
            os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(PRIORITY))
        echo(Path(arguments.echo))
        return
    if arguments.busy and os.sched_getscheduler(0) != os.SCHED_OTHER:
        # nice is nothing under it, so that these would take all cores from everything else
        sys.exit("begun under real-time scheduling, which --busy would hand down: use --fifo")
    print(describe_machine())
    print(f"{'round trip [ms]':22}{'p50':>9}{'p99':>9}{'max':>9}")
    for rate in map(float, arguments.rates.split(",")):
        at_rate(arguments, rate)
    print(describe_machine())


def at_rate(given: argparse.Namespace, rate: float) -> None:
    """Start a service and an echo, and measure both at one rate [Hz]."""
    with tempfile.TemporaryDirectory() as folder:
        here, there = configurations(Path(folder))
        model = ("--model", str(given.model))
        fifo = ("--fifo",) if given.fifo else ()
        commands = [
            serve(there, *model, *fifo, "--delay", str(given.delay)),
            [sys.executable, __file__, *model, *fifo, "--echo", str(there)],
            *[[sys.executable, "-c", BUSY]] * given.busy,
        ]
        with open_session(config=here) as session, running(*commands):
            measure(session, Motion(given.model), given.minutes, rate)


def measure(session: zenoh.Session, motion: Motion, minutes: float, rate: float) -> None:
    """Drive for some minutes, and print how long estimates and echoes took."""
    estimates, echoes = Answers(session), Answers(session, ECHO_OUT)
    publisher, sent = declare_stream(session, ECHO_IN), []
    codec, source = JointStateCodec(motion.names, ARM), zenoh.SourceInfo(publisher.id, 0)
    still = np.zeros(len(motion.names))

    def send(k: int) -> None:
        position = motion.at(np.array([k / rate]))[0]
        sent.append(time.perf_counter())  # encoding counts, as it does where a driver publishes
        payload = codec.encode(round(1e9 * k / rate), position, still, still)
        publisher.put(payload, attachment=Attachment(k, 0).encode(), source_info=source)

    wait_until_serving(session, ARM, until="waiting", timeout=START)
    wait_for(lambda: bool(publisher.matching_status.matching), START, "echo")
    with Driver(session, motion, between=send, rate=rate) as driver:
        wait_until_serving(session, ARM, timeout=START)
        first = len(driver.sent) + round(LEAD * rate)
        time.sleep(LEAD + 60.0 * minutes)
    time.sleep(1.0)
    ours = show(f"estimate at {rate:g} Hz", estimates, driver.sent, first)
    bare = show(f"echo at {rate:g} Hz", echoes, sent, first)
    ratios = [own / its for own, its in zip(ours, bare, strict=True)]
    print(f"{'ratio':22}{ratios[0]:9.2f}{ratios[1]:9.2f}            bars {BARS[0]:g}, {BARS[1]:g}")


def show(name: str, answers: Answers, sent: list[float], first: int) -> tuple[float, float]:
    """Print percentiles and what went missing from a number on; return p50 and p99 [ms]."""
    answers.close()
    took = answers.round_trips(sent, first)
    p50, p99, most = np.nanpercentile(took, (50, 99, 100))
    twice, disordered = answers.order()
    print(
        f"{name:22}{p50:9.3f}{p99:9.3f}{most:9.1f}   {took.size} sent, "
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
