"""The list of what tests have to notice names files, tests and lines that exist."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).parents[2]


def test_every_file_test_and_line_of_the_list_of_mutants_exists():
    done = subprocess.run(
        [sys.executable, str(ROOT / "benchmarks" / "mutants.py"), "--check"],
        capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stdout + done.stderr
