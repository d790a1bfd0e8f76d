"""What the live page costs: updates a second, and the part of a core that `limo watch --web` takes.

    python benchmarks/service/live_page.py        # needs Chromium; 20 s

An arm of seven joints is published at 1 kHz, with estimates, as a driver and a service do. The
bars: 10 updates a second in the browser, 15 % of a core.
"""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
import threading
import time
from pathlib import Path

import numpy as np

HERE = Path(__file__).parents[2]
sys.path[:0] = [str(HERE / folder) for folder in ("docs/site", "tests/limo_driver/network")]

from browser import browser  # noqa: E402
from sessions import configurations_of_two  # noqa: E402

from limo_driver.model import RobotModel  # noqa: E402
from limo_driver.network.messages import JointStateCodec, TorqueEstimateCodec  # noqa: E402
from limo_driver.network.streaming import Keys, declare_stream, open_session  # noqa: E402

SECONDS = 15.0
WATCH = "from limo_driver.cli import main; main()"


def publish(config: Path, stop: threading.Event) -> None:
    """Publish states and estimates at 1 kHz."""
    names = RobotModel.load("iiwa14").joint_names
    states, estimates, zero = JointStateCodec(names), TorqueEstimateCodec(names), np.zeros(7)
    keys = Keys("arm")
    with open_session(config=config) as session:
        outlets = [declare_stream(session, key) for key in (keys.joints, keys.estimate)]
        began, k = time.perf_counter(), 0
        while not stop.is_set():
            k += 1
            q = 0.3 * np.sin(1e-3 * k + np.arange(7))
            outlets[0].put(states.encode(10**6 * k, q, zero, zero))
            outlets[1].put(estimates.encode(10**6 * k, q, zero + 0.1, 0.1 * q, q > 1))
            time.sleep(max(0.0, began + 1e-3 * k - time.perf_counter()))


def cpu(pid: int) -> float:
    """Return the CPU time that a process took [s]."""
    fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def main() -> None:
    """Measure and print."""
    with tempfile.TemporaryDirectory() as folder:
        here, there = configurations_of_two(Path(folder))
        words = ["watch", "--arm", "arm", "--web", "--port", "0", "--zenoh-config", str(here)]
        stop = threading.Event()
        source = threading.Thread(target=publish, args=(there, stop))
        with subprocess.Popen([sys.executable, "-c", WATCH, *words], stdout=subprocess.PIPE,
                              text=True) as process:  # fmt: skip
            assert process.stdout is not None
            address = process.stdout.readline().split()[-1]
            source.start()
            with browser() as tab:
                tab.look(address)
                tab.wait("Number(document.body.dataset.frames) > 5")
                counts = "[document.body.dataset.updates, document.body.dataset.frames].map(Number)"
                before, spent, began = tab.value(counts), cpu(process.pid), time.perf_counter()
                time.sleep(SECONDS)
                after, seconds = tab.value(counts), time.perf_counter() - began
                share = (cpu(process.pid) - spent) / seconds
                if len(sys.argv) > 1:
                    tab.picture(Path(sys.argv[1]))
            stop.set()
            source.join()
            process.terminate()
    updates, frames = ((b - a) / seconds for a, b in zip(before, after, strict=True))
    print(f"updates in the browser   {updates:5.1f} Hz   bar 10")
    print(f"frames drawn, no GPU     {frames:5.1f} Hz")
    print(f"part of a core           {100 * share:5.1f} %    bar 15")


if __name__ == "__main__":
    main()
