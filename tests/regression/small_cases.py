"""Small cases: an arm without torque, an export to each target, and a session of the service.

Like the six recordings of `frozen_cases`, they start from stored inputs, and go through commands,
what `limo_driver` exports, and bytes on the wire. Each takes seconds.
"""

from __future__ import annotations

import hashlib
import json
import queue
import re
import shutil
import struct
import sys
from functools import partial
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pyarrow.parquet as pq
import zenoh
from frozen_cases import DATA, computed_apart, json_of, limo, table_of, write_values, yaml_of
from frozen_values import summary

import limo_driver
from limo_driver.network.messages import JointStateCodec, decode_torque_estimate
from limo_driver.network.streaming import open_session

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping

    from limo_driver.network.messages import Event

PATIENCE = 300.0  # [s]; matters only where something is broken
SHORT = 200  # lines of a text that is kept line by line
_FIGURE = re.compile(r"(?<![\w.])-?\d+(?:\.\d+)?(?:[eE][-+]?\d+)?")

RATE, ARM = 100.0, "arm"  # [Hz]
STATES = 700
PUSH = slice(300, 360)  # states in which something pushes joint 1
GAP = range(500, 560)  # states that are lost
START = 1_700_000_000_000_000_000  # [ns]


def _identify() -> dict[str, Any]:
    printed = limo(
        "identify", "servos.parquet", "--robot", "servos.xml", "--out", "i.yaml", "--json"
    )
    return {"printed": json.loads(printed), "sim": yaml_of("i.yaml")}


def _diagnose() -> dict[str, Any]:
    limo("diagnose", "servos.parquet", "--sim", "servos_believed.yaml", "--out", "d")
    verdict = json_of("d/verdict.json")
    return {"verdict": verdict, "sim": yaml_of("d/sim.yaml")}


def _predict() -> dict[str, Any]:
    given = ("--sim", "servos_believed.yaml", "--free-running", "--out", "p.parquet")
    limo("predict", "servos.parquet", *given)
    return {"predicted": table_of("p.parquet")}


def _exported(to: str, sim: str, *, signs: bool = True) -> dict[str, Any]:
    """Export a simulation or a model, and return what was printed and what the files hold.

    Args:
        to: The target.
        sim: What is exported.
        signs: Whether figures have one; those of the root of a covariance are free.
    """
    printed = json.loads(limo("export", sim, "--to", to, "--out", to, "--json"))
    texts = {path: Path(path).read_text(encoding="utf-8") for path in printed["files"]}
    return {"printed": printed, "files": {path: _text(t, signs) for path, t in texts.items()}}


def _text(text: str, signs: bool) -> dict[str, Any]:
    """Return the words and the figures of a file, the words of a long one by their digest."""
    text = text.replace(f"limo {version('limo')}", "limo")
    lines = [" ".join(line.split()) for line in _FIGURE.sub("#", text).splitlines()]
    figures = np.array(_FIGURE.findall(text), dtype=float)
    long = hashlib.sha256(" ".join(lines).encode()).hexdigest()
    return {
        "words": lines if len(lines) <= SHORT else long,
        "figures": summary(figures if signs else np.abs(figures)),
    }


def _usd() -> dict[str, Any]:
    sim = Path("two_links_true.yaml").read_text(encoding="utf-8").replace(".urdf", ".usda")
    Path("usd.yaml").write_text(sim, encoding="utf-8")
    return _exported("usd", "usd.yaml")


def _train() -> dict[str, Any]:
    """Train the model that the stages after this one use."""
    given = ("--sim", "two_links_believed.yaml", "--model", "joint-physics", "--out", "model")
    return {"printed": json.loads(limo("train", "two_links.parquet", *given, "--json"))}


def _session() -> dict[str, Any]:
    """Serve the model, answer one state after the other, and return all that was said."""
    events: queue.SimpleQueue[Event] = queue.SimpleQueue()
    settings = limo_driver.ServiceSettings(rate=RATE, bound=50.0, contact_torque=3.0)
    here, there = _configurations()
    with (
        open_session(config=here) as session,
        limo_driver.serve(
            ARM, model="model", settings=settings, config=there, told=lambda _, e: events.put(e)
        ),
    ):
        answers = _answers(session, events)
        told = [events.get(timeout=PATIENCE) for _ in range(events.qsize())]
    kept = [item for item in told if item.kind in {"contact", "contact_end", "reset"}]
    rows = {
        name: summary(np.array([getattr(item, name) for item in answers]))
        for name in ("stamp_ns", "torque", "std", "external", "outside", "reset", "fallback")
    }
    return {
        "estimates": rows,
        "model": sorted({item.model for item in answers}),
        "events": [{"kind": item.kind, "text": item.text, **item.facts} for item in kept],
    }


def _answers(session: zenoh.Session, events: queue.SimpleQueue[Event]) -> list[Any]:
    """Send states, each once the one before is answered, and return the answers."""
    answers: queue.SimpleQueue[bytes] = queue.SimpleQueue()
    key, block = f"limo/{ARM}/state/joints", zenoh.CongestionControl.BLOCK
    with (
        session.declare_subscriber(
            f"limo/{ARM}/torque/estimate", lambda sample: answers.put(sample.payload.to_bytes())
        ),
        session.declare_publisher(key, congestion_control=block) as states,
    ):
        first, *others = _states()
        _wait_for("waiting", events)
        states.put(first[0], attachment=first[1])  # of which the service makes itself ready
        _wait_for("serving", events)
        found: list[Any] = []
        for payload, attachment in others:
            states.put(payload, attachment=attachment)
            found.append(decode_torque_estimate(answers.get(timeout=PATIENCE)))
    return found


def _states() -> Iterator[tuple[bytes, bytes]]:
    """Yield the states of a recording, with a push and a gap, and what is attached to them."""
    recorded = pq.read_table("two_links.parquet").slice(0, STATES)
    q, tau = (
        np.stack([recorded[f"{name}_{j}"].to_numpy() for j in (1, 2)], axis=1)
        for name in ("position", "torque")
    )
    tau[PUSH, 0] += 6.0
    codec = JointStateCodec(limo_driver.Simulation.load("model/sim.yaml").model.joint_names, ARM)
    for k in range(STATES):
        if k not in GAP:
            stamp = START + round(k * 1e9 / RATE)
            attached = struct.pack("<BBQQ", 1, 0, k, k)  # docs/messages.md
            yield codec.encode(stamp, q[k], 0 * q[k], tau[k]), attached


def _wait_for(phase: str, events: queue.SimpleQueue[Event]) -> None:
    while events.get(timeout=PATIENCE).facts.get("phase") != phase:
        pass


def _configurations() -> tuple[Path, Path]:
    """Write the configurations of two sessions that see each other and nobody else.

    By default a message that cannot leave within 1 ms is dropped, which depends on the machine.
    """
    socket = "unixsock-stream/session.sock"
    waits = {"congestion_control": {"drop": {"wait_before_drop": int(PATIENCE * 1e6)}}}  # [us]
    for role in ("listen", "connect"):
        given = {
            role: {"endpoints": [socket]},
            "scouting": {"multicast": {"enabled": False}},
            "transport": {"link": {"tx": {"queue": waits}}},
        }
        Path(f"{role}.json5").write_text(json.dumps(given), encoding="utf-8")
    return Path("listen.json5"), Path("connect.json5")


# Tolerance on another machine where that of `FITS` does not follow. A fit of drives stops where a
# step gains less than 1e-3 nat: within sqrt(2e-3) standard deviations of its best, and that is a
# tenth of an estimate at most.
ELSEWHERE: Mapping[str, float] = {"servos": 4.5e-3}

SMALL: Mapping[str, Mapping[str, Callable[[], dict[str, Any]]]] = {
    "servos": {"identify": _identify, "diagnose": _diagnose, "predict": _predict},
    "exports": {
        "mjcf": partial(_exported, "mjcf", "servos_believed.yaml"),
        "new_mjcf": partial(_exported, "mjcf", "two_links_true.yaml"),
        "urdf": partial(_exported, "urdf", "two_links_true.yaml"),
        "drake": partial(_exported, "drake", "two_links_true.yaml"),
        "isaaclab": partial(_exported, "isaaclab", "two_links_true.yaml"),
        "usd": _usd,
        "c": partial(_exported, "c", "two_links_true.yaml"),
    },
    "service": {
        "train": _train,
        "session": _session,
        "c": partial(_exported, "c", "model", signs=False),
    },
}


def small_values(name: str, folder: Path) -> dict[str, Any]:
    """Return what the stages of a small case make, by stage, computed in an empty folder."""
    for file in DATA.glob("[st]*"):
        shutil.copy(file, folder)
    return computed_apart(__file__, name, folder)


if __name__ == "__main__":
    _name, _folder = sys.argv[1:]
    write_values(_folder, SMALL[_name])
