"""Compare two trees of limo, as moves, merges and renames have to leave them alike.

    python tests/regression/compare.py OLD_TREE NEW_TREE [CASE ...]

The frozen cases (all, or those that are named) are computed on both trees, on this machine in one
run, and have to agree to 1e-12 of their scale. So do the surfaces: names of `limo_driver`,
signatures of what it exports, and the help of every command. Prints what differs; ends with 1 if
anything does.
"""

from __future__ import annotations

import argparse
import inspect
import json
import os
import re
import subprocess
import sys
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any

from frozen_cases import limo
from frozen_values import SAME_MACHINE, differences

import limo_driver

if TYPE_CHECKING:
    from collections.abc import Iterator

SURFACE = "surface"
_ADDRESS = re.compile(r" at 0x[0-9a-f]+")
_COMMAND = re.compile(r"^  ([a-z-]+)  ", re.MULTILINE)


def surface() -> dict[str, Any]:
    """Return what a user sees of limo without running it."""
    exported = {name: getattr(limo_driver, name) for name in sorted(limo_driver.__all__)}
    return {
        "names": [name for name in dir(limo_driver) if not name.startswith("__")],
        "signatures": {name: dict(_signatures(name, value)) for name, value in exported.items()},
        "help": dict(_help(())),
    }


def _signatures(name: str, value: Any) -> Iterator[tuple[str, str]]:  # any object
    """Yield the signature of a function, or those of a class and its public members."""
    yield name, _signature(value)
    for member in dir(value) if inspect.isclass(value) else ():
        if not member.startswith("_"):
            found = inspect.getattr_static(value, member)
            yield member, _signature(getattr(found, "__func__", found))  # of class methods, too


def _signature(value: Any) -> str:  # any object
    try:
        return _ADDRESS.sub("", str(inspect.signature(value)))
    except (TypeError, ValueError):  # a property, or of a class that Python itself has
        return type(value).__name__


def _help(command: tuple[str, ...]) -> Iterator[tuple[str, list[str]]]:
    """Yield the help of a command, and of each of its own."""
    text = limo(*command, "--help")
    yield " ".join(("limo", *command)), text.splitlines()
    _, _, commands = text.partition("\nCommands:\n")
    for name in _COMMAND.findall(commands):
        yield from _help((*command, name))


def computing(tree: Path, into: Path, cases: list[str]) -> list[subprocess.Popen[bytes]]:
    """Begin to compute the surface of a tree, by this file, and its cases, by its own."""
    environment = os.environ | {"PYTHONPATH": str(tree), "OPENBLAS_NUM_THREADS": "1"}
    freeze = tree / "tests" / "regression" / "freeze.py"
    commands = (
        [__file__, f"--{SURFACE}", str(into / f"{SURFACE}.json"), str(tree)],
        [str(freeze), "--into", str(into), *cases],
    )
    return [
        subprocess.Popen([sys.executable, *words], env=environment, cwd=into) for words in commands
    ]


def compared(old: Path, new: Path) -> Iterator[str]:
    """Yield what differs between two folders of computed values."""
    names = ({path.name for path in folder.glob("*.json")} for folder in (old, new))
    before, after = names
    yield from (f"{name}: of one tree alone" for name in sorted(before ^ after))
    for name in sorted(before & after):
        values = (json.loads((folder / name).read_text(encoding="utf-8")) for folder in (old, new))
        for difference in differences(*values, SAME_MACHINE):
            yield f"{name}: {difference}"


def main() -> None:
    """Compute both trees side by side, and print what differs."""
    asked = argparse.ArgumentParser(description="Compare what two trees of limo compute.")
    asked.add_argument("old", type=Path)
    asked.add_argument("new", type=Path)
    asked.add_argument("cases", nargs="*", metavar="CASE", help="as of freeze.py; or all")
    given = asked.parse_args()
    with TemporaryDirectory() as made:
        folders = [Path(made, side) for side in ("old", "new")]
        begun: list[subprocess.Popen[bytes]] = []
        for folder, tree in zip(folders, (given.old, given.new), strict=True):
            folder.mkdir()
            begun += computing(tree.resolve(), folder, given.cases)
        failed = [process.args for process in begun if process.wait()]
        found = [*map(str, failed), *compared(*folders)]
    sys.stdout.write("\n".join([*found, f"{len(found)} differences"]) + "\n")
    sys.exit(bool(found))


if __name__ == "__main__":
    if sys.argv[1:2] == [f"--{SURFACE}"]:
        _path, _tree = map(Path, sys.argv[2:])
        if not Path(limo_driver.__file__).is_relative_to(_tree):
            raise SystemExit(f"limo_driver is {limo_driver.__file__}, expected that of {_tree}")
        _path.write_text(json.dumps(surface(), indent=1), encoding="utf-8")
    else:
        main()
