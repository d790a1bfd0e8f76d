"""Stream an arm at 1 kHz, push it, and see the push in the torque that nothing else explains.

    make demo
    python examples/stream_and_push.py --model out/demo/model --motion out/demo/test.traj.parquet

Half a minute, two processes: this one drives a simulated iiwa 14 in real time, which is pushed at
its flange for a while; another one serves, as `limo serve` does: it estimates the torque that the
motion needs, and logs. The arm stands until the first estimates come, however long the service
takes to load and compile. OUT/live.png shows both.
"""

from __future__ import annotations

import argparse
import json
import shutil
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Self

import numpy as np
from live_service import PATIENCE, TRUTH, background_service, network

import limo_driver as limo
from estimators.service.settings import ServiceSettings
from limo_driver.errors import LimoError
from limo_driver.logs.mcap_log import read_mcap
from limo_driver.network.messages import decode_event, decode_torque_estimate
from limo_driver.physics import ExternalContact

if TYPE_CHECKING:
    from limo_driver.network.messages import Event

SECONDS = 20.0  # of stream
# in the time of the motion, which begins once there are estimates
PUSH = ExternalContact(windows=((8.0, 9.5),), wrench=((0.0, 12.0, -12.0, 0.0, 0.0, 0.0),))
THRESHOLD = 2.0  # [N m] of external torque that is a contact
DEVIATIONS = 1.96  # of a 95 % interval


@dataclass(frozen=True)
class Live:
    """What the service wrote."""

    time: np.ndarray  # (T,) [s]
    torque: np.ndarray  # (T, n) [N m], estimated
    std: np.ndarray  # (T, n) [N m]
    external: np.ndarray  # (T, n) [N m], measured less estimated
    events: list[tuple[float, Event]]  # when [s]
    status: dict[str, Any]  # the last one

    @classmethod
    def read(cls, folder: Path) -> Self:
        """Read the log and the last status.

        Raises:
            LimoError: No state was answered; says what was heard last of the service.
        """
        messages = [m for path in sorted(folder.glob("*.mcap")) for m in read_mcap(path)]
        answers = [
            decode_torque_estimate(m.payload) for m in messages if m.topic.endswith("/estimate")
        ]
        told = [json.loads(line) for line in (folder / "service.jsonl").read_text().splitlines()]
        status = [line["status"] for line in told if "status" in line]
        counted = [one for one in status if one.get("latency", {}).get("count")]
        if not answers or not counted:
            said = status[-1]["state"] if status else "nothing"
            raise LimoError(
                f"{folder}: no estimates in the log; the service said last: {said}. "
                "Is it given another model, or the driver another rate?"
            )
        begin = answers[0].stamp_ns
        unknown = np.where([answer.reset for answer in answers], np.nan, 1.0)[:, None]
        events = [decode_event(m.payload) for m in messages if m.topic.endswith("/event")]
        return cls(
            1e-9 * np.array([answer.stamp_ns - begin for answer in answers]),
            *(
                unknown * np.array([getattr(a, name) for a in answers])
                for name in ("torque", "std", "external")
            ),
            [(1e-9 * (stamp_of(event) - begin), event) for event in events],
            counted[-1],
        )


def stamp_of(event: Event) -> int:
    """Return when an event was by the clock of the stream [ns], which estimates have.

    A machine that is too slow for the stream falls behind, and tells a contact seconds later.
    """
    return int(event.facts.get("state_stamp", event.stamp_ns))


def stream(model: Path, motion: Path, out: Path) -> Live:
    """Serve while the arm moves and is pushed."""
    logs = out / "live"
    shutil.rmtree(logs, ignore_errors=True)
    logs.mkdir(parents=True)
    known = limo.Simulation.load(TRUTH)
    here, there = network(logs)
    with background_service(
        logs / "service.jsonl",
        model=model,
        log=logs,
        config=here,
        settings=ServiceSettings(contact_torque=THRESHOLD),
    ):
        limo.run(
            "mujoco",
            limo.Trajectory.load(motion).first(SECONDS),
            simulation=replace(known, effects=(*known.effects, PUSH)),
            seed=4,
            record=out / "pushed.parquet",
            stream=limo.Streaming(wait_for_estimates=PATIENCE, config=there),
        )
    return Live.read(logs)


def picture(live: Live, path: Path) -> None:
    """Draw the torque of the joint that feels the push most, and what nothing else explains."""
    import matplotlib.pyplot as plt  # which the process of the service has no use for

    joint = int(np.nanargmax(np.nanmax(np.abs(live.external), axis=0)))
    figure, (above, below) = plt.subplots(
        2, 1, figsize=(11, 6.5), sharex=True, layout="constrained", height_ratios=(2, 3)
    )
    torque, margin = live.torque[:, joint], DEVIATIONS * live.std[:, joint]
    above.plot(live.time, torque + live.external[:, joint], color="C3", lw=1, label="measured")
    above.plot(live.time, torque, color="C0", lw=1, label="estimated")
    above.fill_between(
        live.time, torque - margin, torque + margin, color="C0", alpha=0.3, lw=0,
        label="its 95 % interval",
    )  # fmt: skip
    above.set(ylabel=f"torque of joint {joint + 1} [N m]")
    above.legend(ncols=3, fontsize=9, loc="upper right")
    for j in range(live.external.shape[1]):
        below.plot(live.time, live.external[:, j], lw=1, label=f"joint {j + 1}")
    below.axhspan(-THRESHOLD, THRESHOLD, color="0.9", zorder=0, label="no contact")
    told = [when for when, event in live.events if event.kind == "contact"]
    for k, when in enumerate(told):
        below.axvline(when, color="0.3", lw=0.8, ls=":", label="_" if k else "contact told")
    below.set(xlabel="time [s]", ylabel="measured less estimated torque [N m]")
    below.legend(ncols=5, fontsize=8, loc="upper right")
    figure.savefig(path, dpi=130)
    plt.close(figure)


def summary(live: Live) -> str:
    """Return what was told, and how fast."""
    latency, lost = live.status["latency"], live.status["arrivals"]["lost"]
    free = ~np.any([abs(live.time - when) < 3.0 for when, _ in contacts(live)], axis=0)
    rms = np.sqrt(np.nanmean(live.external[free] ** 2, axis=0))
    lines = [f"{when:5.1f} s  {event.text}" for when, event in contacts(live)]
    return "\n".join([
        f"{len(live.time)} estimates, {lost} states lost; state taken to estimate out: "
        f"{1e6 * latency['p50']:.0f} µs (p50), {1e6 * latency['p99']:.0f} µs (p99); the last ones "
        f"up to {live.status['age']['longest']:.2g} s after the arm's clock",
        "measured less estimated torque without contact, RMS [N m]: "
        + " ".join(f"{value:.2f}" for value in rms),
        *lines,
    ])  # fmt: skip


def contacts(live: Live) -> list[tuple[float, Event]]:
    """Return the events of contact."""
    return [(when, e) for when, e in live.events if e.kind in {"contact", "contact_end"}]


def main() -> None:
    """Stream, push, draw."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--model", type=Path, required=True, help="model folder of limo train")
    parser.add_argument("--motion", type=Path, required=True, help="trajectory to stream")
    parser.add_argument("--out", type=Path, default=Path("out/push"), help="folder to write")
    options = parser.parse_args()
    options.out.mkdir(parents=True, exist_ok=True)
    live = stream(options.model, options.motion, options.out)
    picture(live, options.out / "live.png")
    print(f"\n{summary(live)}\nsee {options.out / 'live.png'}")


if __name__ == "__main__":
    main()
