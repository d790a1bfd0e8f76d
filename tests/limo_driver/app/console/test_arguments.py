"""The library speaks of its arguments, and commands of their options."""

import ast
import re
import subprocess
import sys
from pathlib import Path

import pytest
import typer

import backends
import estimators
import limo_driver
import limopa
from limo_driver.app.console.command_line import (
    OPTIONS,
    SessionOptions,
    command_line,
    describe_options,
    in_options,
)

pytestmark = pytest.mark.waits

COMMAND = re.compile(r"limo [a-z][^`)]*")  # a whole command line, of which options are a part
SOURCES = [
    path
    for package in (backends, estimators, limo_driver, limopa)
    for path in sorted(Path(package.__path__[0]).rglob("*.py"))
    if not {"cli", "console"} & set(path.relative_to(package.__path__[0]).parts)
]


def test_arguments_are_called_by_their_options():
    assert in_options("give `simulation` or `robot`; see `limo run`") == (
        "give --sim or --robot; see `limo run`"
    )


def test_a_signature_and_its_docstring_are_the_options():
    heard = []

    @describe_options
    def command(log: str, *, dry_run: bool = False, network: SessionOptions, as_json: bool = False):
        """Do it.

        Args:
            log: To be read.
            dry_run: Only say what would
                be done.
            as_json: Print JSON.
        """
        heard.append((log, dry_run, network, as_json))

    one = typer.Typer(rich_markup_mode=None)
    one.command()(command)
    line = typer.main.get_command(one)
    helps = {each.name: each.help for each in line.params}
    assert helps["dry_run"] == "Only say what would be done."
    assert helps["connect"].startswith("Zenoh endpoint to reach")
    assert "--no-dry-run" not in [name for each in line.params for name in each.secondary_opts]
    line(["a.csv", "--dry-run", "--connect", "tcp/x", "--json"], standalone_mode=False)
    assert heard == [("a.csv", True, SessionOptions(connect=["tcp/x"]), True)]


def test_every_option_exists():
    found = set()
    waiting = [command_line()]
    while waiting:
        command = waiting.pop()
        waiting += getattr(command, "commands", {}).values()
        assert all(item.help for item in command.params), command.name
        found |= {name for item in command.params for name in (*item.opts, *item.secondary_opts)}
    assert set(OPTIONS.values()) <= found


OPTION = re.compile(r"--[a-z]")


def said_of_options(path):
    """Return what errors that a file raises say of options."""
    source = path.read_text()
    if not OPTION.search(source):
        return []
    return [
        f"{path}:{node.lineno}: {node.value}"
        for error in ast.walk(ast.parse(source))
        if isinstance(error, ast.Raise)
        for node in ast.walk(error)
        if isinstance(node, ast.Constant)
        and isinstance(node.value, str)
        and OPTION.search(COMMAND.sub("", node.value))
    ]


def test_no_error_of_the_library_speaks_of_options():
    assert len(SOURCES) > 400
    assert [line for path in SOURCES for line in said_of_options(path)] == []


def test_an_error_that_speaks_of_options_is_noticed(tmp_path):
    path = tmp_path / "any.py"
    path.write_text("raise ValueError('see `limo run --sim x`')\nraise ValueError('give --sim')")
    assert said_of_options(path) == [f"{path}:2: give --sim"]


@pytest.mark.slow("starts two processes")
def test_a_command_says_which_of_its_options(tmp_path):
    """From argument to option on the whole way, in a process of its own."""
    trajectory = tmp_path / "any.parquet"
    code = f"""
import numpy as np, limo_driver as limo
still = np.zeros((3, 7))
limo.Trajectory(np.arange(3.0), still, still, still).save({str(trajectory)!r})
"""
    subprocess.run([sys.executable, "-c", code], check=True)
    given = ["run", "--backend", "virtual", "--trajectory", trajectory, "--record", "x.parquet"]
    command = [
        sys.executable,
        "-c",
        "from limo_driver.app.cli import main; main()",
        *map(str, given),
    ]
    done = subprocess.run(command, capture_output=True, text=True, check=False, cwd=tmp_path)
    assert done.returncode == 2
    assert done.stderr == "limo: the trajectory names no robot; give --sim or --robot\n"
