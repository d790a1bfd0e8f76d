"""Keep the unfinished stage of retraining on disk, so that the next service can resume it.

    models/<robot>/retraining-<arm>.json

A challenger that is judged is kept by its alias; what else has to survive is that the arm changed
and nothing was learned from it yet, and that a champion is on probation.

Also the current stage of retraining, written by one thread and read by others.
"""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Any, Final

from estimators.service.store.atomic_files import locked, replace
from limo_driver.errors import ModelStoreError
from limo_driver.runtime.declarations import read_json

if TYPE_CHECKING:
    from pathlib import Path

GATHERING, TRAINING, PROBATION = "gathering", "training", "probation"
_SCHEMA: Final = 1
_STAGES: Final = (GATHERING, TRAINING, PROBATION)
_FIELDS: Final[dict[str, tuple[type, ...]]] = {
    "stage": (str,),
    "reason": (str,),
    "tries": (int,),
    "champion": (int, type(None)),
    "before": (int, type(None)),
    "foretold": (list, type(None)),
}


@dataclass(frozen=True)
class Unfinished:
    """A stage that has not come to its end."""

    stage: str
    reason: str  # why a challenger is, or was, trained
    tries: int = 0  # trainings that may still begin for this reason
    champion: int | None = None  # on probation
    before: int | None = None  # that it goes back to
    # Its squared errors beside those before, at most, as the shadow predicted; None: not known.
    foretold: list[float | None] | None = None


class RetrainingFile:
    """The file of one arm.

    Args:
        home: Folder of the robot's versions.
        arm: Name of the arm in keys.
    """

    def __init__(self, home: Path, arm: str) -> None:
        self._home, self._path = home, home / f"retraining-{arm}.json"

    def read(self) -> Unfinished | None:
        """Return what was not finished; None if nothing was.

        Raises:
            ModelStoreError: The file cannot be read or understood.
        """
        if not self._path.exists():
            return None
        given = read_json(self._path, ModelStoreError, _SCHEMA)
        content = given.content
        for name, kinds in _FIELDS.items():
            if not isinstance(content.get(name, ...), kinds):
                given.fail(f"{name} is missing or of the wrong type")
        given.text("stage", _STAGES)
        ratios = content["foretold"] or []
        if not all(ratio is None or isinstance(ratio, int | float) for ratio in ratios):
            given["foretold"].refuse("a list of numbers")
        return Unfinished(**{name: content[name] for name in _FIELDS})

    def write(self, unfinished: Unfinished | None) -> None:
        """Keep a stage instead of the one before; None: everything is finished.

        Raises:
            ModelStoreError: It cannot be written.
        """
        if unfinished is None and not self._path.exists():
            return
        try:
            with locked(self._home):
                if unfinished is None:
                    self._path.unlink(missing_ok=True)
                else:
                    content = {"schema": _SCHEMA, **asdict(unfinished)}
                    replace(self._path, (json.dumps(content, indent=1) + "\n").encode())
        except OSError as error:
            raise ModelStoreError(f"{self._path}: cannot be written: {error.strerror}") from None


class Stage:
    """A name, since when it is so, and what is known of it; each change is one new dict."""

    def __init__(self) -> None:
        self._facts: dict[str, Any] = {"stage": "idle"}

    @property
    def name(self) -> str:
        """Its name, for example `idle`."""
        return self._facts["stage"]

    @property
    def challenger(self) -> str | None:
        """Version that it is about, if there is one yet."""
        return self._facts.get("challenger")

    def enter(self, name: str, since: float, **facts: object) -> None:
        """Go over to a stage, `since` in seconds of joint states."""
        self._facts = {"stage": name, "since": since, **facts}

    def note(self, **facts: object) -> None:
        """Add what is known by now."""
        self._facts = {**self._facts, **facts}

    def as_values(self) -> dict[str, Any]:
        """Return all of it as JSON values."""
        return dict(self._facts)
