"""Make the plant's modules importable by their plain names, as the benchmark does."""

import sys
from pathlib import Path

HERE = Path(__file__).parent
for folder in (HERE, HERE.parents[1] / "benchmarks" / "diagnosis"):
    if str(folder) not in sys.path:
        sys.path.insert(0, str(folder))
