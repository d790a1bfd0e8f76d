"""Changes of a source that tests should notice: one number, comparison or operator each.

Of the well-kept tools, mutmut 3.8 leaves out decorated functions and constants of a module, which
are the arithmetic and the thresholds here, and cosmic-ray 8.7 changes numbers by one only, which
for a threshold of 0.02 is a factor of 51.
"""

from __future__ import annotations

import ast
import re
from collections import Counter
from dataclasses import dataclass
from itertools import accumulate, pairwise
from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:
    from collections.abc import Iterator

SMALL: Final = 4  # whole numbers up to this are counts, places and bits: changed by one
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
        self._starts = [0, *accumulate(map(len, self._lines))]
        self._seen: Counter[tuple[str, str, str]] = Counter()
        self._alike = set[tuple[int, float]]()  # numbers and places where they change nothing
        self.found: list[Mutant] = []
        self.visit(ast.parse(source))

    def visit(self, node: ast.AST) -> None:
        """Look at everything but types, texts and decorators, which decide nothing here.

        A `zip` that is strict is left alone, too: it asserts what always holds.
        """
        for change in self._changes(node):
            self._add(*change)
        for name, value in ast.iter_fields(node):
            if name in {"annotation", "returns", "decorator_list"}:
                continue
            for child in value if isinstance(value, list) else [value]:
                if isinstance(child, ast.AST) and not _is_left_alone(child):
                    self.visit(child)

    def _changes(self, node: ast.AST) -> Iterator[tuple[int, int, str]]:
        """Yield start, stop and replacement of each change of a node itself."""
        match node:
            case ast.Constant(value=bool(value)):
                yield (*self._span(node), str(not value))
            case ast.Constant(value=int(value) | float(value)):
                for number in self._numbers(value):
                    if (self._span(node)[0], number) not in self._alike:
                        yield (*self._span(node), repr(number))
            case ast.Compare(left=left, comparators=others):
                for before, after in pairwise([left, *others]):
                    yield from self._between(before, after, COMPARISONS)
            case ast.Call(func=ast.Attribute(attr="reshape"), args=lengths):
                for length in lengths:  # any that is negative is the one that is left: -2 as -1
                    if isinstance(length, ast.UnaryOp):
                        self._alike.add((self._span(length.operand)[0], 2))
            case ast.Call(func=ast.Name(id=name) | ast.Attribute(attr=name) as called):
                if name in NAMES:  # a `floor` that is not called is a level of noise
                    stop = self._span(called)[1]
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
            return self._starts[number - 1] + within

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


def _is_left_alone(node: ast.AST) -> bool:
    match node:
        case ast.keyword(arg="strict", value=ast.Constant(value=True)):
            return True
        case _:  # before Python 3.12, what stands in an f-string does not say where
            return isinstance(node, ast.JoinedStr)
