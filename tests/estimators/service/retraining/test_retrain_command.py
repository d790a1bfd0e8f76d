"""`limo models retrain` without a service: a challenger from a folder of logs."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING

import pytest
from test_trainer import write_keys, write_log
from typer.testing import CliRunner

from estimators.service.store.store import ModelStore
from limo_driver.app.cli.models import command
from limo_driver.errors import ConfigError, ModelStoreError

if TYPE_CHECKING:
    from pathlib import Path

    from limo_driver.recordings.recording import Recording

pytestmark = pytest.mark.waits


def run(*arguments: object):
    environment = {"COLUMNS": "160", "TERM": "dumb"}
    return CliRunner().invoke(command, ["retrain", *map(str, arguments)], env=environment)


@pytest.fixture
def logs(training_recording: Recording, tmp_path: Path) -> Path:
    write_log(tmp_path / "logs", training_recording)
    return tmp_path / "logs"


def test_a_challenger_is_added_and_compared(store: ModelStore, logs: Path) -> None:
    found = run("--store", store.root, "--log", logs, "--seconds", 50)
    assert found.exit_code == 0, found.exception
    assert found.stdout.startswith("version 3, trained on 50")
    assert "beside version 1" in found.stdout
    assert (store.aliases.champion, store.aliases.challenger) == (1, None)
    assert store.verify(3) <= 1e-6


@pytest.mark.slow("trains a model")
def test_it_is_signed_and_of_a_kind_if_that_is_wanted(
    store: ModelStore, logs: Path, tmp_path: Path
) -> None:
    private, public = write_keys(tmp_path, "own")
    given = ("--store", store.root, "--log", logs, "--sign", private, "--trust", public)
    refused = run(*given)
    assert isinstance(refused.exception, ModelStoreError)
    assert "the version is not signed" in str(refused.exception)
    store.sign(1, private)
    values = json.loads(run(*given, "--kind", "joint-physics", "--json").stdout)
    assert values["version"] == 3
    assert ModelStore(store.root, trusted_keys=[public]).open(3).estimator == "joint-physics"


@pytest.mark.parametrize(
    ("given", "told"),
    [
        ((), "give --arm to ask a running service, or --log"),
        (("--arm", "a", "--log", "LOGS"), "give --arm to ask a running service, or --log"),
        (("--arm", "a", "--kind", "lstm-fcl"), "--kind are for training from --log"),
        (("--log", "LOGS", "--kind", "x"), "no kind of challenger is 'x'"),
        (("--log", "LOGS", "--connect", "tcp/127.0.0.1:1"), "reach a service: give --arm"),
        (("--log", "STORE"), "holds logs of no arm"),
    ],
)
def test_what_cannot_be_is_refused(
    given: tuple[str, ...], told: str, store: ModelStore, logs: Path
) -> None:
    places = {"LOGS": logs, "STORE": store.root}
    at = () if "--arm" in given else ("--store", store.root)
    found = run(*(places.get(word, word) for word in given), *at)
    assert isinstance(found.exception, ConfigError)
    assert told in str(found.exception)


@pytest.mark.slow("trains a model")
def test_logs_of_several_arms_need_a_name(store: ModelStore, logs: Path) -> None:
    (log,) = logs.glob("arm_*.mcap")
    log.with_name(log.name.replace("arm", "other")).write_bytes(log.read_bytes())
    found = run("--store", store.root, "--log", logs)
    assert "holds logs of arm, other; say which with --name" in str(found.exception)
    assert run("--store", store.root, "--log", logs, "--name", "arm").exit_code == 0
