"""Settings: each says what it trades, the page has them all, and no number stands beside them.

`python tests/estimators/diagnosis/test_chosen_numbers.py` writes the page anew.
"""

import ast
import re
from dataclasses import FrozenInstanceError, fields
from pathlib import Path

import pytest

from estimators.diagnosis import settings
from estimators.diagnosis.settings import fitting, judgement, residuals
from estimators.diagnosis.settings.residuals import NOISE

ROOT = Path(settings.__file__).parents[1]
FILES = [
    file
    for file in sorted(ROOT.rglob("*.py"))
    if file.parent.name != "settings"
    and file.name != "figures.py"  # which is colours and sizes
    and "from_motion" not in file.parts  # whose numbers stand where they are used
]
# of arithmetic, decades and units; 20 is the variance of a third difference of white noise
PLAIN = {0.0, 0.5, 1.0, 2.0, 10.0, 20.0, 100.0, 1e3}
NUMERICAL = 1e-6  # up to which a number only keeps others from being nothing
NAMED = {  # constants of a module that no result hangs on
    "MOST": "characters of a headline",
    "_BODY": "indices of parameters",
}


def numbers_in(source: str, *, of_report: bool = False) -> list[str]:
    """Return the lines with numbers that look chosen: fractions, and constants of a module."""
    tree = ast.parse(source)
    found = {node.lineno for node in _without_progress(tree) if _is_chosen(node)}
    if not of_report:  # whose counts of rows and cards are sizes of a page
        found |= {line for line, name in _constants(tree) if name not in NAMED}
    lines = source.splitlines()
    return [f"{line}: {lines[line - 1].strip()}" for line in sorted(found)]


def _without_progress(tree: ast.AST):
    """Walk a tree without what says how far a bar has come."""
    for node in ast.iter_child_nodes(tree):
        if isinstance(node, ast.Call) and getattr(node.func, "id", "") == "progress":
            continue
        yield node
        yield from _without_progress(node)


def _is_chosen(node: ast.AST) -> bool:
    value = getattr(node, "value", None)
    return (
        isinstance(node, ast.Constant)
        and isinstance(value, float)
        and value not in PLAIN
        and value > NUMERICAL
    )


def _constants(tree: ast.Module):
    """Yield line and name of each constant of the module that is a whole number, or several."""
    for node in tree.body:
        if not isinstance(node, ast.Assign | ast.AnnAssign) or node.value is None:
            continue
        names = node.targets if isinstance(node, ast.Assign) else [node.target]
        parts = node.value.elts if isinstance(node.value, ast.List | ast.Tuple) else [node.value]
        values = [part.value for part in parts if isinstance(part, ast.Constant)]
        if any(type(value) is int and value > 1 for value in values):
            yield node.lineno, ast.unparse(names[0])


def test_no_chosen_number_stands_beside_the_settings():
    found = [
        f"{file.relative_to(ROOT)}:{line}"
        for file in FILES
        for line in numbers_in(file.read_text("utf-8"), of_report=file.parent.name == "report")
    ]
    assert len(FILES) > 50
    assert not found, (
        "what somebody chose stands in estimators/diagnosis/settings/, with what it trades:\n"
        + "\n".join(found)
    )


@pytest.mark.parametrize(
    "line",
    [
        "x = f(0.02)",
        "STEPS = (1, 7)",
        "_MOST: Final = 3",
        "def f(x, part=0.3): pass",
        "y = y if ok else 1e6",
    ],
)
def test_such_a_number_would_be_noticed(line):
    assert numbers_in(line)


@pytest.mark.parametrize("line", ["progress('searching', 0.4)", "x = max(x, 1e-12)", "x = a[4:]"])
def test_others_are_left_alone(line):
    assert not numbers_in(line)


_HEAD = """# Settings of the diagnosis

Every number of the [diagnosis](diagnosis.md) that somebody chose. They stand in
`estimators/diagnosis/settings/`, a file a stage, from which this page is written; there each says
what it trades, and why it was chosen.

Levels that mean the same everywhere, as what part of a whole matters, are shared.

Not here: constants of mathematics, numbers up to 1e-6 that keep others from being nothing, where
effects are looked for (with each effect), colours and sizes of the report, and the reach of
tolerances, three deviations (`estimators/regression/evidence.py`).
"""


def groups():
    """Yield the name of each group of settings, and the group, in the order of the stages."""
    for stage in (residuals, fitting, judgement):
        for name, value in vars(stage).items():
            if name.isupper() and type(value).__module__ == stage.__name__:
                yield name, value


def table() -> str:
    """Return all settings as Markdown."""
    shared = re.findall(
        r"^([A-Z]\w+): Final = (.+?)  # (.+)$", Path(settings.__file__).read_text("utf-8"), re.M
    )
    rows = "\n".join(f"| `{name}` | {value} | {meaning} |" for name, value, meaning in shared)
    parts = [_HEAD, f"## Shared\n\n| level | value | meaning |\n|---|---|---|\n{rows}\n"]
    for name, group in groups():
        parts.append(f"## `{name}`\n{group.__doc__}\n")
        parts.append("| setting | value | unit | meaning |\n|---|---|---|---|")
        for item in fields(group):
            value = getattr(group, item.name)
            many = ", ".join(f"{v:g}" for v in (value if isinstance(value, tuple) else (value,)))
            known = item.metadata
            parts.append(f"| `{item.name}` | {many} | {known['unit']} | {known['meaning']} |")
        parts[-1] += "\n"
    return "\n".join(parts)


PAGE = Path(__file__).parents[3] / "docs" / "diagnosis_settings.md"
GROUPS = list(groups())
NAMES = [name for name, _ in GROUPS]


def test_the_page_is_the_table():
    assert PAGE.read_text(encoding="utf-8") == table()


@pytest.mark.parametrize(("name", "group"), GROUPS, ids=NAMES)
def test_each_says_what_it_is_what_it_trades_and_why(name, group):
    for item in fields(group):
        assert all(item.metadata[what] for what in ("meaning", "trades", "chosen")), name
        assert item.default == getattr(group, item.name)


def test_names_of_groups_are_unique():
    assert len(set(NAMES)) == len(NAMES) > 20


def test_nothing_changes_them():
    with pytest.raises(FrozenInstanceError):
        NOISE.order = 4


if __name__ == "__main__":
    PAGE.write_text(table(), encoding="utf-8")
