"""What commands print is printed as it is: rich takes `[mrad]` for a style, if it may."""

import ast
from pathlib import Path

import pytest
from rich.progress import Progress, TextColumn
from rich.table import Table

from limo_driver.console.terminal import terminal

ROOT = Path(__file__).parents[3]
PACKAGES = ("limo_driver", "backends", "estimators", "limopa")
FILES = sorted(path for package in PACKAGES for path in (ROOT / package).rglob("*.py"))
TEXT = "[mrad] [rad/s] [N m] [s] [/] :smile:"


def calls(path):
    """Return the calls of a file, by the last part of what is called."""
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Call):
            yield getattr(node.func, "attr", getattr(node.func, "id", "")), node


def test_text_is_printed_as_it_is_wherever_it_stands(capsys, monkeypatch):
    monkeypatch.setenv("COLUMNS", "200")
    table = Table(TEXT, title=TEXT, caption=TEXT)
    table.add_row(TEXT)
    terminal().print(TEXT, table, style="bold")
    assert capsys.readouterr().out.count(TEXT) == 5


@pytest.mark.parametrize("path", FILES, ids=lambda path: str(path.relative_to(ROOT)))
def test_there_is_no_other_way_to_print_with_rich(path):
    """Each `Console` is one of `terminal`, and what has markup of its own goes without."""
    for name, call in calls(path):
        switched_off = any(
            word.arg == "markup" and getattr(word.value, "value", True) is False
            for word in call.keywords
        )
        if name == "Console":
            assert path.name == "terminal.py", call.lineno
        if name == "TextColumn" and "{" in ast.unparse(call):
            assert switched_off, call.lineno
        assert name not in {"from_markup", "track"}, call.lineno
        assert not (name == "print" and any(w.arg == "markup" for w in call.keywords)), call.lineno
        if name in {"Panel", "status"}:  # parse what stands in them whatever the console does
            texts = [*call.args, *(word.value for word in call.keywords)]
            held = [each.value for each in texts if isinstance(each, ast.Constant)]
            assert not any("[" in str(each) for each in held), call.lineno


def test_a_column_of_progress_keeps_its_brackets(capsys):
    column = TextColumn("{task.description}", markup=False)
    with Progress(column, console=terminal()) as bar:
        bar.add_task(TEXT, total=1)
    assert TEXT in capsys.readouterr().out
