"""What came of trials, a line each, so that a run that is interrupted goes on where it was."""

from __future__ import annotations

import hashlib
import json
import threading
from dataclasses import dataclass
from functools import cache
from typing import TYPE_CHECKING

from mutation.trials import files_of

if TYPE_CHECKING:
    from pathlib import Path

    from mutation.changes import Mutant
    from mutation.trials import Outcome, Tests


@dataclass(frozen=True)
class _Trial:
    noticed: bool
    tests: str  # digest of the tests that were run
    seconds: float


class Kept:
    """Outcomes of trials, of which survivors count until the tests change.

    What was noticed stays noticed; what lived is tried again by tests that are new.
    """

    def __init__(self, path: Path) -> None:
        self._path, self._trials = path, dict[tuple[str, str, str], _Trial]()
        self._one_at_a_time = threading.Lock()
        path.parent.mkdir(parents=True, exist_ok=True)
        for line in path.read_text().splitlines() if path.exists() else ():
            entry = json.loads(line)
            trial = _Trial(entry["noticed"], entry["tests"], entry["seconds"])
            self._trials[entry["file"], entry["name"], entry["lane"]] = trial

    def noticed(self, mutant: Mutant, tests: Tests) -> bool | None:
        """Say whether tests notice a mutant; None where that is not known."""
        trial = self._trials.get((mutant.file, mutant.name, tests.lane))
        if trial is None or not (trial.noticed or trial.tests == digest(tests.paths)):
            return None
        return trial.noticed

    def add(self, mutant: Mutant, tests: Tests, outcome: Outcome) -> None:
        """Keep what came of a trial."""
        trial = _Trial(outcome.noticed, digest(tests.paths), round(outcome.seconds, 1))
        key = {"file": mutant.file, "name": mutant.name, "lane": tests.lane}
        with self._one_at_a_time, self._path.open("a") as file:
            file.write(json.dumps(key | vars(trial)) + "\n")
            self._trials[mutant.file, mutant.name, tests.lane] = trial


@cache  # tests that change while a run goes on are no part of it
def digest(paths: tuple[str, ...]) -> str:
    """Return what tells tests from those that they were."""
    read = hashlib.sha256()
    for file in files_of(paths):
        read.update(file.read_bytes())
    return read.hexdigest()[:16]
