"""What came of trials, a line each, so that a run that is interrupted goes on where it was."""

from __future__ import annotations

import hashlib
import json
import threading
from dataclasses import dataclass, field, replace
from functools import cache
from typing import TYPE_CHECKING

from mutation.trials import ROOT, files_of

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path

    from mutation.changes import Mutant
    from mutation.trials import Outcome, Tests


@dataclass(frozen=True)
class _Known:
    noticed: bool = False
    tests: Mapping[str, str] = field(default_factory=dict[str, str])  # that ran, and their digests


class Kept:
    """Outcomes of trials: what was noticed stays so, and tests that did not notice need not run.

    Args:
        path: Of the file, which grows by a line for each trial.
    """

    def __init__(self, path: Path) -> None:
        self._path, self._known = path, dict[tuple[str, str, str], _Known]()
        self._one_at_a_time = threading.Lock()
        path.parent.mkdir(parents=True, exist_ok=True)
        for line in path.read_text().splitlines() if path.exists() else ():
            entry = json.loads(line)
            self._take((entry["file"], entry["name"], entry["lane"]), entry)

    def noticed(self, mutant: Mutant, lane: str) -> bool:
        """Say whether tests of a lane are known to notice a mutant."""
        return self._of(mutant, lane).noticed

    def lives(self, mutant: Mutant, lane: str) -> bool:
        """Say whether a mutant was tried, and not noticed."""
        known = self._of(mutant, lane)
        return bool(known.tests) and not known.noticed

    def untried(self, mutant: Mutant, tests: Tests) -> Tests:
        """Return those of some tests that did not run on a mutant yet, as they are now."""
        known = self._of(mutant, tests.lane)
        files = [str(file.relative_to(ROOT)) for file in files_of(tests.paths)]
        new = [file for file in files if known.tests.get(file) != digest(file)]
        return replace(tests, paths=() if known.noticed else tuple(dict.fromkeys(new)))

    def add(self, mutant: Mutant, tests: Tests, outcome: Outcome) -> None:
        """Keep what came of a trial."""
        key = {"file": mutant.file, "name": mutant.name, "lane": tests.lane}
        entry = {"noticed": outcome.noticed, "seconds": round(outcome.seconds, 1)}
        entry["tests"] = {file: digest(file) for file in tests.paths}
        with self._one_at_a_time, self._path.open("a") as file:
            file.write(json.dumps(key | entry) + "\n")
            self._take((mutant.file, mutant.name, tests.lane), entry)

    def _of(self, mutant: Mutant, lane: str) -> _Known:
        return self._known.get((mutant.file, mutant.name, lane), _Known())

    def _take(self, key: tuple[str, str, str], entry: Mapping[str, bool | dict[str, str]]) -> None:
        before = self._known.get(key, _Known())
        tests = {**before.tests, **entry["tests"]}
        self._known[key] = _Known(before.noticed or bool(entry["noticed"]), tests)


@cache  # tests that change while a run goes on are no part of it
def digest(file: str) -> str:
    """Return what tells a file of tests from what it was."""
    return hashlib.sha256((ROOT / file).read_bytes()).hexdigest()[:16]
