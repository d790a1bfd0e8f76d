"""The command line: how it presents itself and how it refuses."""

import re
import subprocess
import sys
from importlib.metadata import entry_points, version
from pkgutil import iter_modules

import pytest

from limo_driver.app import cli

COMMANDS = sorted(module.name.replace("_", "-") for module in iter_modules(cli.__path__))
HEAVY = {"numpy", "torch", "pinocchio", "mujoco", "numba", "scipy", "pyarrow", "matplotlib"}


def test_the_command_is_installed():
    (script,) = entry_points(group="console_scripts", name="limo")
    assert script.value == "limo_driver.cli:main"


def test_version(limo):
    result = limo("--version")
    assert result.returncode == 0
    assert result.stdout == f"limo {version('limo')}\n"


def test_help_lists_every_command(limo):
    result = limo("--help")
    assert result.returncode == 0
    listed = re.findall(r"^  ([a-z]+)  ", result.stdout, flags=re.MULTILINE)
    assert sorted(listed) == sorted(COMMANDS)
    assert result.stdout.index("Find what the simulation of a robot arm lacks") < 80
    assert listed.index("inspect") < listed.index("identify") < listed.index("serve")


def test_the_usage_names_the_command_however_it_is_begun():
    program = "from limo_driver.app.cli import main; main()"
    ended = subprocess.run(
        [sys.executable, "-c", program, "plan", "--help"],
        capture_output=True, text=True, check=True,
    )  # fmt: skip
    assert ended.stdout.split()[:3] == ["Usage:", "limo", "plan"]


def test_a_command_that_is_mistyped_is_suggested(limo):
    result = limo("identfy")
    assert result.returncode == 2
    assert "No such command 'identfy'. Did you mean 'identify'?" in " ".join(result.stderr.split())


@pytest.mark.parametrize("command", COMMANDS)
def test_every_command_shows_an_example(limo, command):
    result = limo(command, "--help")
    assert result.returncode == 0
    assert "Example" in result.stdout
    assert f"limo {command} " in result.stdout


def imported_by(*arguments):
    """Return the modules that a command line imports, in a process of its own."""
    code = (
        f"import sys; sys.argv = {['limo', *arguments]}\n"
        "from limo_driver.app.cli import main\n"
        "try: main()\n"
        "except SystemExit: print(*sys.modules, file=sys.stderr)"
    )
    result = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True
    )
    return set(result.stderr.split())


def test_help_imports_nothing_heavy():
    imported = imported_by("--help")
    assert "limo_driver.app.cli" in imported
    assert not imported & HEAVY


def test_a_command_imports_no_other():
    imported = imported_by("plan", "--help")
    assert {name for name in imported if name.startswith("limo_driver.app.cli.")} == {
        "limo_driver.app.cli.plan"
    }


def test_bad_input_is_one_line_and_status_2(tmp_path):
    """In a process of its own, where nothing but the command itself catches what is raised."""
    code = "from limo_driver.app.cli import main; main()"
    options = ("--sim", tmp_path / "none.yaml", "--out", "x.parquet")
    result = subprocess.run(
        [sys.executable, "-c", code, "predict", "nowhere.parquet", *options],
        capture_output=True,
        text=True,
        check=False,
    )
    assert result.returncode == 2
    assert result.stderr.count("\n") == 1
    assert result.stderr.startswith("limo: ")


def test_an_unknown_command_is_refused(limo):
    result = limo("fly")
    assert result.returncode == 2
    assert "fly" in result.stderr
