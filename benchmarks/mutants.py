"""Whether the tests would notice: mutate one number or comparison at a time, and print who lives.

    python benchmarks/mutants.py [--file safety] [--sample 300 --seed 1] [--slow]

Each file of `mutants.yaml` is changed in a copy of this tree, never here, and its nearest fast
tests run on every change; with `--slow`, its slow ones run on what survives those. Mutated are
numbers (times and over `--factor`; small whole ones by one), comparisons, `and`/`or`/`not`, minimum
and maximum, + and -, * and /. A sample takes from each file as its lines are part of all lines; of
one seed it stays the same mutants when other lines change. What came of each trial is kept in
`--results`: a run that was interrupted goes on there, and only what lived is tried again once tests
have changed.

A change that cannot be noticed stands in `mutants.yaml` with its line and the reason; it counts as
a survivor. A line there that no longer exists, or that the tests notice, is an error.
"""

from __future__ import annotations

import hashlib
import math
import tempfile
import threading
import time
from collections import defaultdict
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Final

import typer
import yaml
from mutation.changes import Finder
from mutation.trials import ROOT, Kept, Tests, Trees, files_of, start

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping, Sequence

    from mutation.changes import Mutant

LISTED: Final = Path(__file__).with_suffix(".yaml")
RESULTS: Final = ROOT / "out" / "mutants.jsonl"
BARS: Final = {"fast": 0.90, "slow": 0.95}  # of the mutants, that are noticed after each lane
FACTOR: Final = 3.0  # by which numbers are changed, unless told; what is listed is of this one


@dataclass(frozen=True)
class Listed:
    """A file whose changes have to be noticed.

    Args:
        file: Its path.
        tests: Paths of the nearest tests; the fast ones among them run on every change.
        slow: More whose slow ones run on survivors.
        compiled: Whether numba compiles meanwhile.
        unnoticed: Reasons of those that cannot be noticed, by name.
    """

    file: str
    tests: tuple[str, ...]
    slow: tuple[str, ...]
    compiled: bool
    unnoticed: Mapping[str, str]

    @classmethod
    def of(cls, file: str, entry: Mapping[str, Any], unnoticed: Mapping[str, str]) -> Listed:
        """Take over what the list says of a file; tests of its own name come first."""
        name = f"test_{Path(file).name}"
        own = (str(path.relative_to(ROOT)) for path in files_of(entry["tests"]))
        tests = [*(path for path in own if path.endswith(f"/{name}")), *entry["tests"]]
        slow = tuple(entry.get("slow", ()))
        return cls(file, tuple(tests), slow, entry.get("compiled", True), unnoticed)

    def of_lane(self, lane: str) -> Tests:
        """Return the tests of a lane."""
        more = self.slow if lane == "slow" else ()
        return Tests((*self.tests, *more), lane, self.compiled)

    def mutants(self, factor: float = FACTOR) -> list[Mutant]:
        """Return all changes of the file."""
        return Finder(self.file, (ROOT / self.file).read_text(), factor).found

    def stale(self) -> list[str]:
        """Return what is listed and no longer exists, each in a sentence."""
        if not (ROOT / self.file).is_file():
            return [f"{self.file}: no such file"]
        names = {mutant.name for mutant in self.mutants()}
        gone = [path for path in (*self.tests, *self.slow) if not all(_exist(path))]
        return [f"{self.file}: no test {path}" for path in gone] + [
            f"{self.file}: no longer has: {name}" for name in self.unnoticed if name not in names
        ]


def _exist(path: str) -> Iterable[bool]:
    return (file.is_file() for file in files_of([path]))


def _sources(path: str) -> list[str]:
    found = sorted((ROOT / path).rglob("[!_]*.py"))
    return [str(file.relative_to(ROOT)) for file in found] or [path]


def listed(text: str = "") -> list[Listed]:
    """Return the files whose name holds a text.

    Raises:
        SystemExit: The list names what no longer exists.
    """
    given = yaml.safe_load(LISTED.read_text())
    entries = {file: entry for path, entry in given["files"].items() for file in _sources(path)}
    if unknown := given["unnoticed"].keys() - entries.keys():
        raise SystemExit(f"{LISTED.name} says what is unnoticed of files not listed: {unknown}")
    found = [
        Listed.of(file, entry, given["unnoticed"].get(file, {}))
        for file, entry in entries.items()
        if text in file
    ]
    if not found:
        raise typer.BadParameter(f"--file is {text}, expected part of one of {', '.join(entries)}")
    if stale := [said for one in found for said in one.stale()]:
        raise SystemExit(f"{LISTED.name} is out of date:\n" + "\n".join(stale))
    return found


def sampled(mutants: Mapping[str, Sequence[Mutant]], count: int, seed: int) -> list[Mutant]:
    """Draw mutants of all files, of each as many as its lines are part of all lines."""
    lines = {file: (ROOT / file).read_text().count("\n") for file in mutants}
    drawn = dict.fromkeys(mutants, 0)
    for _ in range(min(count, sum(map(len, mutants.values())))):
        some = [file for file in mutants if drawn[file] < len(mutants[file])]
        drawn[max(some, key=lambda file: lines[file] / (2 * drawn[file] + 1))] += 1

    def chance(mutant: Mutant) -> bytes:
        return hashlib.sha256(f"{seed} {mutant.file} {mutant.name}".encode()).digest()

    return [m for file in mutants for m in sorted(mutants[file], key=chance)[: drawn[file]]]


class Lane:
    """One lane of tests, tried on mutants of many files at once."""

    def __init__(self, name: str, files: Mapping[str, Listed], trees: Trees, kept: Kept) -> None:
        self._name, self._files, self._trees, self._kept = name, files, trees, kept
        self._usual = dict[frozenset[str], float]()  # [s] that tests take without a change
        self._looking: defaultdict[frozenset[str], threading.Lock] = defaultdict(threading.Lock)
        self._telling = threading.Lock()
        self._begin, self._done = time.monotonic(), 0

    def run(self, mutants: Sequence[Mutant], processes: int) -> list[Mutant]:
        """Try what was not tried yet on mutants, and return all that live."""
        wanted = [
            (mutant, self._kept.untried(mutant, self._files[mutant.file].of_lane(self._name)))
            for mutant in mutants
        ]
        left = [(m, tests) for m, tests in wanted if tests.paths and not self._is_explained(m)]
        left.sort(key=lambda item: self._kept.lives(item[0], self._name))  # what is new comes first
        print(f"{self._name} tests: {len(left)} of {len(mutants)} to be tried", flush=True)
        with ThreadPoolExecutor(processes) as pool:
            trials = [pool.submit(self._try, *item, len(left)) for item in left]
            try:
                for trial in trials:
                    trial.result()
            except BaseException:
                pool.shutdown(wait=False, cancel_futures=True)
                raise
        return [mutant for mutant in mutants if not self._kept.noticed(mutant, self._name)]

    def _is_explained(self, mutant: Mutant) -> bool:
        """Say whether a mutant has lived already, for a reason that is listed."""
        listed = self._files[mutant.file].unnoticed
        return mutant.name in listed and self._kept.lives(mutant, self._name)

    def _try(self, mutant: Mutant, tests: Tests, count: int) -> None:
        outcome = self._trees.run(tests, mutant, self._usual_of(tests))
        self._kept.add(mutant, tests, outcome)
        with self._telling:
            self._done += 1
            said = "noticed" if outcome.noticed else "SURVIVED"
            passed = time.monotonic() - self._begin
            ahead = passed / self._done * (count - self._done) / 60
            print(
                f"{self._done}/{count} {said} after {outcome.seconds:.0f} s, {ahead:.0f} min left: "
                f"{mutant.file}:{mutant.number}: {mutant.name}",
                flush=True,
            )

    def _usual_of(self, tests: Tests) -> float:
        some = frozenset(tests.paths)  # in any order
        with self._looking[some]:
            if some not in self._usual:
                outcome = self._trees.run(tests)
                if outcome.noticed:
                    raise SystemExit(f"{tests.paths} fail without any change\n{outcome.told}")
                self._usual[some] = outcome.seconds
            return self._usual[some]


def told(
    mutants: Sequence[Mutant], living: Mapping[str, Sequence[Mutant]], files: Mapping[str, Listed]
) -> bool:
    """Print the share of each lane beside its bar, and who lives; return whether all is well."""
    fine = True
    print(f"{'':52} mutants" + "".join(f"{lane:>6}" for lane in living))
    for file in dict.fromkeys(mutant.file for mutant in mutants):
        own = sum(mutant.file == file for mutant in mutants)
        left = [own - sum(mutant.file == file for mutant in living[lane]) for lane in living]
        print(f"{file:52} {own:7}" + "".join(f"{count:6}" for count in left))
    for lane, left in living.items():
        share = 1.0 - len(left) / len(mutants)
        fine &= share >= BARS[lane]
        which = "fast tests" if lane == "fast" else "fast and slow tests"
        print(
            f"{which} notice {len(mutants) - len(left)} of {len(mutants)}, {100 * share:.1f} % "
            f"(bar {100 * BARS[lane]:.0f} %)"
        )
    last = [*living.values()][-1]
    for mutant in last:
        reason = files[mutant.file].unnoticed.get(mutant.name, "NOT EXPLAINED")
        print(f"{mutant.file}:{mutant.number}: {mutant.name}, survived: {reason}")
    for mutant in mutants:
        if mutant not in last and (reason := files[mutant.file].unnoticed.get(mutant.name)):
            fine = False
            print(f"{mutant.file}:{mutant.number}: {mutant.name}, noticed, though listed: {reason}")
    return fine


def main(
    file: Annotated[str, typer.Option(help="Only files whose name holds this.")] = "",
    sample: Annotated[int, typer.Option(min=0, help="Mutants of all files; 0 for all.")] = 0,
    seed: Annotated[int, typer.Option(help="Of the sample.")] = 1,
    factor: Annotated[float, typer.Option(help="By which numbers are changed.")] = FACTOR,
    lines: Annotated[str, typer.Option(help="Only of lines that hold this.")] = "",
    slow: Annotated[bool, typer.Option("--slow", help="Try slow tests on survivors.")] = False,
    check: Annotated[bool, typer.Option("--check", help="Only look at the list.")] = False,
    processes: Annotated[int, typer.Option(min=1, help="Tests that run at once.")] = 2,
    results: Annotated[Path, typer.Option(help="Where outcomes are kept.")] = RESULTS,
) -> None:
    """Print survivors, and how many mutants the tests notice beside the bars."""
    files = {one.file: one for one in listed(file)}
    if check:
        return
    if not 1.0 < factor < math.inf:
        raise typer.BadParameter(f"--factor is {factor:g}, expected above 1")
    found = {
        one.file: [mutant for mutant in one.mutants(factor) if lines in mutant.line]
        for one in files.values()
    }
    mutants = sampled(found, sample, seed) if sample else [m for own in found.values() for m in own]
    if not mutants:
        raise typer.BadParameter(f"--lines is {lines}, which no line with a mutant holds")
    start(results.parent / "mutants_machine_code")
    kept, living = Kept(results), {}
    with tempfile.TemporaryDirectory(prefix="mutants-") as temporary:
        trees, left = Trees(Path(temporary), processes), mutants
        for lane in ("fast", "slow") if slow else ("fast",):
            left = living[lane] = Lane(lane, files, trees, kept).run(left, processes)
    raise SystemExit(0 if told(mutants, living, files) else 1)


if __name__ == "__main__":
    plain = typer.Typer(rich_markup_mode=None, pretty_exceptions_enable=False, add_completion=False)
    plain.command()(main)
    plain()
