"""Whether the tests would notice: mutate one number or comparison at a time, and print who lives.

    python benchmarks/mutants.py [--file safety] [--sample 100] [--factor 1.05] [--processes 2]

Each file below is changed in a copy of this tree, never here, and its nearest tests run on every
change. Mutated are numbers (times and over `--factor`; small whole ones by one), comparisons,
`and`/`or`/`not`, minimum and maximum, + and -, * and /. Compiled functions run as plain Python, so
that what runs is what was changed. A change that cannot be noticed stands in `mutants.yaml` with
its line and the reason; a line there that no longer exists, or that the tests notice, is an error.

Of the well-kept tools, mutmut 3.8 leaves out decorated functions and constants of a module, which
are the arithmetic and the thresholds here, and cosmic-ray 8.7 changes numbers by one only, which
for a threshold of 0.02 is a factor of 51.
"""

from __future__ import annotations

import ast
import math
import multiprocessing
import os
import random
import re
import shutil
import subprocess
import sys
import tempfile
from collections import Counter
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from itertools import pairwise, repeat
from pathlib import Path
from queue import SimpleQueue
from typing import TYPE_CHECKING, Annotated, Final, NoReturn

import typer
import yaml

if TYPE_CHECKING:
    from collections.abc import Iterator

ROOT: Final = Path(__file__).resolve().parents[1]
LISTED: Final = Path(__file__).with_suffix(".yaml")
BAR: Final = 0.95  # of the mutants of each file, which the tests have to notice
TIMEOUT: Final = 120.0  # [s] for the tests of one mutant: a loop without an end is noticed, too
FACTOR: Final = 3.0  # by which numbers are changed, unless told; what is listed is of this one
SMALL: Final = 4  # whole numbers up to this are counts, places and bits: changed by one
TESTS: Final = {
    "limo_driver/robot/safety.py": (
        "tests/limo_driver/robot/test_safety_limits.py",
        "tests/limo_driver/robot/test_safety_turns.py",
    ),
    "limo_driver/robot/setpoints.py": (
        "tests/limo_driver/robot/test_setpoints.py",
        "tests/limo_driver/robot/test_safety_limits.py",
    ),
    "backends/fri/wire_limits.py": ("tests/backends/fri/test_fri_wire_limits.py",),
    "backends/fri/session.py": ("tests/backends/fri/test_fri_session.py",),
    "backends/fri/connection.py": ("tests/backends/fri/test_fri_limits.py",),
    "backends/can/cia402/drive.py": ("tests/backends/can/test_limits.py",),
    "estimators/service/comparison/gate.py": (
        "tests/estimators/service/comparison/test_gate_bounds.py",
    ),
    "estimators/service/inference/contact.py": (
        "tests/estimators/service/inference/test_contact_bounds.py",
    ),
}
FORKS: Final = multiprocessing.get_context("forkserver")  # which imports what is no part of this
COMPARISONS: Final = {
    "<": ("<=", ">"),
    "<=": ("<", ">"),
    ">": (">=", "<"),
    ">=": (">", "<"),
    "==": ("!=",),
    "!=": ("==",),
    "is not": ("is",),
    "is": ("is not",),
    "not in": ("in",),
    "in": ("not in",),
}
NAMES: Final = {
    "min": "max", "max": "min", "minimum": "maximum", "maximum": "minimum",
    "any": "all", "all": "any", "floor": "ceil", "ceil": "floor",
}  # fmt: skip
ARITHMETIC: Final = {"+": "-", "-": "+", "*": "/", "/": "*", "**": "*", "//": "/"}
BITS: Final = {"&": "|", "|": "&", "<<": ">>", ">>": "<<"}


@dataclass(frozen=True)
class Mutant:
    """One change of one line."""

    file: str
    number: int  # of its line, from 1
    line: str  # as it is, stripped
    start: int  # of what is replaced, in characters of the file
    stop: int
    given: str
    instead: str
    again: int  # how many changes of the file that read the same stand before it

    @property
    def name(self) -> str:
        """Where and what: as it stands in the list of those that cannot be noticed."""
        again = f" #{self.again + 1}" if self.again else ""
        return f"{self.line} | {self.given} -> {self.instead or 'nothing'}{again}"


class Finder(ast.NodeVisitor):
    """Collects the mutants of a source."""

    def __init__(self, file: str, source: str, factor: float) -> None:
        self._file, self._source, self._factor = file, source, factor
        self._lines = source.splitlines(keepends=True)
        self._seen: Counter[tuple[str, str, str]] = Counter()
        self.found: list[Mutant] = []
        self.visit(ast.parse(source))

    def visit(self, node: ast.AST) -> None:
        """Look at everything but types, texts and decorators, which decide nothing here."""
        for change in self._changes(node):
            self._add(*change)
        for name, value in ast.iter_fields(node):
            if name in {"annotation", "returns", "decorator_list"}:
                continue
            for child in value if isinstance(value, list) else [value]:
                # Before Python 3.12, what stands in an f-string does not say where.
                if isinstance(child, ast.AST) and not isinstance(child, ast.JoinedStr):
                    self.visit(child)

    def _changes(self, node: ast.AST) -> Iterator[tuple[int, int, str]]:
        """Yield start, stop and replacement of each change of a node itself."""
        match node:
            case ast.Constant(value=bool(value)):
                yield (*self._span(node), str(not value))
            case ast.Constant(value=int(value) | float(value)):
                for number in self._numbers(value):
                    yield (*self._span(node), repr(number))
            case ast.Compare(left=left, comparators=others):
                for before, after in pairwise([left, *others]):
                    yield from self._between(before, after, COMPARISONS)
            case ast.Name(id=name) if name in NAMES:
                yield (*self._span(node), NAMES[name])
            case ast.Attribute(attr=name) if name in NAMES:
                stop = self._span(node)[1]
                yield stop - len(name), stop, NAMES[name]
            case _:
                yield from self._of_operators(node)

    def _of_operators(self, node: ast.AST) -> Iterator[tuple[int, int, str]]:
        swaps = ARITHMETIC | BITS
        match node:
            case ast.BoolOp(op=op, values=values):
                given, instead = ("and", "or") if isinstance(op, ast.And) else ("or", "and")
                for before, after in pairwise(values):
                    yield from self._between(before, after, {given: (instead,)})
            case ast.BinOp(left=left, right=right):
                table = {given: (instead,) for given, instead in swaps.items()}
                yield from self._between(left, right, table)
            case ast.AugAssign(target=target, value=value):
                table = {f"{given}=": (f"{instead}=",) for given, instead in swaps.items()}
                yield from self._between(target, value, table)
            case ast.UnaryOp(op=ast.Not() | ast.USub() as op):
                start = self._span(node)[0]
                yield start, start + (3 if isinstance(op, ast.Not) else 1), ""
            case _:
                pass

    def _numbers(self, value: float) -> tuple[float, ...]:
        if isinstance(value, int) and value <= SMALL:
            return value + 1, value - 1
        if value == 0:
            return 1.0, -1.0
        if value == 1:  # a part, an identity, or a threshold: any of them
            return self._factor, 1.0 / self._factor, 0.0
        if isinstance(value, int):
            more, less = round(value * self._factor), round(value / self._factor)
            return max(more, value + 1), min(less, value - 1)
        return value * self._factor, value / self._factor

    def _between(
        self, before: ast.expr, after: ast.expr, table: dict[str, tuple[str, ...]]
    ) -> Iterator[tuple[int, int, str]]:
        start, stop = self._span(before)[1], self._span(after)[0]
        between = re.sub(r"#[^\n]*", lambda found: " " * len(found[0]), self._source[start:stop])
        given = between.strip(" ()\n\\")
        where = start + between.index(given)
        for instead in table.get(given, ()):
            yield where, where + len(given), instead

    def _span(self, node: ast.AST) -> tuple[int, int]:
        def at(number: int, column: int) -> int:
            within = len(self._lines[number - 1].encode()[:column].decode())
            return sum(map(len, self._lines[: number - 1])) + within

        assert isinstance(node, ast.expr)
        assert node.end_lineno is not None
        assert node.end_col_offset is not None
        return at(node.lineno, node.col_offset), at(node.end_lineno, node.end_col_offset)

    def _add(self, start: int, stop: int, instead: str) -> None:
        number = self._source.count("\n", 0, start) + 1
        line, given = self._lines[number - 1].strip(), self._source[start:stop]
        self._seen[line, given, instead] += 1
        again = self._seen[line, given, instead] - 1
        self.found.append(Mutant(self._file, number, line, start, stop, given, instead, again))


def copy_of_tree(folder: Path) -> Path:
    """Copy what git knows, and what is new and not ignored."""
    listed = subprocess.run(
        ["git", "ls-files", "-z", "--cached", "--others", "--exclude-standard"],
        cwd=ROOT, check=True, capture_output=True, text=True,
    ).stdout  # fmt: skip
    for name in filter(None, listed.split("\0")):
        if (ROOT / name).is_file() and not (ROOT / name).is_symlink():
            (folder / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copy2(ROOT / name, folder / name)
    return folder


def run_tests(tree: Path, tests: tuple[str, ...], *, changed: bool) -> NoReturn:
    """Run tests in this process, and end it."""
    for stream in (1, 2):
        os.dup2(os.open(os.devnull, os.O_WRONLY), stream)
    os.chdir(tree)
    sys.path.insert(0, str(tree))
    # What was compiled before is told from a change by its time; two changes in a second are not.
    sys.dont_write_bytecode = changed
    import hypothesis
    import pytest

    hypothesis.settings.register_profile("alike", derandomize=True, deadline=None, database=None)
    hypothesis.settings.load_profile("alike")
    quick = ("-x", "-q", "-p", "no:cacheprovider", "--assert=plain", "--noconftest")
    sys.exit(pytest.main([*quick, *tests]))


def fails(tree: Path, file: str, *, changed: bool = True) -> bool:
    """Run the tests of a file in a copy of the tree."""
    process = FORKS.Process(target=run_tests, args=(tree, TESTS[file]), kwargs={"changed": changed})
    process.start()
    process.join(TIMEOUT)
    if process.is_alive():
        process.kill()
        process.join()
    return process.exitcode != 0


def noticed(mutant: Mutant, trees: SimpleQueue[Path]) -> bool:
    """Apply a change in a tree that is free, run the tests, and take it back."""
    tree = trees.get()
    path = tree / mutant.file
    source = path.read_text()
    try:
        path.write_text(source[: mutant.start] + mutant.instead + source[mutant.stop :])
        return fails(tree, mutant.file)
    finally:
        path.write_text(source)
        trees.put(tree)


def listed(file: str, mutants: list[Mutant]) -> dict[str, str]:
    """Return the reasons of those that cannot be noticed; each has to be a mutant of the file."""
    reasons: dict[str, str] = (yaml.safe_load(LISTED.read_text()) or {}).get(file, {})
    names = {mutant.name for mutant in mutants}
    if stale := [name for name in reasons if name not in names]:
        raise SystemExit(f"{LISTED.name} lists what {file} no longer has: {stale}")
    return reasons


def judge(file: str, mutants: list[Mutant], reasons: dict[str, str], processes: int) -> bool:
    """Try the mutants of a file, print who lives, and say whether the bar is met."""
    with tempfile.TemporaryDirectory(prefix="mutants-") as temporary:
        trees: SimpleQueue[Path] = SimpleQueue()
        for k in range(processes):
            tree = copy_of_tree(Path(temporary, str(k)))
            if fails(tree, file, changed=False):
                raise SystemExit(f"the tests of {file} fail without any change")
            trees.put(tree)
        told, wrong = [], False
        with ThreadPoolExecutor(processes) as pool:
            for mutant, dead in zip(
                mutants, pool.map(noticed, mutants, repeat(trees)), strict=True
            ):
                told.append(dead)
                wrong |= dead and mutant.name in reasons
                if said := _said(reasons.get(mutant.name), dead=dead):
                    print(f"{file}:{mutant.number}: {mutant.name}, {said}", flush=True)
    killed, total = sum(told), len(told)
    share = killed / max(total, 1)
    print(
        f"{file}: {killed} of {total} noticed, {100 * share:.1f} % (bar {100 * BAR:.0f} %)",
        flush=True,
    )
    return share >= BAR and not wrong


def _said(reason: str | None, *, dead: bool) -> str:
    """Say what is to be known of a mutant; nothing of one that was noticed and had to be."""
    if dead:
        return "" if reason is None else f"was noticed, though listed: {reason}"
    return f"survived: {reason or 'NOT EXPLAINED'}"


def part_of(text: str) -> tuple[int, int]:
    """Read which part of how many, for example 1/4."""
    match = re.fullmatch(r"([0-9]+)/([0-9]+)", text)
    first, parts = map(int, match.groups()) if match else (0, 0)
    if not 1 <= first <= parts:
        raise typer.BadParameter(f"--part is {text}, expected for example 1/4 or 4/4")
    return first, parts


def files_of(text: str) -> list[str]:
    """Return the files whose name holds a text."""
    if found := [name for name in TESTS if text in name]:
        return found
    raise typer.BadParameter(f"--file is {text}, expected part of one of {', '.join(TESTS)}")


def main(
    file: Annotated[str, typer.Option(help="Only files whose name holds this.")] = "",
    sample: Annotated[int, typer.Option(min=0, help="Mutants of each file; 0 for all.")] = 0,
    seed: Annotated[int, typer.Option(help="Of the sample.")] = 1,
    factor: Annotated[float, typer.Option(help="By which numbers are changed.")] = FACTOR,
    part: Annotated[
        str, typer.Option(help="For example 1/4: every fourth, from the first.")
    ] = "1/1",
    lines: Annotated[str, typer.Option(help="Only of lines that hold this.")] = "",
    processes: Annotated[int, typer.Option(min=1, help="Tests that run at once.")] = 2,
) -> None:
    """Print survivors and, for each file, how many mutants the tests notice beside the bar."""
    first, parts = part_of(part)
    files = files_of(file)
    if not 1.0 < factor < math.inf:
        raise typer.BadParameter(f"--factor is {factor:g}, expected above 1")
    os.environ["NUMBA_DISABLE_JIT"] = "1"
    FORKS.set_forkserver_preload(["hypothesis", "numba", "pinocchio", "pytest", "scipy.stats"])
    fine = True
    for name in files:
        source = (ROOT / name).read_text()
        reasons = listed(name, Finder(name, source, FACTOR).found)
        mutants = Finder(name, source, factor).found
        mutants = [mutant for mutant in mutants if lines in mutant.line][first - 1 :: parts]
        if 0 < sample < len(mutants):
            mutants = random.Random(seed).sample(mutants, sample)  # noqa: S311  # no secret
            mutants.sort(key=lambda mutant: mutant.start)
        fine = judge(name, mutants, reasons, processes) and fine
    raise SystemExit(0 if fine else 1)


if __name__ == "__main__":
    plain = typer.Typer(rich_markup_mode=None, pretty_exceptions_enable=False, add_completion=False)
    plain.command()(main)
    plain()
