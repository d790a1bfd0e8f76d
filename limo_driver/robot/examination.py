"""What an examination of a link or an arm found: each thing with a word for programs."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Final

if TYPE_CHECKING:
    from collections.abc import Mapping

OTHER_PROBLEM: Final = 1  # exit status of a problem that has none of its own


@dataclass(frozen=True)
class CheckResult:
    """One thing that was found out."""

    code: str  # a word for programs
    text: str  # what is, and what to do
    problem: bool = True


@dataclass
class Examination:
    """All that was found out.

    Args:
        statuses: Exit statuses of problems by their codes, the gravest first.
    """

    statuses: Mapping[str, int] = field(default_factory=dict[str, int])
    findings: list[CheckResult] = field(default_factory=list[CheckResult])
    figures: dict[str, Any] = field(default_factory=dict[str, Any])

    @property
    def healthy(self) -> bool:
        """Whether no problem was found."""
        return not any(finding.problem for finding in self.findings)

    @property
    def status(self) -> int:
        """Exit status: that of the gravest problem, 0 if there is none."""
        if self.healthy:
            return 0
        codes = {finding.code for finding in self.findings if finding.problem}
        known = (status for code, status in self.statuses.items() if code in codes)
        return next(known, OTHER_PROBLEM)

    def add(self, code: str, text: str, *, problem: bool = True) -> None:
        """Add a finding."""
        self.findings.append(CheckResult(code, text, problem))

    def as_json(self) -> dict[str, Any]:
        """Return plain values."""
        return {
            "healthy": self.healthy,
            "status": self.status,
            "findings": [vars(finding) for finding in self.findings],
            "figures": self.figures,
        }
