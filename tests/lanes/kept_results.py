"""Run one of two lanes, keep how each test ended, leave out what passed before, shuffle.

`tests/lanes/run.py` and `benchmarks/flaky.py` read the file that `--results` writes: a line of JSON
for each test, with the seconds that it took and those that processors worked for it, those of
its own processes included. A test that has passed there already is left out.
"""

from __future__ import annotations

import gc
import json
import os
import random
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

if TYPE_CHECKING:
    from collections.abc import Generator, Iterable

LANES = ("computing", "waiting")


@dataclass(frozen=True)
class Result:
    """How a test ended."""

    test: str
    outcome: str  # passed, failed, skipped
    seconds: float  # with its fixtures, where it was the first to need them
    cpu: float  # [s] user and system


def read(path: Path) -> dict[str, Result]:
    """Return the last result of each test; a line that was cut off is none."""
    found: dict[str, Result] = {}
    for line in path.read_text(encoding="utf-8").splitlines() if path.exists() else ():
        try:
            result = Result(**json.loads(line))
        except (ValueError, TypeError):
            continue
        found[result.test] = result
    return found


def passed(results: Iterable[Result]) -> list[str]:
    return sorted(one.test for one in results if one.outcome == "passed")


def pytest_addoption(parser: pytest.Parser) -> None:
    group = parser.getgroup("lanes")
    group.addoption("--lane", choices=LANES, help="those that compute, or those that wait")
    group.addoption("--results", type=Path, help="file to keep how each test ended in")
    group.addoption("--shuffle", type=int, metavar="SEED", help="run in a random order")


def pytest_configure(config: pytest.Config) -> None:
    """Keep results where the reports come together: in the process that was called."""
    path = config.getoption("--results")
    if path is not None and not hasattr(config, "workerinput"):
        config.pluginmanager.register(Keeper(path), "kept results")


@pytest.hookimpl(optionalhook=True)
def pytest_configure_node(node) -> None:
    """Tell a worker what to leave out: all have to find the same tests, whenever they start."""
    keeper = node.config.pluginmanager.get_plugin("kept results")
    node.workerinput["passed"] = keeper.before if keeper else []


def pytest_ignore_collect(collection_path: Path, config: pytest.Config) -> bool | None:
    """Spare each of many workers the import of all files without a test that waits."""
    if config.getoption("--lane") != "waiting" or collection_path.suffix != ".py":
        return None
    return True if "mark.waits" not in collection_path.read_text(encoding="utf-8") else None


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    keeper = config.pluginmanager.get_plugin("kept results")
    before = set(getattr(config, "workerinput", {}).get("passed", keeper.before if keeper else []))
    kept: list[pytest.Item] = []
    left_out: list[pytest.Item] = []
    for item in items:
        of_lane = config.getoption("--lane") in (None, LANES["waits" in item.keywords])
        (kept if of_lane and item.nodeid not in before else left_out).append(item)
    if left_out:
        config.hook.pytest_deselected(items=left_out)
        items[:] = kept
    seed = config.getoption("--shuffle")
    if seed is not None:
        _shuffle(items, random.Random(seed))  # noqa: S311


def pytest_collection_finish() -> None:
    """Spare the collector of garbage what lives to the end: a tenth of the time of all tests."""
    gc.collect()
    gc.freeze()


def _shuffle(items: list[pytest.Item], order: random.Random) -> None:
    """Shuffle files, and the tests of each."""
    files: dict[Path, list[pytest.Item]] = {}
    for item in items:
        files.setdefault(item.path, []).append(item)
    shuffled = list(files.values())
    order.shuffle(shuffled)
    for tests in shuffled:
        order.shuffle(tests)
    items[:] = [item for tests in shuffled for item in tests]


def _worked() -> float:
    """Return the time [s] that processors worked for this process and those that it waited for."""
    return sum(os.times()[:4])


@pytest.hookimpl(wrapper=True)
def pytest_runtest_protocol(item: pytest.Item) -> Generator[None, object, object]:
    item.stash[_BEGAN] = _worked()
    return (yield)


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport(
    item: pytest.Item,
) -> Generator[None, pytest.TestReport, pytest.TestReport]:
    report = yield
    report.cpu = _worked() - item.stash[_BEGAN]  # pyright: ignore[reportAttributeAccessIssue]
    return report


_BEGAN = pytest.StashKey[float]()


class Keeper:
    """Adds a line to a file as each test ends."""

    def __init__(self, path: Path) -> None:
        self.before = passed(read(path).values())
        path.parent.mkdir(parents=True, exist_ok=True)
        self._file = path.open("a", encoding="utf-8")
        self._reports: dict[str, list[pytest.TestReport]] = {}

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        reports = self._reports.setdefault(report.nodeid, [])
        reports.append(report)
        if report.when not in ("setup", "call"):  # the end, or that of a worker that crashed
            self._write(self._reports.pop(report.nodeid))

    def _write(self, reports: list[pytest.TestReport]) -> None:
        outcomes = {one.outcome for one in reports}
        outcome = next(one for one in ("failed", "skipped", "passed") if one in outcomes)
        seconds = sum(one.duration for one in reports)
        cpu = getattr(reports[-1], "cpu", 0.0)
        result = Result(reports[0].nodeid, outcome, round(seconds, 3), round(cpu, 3))
        self._file.write(json.dumps(asdict(result)) + "\n")
        self._file.flush()

    def pytest_unconfigure(self) -> None:
        self._file.close()
