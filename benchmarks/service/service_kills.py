"""kill -9 of driver, service and a writer of the model store at random, and what that costs.

    python benchmarks/service/service_kills.py --model model/ --kills 50
    python benchmarks/service/service_kills.py --model model/ --kills 20 --only service

`limo run --stream` drives an ideal arm, `limo serve` answers and logs, and a third process adds
versions to the store and makes them challengers without end, as a trainer does when it is done.
Before half of the kills of the service it is asked to promote another version. After each kill:
what had been published and is in no file, whether every version of the store verifies, and how
long the service takes from its start until it answers with the champion.
"""

from __future__ import annotations

import argparse
import random
import subprocess
import sys
import tempfile
import threading
import time
from collections import Counter
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from service_processes import (
    ARM,
    LIMO,
    Motion,
    configurations,
    describe_machine,
    running,
    save_trajectory,
    serve,
    two_versions,
    wait_for,
)

from estimators.service.store.store import ModelStore
from limo_driver.errors import LimoError, RecordingError
from limo_driver.logs.mcap_log import log_files, read_mcap
from limo_driver.network.messages import (
    Attachment,
    decode_event,
    decode_joint_state,
    decode_torque_estimate,
)
from limo_driver.network.readiness import ModelClient
from limo_driver.network.streaming import Keys, open_session
from limo_driver.recordings.files.recorder import read_log

if TYPE_CHECKING:
    import zenoh

LOST_BAR, BACK_BAR = 1.0, 3.0  # [s]
LENGTH = 1200.0  # [s] of the trajectory, after which the driver is begun anew
PATIENCE = 180.0  # [s] for anything to come back, at most
ARRIVING = 0.2  # [s] for what was sent before a kill
VICTIMS = ("driver", "service", "writer")
PHASES = ("python, imports, store", "rate, models, warm-up", "first estimate", "together")


class Observer:
    """The newest of what is on the network."""

    def __init__(self, session: zenoh.Session) -> None:
        keys = Keys(ARM)
        self.measured = 0.0  # [s] of the robot's clock, newest state
        self.estimated = 0  # [ns], newest estimate
        self.model = ""
        self.estimates = 0
        self.first = self.alive = self.serving = np.nan  # of the performance counter [s]
        self._subscribers = [
            session.declare_subscriber(keys.joints, self._take_state),
            session.declare_subscriber(keys.estimate, self._take_estimate),
            session.declare_subscriber(keys.event, self._take_event),
            session.liveliness().declare_subscriber(keys.alive("service"), self._take_token),
        ]

    def forget(self) -> None:
        """Wait for the first of everything again."""
        self.first = self.alive = self.serving = np.nan

    def _take_state(self, sample: zenoh.Sample) -> None:
        if sample.attachment is not None:
            self.measured = 1e-9 * Attachment.decode(sample.attachment.to_bytes()).stamp_ns

    def _take_estimate(self, sample: zenoh.Sample) -> None:
        estimate = decode_torque_estimate(sample.payload.to_bytes())
        self.estimated, self.model = estimate.stamp_ns, estimate.model
        self.estimates += 1
        if np.isnan(self.first):
            self.first = time.perf_counter()

    def _take_event(self, sample: zenoh.Sample) -> None:
        if decode_event(sample.payload.to_bytes()).kind == "serving":
            self.serving = time.perf_counter()

    def _take_token(self, sample: zenoh.Sample) -> None:
        if str(sample.kind).endswith("PUT"):
            self.alive = time.perf_counter()


class Bench:
    """The processes, what they write, and what was found.

    Args:
        folder: For everything.
        model: Model folder.
        config: Of Zenoh, for the processes.
        session: Of this process.
    """

    def __init__(self, folder: Path, model: Path, config: Path, session: zenoh.Session) -> None:
        self.folder, self.model, self.config, self.session = folder, model, config, session
        motion = Motion(model)
        self.store = two_versions(folder / "models", model, motion)
        save_trajectory(folder / "motion.traj.parquet", motion, self.store.robot, LENGTH)
        self.observer = Observer(session)
        self.runs = 0
        self.lost: dict[str, list[float]] = {"driver": [], "service": []}
        self.back: list[list[float]] = []  # phases of each start [s]
        self.faults: list[str] = []

    def command(self, victim: str) -> list[str]:
        """Return how to run a process."""
        if victim == "driver":
            self.runs += 1
            self.observer.measured = 0.0
            given = ["--backend", "virtual", "--stream", "--name", ARM, "--json"]
            given += ["--trajectory", str(self.folder / "motion.traj.parquet")]
            given += ["--record", str(self.recording), "--zenoh-config", str(self.config)]
            return [*LIMO, "run", *given]
        if victim == "service":
            given = ["--store", str(self.store.root), "--log", str(self.folder / "logs")]
            return serve(self.config, *given)
        given = ["--model", str(self.model), "--write-to", str(self.store.root)]
        return [sys.executable, __file__, *given]

    @property
    def recording(self) -> Path:
        """Where the driver that runs records."""
        return self.folder / f"run{self.runs}.parquet"

    def check_driver(self) -> None:
        """Look for what was published in what the driver left of its recording."""
        partial = self.recording.with_name(f"{self.recording.name}.partial")
        try:
            times = read_log(partial)["time"]
        except RecordingError as error:
            self.faults.append(str(error))
            return
        kept = times[-1].as_py() if len(times) else 0.0  # it was killed before it wrote a row
        self.lost["driver"].append(max(0.0, self.observer.measured - kept))

    def check_service(self) -> None:
        """Look for what was published in the log, which has to be readable."""
        newest, key = 0, Keys(ARM).estimate
        try:
            for message in read_mcap(log_files(self.folder / "logs")[-1]):
                if message.topic == key:
                    newest = decode_torque_estimate(message.payload).stamp_ns
                elif message.topic == Keys(ARM).joints:
                    decode_joint_state(message.payload)
        except LimoError as error:
            self.faults.append(str(error))
            return
        self.lost["service"].append(max(0.0, 1e-9 * (self.observer.estimated - newest)))

    def check_store(self, *, replay: bool = False) -> int:
        """Check every version, and replay its golden motion; return how many there are."""
        try:
            store = ModelStore(self.store.root, self.store.robot)
            _ = store.aliases
            for version in store.versions():
                version.check_files()
                if replay:
                    version.verify()
        except LimoError as error:
            self.faults.append(str(error))
        return len(self.store.numbers())

    def check_return(self, began: float) -> None:
        """Note how long the service took to come back, and whether the champion serves."""
        seen = self.observer
        wait_for(lambda: not np.isnan(seen.first), PATIENCE, "estimate after a kill")
        phases = np.diff([began, seen.alive, seen.serving, seen.first])  # an event may be overtaken
        self.back.append([*phases.tolist(), seen.first - began])
        if seen.model != str(self.store.aliases.champion):
            self.faults.append(f"{seen.model} serves, champion is {self.store.aliases.champion}")


def main() -> None:
    """Kill, and print beside the bars."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--model", type=Path, required=True, help="model folder of limo train")
    parser.add_argument("--kills", type=int, default=50)
    parser.add_argument("--only", choices=VICTIMS, help="the one that is killed; else any of them")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--write-to", type=Path, help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    if arguments.write_to:
        write_versions(arguments.write_to, arguments.model)
        return
    killed: Counter[str] = Counter()
    draw = random.Random(arguments.seed)  # noqa: S311
    with tempfile.TemporaryDirectory() as name:
        here, there = configurations(Path(name), "router")
        with open_session(config=here) as session:
            bench = Bench(Path(name), arguments.model, there, session)
            with running(*map(bench.command, VICTIMS)) as processes:
                for _ in range(arguments.kills):
                    victim = arguments.only or draw.choice(VICTIMS)
                    killed[victim] += 1
                    kill(bench, processes, victim, draw)
            report(bench, killed)
    print(describe_machine())


def kill(
    bench: Bench, processes: list[subprocess.Popen[bytes]], victim: str, draw: random.Random
) -> None:
    """Kill one process while everything runs, look at what is left, and begin it anew."""
    settle(bench, processes)
    if victim == "service" and draw.random() < 0.5:
        threading.Thread(target=promote, args=(bench,), daemon=True).start()
    time.sleep(draw.uniform(0.0, 3.0))
    place = VICTIMS.index(victim)
    processes[place].kill()
    processes[place].wait()
    time.sleep(ARRIVING)
    if victim == "driver":
        bench.check_driver()
    elif victim == "service":
        bench.check_service()
    bench.check_store()
    bench.observer.forget()
    began = time.perf_counter()
    processes[place] = subprocess.Popen(bench.command(victim))
    if victim == "service":
        bench.check_return(began)


def settle(bench: Bench, processes: list[subprocess.Popen[bytes]]) -> None:
    """Wait until estimates come; begin the driver anew if its trajectory is over."""
    if processes[0].poll() is not None:
        processes[0] = subprocess.Popen(bench.command("driver"))
    seen = bench.observer.estimates
    wait_for(lambda: bench.observer.estimates > seen + 100, PATIENCE, "stream of estimates")


def promote(bench: Bench) -> None:
    """Ask for another champion, which may come to nothing when the service is killed."""
    with suppress(LimoError):
        other = 1 if bench.store.aliases.champion == 2 else 2
        ModelClient(bench.session, ARM).promote(str(other), "to be killed meanwhile")


def write_versions(root: Path, model: Path) -> None:
    """Add versions and challenge the champion with them, until killed."""
    store, golden = ModelStore(root), Motion(model).recording()
    while True:
        version = store.add(model, golden=golden, parent=store.aliases.champion)
        store.challenge(version.number, "trained")


def report(bench: Bench, killed: Counter[str]) -> None:
    """Print what was lost and how long the service took."""
    print("killed: " + ", ".join(f"{victim} {killed[victim]}" for victim in VICTIMS))
    for victim, lost in bench.lost.items():
        what = "rows of the recording" if victim == "driver" else "messages of the log"
        show(f"{what} lost with the {victim} [s]", lost, f"bar {LOST_BAR:g}")
    print("service back with the champion [s], from its start:")
    columns = np.array(bench.back).reshape(-1, len(PHASES)).T
    for phase, values in zip(PHASES, columns, strict=True):
        show(f"  {phase}", values.tolist(), f"bar {BACK_BAR:g}" if phase == PHASES[-1] else "")
    versions = bench.check_store(replay=True)
    print(f"store: {versions} versions, each with its golden motion replayed")
    print(f"faults: {len(bench.faults)}   bar 0")
    for fault in bench.faults:
        print(f"  {fault}")


def show(name: str, values: list[float], bar: str) -> None:
    """Print median and largest of some values."""
    if values:
        middle, most = np.nanmedian(values), np.nanmax(values)
        print(f"{name:47}median {middle:6.2f}   most {most:6.2f}   {bar}")


if __name__ == "__main__":
    main()
