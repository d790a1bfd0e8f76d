"""The tables of docs/formats.md, each cell of which is a test."""

from pathlib import Path

DOCUMENT = Path(__file__).parents[4] / "docs" / "formats.md"


def rows_of(heading):
    """Headings and rows of the table whose first heading is this one."""
    lines = DOCUMENT.read_text(encoding="utf-8").splitlines()
    start = next(k for k, line in enumerate(lines) if line.startswith(f"| {heading} |"))
    table = []
    for line in lines[start:]:
        if not line.startswith("|"):
            break
        table.append([cell.strip() for cell in line.strip("|").split("|")])
    return table[0], table[2:]
