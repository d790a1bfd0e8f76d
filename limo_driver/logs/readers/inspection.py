"""Inspection: what a log holds, how it would be read, and what is still to be decided."""

from __future__ import annotations

from dataclasses import dataclass, fields
from hashlib import sha256
from typing import TYPE_CHECKING, Final

from limo_driver.errors import ConfigError, LimoError
from limo_driver.logs.readers.columns import NO_COLUMN
from limo_driver.logs.readers.mapping import QUANTITIES, Channels, LogMapping, TimeColumns
from limo_driver.runtime.display import Displayed, shortened, spanned
from limo_driver.runtime.outputs import whole

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence
    from pathlib import Path

    from limo_driver.logs.readers.proposals.proposal import Proposal
    from limo_driver.logs.readers.table import LogTable
    from limo_driver.recordings.recording import Recording

NO_MOTION: Final = "no motion of those tried: state it, or take it for small"
WELL: Final = 0.1  # relative deviation of a parameter that is known well enough
_PARTS: Final = ("time", *QUANTITIES)
_LISTED: Final = 8
_MARK: Final = "# as proposed: "
_DIGITS: Final = 16


@dataclass(frozen=True)
class ShownParameter:
    """How well a motion shows one base parameter of the arm, and what would show it better."""

    name: str  # with those that are identifiable only in sum with it
    unit: str
    value: float
    known_to: float  # standard deviation over its size; infinite where the motion says nothing
    remedy: str  # a motion that would show it; empty where it is known well

    @property
    def verdict(self) -> str:
        """Say whether it can be identified from the motion."""
        if self.known_to <= WELL:
            return "identifiable"
        return "weak" if self.known_to <= 1.0 else "not from this motion"


@dataclass(frozen=True, repr=False)
class Inspection(Displayed):
    """What a log holds, and the mapping that is proposed for it."""

    table: LogTable
    proposal: Proposal
    recording: Recording | None  # as it would be read; None where it cannot be
    refused: str  # why not
    telemetry: tuple[str, ...] = ()  # what the recording is worth, one sentence each
    robot: tuple[str, ...] = ()  # what was locked of the robot, slides, or is not represented
    parameters: tuple[ShownParameter, ...] = ()  # of the arm, where its torques tell them

    @property
    def mapping(self) -> LogMapping:
        """The proposed mapping; it cannot be used while questions are open."""
        return self.proposal.mapping

    @property
    def questions(self) -> tuple[str, ...]:
        """What has to be decided before the log is read."""
        return self.mapping.undecided

    def headline(self) -> str:
        """Say what it is and how much of it there is."""
        return f"{self.table.source or 'arrays'}: {self.table.kind}, {self.table.rows} rows"

    def figures(self) -> Mapping[str, Sequence[object]]:
        """Return what each quantity is read from."""
        taken = self.proposal.taken
        return {
            "quantity": [item.quantity for item in taken],
            "columns": [item.columns for item in taken],
            "unit": [item.unit or "-" for item in taken],
            "because": [item.why for item in taken],
        }

    def __str__(self) -> str:
        lines = [super().__str__()]
        if self.recording is not None:
            lines.append(self.recording.headline())
        lines += [f"telemetry: {line}" for line in self.telemetry]
        lines += [f"note: {note}" for note in self.notes()]
        lines += [f"undecided: {question}" for question in self.questions]
        return "\n".join(lines)

    def notes(self) -> tuple[str, ...]:
        """Say what is left out, what is strange about the rows, and of the robot."""
        notes = list(self.table.notes)
        if self.mapping.left_out:
            notes.append(f"left out: {shortened(list(self.mapping.left_out), 24)}")
        notes += [f"not read: {name} holds {what}" for name, what in self.table.unread.items()]
        if self.refused and self.recording is None:  # else it is one of the questions
            notes.append(f"read as proposed it is refused: {self.refused}")
        if self.recording is not None:
            notes += [*self.recording.warnings, *map(str, self.recording.left_out)]
        notes += self.robot
        return tuple(dict.fromkeys(notes))


@dataclass(frozen=True)
class Settled:
    """Which file reads the log."""

    path: Path
    mapping: LogMapping  # that stands there
    is_kept: bool  # it was there, and reads otherwise than what is proposed
    told: tuple[str, ...]


def settle(found: Inspection, out: Path, log: str) -> Settled:
    """Write a proposed mapping, unless one is there that is of this log and reads otherwise.

    One that is of another log, or cannot be read as a mapping, stays too; the proposal is then
    written next to it, to a file named after the log.

    Args:
        found: What was proposed.
        out: Where to write it.
        log: Name of the log, without its ending.

    Raises:
        ConfigError: Both files are there, and neither is of this log; or it cannot be written.
    """
    notes: list[str] = []
    text = _marked(found.mapping.as_file)
    for path in (out, out.with_name(f"{log}.{out.stem}.yaml")):
        there = None if path.exists() else found.mapping
        try:
            there = there or LogMapping.load(path)
            _check_of(there, found)
        except LimoError as error:
            reason = str(error).removeprefix(f"{path}: ").removeprefix(f"{path}, ")
            notes.append(f"kept {path}, which is no mapping of this log: {reason}")
            continue
        if not path.exists() or _is_open_still(path, there) or path.read_bytes() == text.encode():
            with whole(path) as draft:
                draft.write_text(text, encoding="utf-8")
            return Settled(path, found.mapping, False, (*notes, f"wrote {path}"))
        notes.append(
            f"kept {path}, which is there and reads otherwise{_difference(there, found.mapping)}; "
            "to see what is proposed now, name another file by `out`"
        )
        return Settled(path, there, True, tuple(notes))
    raise ConfigError(f"{'; '.join(notes)}; name another file by `out`")


def _marked(text: str) -> str:
    """Return the text of a proposal with a mark by which a later change is seen."""
    return f"{text}{_MARK}{sha256(text.encode()).hexdigest()[:_DIGITS]}\n"


def _is_open_still(path: Path, mapping: LogMapping) -> bool:
    """Say whether a file is a proposal that nobody has answered in, and that cannot be used so."""
    text = path.read_text(encoding="utf-8")
    return bool(mapping.undecided) and text == _marked(text.rpartition(_MARK)[0])


def _check_of(mapping: LogMapping, found: Inspection) -> None:
    """Check that a mapping may be of a log.

    Raises:
        ConfigError: It is of other joints, or reads columns that are not there.
    """
    model = found.proposal.model
    known = {*model.joint_names, *model.description.locked}
    if other := [name for name in mapping.joints if name not in known]:
        raise ConfigError(f"it is of the joints {shortened(other)}, not of {model.name}")
    there = {*found.table.columns, *found.table.unread, NO_COLUMN}
    parts = (getattr(mapping, quantity) for quantity in _PARTS)
    lacking = [name for part in parts if part for name in part.columns if name not in there]
    if lacking:
        raise ConfigError(f"it reads {shortened(lacking)}, and the log has no such columns")


def _difference(there: LogMapping, proposed: LogMapping) -> str:
    """Say in which quantities two mappings differ; nothing where they read alike."""
    notes: list[str] = []
    for quantity in _PARTS:
        one, other = getattr(there, quantity), getattr(proposed, quantity)
        if one == other:
            continue
        if one is None or other is None:
            notes.append(f"{'no ' if one is None else ''}{quantity}")
            continue
        notes += [
            f"{quantity} has {item.name} {_said(one, item.name)}, not {_said(other, item.name)}"
            for item in fields(one)
            if getattr(one, item.name) != getattr(other, item.name)
        ]
    return f" ({shortened(notes, _LISTED)})" if notes else ""


def _said(part: Channels | TimeColumns, name: str) -> str:
    value = getattr(part, name)
    if not isinstance(value, tuple):
        return str(value)
    return str(value[0]) if len(set(value)) == 1 else spanned(list(map(str, value)))
