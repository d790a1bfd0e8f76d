"""The command line: how it presents itself and how it refuses."""

import subprocess
import sys
from importlib.metadata import entry_points, version
from pkgutil import iter_modules

import pytest

from limo_driver import cli

COMMANDS = sorted(module.name.replace("_", "-") for module in iter_modules(cli.__path__))


def limo(*arguments: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-c", "from limo_driver.cli import main; main()", *arguments],
        capture_output=True,
        text=True,
        check=False,
        env={"PATH": "/usr/bin:/bin", "COLUMNS": "200", "NO_COLOR": "1", "TERM": "dumb"},
    )


def test_the_command_is_installed():
    (script,) = entry_points(group="console_scripts", name="limo")
    assert script.value == "limo_driver.cli:main"


def test_version():
    result = limo("--version")
    assert result.returncode == 0
    assert result.stdout == f"limo {version('limo')}\n"


def test_help_lists_every_command():
    result = limo("--help")
    assert result.returncode == 0
    assert all(f" {command} " in result.stdout for command in COMMANDS)


@pytest.mark.parametrize("command", COMMANDS)
def test_every_command_shows_an_example(command):
    result = limo(command, "--help")
    assert result.returncode == 0
    assert "Example" in result.stdout
    assert f"limo {command} " in result.stdout


@pytest.mark.parametrize(
    "heavy", ["numpy", "torch", "pinocchio", "mujoco", "numba", "scipy", "pyarrow", "matplotlib"]
)
def test_help_imports_nothing_heavy(heavy):
    code = (
        "import sys; sys.argv = ['limo', '--help']\n"
        "from limo_driver.cli import main\n"
        "try: main()\n"
        "except SystemExit: pass\n"
        f"sys.exit(3 if {heavy!r} in sys.modules else 0)"
    )
    result = subprocess.run([sys.executable, "-c", code], capture_output=True, check=False)
    assert result.returncode == 0


def test_bad_input_is_one_line_and_status_2(tmp_path):
    result = limo(
        "predict", "nowhere.parquet", "--sim", str(tmp_path / "none.yaml"), "--out", "x.parquet"
    )
    assert result.returncode == 2
    assert result.stderr.count("\n") == 1
    assert result.stderr.startswith("limo: ")


def test_an_unknown_command_is_refused():
    result = limo("fly")
    assert result.returncode == 2
    assert "fly" in result.stderr
