"""Stream an arm, push it, change its friction, and see the service notice, relearn and recover.

    python examples/live_service.py        # about ten minutes, most of them in real time

Three processes, as on a real robot: this one is the driver of a simulated iiwa 14, which at 60 s of
the first run is pushed at its flange; the second run finds the same arm with gears gone cold. The
service estimates and logs in a process of its own, as `limo serve` does, and trains again in
another. From the log come OUT/live.png and the lines that are printed.
"""

from __future__ import annotations

import argparse
import json
import multiprocessing
import socket
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

import limo_driver as limo
from estimators.service.settings import RetrainingSettings, ServiceSettings
from estimators.service.store.store import ModelStore
from limo_driver.logs.mcap_log import read_mcap
from limo_driver.network.messages import decode_event, decode_torque_estimate
from limo_driver.physics import ExternalContact, TemperatureDependentFriction

if TYPE_CHECKING:
    from collections.abc import Generator

    from limo_driver.network.messages import Event

TRUTH = Path(__file__).parent / "iiwa14_hysteretic.yaml"
RATE = 250  # [Hz] of the stream
PATIENCE = 120.0  # [s] for a service to answer, or to end
PUSH = ExternalContact(windows=((60.0, 62.0),), wrench=((0.0, 25.0, -25.0, 0.0, 0.0, 0.0),))
WARM = 150.0  # [s] of stream, of which two minutes show how large the residual is usually
COLD = (0.9, 1.0, 0.65, 0.7, 0.35, 0.2, 0.15)  # [N m] of friction more in each joint
SHOWN = {"contact", "drift", "training", "trained", "promoted", "rollback", "probation_passed"}


def serve(told: Path | None, options: dict[str, Any]) -> None:
    """Serve until SIGTERM; the status goes to a file, one JSON line each."""
    with (told or Path("/dev/null")).open("w", buffering=1) as file:

        def show(status: dict[str, Any]) -> None:
            file.write(json.dumps({"status": status}) + "\n")

        with limo.serve("iiwa14", show=show, **options) as service:
            service.wait()


@contextmanager
def background_service(told: Path | None = None, **options: Any) -> Generator[None]:  # noqa: ANN401
    """Serve in a process of its own until the block ends; options are those of `limo.serve`.

    Driver and service in one process would take turns at its interpreter, and keep no millisecond.
    """
    process = multiprocessing.get_context("spawn").Process(target=serve, args=(told, options))
    process.start()
    try:
        yield
    finally:
        process.terminate()  # SIGTERM, at which the service closes in order
        process.join(PATIENCE)
        process.kill()


def learn(out: Path) -> None:
    """Record the arm while it is warm, and put what was learned into a store."""
    motion = limo.plan("iiwa14", limo.PlanRequest(scaffolds=8), seed=1)
    warm = limo.Simulation.load(TRUTH)
    recording = limo.run("mujoco", motion, simulation=warm, rate=RATE)
    believed = limo.identify("iiwa14", [recording]).simulation
    print(f"identified from the warm arm: {believed.score(recording).headline()}")
    limo.train(believed, [recording]).save(out / "model")
    store = ModelStore(out / "models")
    store.add(out / "model", golden=recording)
    store.promote(1, "learned while warm")


def arms() -> tuple[limo.Simulation, limo.Simulation]:
    """Return the arm that is pushed, and the arm that went cold."""
    known = limo.Simulation.load(TRUTH)
    cold = [
        TemperatureDependentFriction(joint=j, excess=excess, time_constant=1e6)
        for j, excess in enumerate(COLD, start=1)
    ]
    pushed = replace(known, effects=(*known.effects, PUSH))
    return pushed, replace(known, effects=(*known.effects, *cold))


def network(out: Path) -> tuple[Path, Path]:
    """Write Zenoh configurations of the service, which listens, and the driver, which connects.

    On a network with multicast none is needed.
    """
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        endpoint = f"tcp/127.0.0.1:{free.getsockname()[1]}"
    paths = out / "service.json5", out / "driver.json5"
    for path, role in zip(paths, ("listen", "connect"), strict=True):
        alone = {"multicast": {"enabled": False}}
        path.write_text(json.dumps({role: {"endpoints": [endpoint]}, "scouting": alone}))
    return paths


def stream(out: Path, seconds: float) -> None:
    """Serve while the arm moves: first pushed once, then cold."""
    here, there = network(out)
    pushed, cooled = arms()
    motion = limo.plan("iiwa14", limo.PlanRequest(scaffolds=12), seed=2).trajectory
    with background_service(
        store=out / "models",
        log=out / "logs",
        config=here,
        settings=ServiceSettings(contact_torque=3.0),
        retraining=RetrainingSettings(seconds=90.0),
    ):
        for arm, duration, seed in ((pushed, WARM, 3), (cooled, seconds, 4)):
            print(f"streaming {duration:g} s", flush=True)
            limo.run(
                "mujoco",
                motion.first(duration),
                simulation=arm,
                seed=seed,
                rate=RATE,
                stream=limo.Streaming(wait_for_estimates=PATIENCE, config=there),
            )


class Log:
    """What the service wrote of external torque and events."""

    def __init__(self, folder: Path) -> None:
        self.events: list[Event] = []
        stamps, external, self.models = [], [], []
        for path in sorted(folder.glob("*.mcap")):
            for message in read_mcap(path):
                if message.topic.endswith("/event"):
                    self.events.append(decode_event(message.payload))
                elif message.topic.endswith("/estimate"):
                    estimate = decode_torque_estimate(message.payload)
                    if not estimate.reset:
                        stamps.append(estimate.stamp_ns)
                        external.append(estimate.external)
                        self.models.append(estimate.model)
        self.begin = min(stamps)
        self.time = 1e-9 * (np.array(stamps) - self.begin)  # [s]
        self.external = np.array(external)  # (T, n) [N m]

    def rms(self, window: float = 2.0) -> tuple[np.ndarray, np.ndarray]:
        """Return times and RMS over windows, (K,) [s] and (K, n) [N m]."""
        which = (self.time / window).astype(int)
        kept = np.unique(which)
        squares = np.array([(self.external[which == k] ** 2).mean(axis=0) for k in kept])
        return (kept + 0.5) * window, np.sqrt(squares)

    def when(self, event: Event) -> float:
        """Return when it was told [s]."""
        return 1e-9 * (event.stamp_ns - self.begin)


def picture(log: Log, path: Path) -> None:
    """Draw the external torque of each joint over time, the models that served, and the events."""
    import matplotlib.pyplot as plt  # which the process of the service has no use for

    time, rms = log.rms()
    figure, axes = plt.subplots(figsize=(11, 5.5), layout="constrained")
    for j in range(rms.shape[1]):
        axes.semilogy(time, rms[:, j], lw=1.2, label=f"joint {j + 1}")
    for k, (start, end, model) in enumerate(reigns(log)):
        axes.axvspan(start, end, color=f"C{k}", alpha=0.08, lw=0)
        axes.text(0.5 * (start + end), 1.02, f"model {model}", ha="center",
                  transform=axes.get_xaxis_transform())  # fmt: skip
    for k, (when, text) in enumerate(moments(log)):
        axes.axvline(when, color="0.4", lw=0.8, ls=":")
        place = axes.get_xaxis_transform()
        axes.text(when, 0.98 - 0.05 * (k % 4), f" {text}", fontsize=8, va="top", transform=place)
    axes.set(xlabel="time [s]", ylabel="measured less estimated torque, RMS over 2 s [N m]")
    axes.legend(ncols=7, fontsize=8, loc="lower center")
    figure.savefig(path, dpi=130)


def moments(log: Log) -> list[tuple[float, str]]:
    """Return what happened when [s]; what happens to several joints at once is said once."""
    shown: list[tuple[float, str]] = []
    for event in log.events:
        when, text = log.when(event), event.kind.replace("_", " ")
        if event.kind in SHOWN and not any(t == text and when - w < 1.0 for w, t in shown):
            shown.append((when, text))
    return shown


def reigns(log: Log) -> list[tuple[float, float, str]]:
    """Return from when to when [s] each model served."""
    models = np.array(log.models)
    starts = np.r_[0, np.flatnonzero(models[1:] != models[:-1]) + 1]
    stops = np.r_[starts[1:], len(models)]
    return [
        (float(log.time[a]), float(log.time[b - 1]), str(models[a]))
        for a, b in zip(starts, stops, strict=True)
    ]


def main() -> None:
    """Learn, stream, draw."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=Path("out/live"), help="folder to write")
    parser.add_argument("--seconds", type=float, default=300.0, help="of the arm gone cold")
    options = parser.parse_args()
    options.out.mkdir(parents=True, exist_ok=True)
    learn(options.out)
    stream(options.out, options.seconds)
    log = Log(options.out / "logs")
    picture(log, options.out / "live.png")
    print("\nwhat the service told:")
    for event in log.events:
        print(f"  {log.when(event):7.1f} s  {event.kind:16} {event.text}")
    print(f"see {options.out / 'live.png'}")


if __name__ == "__main__":
    main()
