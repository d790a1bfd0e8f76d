"""What burdens the service: training beside it, hours of stream, and more arms.

    python benchmarks/service/service_load.py training --model model/ --data train.parquet \
        --minutes 2
    python benchmarks/service/service_load.py memory --model model/ --minutes 120
    python benchmarks/service/service_load.py memory --model model/ --hours 24 --rate 100
    python benchmarks/service/service_load.py arms --model model/ --arms 1,2,4,8 --minutes 1

`training` measures round trips at 1 kHz alone and then while a niced process fits joint-physics to
a recording, over and over, as retraining does. `memory` measures the resident memory of `limo
serve` and gives its slope with an interval; --hours are of simulated time, as fast as the service
answers. `arms` serves more and more arms, each by a process of its own under one supervisor, at
--rate, until the 99th percentile doubles; their drivers share one process, which is burdened as
well, so the service alone would bear more. What it takes of a core for each answer says how many
arms would fill one, also where other programs use the machine.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import tempfile
import time
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from scipy.stats import t as student
from service_processes import (
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

from limo_driver.network.streaming import Keys, open_session

if TYPE_CHECKING:
    from collections.abc import Generator

TRAINING_BAR, MEMORY_BAR, ARMS_BAR = 2.0, 5.0, 2.0  # ratio of p99, MB, ratio of p99
START, SETTLE = 180.0, 20.0  # [s] for the first estimate, and until everything is compiled
LOG_SIZE = "0.5"  # [GB], so that old files are deleted while it runs
NO_CONTACT = "1000"  # [N m]; the states have no torque
NICE = 10  # of what trains
BLOCKS = 20  # of memory samples, whose means hardly depend on each other
LEVEL = 0.95
MEGABYTE = 1e6


def main() -> None:
    """Measure one of the burdens."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("burden", choices=("training", "memory", "arms", "fit"))
    parser.add_argument("--model", type=Path, required=True, help="model folder of limo train")
    parser.add_argument("--data", type=Path, help="recording to train on")
    parser.add_argument("--minutes", type=float, default=2.0, help="of each measurement")
    parser.add_argument("--hours", type=float, help="of simulated time, for memory")
    parser.add_argument(
        "--rate", type=float, default=RATE, help="of the states of memory and arms [Hz]"
    )
    parser.add_argument("--arms", default="1,2,4", help="how many, one after the other")
    given = parser.parse_args()
    if given.burden in {"training", "fit"} and given.data is None:
        parser.error("training needs --data")
    if given.burden == "fit":
        fit(given.model, given.data)
    elif given.burden == "training":
        beside_training(given.model, given.data, given.minutes)
    elif given.burden == "memory":
        served = Served(given.model, rate=given.rate, hurry=given.hours is not None)
        over_time(served, given.minutes if given.hours is None else 60.0 * given.hours)
    else:
        with_more_arms(
            given.model, [int(count) for count in given.arms.split(",")], given.minutes, given.rate
        )
    print(describe_machine())


class Served:
    """A running service and the drivers of its arms.

    Args:
        model: Model folder.
        arms: How many.
        rate: Of the states [Hz].
        hurry: Send states as fast as they are answered.
    """

    def __init__(
        self, model: Path, arms: int = 1, *, rate: float = RATE, hurry: bool = False
    ) -> None:
        self._motion, self._arms, self.rate, self._hurry = Motion(model), arms, rate, hurry
        self._model, self._open = model, ExitStack()
        self.answers: list[Answers] = []
        self.drivers: list[Driver] = []
        self.process: subprocess.Popen[bytes]

    def __enter__(self) -> Served:
        with ExitStack() as opening:  # closed where something fails on the way
            self._start(opening)
            self._open = opening.pop_all()
        return self

    def _start(self, opening: ExitStack) -> None:
        folder = Path(opening.enter_context(tempfile.TemporaryDirectory()))
        names = [f"bench{k}" for k in range(self._arms)]
        stores = [two_versions(folder / name, self._model, self._motion) for name in names]
        given = [
            part
            for name, store in zip(names, stores, strict=True)
            for part in ("--arm", f"{name}={store.root}")
        ]
        given += ["--log", str(folder / "logs"), "--log-size", LOG_SIZE, "--contact", NO_CONTACT]
        here, there = configurations(folder)
        session = opening.enter_context(open_session(config=here))
        (self.process,) = opening.enter_context(running(serve(there, *given)))
        self.answers = [Answers(session, Keys(name).estimate) for name in names]
        self.drivers = [
            opening.enter_context(
                Driver(
                    session,
                    self._motion,
                    name,
                    rate=self.rate,
                    answers=answers if self._hurry else None,
                )
            )
            for name, answers in zip(names, self.answers, strict=True)
        ]
        for answers in self.answers:
            wait_for(lambda a=answers: bool(a.sequences), START, "estimate")
        time.sleep(SETTLE)

    def __exit__(self, *_: object) -> None:
        self._open.close()

    @property
    def answered(self) -> int:
        """How many estimates came back so far, of all arms."""
        return sum(len(answers.sequences) for answers in self.answers)

    def measure(self, minutes: float) -> np.ndarray:
        """Return the round trips of some minutes [ms], of all arms; NaN is an answer lost."""
        begun = [len(driver.sent) for driver in self.drivers]
        time.sleep(60.0 * minutes)
        ended = [len(driver.sent) for driver in self.drivers]
        time.sleep(1.0)
        return np.concatenate(
            [
                answers.round_trips(driver.sent[:stop], start)
                for answers, driver, start, stop in zip(
                    self.answers, self.drivers, begun, ended, strict=True
                )
            ]
        )


def beside_training(model: Path, data: Path, minutes: float) -> None:
    """Measure alone, beside training, and alone again."""
    with Served(model) as served:
        alone = served.measure(minutes)
        with training(model, data):
            burdened = served.measure(minutes)
        again = served.measure(minutes)
    print(f"round trip [ms]             p50      p99      max   ({minutes:g} min each)")
    before, beside = show("alone", alone), show("beside training", burdened)
    after = show("alone again", again)
    print(f"p99 beside training to p99 alone: {beside / before:.2f}   bar {TRAINING_BAR:g}")
    print(f"p99 alone again to p99 alone: {after / before:.2f} (what chance does)")


@contextmanager
def training(model: Path, data: Path) -> Generator[None]:
    """Fit joint-physics in a process of its own, at low priority, until the block ends."""
    given = ["--model", str(model), "--data", str(data)]
    process = subprocess.Popen(
        [sys.executable, __file__, "fit", *given], start_new_session=True
    )  # in a session of its own, whose weight is its own, too
    try:
        yield
    finally:
        if process.poll() is not None:
            print(f"the fit ended by itself, with status {process.returncode}")
        process.kill()
        process.wait()


def fit(model: Path, data: Path) -> None:
    """Fit over and over, and give way to everything else."""
    from estimators.joint_physics import JointPhysics
    from estimators.model_folder import load_model
    from limo_driver.recordings.recording import Recording

    os.nice(NICE)
    Path("/proc/self/autogroup").write_text(str(NICE))
    simulation, recording = load_model(model).simulation, Recording.load(data)
    while True:
        JointPhysics(simulation).fit([recording])


def over_time(serving: Served, minutes: float) -> None:
    """Measure the resident memory of the service once a second, for so long of the arm's time."""
    with serving as served:
        (driver,), (answers,) = served.drivers, served.answers
        resident, began, first = [], time.monotonic(), len(driver.sent)
        while len(driver.sent) - first < 60.0 * minutes * served.rate:
            resident.append(memory(served.process.pid))
            time.sleep(1.0)
        answered, took = len(answers.sequences), (time.monotonic() - began) / 60.0
    values = np.array(resident)
    slope, half = trend(values)
    print(
        f"memory of the service over {minutes / 60.0:g} h at {served.rate:g} Hz in {took:.0f} min, "
        f"{answered} estimates of {len(driver.sent)} states [MB]"
    )
    print(f"  first, last, most      {values[0]:.1f}, {values[-1]:.1f}, {values.max():.1f}")
    tenths = ", ".join(f"{part.mean():.1f}" for part in np.array_split(values, 10))
    print(f"  by tenths              {tenths}")
    edge = max(1, values.size // 10)
    drift = values[-edge:].mean() - values[:edge].mean()
    print(f"  last tenth - first     {drift:+.2f}   bar {MEMORY_BAR:g}")
    print(f"  slope                  {slope:+.2f} ± {half:.2f} MB per hour of this machine (95 %)")


def memory(process: int) -> float:
    """Return the resident memory of a process [MB]."""
    for line in Path(f"/proc/{process}/status").read_text().splitlines():
        if line.startswith("VmRSS:"):
            return 1024.0 * float(line.split()[1]) / MEGABYTE
    sys.exit(f"process {process} ended")


def processor_time(process: int) -> float:
    """Return what a process and those that it began have had of the cores [s]."""
    ticks, parents = dict[int, int](), dict[int, int]()
    for folder in Path("/proc").glob("[0-9]*"):
        with suppress(OSError):  # it has ended
            fields = (folder / "stat").read_text().rpartition(")")[2].split()
            parents[int(folder.name)] = int(fields[1])
            ticks[int(folder.name)] = int(fields[11]) + int(fields[12])
    own = {process}
    while more := {child for child, parent in parents.items() if parent in own} - own:
        own |= more
    return sum(ticks[each] for each in own) / os.sysconf("SC_CLK_TCK")


def trend(values: np.ndarray) -> tuple[float, float]:
    """Return the slope of values a second apart [1/h] and half its interval, from block means."""
    blocks = np.array_split(values, BLOCKS)
    y = np.array([block.mean() for block in blocks])
    x = np.arange(BLOCKS) * values.size / BLOCKS / 3600.0  # [h]
    x -= x.mean()
    slope = (x @ y) / (x @ x)
    error = y - y.mean() - slope * x
    variance = (error @ error) / (BLOCKS - 2) / (x @ x)
    return slope, student.ppf(0.5 + LEVEL / 2, BLOCKS - 2) * np.sqrt(variance)


def with_more_arms(model: Path, counts: list[int], minutes: float, rate: float) -> None:
    """Serve more and more arms, each by a process under one supervisor."""
    print(
        f"round trip [ms]             p50      p99      max   ({minutes:g} min each, {rate:g} Hz)"
    )
    single = np.nan
    for count in counts:
        with Served(model, count, rate=rate) as served:
            before, answered = processor_time(served.process.pid), served.answered
            took = served.measure(minutes)
            busy = processor_time(served.process.pid) - before
            each = busy / (served.answered - answered)
            p99 = show(f"{count} arms", took)
            sent = sum(len(driver.sent) for driver in served.drivers)
        print(f"  processor time: {1e6 * each:.0f} µs an answer, {1 / each / rate:.1f} arms a core")
        single = p99 if np.isnan(single) else single
        print(f"  p99 to that of the first: {p99 / single:.2f}   ({sent} states sent in all)")
        if p99 > ARMS_BAR * single:
            print(f"p99 has more than doubled at {count} arms")
            return
    print(f"p99 has not doubled at {counts[-1]} arms")


def show(name: str, took: np.ndarray) -> float:
    """Print percentiles and what was lost; return the 99th [ms]."""
    p50, p99, most = np.nanpercentile(took, (50, 99, 100))
    lost = np.isnan(took).sum()
    print(f"  {name:24}{p50:9.3f}{p99:9.3f}{most:9.1f}   {took.size} sent, {lost} lost")
    return float(p99)


if __name__ == "__main__":
    main()
