"""The page of figures says what the benchmarks printed."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).parents[2]
PUBLISH = ROOT / "benchmarks" / "publish.py"


def test_the_page_has_the_figures_that_the_benchmarks_printed():
    done = subprocess.run(
        [sys.executable, str(PUBLISH), "--check"], capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stdout + done.stderr


def test_every_kept_output_is_shown_on_the_page():
    page = (ROOT / "docs" / "benchmarks.md").read_text(encoding="utf-8")
    kept = sorted(path.name for path in (ROOT / "benchmarks" / "results").glob("*.txt"))
    assert kept
    assert [name for name in kept if f"benchmarks/results/{name}" not in page] == []
