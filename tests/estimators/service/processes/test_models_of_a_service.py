"""`limo models --arm`: the models of a running service, seen and changed over the network."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING

import pytest
import typer
from processes import ARM, Answers, driven, served, wait_for
from typer.testing import CliRunner

from limo_driver.app.cli import serve
from limo_driver.app.cli.models import command
from limo_driver.app.console.command_line import in_options
from limo_driver.errors import ConfigError, ConnectionLostError, LimoError, ModelStoreError
from limo_driver.network.streaming import open_session

if TYPE_CHECKING:
    from pathlib import Path

    from processes import Network

    from estimators.service.store.store import ModelStore

pytestmark = pytest.mark.waits


def run(*arguments: object):
    environment = {"COLUMNS": "160", "TERM": "dumb"}
    return CliRunner().invoke(command, [str(a) for a in arguments], env=environment)


@pytest.mark.slow("asks a real service process a dozen times, as a user does")
def test_versions_of_a_service_are_listed_loaded_promoted_and_rolled_back(
    store: ModelStore, network: Network, tmp_path: Path
) -> None:
    there = ("--arm", ARM, "--zenoh-config", network.there)
    with (
        open_session(config=network.here) as session,
        driven(session),
        served(network, "--arm", ARM, "--store", store.root, "--log", tmp_path / "logs"),
    ):
        answers = Answers(session)
        wait_for(lambda: bool(answers.models))
        found = run("list", *there)
        assert found.exit_code == 0, found.exception
        assert "champion, serves" in found.stdout
        assert run("load", 2, *there).stdout == "version 2 serves instead of 1\n"
        answers.later()
        assert answers.models[-1] == "2"
        values = json.loads(run("list", *there, "--json").stdout)
        assert [value["aliases"] for value in values] == [["champion"], ["serves"]]
        refused = run("promote", 1, *there)
        assert isinstance(refused.exception, ModelStoreError)
        assert "version 1 is the champion already" in str(refused.exception)
        found = run("promote", 2, "--reason", "as good", *there)
        assert found.stdout == "champion: version 2 instead of 1\n"
        assert store.aliases.champion == 2
        assert "promote 1 → 2: as good" in run("show", *there).stdout
        assert run("rollback", *there).stdout == "champion: version 1 instead of 2\n"
        answers.later()
        assert answers.models[-1] == "1"
        assert store.aliases.champion == 1
        refused = run("load", 9, *there)
        assert isinstance(refused.exception, ModelStoreError)
        assert "has no version '9'; known: 1, 2, champion, challenger" in str(refused.exception)
        found = run("retrain", "--reason", "to see", *there)
        assert found.stdout == "a challenger will be trained: to see\n"
        refused = run("retrain", *there)
        assert isinstance(refused.exception, ModelStoreError)
        assert "cannot train now" in str(refused.exception)


@pytest.mark.slow("looks for a service in vain, and waits")
def test_a_service_that_is_not_there_is_said(network: Network) -> None:
    with open_session(config=network.here):
        found = run("list", "--arm", "nobody", "--zenoh-config", network.there)
    assert isinstance(found.exception, ConnectionLostError)
    assert "no service of arm 'nobody' is on the network" in str(found.exception)


@pytest.mark.parametrize(
    ("given", "told"),
    [
        (("--store", "elsewhere", "--arm", "arm"), "--arm arm asks a running service"),
        (("--robot", "iiwa14", "--arm", "arm"), "--arm arm asks a running service"),
        (("--connect", "tcp/127.0.0.1:1"), "reach a service: give --arm"),
    ],
)
def test_options_of_a_store_and_of_a_service_do_not_mix(
    given: tuple[str, ...], told: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    found = run("list", *given)
    assert isinstance(found.exception, ConfigError)
    assert told in in_options(str(found.exception))


@pytest.mark.slow("starts a service of two arms")
def test_several_arms_are_served_from_stores_of_their_own(
    store: ModelStore, stored: Path, network: Network
) -> None:
    store.promote(2, "as good")
    with (
        open_session(config=network.here) as session,
        driven(session, "left"),
        driven(session, "right"),
        served(network, "--arm", f"left={store.root}", "--arm", f"right={stored}"),
    ):
        left, right = Answers(session, "left"), Answers(session, "right")
        wait_for(lambda: bool(left.models and right.models))
        assert {*left.models} == {"2"}
        assert {*right.models} == {"1"}


@pytest.mark.parametrize(
    ("given", "told"),
    [
        ("--arm a=STORE --arm a=STORE", "--arm a is given twice"),
        ("--arm a=STORE --store STORE", "names a store, and so does --store"),
        ("--arm a", "give each of --arm a store, or all one --store, or --model: one of them"),
        ("--arm a/b=STORE", "the arm's name is 'a/b'"),
        ("--arm a=STORE --arm b=STORE --log LOGS", "arms a and b share the store"),
        ("--arm a --model STORE --sign KEY", "--trust and --sign are for the versions"),
        ("--arm a=STORE --sign KEY", "KEY: cannot be read"),
        ("--arm a=STORE --log LOGS --challenger x", "no kind of challenger is 'x'"),
        ("--arm a=STORE --arm b=STORE --ros joint_states", "--ros is the topic of one arm"),
    ],
)
def test_arms_that_cannot_be_served_are_refused(given: str, told: str, stored: Path) -> None:
    app = typer.Typer()
    app.command()(serve.command)
    found = CliRunner().invoke(app, given.replace("STORE", str(stored)).split())
    assert isinstance(found.exception, LimoError)
    assert told in in_options(str(found.exception))
