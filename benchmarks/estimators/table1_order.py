"""How far the order of Table I's rows is the paper's, from finished trials, with intervals.

    python benchmarks/estimators/table1_order.py out/table1_real/ur10e out/table1_real/panda

Reads the table1.json of each folder that `limo reproduce table1` wrote. Rows are ranked by their
joint-averaged MSE; Spearman's correlation with the paper's ranks is that of each folder, averaged
over folders, of rows that all of them have finished: all that the paper has, and its hybrids alone.
The interval holds 95 % of bootstrap draws of folders, of each row's runs, and of rows. With one run
of each row and one folder, only the draw of rows is left, which says nothing of other recordings.
Below stand the paper's claims: in how many comparisons of two rows the geometric mean of the factor
between their MSE, over runs and folders, is as it says; with `--each` all of them, with the
interval over folders where there are several.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy.stats import rankdata
from scipy.stats import t as student

from estimators.studies.table1_data import PARTS, ROWS, paper_table
from estimators.studies.table1_page import JSON
from estimators.studies.table1_results import SPLIT_WORDS

if TYPE_CHECKING:
    from numpy.typing import NDArray

DRAWS = 2000
FEWEST = 4  # rows in a draw that differ, of which an order says something
HYBRIDS = {row.name for row in ROWS if row.model is not None and row.rigid_body}
Runs = dict[str, "NDArray[np.float64]"]  # joint-averaged MSE of each run, by row


def main() -> None:
    """Print both tables."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("folders", type=Path, nargs="+")
    parser.add_argument("--each", action="store_true", help="each comparison of the claims")
    given = parser.parse_args()
    folders: list[Path] = given.folders
    found = [json.loads((folder / JSON).read_text(encoding="utf-8")) for folder in folders]
    print(f"{len(found)} folders: {', '.join(folder.name for folder in folders)}")
    print("Spearman's correlation with the paper's order, 95 % interval")
    print(f"{'split':12} {'part':10} {'rows':>4}  {'all':24} {'rows':>4}  hybrids")
    for split, word in SPLIT_WORDS.items():
        for part in PARTS:
            tables = [runs_of(one, split, part) for one in found]
            done = [row.name for row in ROWS if all(len(own[row.name]) for own in tables)]
            hybrids = [name for name in done if name in HYBRIDS]
            cells = [f"{len(own):4d}  {order(tables, own, part):24}" for own in (done, hybrids)]
            print(f"{word:12} {part:10} {' '.join(cells)}")
    claims(found, each=given.each)


def runs_of(table: dict[str, Any], split: str, part: str) -> Runs:
    """Return the joint-averaged MSE of each finished run."""
    return {
        entry["architecture"]: np.array([np.mean(run) for run in entry["each_run"]])
        for entry in table["table"]
        if (entry["split"], entry["part"]) == (split, part)
    }


def order(tables: list[Runs], names: list[str], part: str) -> str:
    """Return the correlation over rows and its interval, in words."""
    if len(names) < FEWEST:
        return "-"
    random = np.random.default_rng(0)
    paper = np.array([paper_table()[part, name][-1] for name in names])
    means = [np.array([own[name].mean() for name in names]) for own in tables]
    drawn = []
    for _ in range(DRAWS):
        rows = random.integers(len(names), size=len(names))
        if np.unique(rows).size < FEWEST:
            continue
        each = []
        for k in random.integers(len(tables), size=len(tables)):
            runs = [tables[k][names[i]] for i in rows]
            ours = [one[random.integers(one.size, size=one.size)].mean() for one in runs]
            each.append(spearman(np.array(ours), paper[rows]))
        drawn.append(np.mean(each))
    middle = np.mean([spearman(ours, paper) for ours in means])
    low, high = np.quantile(drawn, (0.025, 0.975))
    return f"{middle:5.2f} ({low:5.2f} to {high:5.2f})"


def spearman(ours: NDArray[np.float64], paper: NDArray[np.float64]) -> float:
    """Return the correlation of the ranks."""
    return float(np.corrcoef(rankdata(ours), rankdata(paper))[0, 1])


def claims(found: list[dict[str, Any]], *, each: bool) -> None:
    """Print in how many comparisons each claim is as the paper says, and each of them if asked."""
    print("\nclaims of the paper: comparisons as it says, of all; factor above 1: as it says")
    by_claim: dict[str, list[tuple[str, NDArray[np.float64]]]] = {}
    for same in zip(*(one["claims"] for one in found), strict=True):
        first = same[0]
        logs = np.log([one["factor"] for one in same if one["factor"] is not None])
        if logs.size:
            where = f"{first['part']}, {SPLIT_WORDS[first['split']]}"
            paper = f"{first['paper']:.2f}" if first["paper"] else "-"
            pair = f"{where:24} {first['worse']} / {first['better']}, paper's {paper}"
            by_claim.setdefault(first["claim"], []).append((pair, logs))
    for claim, compared in by_claim.items():
        middles = [float(logs.mean()) for _, logs in compared]
        hold = sum(middle > 0 for middle in middles)
        over_all = np.exp(np.median(middles))
        print(f"{claim}: {hold} of {len(compared)}, median factor {over_all:.2f}")
        for pair, logs in compared if each else ():
            print(f"  {interval(logs):34} {pair}")


def interval(logs: NDArray[np.float64]) -> str:
    """Return the geometric mean, its interval by Student where there are several, a verdict."""
    middle = f"{np.exp(logs.mean()):.2f}"
    if logs.size == 1:
        return middle
    reach = student.ppf(0.975, logs.size - 1) * logs.std(ddof=1) / np.sqrt(logs.size)
    low, high = np.exp(logs.mean() + np.array([-reach, reach]))
    verdict = "holds" if low > 1 else "does not hold" if high < 1 else "open"
    return f"{middle} ({low:.2f} to {high:.2f}) {verdict}"


if __name__ == "__main__":
    main()
