"""What small or strange files cost before they are refused: time and memory of whole commands.

    python benchmarks/files/bombs.py

Each file is refused with one line, within 2 s of CPU time beyond that of a command whose file is
not there (the first row), and 500 MB in all. Words on the command line choose what is tried.
"""

from __future__ import annotations

import os
import struct
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import TYPE_CHECKING

import zstandard

if TYPE_CHECKING:
    from collections.abc import Iterator

LIMO = (sys.executable, "-c", "from limo_driver.app.cli import main; main()")
SECONDS, MEGABYTES = 2.0, 500.0
PATIENCE = 60.0  # [s], after which a command is ended
RECORDED = "tests/regression/data/iiwa14_excited.parquet"
MCAP = b"\x89MCAP0\r\n"


def mcap(folder: Path) -> Path:
    """Make a log of one chunk of 8 kB that unpacks to 256 MB."""
    size = 1 << 28
    packed = zstandard.ZstdCompressor(level=19).compress(bytes(size))
    chunk = struct.pack("<QQQII4sQ", 0, 0, size, 0, 4, b"zstd", len(packed)) + packed
    path = folder / "bomb.mcap"
    path.write_bytes(
        MCAP
        + struct.pack("<BQII", 1, 8, 0, 0)
        + struct.pack("<BQ", 6, len(chunk))
        + chunk
        + struct.pack("<BQI", 15, 4, 0)
        + MCAP
    )
    return path


def urdf(folder: Path) -> Path:
    """Make a chain of 20 000 joints."""
    link = '<link name="l{0}"><inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" '
    link += 'ixz="0" iyz="0"/></inertial></link>'
    joint = '<joint name="j{0}" type="revolute"><parent link="l{0}"/><child link="l{1}"/>'
    joint += '<axis xyz="0 0 1"/><limit lower="-1" upper="1" velocity="1" effort="1"/></joint>'
    path = folder / "chain.urdf"
    with path.open("w") as file:
        file.write('<robot name="chain"><link name="l0"/>')
        for k in range(20_000):
            file.write(link.format(k + 1) + joint.format(k, k + 1))
        file.write("</robot>")
    return path


def csv(folder: Path) -> Path:
    """Make a table of 10^5 columns."""
    path = folder / "wide.csv"
    names = ",".join(["time", *(f"position_{k}" for k in range(1, 100_000))])
    row = ",".join(["0.0"] * 100_000)
    path.write_text("\n".join([names, row, row]) + "\n")
    return path


def effects(folder: Path) -> Path:
    """Make a simulation of 60 000 effects."""
    path = folder / "sim.yaml"
    line = "  - {effect: viscous_friction, joint: 1, coefficient: 1.0}\n"
    path.write_text("robot: iiwa14\neffects:\n" + line * 60_000)
    return path


def device(folder: Path, name: str) -> Path:
    """Make a link to a device without an end."""
    path = folder / name
    path.symlink_to("/dev/zero")
    return path


def fifo(folder: Path, name: str) -> Path:
    """Make a pipe into which nobody writes."""
    path = folder / name
    os.mkfifo(path)
    return path


def bombs(folder: Path) -> Iterator[tuple[str, tuple[str, ...]]]:
    """Yield what is tried, and the command."""
    out, arm = ("--out", str(folder / "out.parquet")), ("--robot", "iiwa14")
    kept = ("--record", str(folder / "run.parquet"))
    yield "no file", ("inspect", str(folder / "none.csv"), *arm)
    packed = mcap(folder)
    yield f"{packed.stat().st_size} bytes of MCAP", ("inspect", str(packed), *arm)
    yield "20 000 joints", ("plan", "--robot", str(urdf(folder)), *out)
    wide = csv(folder)
    yield "10^5 columns", ("inspect", str(wide), *arm)
    yield "10^5 columns, identified", ("identify", str(wide), *arm, *out)
    sim = effects(folder)
    yield "60 000 effects", ("predict", RECORDED, "--sim", str(sim), *out)
    for make, what in ((device, "link to a device"), (fifo, "pipe")):
        for suffix in ("csv", "mcap", "parquet", "npz", "db3"):
            log = make(folder, f"{make.__name__}.{suffix}")
            yield f"{what}, .{suffix}", ("inspect", str(log), *arm)
        robot = make(folder, f"{make.__name__}.urdf")
        yield f"{what}, .urdf", ("plan", "--robot", str(robot), *out)
        given = make(folder, f"{make.__name__}.yaml")
        yield f"{what}, sim.yaml", ("predict", RECORDED, "--sim", str(given), *out)
        route = make(folder, f"{make.__name__}.traj.parquet")
        yield (
            f"{what}, trajectory",
            ("run", "--backend", "virtual", "--trajectory", str(route), *kept),
        )


def main() -> None:
    """Try all, and print beside the bars."""
    os.chdir(Path(__file__).parents[2])
    print(f"{'what':32} {'CPU [s]':>8} {'[s]':>7} {'[MB]':>6} {'lines':>5}  said")
    met, first = True, 0.0
    with tempfile.TemporaryDirectory() as folder:
        for what, command in bombs(Path(folder)):
            if first and sys.argv[1:] and not any(word in what for word in sys.argv[1:]):
                continue
            refused, seconds = _tried(what, command)
            first = first or seconds
            met &= refused and seconds <= first + SECONDS
    print(f"bars: {first + SECONDS:.1f} s of CPU time, {MEGABYTES:g} MB, one line")
    sys.exit(not met)


def _tried(what: str, command: tuple[str, ...]) -> tuple[bool, float]:
    """Run a command; say whether it refused in one line, and the CPU time it took [s]."""
    began = time.monotonic()
    with tempfile.TemporaryFile("w+") as said:
        running = subprocess.Popen((*LIMO, *command), stdout=said, stderr=said)
        deadline = began + PATIENCE
        status, usage = 0, None
        while usage is None:
            pid, status, used = os.wait4(running.pid, os.WNOHANG)
            usage = used if pid else None
            if usage is None and time.monotonic() > deadline:
                running.kill()
            time.sleep(0.01)
        running.returncode = os.waitstatus_to_exitcode(status)
        said.seek(0)
        lines = [line for line in said.read().splitlines() if line.strip()]
    seconds, megabytes = usage.ru_utime + usage.ru_stime, usage.ru_maxrss / 1e3
    last = lines[-1][:90] if lines else f"ended with {running.returncode}"
    passed = time.monotonic() - began
    print(
        f"{what:32} {seconds:8.1f} {passed:7.1f} {megabytes:6.0f} {len(lines):5}  {last}",
        flush=True,
    )
    refused = running.returncode > 0 and len(lines) == 1
    return refused and megabytes <= MEGABYTES, seconds


if __name__ == "__main__":
    main()
