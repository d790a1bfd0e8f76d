"""What commands print is printed as it is: rich takes `[mrad]` for a style, if it may."""

import ast
from io import StringIO
from pathlib import Path
from threading import Event

import pytest
from rich.console import Console
from rich.progress import Progress, TextColumn
from rich.table import Table

from limo_driver.app.console import terminal as console
from limo_driver.app.console.terminal import progress_bar, progress_lines, terminal

ROOT = Path(__file__).parents[4]
PACKAGES = ("limo_driver", "backends", "estimators", "limopa")
FILES = sorted(path for package in PACKAGES for path in (ROOT / package).rglob("*.py"))
NAMES = ("Console", "TextColumn", "Panel", "status", "from_markup", "track", "markup")
TEXT = "[mrad] [rad/s] [N m] [s] [/] :smile:"


def calls(path):
    """Return the calls of a file, by the last part of what is called."""
    text = path.read_text()
    if any(name in text for name in NAMES):  # most have none of them, and need no parser
        for node in ast.walk(ast.parse(text)):
            if isinstance(node, ast.Call):
                yield getattr(node.func, "attr", getattr(node.func, "id", "")), node


def test_text_is_printed_as_it_is_wherever_it_stands(capsys, monkeypatch):
    monkeypatch.setenv("COLUMNS", "200")
    table = Table(TEXT, title=TEXT, caption=TEXT)
    table.add_row(TEXT)
    terminal().print(TEXT, table, style="bold")
    assert capsys.readouterr().out.count(TEXT) == 5


def is_another_way(path, name, call):
    """Say whether a call prints text that rich would take for markup."""
    marked_up = [word.value for word in call.keywords if word.arg == "markup"]
    switched_off = any(getattr(value, "value", True) is False for value in marked_up)
    if name == "Console":
        return path.name != "terminal.py"
    if name == "TextColumn":
        return "{" in ast.unparse(call) and not switched_off
    if name in {"Panel", "status"}:  # parse what stands in them whatever the console does
        texts = [*call.args, *(word.value for word in call.keywords)]
        return any("[" in str(each.value) for each in texts if isinstance(each, ast.Constant))
    return name in {"from_markup", "track"} or (name == "print" and bool(marked_up))


def other_ways(path):
    """Return the lines of a file that print in another way than `terminal`."""
    return [
        f"{path}:{call.lineno}" for name, call in calls(path) if is_another_way(path, name, call)
    ]


def test_there_is_no_other_way_to_print_with_rich():
    """Each `Console` is one of `terminal`, and what has markup of its own goes without."""
    assert len(FILES) > 300
    assert [line for path in FILES for line in other_ways(path)] == []


@pytest.mark.parametrize(
    "code",
    [
        "rich.console.Console()",
        "TextColumn('{task.description}')",
        "Text.from_markup('[b]')",
        "track(range(3))",
        "console.print(text, markup=True)",
        "Panel('[mrad]')",
        "console.status('of [s]')",
    ],
)
def test_another_way_is_noticed(tmp_path, code):
    path = tmp_path / "any.py"
    path.write_text(f"\n{code}\n")
    assert other_ways(path) == [f"{path}:2"]


def test_a_column_of_progress_keeps_its_brackets(capsys):
    column = TextColumn("{task.description}", markup=False)
    with Progress(column, console=terminal()) as bar:
        bar.add_task(TEXT, total=1)
    assert TEXT in capsys.readouterr().out


class File(StringIO):
    """A log that says when a text stands in it."""

    def __init__(self, awaited):
        super().__init__()
        self.awaited, self.is_there = awaited, Event()

    def write(self, text):
        super().write(text)
        if self.awaited in self.getvalue():
            self.is_there.set()
        return len(text)


def test_progress_shows_in_a_file_now_and_then_also_within_one_stage(monkeypatch):
    monkeypatch.setattr(console, "QUIET", 0.001)
    file = File("25%: searching")
    with progress_bar(Console(file=file)) as tell:
        tell("searching", 0.25)
        assert file.is_there.wait(60)
    file = File("3 of 4: ")
    with progress_lines(Console(file=file), "diagnosing") as count:
        count("a row", 3, 4)
        assert file.is_there.wait(60)
    assert file.getvalue().replace("\n", "").isprintable()
    monkeypatch.setattr(console, "QUIET", 1e9)
    with progress_bar(Console(file=(file := File("")))) as tell:
        tell("searching", 0.5)
    assert not file.getvalue()
