"""What tests of several parts share."""

import signal
import sys
from pathlib import Path
from subprocess import CompletedProcess

import hypothesis
import pytest
import typer
from typer.testing import CliRunner

from limo_driver.app.cli import main
from limo_driver.physics import Simulation

pytest_plugins = ["kept_results"]

TWO_LINKS = """<robot name="two_links">
  <link name="base"/>
  <link name="upper"><inertial><origin xyz="0.2 0 0"/><mass value="2"/>
    <inertia ixx="0.01" ixy="0" ixz="0" iyy="0.03" iyz="0" izz="0.03"/></inertial></link>
  <link name="lower"><inertial><origin xyz="0.15 0 0"/><mass value="1"/>
    <inertia ixx="0.01" ixy="0" ixz="0" iyy="0.02" iyz="0" izz="0.02"/></inertial></link>
  <joint name="a" type="revolute"><parent link="base"/><child link="upper"/><axis xyz="0 1 0"/>
    <limit lower="-3" upper="3" effort="50" velocity="2"/></joint>
  <joint name="b" type="revolute"><parent link="upper"/><child link="lower"/>
    <origin xyz="0.4 0 0" rpy="0.3 0 0"/><axis xyz="0 0.6 0.8"/>
    <limit lower="-3" upper="3" effort="50" velocity="2"/></joint>
</robot>"""

# The same examples each time, and none is too slow on a busy machine: what fails, fails again.
# `--hypothesis-profile explore` looks at others, and at more of them.
for name, alike, examples in (("alike", True, 30), ("explore", False, 100)):
    hypothesis.settings.register_profile(
        name,
        max_examples=examples,
        derandomize=alike,
        deadline=None,
        suppress_health_check=[hypothesis.HealthCheck.too_slow],
    )
hypothesis.settings.load_profile("alike")


def pytest_configure() -> None:
    """Hear Ctrl-C, and let the programs of tests hear it, where a shell in the background does not.

    What is ignored stays ignored in every process that is started, in which tests wait for it.
    """
    if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
        signal.signal(signal.SIGINT, signal.default_int_handler)


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Refuse what is left out of `make test` without a reason."""
    for item in items:
        for mark in item.iter_markers("slow"):
            given = [*mark.args, *mark.kwargs.values()]
            if len(given) != 1 or not str(given[0]).strip():
                raise pytest.UsageError(f"{item.nodeid}: slow needs one argument, which says why")


@pytest.fixture(scope="session")
def hysteretic():
    """The simulation of the examples: friction with memory, noise, quantised encoders."""
    return Simulation.load(Path(__file__).parents[1] / "examples" / "iiwa14_hysteretic.yaml")


@pytest.fixture(scope="session")
def two_links_urdf(tmp_path_factory):
    """A file of an arm with two skew joints: small, and no iiwa."""
    path = tmp_path_factory.mktemp("robot") / "two_links.urdf"
    path.write_text(TWO_LINKS)
    return path


@pytest.fixture
def commanded():
    """Make a function that runs one command with arguments, as a user would."""

    def of(command):
        app = typer.Typer()
        app.command()(command)
        return lambda *arguments: CliRunner().invoke(app, [str(a) for a in arguments])

    return of


@pytest.fixture
def limo(monkeypatch, capsys):
    """Make a function that runs the command line to its end, in this process."""
    monkeypatch.setenv("COLUMNS", "200")
    monkeypatch.setenv("NO_COLOR", "1")

    def run(*arguments):
        given = ["limo", *map(str, arguments)]
        monkeypatch.setattr(sys, "argv", given)
        with pytest.raises(SystemExit) as ended:
            main()
        return CompletedProcess(given, ended.value.code or 0, *capsys.readouterr())

    return run
