"""The table of all settings, as docs/diagnosis_settings.md has it."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

from estimators.diagnosis.settings import (
    afterwards,
    fitting,
    hypotheses,
    judgement,
    pushes,
    residuals,
    selection,
    settings_of,
)

if TYPE_CHECKING:
    from collections.abc import Iterator

STAGES = (residuals, hypotheses, selection, fitting, judgement, pushes, afterwards)
_HEAD = """# Settings of the diagnosis

Every number of the [diagnosis](diagnosis.md) that somebody chose. They stand in
`estimators/diagnosis/settings/`, a file a stage, from which this page is written; there each says
what it trades, and why it was chosen.

Not here: constants of mathematics, numbers up to 1e-6 that keep others from being nothing, where
effects are looked for (with each effect), colours and sizes of the report, and the reach of
tolerances, three deviations (`estimators/regression/evidence.py`).
"""


def groups() -> Iterator[tuple[str, Any]]:
    """Yield the name of each group of settings, and the group, in the order of the stages."""
    for stage in STAGES:
        for name, value in vars(stage).items():
            if name.isupper() and type(value).__module__ == stage.__name__:
                yield name, value


def table() -> str:
    """Return all settings as Markdown."""
    parts = [_HEAD]
    for name, group in groups():
        parts.append(f"## `{name}`\n{group.__doc__}\n")
        parts.append("| setting | value | unit | meaning |\n|---|---|---|---|")
        for item in settings_of(group):
            cells = (f"`{item.name}`", _said(item.value), item.unit, item.meaning)
            parts.append(f"| {' | '.join(cells)} |")
        parts[-1] += "\n"
    return "\n".join(parts)


def _said(value: Any) -> str:  # noqa: ANN401  # a number, or several
    return ", ".join(f"{v:g}" for v in value) if isinstance(value, tuple) else f"{value:g}"


if __name__ == "__main__":
    Path(sys.argv[1]).write_text(table(), encoding="utf-8")
