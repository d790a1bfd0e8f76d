"""Forged packets from another process of the robot's own host, beside a session that is commanded.

    python benchmarks/backends/fri_forger.py --packets 100000

The forger knows all but the robot's port: it sends valid messages of every session state with
shifted poses, restarted counters, other paces and clocks, and noise, to the driver's port, about
ten for each packet of the robot. In the last fifth of them the robot is silent, and the forger is
all that is heard. The bar: no state that it told, no hold, no set-point off the motion that was
commanded, no answer to the forger, no end of the session. All that was ignored is counted.
"""

# ruff: noqa: E402  # what tests share is found once its folders are on the path

from __future__ import annotations

import json
import random
import socket
import subprocess
import sys
import time
from pathlib import Path
from typing import Annotated

import numpy as np
import typer

ROOT = Path(__file__).parents[2]
sys.path[:0] = [
    str(ROOT / "tests" / folder) for folder in ("contract", "backends/fri", "limo_driver/network")
]

from fri_messages import POSE
from stepped_arm import HOST, SteppedArm, stepped

from backends.fri.codec import messages as m
from backends.fri.codec.codec import encode_monitoring
from limo_driver.types import PositionCommand

BURST = 10  # forged packets in one go
SPOKEN = 0.8  # of the cycles, before the robot falls silent
AMPLITUDE, TURN = 0.05, 1000  # [rad], cycles


def packets(seed: int) -> list[bytes]:
    """Return forged packets of all kinds."""
    rng, made = random.Random(seed), []  # noqa: S311
    arm = SteppedArm(port=9)
    try:
        for _ in range(2000):
            arm.state = rng.choice(list(m.SessionState))
            arm.mode = rng.choice(list(m.CommandMode))
            arm.period_ms, arm.multiplier = rng.choice([1, 1, 1, 5]), rng.choice([1, 1, 3])
            arm.sequence, arm.ns = rng.randrange(2**32), rng.randrange(4 * 10**18)
            shift = rng.choice([0.0, 0.01, 0.5, 3.0])
            arm.ipo, arm.position = np.array(POSE) + shift, np.array(POSE) - shift
            message = arm.message()
            if rng.random() < 0.1:
                message = message._replace(ipo=None)
            data = bytearray(encode_monitoring(message, arm.generation))
            if rng.random() < 0.2:
                data[rng.randrange(len(data))] = rng.randrange(256)
            made.append(bytes(data) if rng.random() < 0.95 else rng.randbytes(300))
    finally:
        arm.close()
    return made


def forge(port: int, count: int, seed: int) -> None:
    """Send packets, a burst for each line that is read; say how many were answered."""
    made, answers = packets(seed), 0
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as own:
        own.bind((HOST, 0))
        own.setblocking(False)
        print("ready", flush=True)
        for sent in range(0, count, BURST):
            sys.stdin.readline()
            for k in range(sent, sent + BURST):
                own.sendto(made[k % len(made)], ("127.0.0.1", port))
            print("sent", flush=True)
        time.sleep(0.2)
        try:
            while own.recv(2000):
                answers += 1
        except BlockingIOError:
            pass
    print(json.dumps({"answers": answers}), flush=True)


def main(
    packets: Annotated[int, typer.Option(help="That are forged.")] = 100_000,
    seed: int = 0,
    forger: Annotated[int, typer.Option(hidden=True)] = 0,
) -> None:
    """Command an arm beside a forger, and print what that changed."""
    if forger:
        forge(forger, packets, seed)
        return
    with stepped() as robot:
        options = ["--forger", str(robot.arm.port), "--packets", str(packets), "--seed", str(seed)]
        command = [sys.executable, __file__, *options]
        with subprocess.Popen(
            command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
        ) as child:
            assert child.stdin is not None
            assert child.stdout is not None
            child.stdout.readline()
            effects, cycles = 0, 0
            state = robot.receive()
            speaks = round(SPOKEN * (packets // BURST))
            for cycles in range(packets // BURST):
                child.stdin.write("\n")
                child.stdin.flush()
                child.stdout.readline()
                if cycles >= speaks:
                    robot.lose_measurements(1)
                    effects += not robot.receive().stale
                    continue
                goal = np.array(POSE) + AMPLITUDE * (1 - np.cos(2 * np.pi * cycles / TURN))
                sent = robot.send(PositionCommand(position=goal, valid_for=1.0))
                effects += bool(np.abs(sent.position - goal).max() > 1e-9 or sent.limited_by)
                state = robot.receive()
                effects += bool(state.holding or state.stale)
                effects += bool(np.abs(state.position - goal).max() > 1e-9)
            told = json.loads(child.stdout.readline())
        figures = robot.link_figures()
    effects += told["answers"]
    print(f"{packets} forged packets in {cycles + 1} cycles: {effects} effects")
    print(f"foreign {figures['foreign']}, implausible {figures['implausible']}, "
          f"malformed {figures['malformed']}, answers to the forger {told['answers']}")  # fmt: skip
    raise typer.Exit(effects > 0)


if __name__ == "__main__":
    typer.run(main)
