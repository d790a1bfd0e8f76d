"""What each command compiles on a fresh machine, and how long it takes to get going.

    python benchmarks/service/cold_start.py [run identify ...]

Each command runs in a process of its own, first with an empty cache of machine code and then with
what the first one left. Beside the time to its first sign of life (the first command to an arm, the
first estimate's service, the first stage) stands the bar, for two idle cores; the last lines name
functions that were compiled for more than one signature by all commands together. All of it takes
a few minutes on two cores.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import time
from collections import Counter
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any

from service_processes import ARM, Driver, Motion, configurations

if TYPE_CHECKING:
    from collections.abc import Sequence

COLD = {"run": 8.0, "serve": 15.0, "diagnose": 8.0}  # [s], bars
WARM = {"run": 2.0, "serve": 2.0, "help": 0.35}
SIGN = {"run": "first cycle", "serve": "serving", "diagnose": "first stage"}  # else the end
ROUNDS = 3  # warm, of what has a bar; the best counts, the others met other work
SIM = Path(__file__).parents[2] / "examples" / "iiwa14_hysteretic.yaml"
# Inside the process: note the first sign of life, and at the end what was compiled.
CHILD = """
import atexit, json, os, sys, time
from limo_driver import cli; from limo_driver.runtime.machine_code import compilation
begun, where, noted = float(os.environ["BEGUN"]), os.environ["NOTES"], {}
def note(*_):
    noted.setdefault("sign", time.time() - begun)
    if os.environ["STOP"]:
        write()
        os._exit(0)
def before(owner, name, told=None):
    own = getattr(owner, name)
    def noting(*given, **named):
        if told is None:
            note()
        else:
            tell = named[told]
            named[told] = lambda *stage: (note(), tell(*stage))
        return own(*given, **named)
    setattr(owner, name, noting)
if sys.argv[1] == "run":
    from limo_driver.robot.robot import Robot
    before(Robot, "send")
if sys.argv[1] == "diagnose":
    from limo_driver.app.library import diagnosing
    before(diagnosing, "diagnose", "progress")
def write():
    last = compilation.current()
    if last is not None:
        noted.update(functions=last.done, seconds=last.seconds)
    with open(where, "w") as file:
        json.dump(noted, file)
atexit.register(write)
cli.main()
"""


@dataclass(frozen=True)
class Start:
    """How one process got going."""

    functions: int  # compiled
    compiling: float  # [s]
    sign: float  # [s] to its first sign of life


def commands(folder: Path) -> dict[str, list[str]]:
    """Return the arguments of each command; each needs what those before it wrote."""
    motion, recording, sim = folder / "t.parquet", folder / "r.parquet", folder / "sim.yaml"
    given: dict[str, list[Any]] = {
        "help": ["--help"],
        "plan": ["plan", "--scaffolds", 2, "--seed", 3, "--out", motion],
        "run": [
            "run", "--backend", "mujoco", "--trajectory", motion, "--sim", SIM,
            "--record", recording, "--json",
        ],
        "identify": ["identify", recording, "--robot", "iiwa14", "--out", sim],
        "train": [
            "train", recording, "--sim", sim, "--model", "joint-physics", "--out", folder / "model",
        ],
        "serve": ["serve", "--arm", ARM, "--model", folder / "model", "--json", "--duration", 20],
        "diagnose": ["diagnose", recording, "--sim", sim, "--out", folder / "diagnosis"],
        "excite": [
            "excite", "--duration", 10, "--harmonics", 2, "--iterations", 3, "--starts", 2,
            "--out", folder / "e.parquet",
        ],
    }  # fmt: skip
    return {name: list(map(str, words)) for name, words in given.items()}


def started(words: Sequence[str], folder: Path, cache: Path, *, stop: bool = False) -> Start:
    """Run a command and return how it got going; `stop` ends it there, as always with `serve`."""
    notes = folder / "notes.json"
    notes.unlink(missing_ok=True)
    begun = time.time()
    settings = {"BEGUN": str(begun), "NOTES": str(notes), "NUMBA_CACHE_DIR": str(cache)}
    settings["STOP"] = "yes" if stop else ""
    with ExitStack() as open_:
        if words[0] == "serve":
            words = [*words, "--zenoh-config", str(_driven(folder, open_))]
        child = subprocess.Popen(
            [sys.executable, "-c", CHILD, *words],
            env=os.environ | settings,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            text=True,
        )
        serving = 0.0
        for line in child.stdout or ():
            if words[0] == "serve" and '"serving"' in line and not serving:
                serving = time.time() - begun
                child.terminate()
        child.wait()
    noted = json.loads(notes.read_text())
    end = time.time() - begun
    sign = serving or noted.get("sign", end)
    return Start(noted.get("functions", 0), noted.get("seconds", 0.0), sign)


def _driven(folder: Path, open_: ExitStack) -> Path:
    """Have an arm publish its states; return the configuration by which it is reached."""
    import zenoh

    here, there = configurations(folder)
    session = open_.enter_context(zenoh.open(zenoh.Config.from_file(here)))
    open_.enter_context(Driver(session, Motion(folder / "model"), rate=100.0))
    return there


def several_signatures(cache: Path) -> dict[str, int]:
    """Return the functions that were compiled more than once, and how often."""
    counts = Counter(path.name.rsplit("-", 2)[0] for path in cache.rglob("*.code"))
    return {name: count for name, count in sorted(counts.items()) if count > 1}


def chosen() -> list[str]:
    """Return the commands that are asked for; all where none is."""
    names = list(commands(Path()))
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument(
        "command",
        nargs="*",
        help=f"to show: {', '.join(names)}; all if none is named. The others only prepare",
    )
    only: list[str] = parser.parse_args().command
    if unknown := [name for name in only if name not in names]:
        parser.error(f"no such command: {', '.join(unknown)}; expected {', '.join(names)}")
    return only or names


def main() -> None:
    """Print the table."""
    only = chosen()
    print(f"{'command':10}{'compiled':>9}{'[s]':>6}  {'until':12}{'cold [s]':>12}{'warm [s]':>14}")
    with TemporaryDirectory() as name:
        folder = Path(name)
        for command, words in commands(folder).items():
            shown = command in only
            if not shown and command in {"help", "serve", "diagnose", "excite"}:
                continue
            cache = folder / f"cache_{command}"
            cold = started(words, folder, cache)
            if not shown:
                continue
            rounds = ROUNDS if command in WARM else 1
            warm = [started(words, folder, cache, stop=True).sign for _ in range(rounds)]
            print(
                f"{command:10}{cold.functions:9}{cold.compiling:6.1f}  "
                f"{SIGN.get(command, 'end'):12}{cold.sign:6.1f}{_bar(COLD, command):6}"
                f"{min(warm):8.2f}{_bar(WARM, command):7}",
                flush=True,
            )
        shared = folder / "shared"
        for path in folder.glob("cache_*/limo/*.code"):
            shared.mkdir(exist_ok=True)
            path.replace(shared / path.name)
        print("compiled for more than one signature:", several_signatures(shared) or "none")


def _bar(bars: dict[str, float], command: str) -> str:
    """Return the bar of a command in brackets."""
    return f" [{bars[command]:g}]" if command in bars else ""


if __name__ == "__main__":
    main()
