"""Hot swaps under a stream of 1 kHz: what is lost, and by how much the estimate steps.

    python benchmarks/service/service_swaps.py --model model/ --swaps 100
    python benchmarks/service/service_swaps.py --model model/ --swaps 20 --busy 4

One process publishes joint states and asks `limo serve`, in another, to let two versions serve in
turn; they are the same model, so that no swap may show. Each version is vetted as always, which is
most of the time. The service's own log says which states it took and what it answered; so a state
that the network dropped, on its way in, and an estimate that it dropped, on its way out, are told
apart from one that the service did not give. The torque is compared with that of one stream over
the same states that never swapped.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
import time
from collections import defaultdict
from dataclasses import dataclass
from pathlib import Path

import numpy as np
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
    two_versions,
    wait_for,
)

from estimators.model_folder import load_model
from estimators.stream import Stream
from limo_driver.errors import LimoError
from limo_driver.logs.mcap_log import log_files, read_mcap
from limo_driver.network.messages import decode_event, decode_joint_state, decode_torque_estimate
from limo_driver.network.readiness import ModelClient
from limo_driver.network.streaming import Keys, open_session

STEP_BAR = 1e-6  # [N m]
START = 120.0  # [s] for the first estimate, at most
AFTER = 0.5  # [s] after a swap that count as its step
PAUSE = 1.0  # [s] between two swaps


@dataclass(frozen=True)
class Logged:
    """What the service wrote down of itself."""

    sequences: np.ndarray  # (T,) of the states it took
    stamps: np.ndarray  # (T,) [ns]
    position: np.ndarray  # (T, n) [rad]
    measured: np.ndarray  # (T, n) [N m]
    answers: dict[int, list[tuple[str, np.ndarray]]]  # version and torque, by stamp [ns]
    events: list[str]


def main() -> None:
    """Swap, and print beside the bars."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--model", type=Path, required=True, help="model folder of limo train")
    parser.add_argument("--swaps", type=int, default=100)
    parser.add_argument("--busy", type=int, default=0, help="processes that compute meanwhile")
    parser.add_argument("--rate", type=float, default=RATE, help="of the states [Hz]")
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory() as name:
        folder, motion = Path(name), Motion(arguments.model)
        store = two_versions(folder / "models", arguments.model, motion)
        here, there = configurations(folder)
        command = serve(there, "--store", str(store.root), "--log", str(folder / "logs"))
        busy = [[sys.executable, "-c", "while True: pass"]] * arguments.busy
        with open_session(config=here) as session, running(command, *busy):
            answers = Answers(session)
            with Driver(session, motion, rate=arguments.rate) as driver:
                wait_for(lambda: bool(answers.sequences), START, "estimate")
                took = swap(ModelClient(session, ARM), arguments.swaps)
                time.sleep(PAUSE)
            time.sleep(PAUSE)
            answers.close()
        logged = read(folder / "logs", len(motion.names))
        report(arguments, len(driver.sent), answers, logged, took)
    print(describe_machine())


def swap(client: ModelClient, swaps: int) -> list[tuple[float, float]]:
    """Let the versions take turns; return how long each was vetted, and the swap then took [s]."""
    took: list[tuple[float, float]] = []
    for k in range(swaps):
        try:
            facts = client.load("21"[k % 2])
            took.append((facts["vetting"], facts["seconds"] - facts["vetting"]))
        except LimoError as error:
            print(f"swap {k + 1} was refused: {error}")
        time.sleep(PAUSE)
        if sys.stderr.isatty():
            sys.stderr.write(f"\r{k + 1} of {swaps} swaps")
    return took


def read(folder: Path, n: int) -> Logged:
    """Read the log of the service."""
    keys, states, events = Keys(ARM), [], []
    answers: dict[int, list[tuple[str, np.ndarray]]] = defaultdict(list)
    for path in log_files(folder):
        for message in read_mcap(path):
            if message.topic == keys.joints:
                state = decode_joint_state(message.payload)
                states.append((message.sequence, state.stamp_ns, state.position, state.torque))
            elif message.topic == keys.estimate:
                estimate = decode_torque_estimate(message.payload)
                answers[estimate.stamp_ns].append((estimate.model, estimate.torque))
            elif message.topic == keys.event:
                events.append(decode_event(message.payload).kind)
    sequences, stamps, position, torque = zip(*states, strict=True)
    return Logged(
        np.array(sequences),
        np.array(stamps),
        np.array(position).reshape(-1, n),
        np.array(torque).reshape(-1, n),
        answers,
        events,
    )


def report(
    given: argparse.Namespace,
    sent: int,
    answers: Answers,
    logged: Logged,
    took: list[tuple[float, float]],
) -> None:
    """Print what became of every state, and the step at the swaps."""
    came = np.array(answers.sequences)
    first, last = came.min(), min(came.max(), logged.sequences.max())
    taken = logged.sequences[(logged.sequences >= first) & (logged.sequences <= last)]
    stream = Stream(load_model(given.model), given.rate, DELAY)
    delay = round(1e9 * stream.delay)
    counts = np.array([len(logged.answers[stamp - delay]) for stamp in logged.stamps])
    twice, disordered = answers.order()
    out_of_order = int((np.diff(logged.sequences) <= 0).sum())
    offered = last - first + 1
    print(f"{len(took)} of {given.swaps} swaps at {given.rate:g} Hz, the others were refused")
    if took:
        vetting, swapping = np.array(took).T
        print(f"  vetted for {vetting.max():.1f} s at most, each version once")
        median, most = np.median(swapping), swapping.max()
        print(f"  from there to the swap {median:.3f} s, at most {most:.2f}   bar 2")
    print(f"states from the first estimate on          {offered:10d} of {sent} sent")
    print(f"  dropped on their way in, or too late     {offered - taken.size:10d}")
    print(f"  the service did not answer               {(counts == 0).sum():10d}   bar 0")
    print(f"  it answered twice                        {(counts > 1).sum():10d}   bar 0")
    print(f"  it took out of order                     {out_of_order:10d}   bar 0")
    print(f"estimates that came twice                  {twice:10d}   bar 0")
    print(f"  out of order                             {disordered:10d}   bar 0")
    dropped = np.setdiff1d(taken, came).size
    print(f"  the network dropped on their way out     {dropped:10d}")
    print(f"memory began anew {logged.events.count('reset')} times (gaps in what came)")
    show_steps(stream, logged, delay)


def show_steps(stream: Stream, logged: Logged, delay: int) -> None:
    """Print by how much the torque differs from that of a stream that never swapped."""
    time_ = 1e-9 * (logged.stamps - logged.stamps[0])
    expected = stream.advance(stream.init(), time_, logged.position, logged.measured)[0].torque
    found = [logged.answers.get(stamp - delay) for stamp in logged.stamps]
    answered = np.array([t for t, answer in enumerate(found) if answer])
    versions = np.array([answer[0][0] for answer in found if answer])
    torque = np.array([answer[0][1] for answer in found if answer])
    error = np.abs(torque - expected[answered]).max(axis=1)
    swaps = np.flatnonzero(versions[1:] != versions[:-1]) + 1
    rows = int(AFTER * stream.rate)
    steps = [error[swap : swap + rows].max() for swap in swaps]
    print(f"step at a swap, {AFTER:g} s after each of {len(steps)} [N m]: ", end="")
    if steps:
        print(f"at most {max(steps):.2g}, median {np.median(steps):.2g}   bar {STEP_BAR:g}")
    else:
        print("none was seen")
        return
    cold = [without_memory(stream, time_, logged, expected, answered[swap]) for swap in swaps]
    print(f"  without the memory that it is given: median {np.median(cold):.2g}, for comparison")
    print(f"difference at any time [N m]: at most {error.max():.2g}")


def without_memory(
    stream: Stream, time_: np.ndarray, logged: Logged, expected: np.ndarray, row: int
) -> float:
    """Return the step [N m] of a model that begins at a row with no memory at all."""
    rows = slice(row, row + int(AFTER * stream.rate))
    given = time_[rows], logged.position[rows], logged.measured[rows]
    found = stream.advance(stream.init(), *given)[0].torque
    return float(np.abs(found - expected[rows]).max())


if __name__ == "__main__":
    main()
