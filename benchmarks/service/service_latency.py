"""Joint state in, estimate out, over Zenoh between processes, beside a bare echo in the same run.

    python benchmarks/service/service_latency.py --model model/ --minutes 10
    python benchmarks/service/service_latency.py --model model/ --rates 1000,100,30 --minutes 1
    python benchmarks/service/service_latency.py --model slow/ --rates 10 --delay 0.5 --minutes 1
    nice -n -1 python benchmarks/service/service_latency.py --model model/ --busy 1 --minutes 2
    python benchmarks/service/service_latency.py --model model/ --slow slow/ --bars

One process publishes joint states and takes the time until their estimates come back from `limo
serve`, in another process. Half a cycle later it sends the same state, encoded in the same way, to
a third process, which does nothing but send its bytes back: the bar is a ratio to that. All share
this machine's cores. With `--busy`, so do processes that compute without end at the least priority.
Ratios are medians of ten parts of the run, in each of which the two took turns. `--bars` does all
in five minutes: three rates, one beside a busy process, and eight arms at 200 Hz.
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
from contextlib import ExitStack
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
from limo_driver.network.streaming import Keys, declare_stream, open_session
from limo_driver.robot.realtime import PRIORITY

BARS = (1.3, 2.0)  # ratios to the echo: of p50, of p99
BUSY = "import os; os.nice(19)\nwhile True: sum(i * i for i in range(100_000))"
ECHO_IN, ECHO_OUT = "limo/bench/echo/in", "limo/bench/echo/out"
START = 180.0  # [s] for service and echo to be there, at most
LEAD = 5.0  # [s] of the served stream that do not count
PARTS = 10
ARMS, ARMS_RATE = 8, 200.0  # [Hz]


def main() -> None:
    """Measure, and print beside the bars."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--model", type=Path, required=True, help="model folder of limo train")
    parser.add_argument("--slow", type=Path, help="model folder of at most 4 Hz, for --bars")
    parser.add_argument("--bars", action="store_true", help="everything that has a bar")
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
    if arguments.bars:
        all_bars(arguments)
    else:
        for rate in map(float, arguments.rates.split(",")):
            at_rate(arguments, rate)
    print(describe_machine())


def all_bars(given: argparse.Namespace) -> None:
    """Measure what has a bar, each briefly."""
    for rate, busy, minutes in ((RATE, 0, 0.5), (100.0, 0, 0.5), (10.0, 0, 1.0), (RATE, 1, 0.5)):
        own = vars(given) | {"busy": busy, "minutes": minutes}
        if rate == 10.0:
            own |= {"model": given.slow or given.model, "delay": 0.5}
        print(f"{rate:g} Hz beside {busy} busy processes")
        at_rate(argparse.Namespace(**own), rate)
    several_arms(given)


def several_arms(given: argparse.Namespace) -> None:
    """Print the least share of states that is answered of any of eight arms."""
    motion, names = Motion(given.model), [f"bench{k}" for k in range(ARMS)]
    with tempfile.TemporaryDirectory() as folder, ExitStack() as open_:
        here, there = configurations(Path(folder))
        arms = [part for name in names for part in ("--arm", name)]
        session = open_.enter_context(open_session(config=here))
        open_.enter_context(running(serve(there, *arms, "--model", str(given.model))))
        answers = [Answers(session, Keys(name).estimate) for name in names]
        for name in names:
            wait_until_serving(session, name, until="waiting", timeout=START)
        drivers = [
            open_.enter_context(Driver(session, motion, name, rate=ARMS_RATE)) for name in names
        ]
        for name in names:
            wait_until_serving(session, name, timeout=START)
        first = [len(driver.sent) + round(LEAD * ARMS_RATE) for driver in drivers]
        time.sleep(LEAD + 20.0)
        last = [len(driver.sent) - round(0.5 * ARMS_RATE) for driver in drivers]
        shares = [
            np.isfinite(own.round_trips(driver.sent[:stop], start)).mean()
            for own, driver, start, stop in zip(answers, drivers, first, last, strict=True)
        ]
    print(f"{ARMS} arms at {ARMS_RATE:g} Hz: answered at least {min(shares):.2%}   bar 99%")


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
    parts = [
        np.array([np.nanpercentile(part, (50, 99)) for part in np.array_split(took, PARTS)])
        for took in (ours, bare)
    ]
    p50, p99 = np.median(parts[0] / parts[1], axis=0)
    print(f"{'ratio':22}{p50:9.2f}{p99:9.2f}            bars {BARS[0]:g}, {BARS[1]:g}")
    lost = [float(np.isnan(took).mean()) for took in (ours, bare)]
    print(
        f"{'lost more':22}{lost[0] - lost[1]:9.2%}   of {lost[1]:.2%}   bar 0.1% beside busy ones"
    )


def show(name: str, answers: Answers, sent: list[float], first: int) -> np.ndarray:
    """Print percentiles and what went missing from a number on; return all [ms]."""
    answers.close()
    took = answers.round_trips(sent, first)
    p50, p99, most = np.nanpercentile(took, (50, 99, 100))
    twice, disordered = answers.order()
    print(
        f"{name:22}{p50:9.3f}{p99:9.3f}{most:9.1f}   {took.size} sent, "
        f"{np.isnan(took).sum()} lost, {twice} twice, {disordered} out of order"
    )
    return took


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
