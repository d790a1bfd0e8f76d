"""Freeze what the commands make of six recordings, and the small cases beside them.

    python tests/regression/freeze.py [--texts] [--stage STAGE] [--into FOLDER] [CASE ...]

Writes `frozen/CASE.json` for each case whose files are there. Do so only where numbers are meant
to change, on a tree without other changes, and say in the commit why they change.

--texts takes over sentences whose words changed and leaves everything else as it is; if anything
else changed, or a figure in a sentence, it says so and writes nothing.

--stage makes one stage of recordings anew and leaves the others as they are, where only that is
meant to change.
"""

from __future__ import annotations

import argparse
import json
import re
import sys
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from frozen_cases import CASES, FROZEN, STAGES, values_of
from frozen_values import SAME_MACHINE, Difference, differences, fingerprint
from small_cases import SMALL, small_values

_BREAK = re.compile(r"\n\s*")  # between values; within a text, JSON has none
_PLAIN_LIST = re.compile(r'\[\s+((?:[^][{}"]|"[^"\n]*")*?)\s+\]')


def computed(name: str) -> dict[str, Any]:
    """Return the values of all stages of a case; the later ones start from what is identified."""
    first, *later = STAGES
    with TemporaryDirectory() as made:
        folder = Path(made)
        if name in SMALL:
            return small_values(name, folder)
        CASES[name].prepare(folder, None)
        values = values_of(name, [first], folder)
        CASES[name].prepare(folder, values[first]["sim"])
        return values | values_of(name, later, folder)


def with_stage(content: dict[str, Any], name: str, stage: str) -> dict[str, Any]:
    """Return what is frozen of a case, with one stage made anew from what was identified then."""
    if content["fingerprint"] != fingerprint():
        raise SystemExit(f"{name}: frozen on another machine or of other packages; freeze it whole")
    stages = content["stages"]
    with TemporaryDirectory() as made:
        CASES[name].prepare(Path(made), stages[next(iter(STAGES))]["sim"])
        return content | {"stages": stages | values_of(name, [stage], Path(made))}


def as_text(content: dict[str, Any]) -> str:
    """Return JSON with every list of plain values in one line, for the size and for reading."""
    text = json.dumps(content, indent=1)
    return _PLAIN_LIST.sub(lambda found: f"[{_BREAK.sub(' ', found[1])}]", text) + "\n"


def with_texts(frozen: Any, changes: list[Difference]) -> Any:
    """Return frozen values with the new texts in the places of the old ones."""
    for change in changes:
        at = frozen
        for step in change.place[:-1]:
            at = at[step]
        at[change.place[-1]] = change.new
    return frozen


def freeze(name: str, into: Path, *, texts: bool, stage: str | None = None) -> str:
    """Write what is frozen of a case, and return what to say about it."""
    path, absent = into / f"{name}.json", CASES[name].absent if name in CASES else ()
    if absent:
        return f"{name}: left as it is; no {', '.join(map(str, absent))}"
    if stage is None:
        content = {"fingerprint": fingerprint(), "stages": computed(name)}
    else:
        content = with_stage(json.loads(path.read_text(encoding="utf-8")), name, stage)
    if texts:
        content_now, content = content, json.loads(path.read_text(encoding="utf-8"))
        changes = differences(content["stages"], content_now["stages"], SAME_MACHINE)
        others = [change for change in changes if not change.of_text]
        if others:
            return "\n".join([f"{name}: left as it is; not of texts:", *map(str, others)])
        with_texts(content["stages"], changes)
    path.write_text(as_text(content), encoding="utf-8")
    return f"{name}: frozen"


def main() -> None:
    """Freeze the cases that are named, or all."""
    every = (*SMALL, *CASES)
    asked = argparse.ArgumentParser(description="Freeze what commands make of stored inputs.")
    asked.add_argument("cases", nargs="*", metavar="CASE", help=f"of {', '.join(every)}; or all")
    asked.add_argument("--texts", action="store_true", help="take over changed sentences only")
    asked.add_argument("--stage", choices=STAGES, help="make this one anew, and no other")
    asked.add_argument("--into", type=Path, default=FROZEN, help="folder to write")
    given = asked.parse_args()
    known = CASES if given.stage else every
    unknown = sorted(set(given.cases) - set(known))
    if unknown:
        asked.error(f"no case is called {', '.join(unknown)}; known: {', '.join(known)}")
    given.into.mkdir(parents=True, exist_ok=True)
    for name in given.cases or known:
        sys.stdout.write(freeze(name, given.into, texts=given.texts, stage=given.stage) + "\n")
        sys.stdout.flush()


if __name__ == "__main__":
    main()
