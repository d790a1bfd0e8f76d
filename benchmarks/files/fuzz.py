"""Mutations of valid files of every format: each is read or refused in one line, at little cost.

    python benchmarks/files/fuzz.py FOLDER [--formats urdf mjcf] [--first 0] [--most 10000]
    python benchmarks/files/fuzz.py FOLDER --again     # the failures alone, as after a repair

A mutation is told by its format and its number alone. What was found is kept in FOLDER, and later
runs go on from there; so the counts gather over days. Failures are: an error that is none of
limo's, a refusal of more than one line or with what a terminal obeys, a warning of a library on the
way, more than 5 s of CPU time or 1 GB, and the end of the process.
"""

from __future__ import annotations

import argparse
import json
import os
import pickle
import resource
import shutil
import signal
import sys
import tempfile
import time
import traceback
import warnings
from contextlib import suppress
from dataclasses import asdict, dataclass, field
from pathlib import Path
from random import Random
from typing import TYPE_CHECKING, Any, Final

from formats import FORMATS
from mutations import mutated

from limo_driver.runtime import given_files

if TYPE_CHECKING:
    from collections.abc import Iterator

SECONDS, MEGABYTES = 5.0, 1000.0
_BATCH: Final = 100  # mutations of one process
_PATIENCE: Final = 240  # [s] that one may wait, on a busy machine
_STATUS: Final = Path("/proc/self/status")
_PEAK: Final = Path("/proc/self/clear_refs")


@dataclass
class Found:
    """What a batch of mutations came to."""

    format: str
    first: int
    after: int  # the number behind the last
    read: int = 0
    refused: int = 0
    failures: dict[int, str] = field(default_factory=dict)  # by number of the mutation
    seconds: float = 0.0  # of the slowest
    megabytes: float = 0.0  # of the largest


def _forked(*given: str) -> tuple[str, Any, int]:
    """Run what a reader runs apart, without the seconds in which an interpreter starts."""
    told, tell = os.pipe()
    child = os.fork()
    if not child:
        signal.setitimer(signal.ITIMER_PROF, 0)
        signal.alarm(_PATIENCE)
        os.close(told)
        os.dup2(tell, 1)
        os.dup2(os.open(os.devnull, os.O_WRONLY), 2)
        try:
            given_files.main(*given)
        finally:
            os._exit(1)
    os.close(tell)
    refused, answer = "", None
    with os.fdopen(told, "rb") as answers, suppress(EOFError, pickle.UnpicklingError):
        refused, answer = pickle.load(answers)  # noqa: S301  # of this program
    return refused, answer, os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])


def main() -> None:
    """Go on, and print what was found so far."""
    given = _given()
    os.nice(10)
    given_files._asked = _forked
    given.folder.mkdir(parents=True, exist_ok=True)
    ends = time.monotonic() + 60 * given.minutes
    for name in given.formats:
        kept = given.folder / f"{name}.jsonl"
        numbers = (
            _failed(kept) if given.again else _missing(kept, given.first, given.first + given.most)
        )
        with tempfile.TemporaryDirectory() as folder:
            _make(name, Path(folder))
            for batch in numbers if time.monotonic() < ends else ():
                found = _tried(name, batch, Path(folder))
                with kept.open("a") as file:
                    file.write(json.dumps(asdict(found)) + "\n")
                if time.monotonic() > ends:
                    break
    met = True
    for name in given.formats:
        met &= _said(given.folder / f"{name}.jsonl", name)
    sys.exit(not met)


def _given() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("folder", type=Path, help="where what is found is kept")
    parser.add_argument("--formats", nargs="+", choices=FORMATS, default=list(FORMATS))
    parser.add_argument("--first", type=int, default=0, help="number to begin with")
    parser.add_argument("--most", type=int, default=10_000, help="mutations of each format")
    parser.add_argument("--minutes", type=float, default=1e9, help="after which it ends")
    parser.add_argument("--again", action="store_true", help="try the failures again")
    return parser.parse_args()


def _lines(kept: Path) -> list[Found]:
    """Return what was kept, each mutation as it was tried last."""
    if not kept.exists():
        return []
    return [
        Found(**{**values, "failures": {int(k): v for k, v in values["failures"].items()}})
        for values in map(json.loads, kept.read_text().splitlines())
    ]


def _missing(kept: Path, start: int, most: int) -> Iterator[range]:
    """Yield the numbers that were not tried yet."""
    done = {k for found in _lines(kept) for k in range(found.first, found.after)}
    while start < most:
        if start in done:
            start += 1
            continue
        stop = next(
            (k for k in range(start, min(start + _BATCH, most)) if k in done), start + _BATCH
        )
        yield range(start, min(stop, most))
        start = stop


def _still_failing(kept: Path) -> dict[int, str]:
    failing = dict[int, str]()
    for found in _lines(kept):
        for k in range(found.first, found.after):
            failing.pop(k, None)
        failing |= found.failures
    return failing


def _failed(kept: Path) -> Iterator[range]:
    for k in sorted(_still_failing(kept)):
        yield range(k, k + 1)


def _make(name: str, folder: Path) -> None:
    """Make the valid files of a format, and read each, which also compiles what reads them."""
    valid = folder / "valid"
    valid.mkdir()
    made = FORMATS[name].make(valid)
    for path in made:
        FORMATS[name].read(path)
    (folder / "valid.txt").write_text("\n".join(path.name for path in made))


def _tried(name: str, numbers: range, folder: Path) -> Found:
    """Try mutations in a process of their own, and go on in another one where that ends."""
    found = Found(name, numbers.start, numbers.stop)
    k = numbers.start
    while k < numbers.stop:
        told, tell = os.pipe()
        child = os.fork()
        if not child:
            os.close(told)
            os.dup2(os.open(folder, os.O_TMPFILE | os.O_RDWR | os.O_APPEND), 2)
            with os.fdopen(tell, "wb") as out:
                for number in range(k, numbers.stop):
                    pickle.dump(_read_one(name, number, folder), out)
                    out.flush()
            os._exit(0)
        os.close(tell)
        with os.fdopen(told, "rb") as answers, suppress(EOFError):
            while True:
                _note(found, k, *pickle.load(answers))  # noqa: S301  # of this program
                k += 1
        _, status = os.waitpid(child, 0)
        if k < numbers.stop:
            ended = signal.Signals(os.WTERMSIG(status)).name if os.WIFSIGNALED(status) else status
            found.failures[k] = f"the process ended with {ended}"
            k += 1
    return found


def _note(found: Found, k: int, said: str, failed: bool, seconds: float, megabytes: float) -> None:
    found.read += not said
    found.refused += bool(said) and not failed
    found.seconds, found.megabytes = max(found.seconds, seconds), max(found.megabytes, megabytes)
    if seconds > SECONDS or megabytes > MEGABYTES:
        failed, said = True, f"took {seconds:.1f} s and {megabytes:.0f} MB: {said[:100]}"
    if failed:
        found.failures[k] = said


def _read_one(name: str, number: int, folder: Path) -> tuple[str, bool, float, float]:
    """Read one mutation; return what was said, whether that is wrong, its time and memory."""
    path = mutation(name, number, folder)
    _limit_this()
    before, base = _cpu(), _megabytes("VmRSS")
    with suppress(OSError):
        _PEAK.write_text("5")
    said, failed = _outcome(name, path)
    if printed := _printed():
        said, failed = f"printed: {printed}", True
    signal.setitimer(signal.ITIMER_PROF, 0)
    signal.alarm(0)
    return said, failed, _cpu() - before, max(_megabytes("VmHWM") - base, 0.0)


def mutation(name: str, number: int, folder: Path) -> Path:
    """Write a mutation of a format by its number, and return where it is."""
    random, format_ = Random(f"{name} {number}"), FORMATS[name]  # noqa: S311
    chosen = random.choice((folder / "valid.txt").read_text().splitlines())
    place = folder / "mutation"
    shutil.rmtree(place, ignore_errors=True)
    shutil.copytree(folder / "valid", place)
    path = place / chosen
    part = random.choice(format_.parts(path))
    part.write_bytes(mutated(part.read_bytes(), random))
    if random.random() < 0.9:
        format_.mended(path)
    return path


def _limit_this() -> None:
    signal.setitimer(signal.ITIMER_PROF, 3 * SECONDS)
    signal.alarm(_PATIENCE)


def _outcome(name: str, path: Path) -> tuple[str, bool]:
    from limo_driver.errors import LimoError

    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            FORMATS[name].read(path)
    except LimoError as error:
        said = str(error)
        return said, not said.isprintable()
    except Exception:  # noqa: BLE001  # that is what is looked for
        return "".join(traceback.format_exc(limit=-3)), True
    return "", False


def _printed() -> str:
    """Return what libraries wrote to stderr meanwhile, below Python."""
    sys.stderr.flush()
    text = os.pread(2, 2000, 0).decode(errors="replace")
    os.ftruncate(2, 0)
    return text


def _cpu() -> float:
    own, inner = map(resource.getrusage, (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN))
    return own.ru_utime + own.ru_stime + inner.ru_utime + inner.ru_stime


def _megabytes(what: str) -> float:
    lines = dict(line.split(":", 1) for line in _STATUS.read_text().splitlines())
    return float(lines[what].split()[0]) / 1e3


def _said(kept: Path, name: str) -> bool:
    """Print what a format came to; say whether nothing of it fails."""
    lines, failing = _lines(kept), _still_failing(kept)
    done = {k for found in lines for k in range(found.first, found.after)}
    slowest = max((found.seconds for found in lines), default=0.0)
    largest = max((found.megabytes for found in lines), default=0.0)
    print(
        f"{name:12} {len(done):6} tried, {len(failing):4} fail; at most {slowest:4.1f} s of CPU, "
        f"{largest:5.0f} MB"
    )
    for k, text in list(failing.items())[:3]:
        print(f"    {k}: {' | '.join(text.strip().splitlines()[-4:])[:300]}")
    return not failing


if __name__ == "__main__":
    main()
