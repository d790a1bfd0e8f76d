"""Cases that nothing can have been made on, and of which nobody chose the luckier ones.

Seeds follow from the commit that is measured: before it there were none such, and after it they are
what they are. Cases are kept in a folder of this version, so that a series that was ended goes on
where it was, and never holds those of two versions.
"""

from __future__ import annotations

import subprocess
from pathlib import Path

ROOT = Path(__file__).parents[2]
APART = 1000  # seeds of two commits, at least


def version() -> str:
    """Return the commit of this tree; with `-dirty` where what is measured differs from it."""
    name = _git("rev-parse", "--short=8", "HEAD")
    changed = _git("status", "--porcelain", "--", "*.py", "*.yaml", "*.toml", ":!benchmarks/*.yaml")
    return f"{name}-dirty" if changed else name


def _git(*words: str) -> str:
    done = subprocess.run(["git", *words], cwd=ROOT, capture_output=True, text=True, check=True)
    return done.stdout.strip()


def first_seed() -> int:
    """Return the first seed of this version, beyond all that were ever looked at."""
    return 10**9 + APART * int(version()[:6], 16)


def folder(series: str) -> Path:
    """Return where the cases of a series are kept for this version."""
    return Path("out") / series / version()
