"""Inspection: what a log holds, how it would be read, and what is still to be decided."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from limo_driver.runtime.display import Displayed, shortened

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from limo_driver.logs.readers.mapping import LogMapping
    from limo_driver.logs.readers.proposals.proposal import Proposal
    from limo_driver.logs.readers.table import LogTable
    from limo_driver.recordings.recording import Recording


@dataclass(frozen=True, repr=False)
class Inspection(Displayed):
    """What a log holds, and the mapping that is proposed for it."""

    table: LogTable
    proposal: Proposal
    recording: Recording | None  # as it would be read; None where it cannot be
    refused: str  # why not
    telemetry: tuple[str, ...] = ()  # what the recording is worth, one sentence each
    robot: tuple[str, ...] = ()  # what was locked of the robot, slides, or is not represented

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
        told = list(self.table.notes)
        if self.mapping.left_out:
            told.append(f"left out: {shortened(list(self.mapping.left_out), 24)}")
        told += [f"not read: {name} holds {what}" for name, what in self.table.unread.items()]
        if self.refused and self.recording is None:  # else it is one of the questions
            told.append(f"read as proposed it is refused: {self.refused}")
        if self.recording is not None:
            told += [*self.recording.warnings, *map(str, self.recording.left_out)]
        told += self.robot
        return tuple(dict.fromkeys(told))
