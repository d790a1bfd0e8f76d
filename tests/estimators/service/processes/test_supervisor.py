"""Two arms, a process each: a killed one comes back, the other does not notice."""

from __future__ import annotations

import os
import signal
from typing import TYPE_CHECKING

import numpy as np
import pytest
from processes import PATIENCE, Answers, Network, driven, served, told, wait_for

from limo_driver.app.library.supervising import listens
from limo_driver.network.streaming import open_session

if TYPE_CHECKING:
    from pathlib import Path

    from estimators.service.store.store import ModelStore

pytestmark = pytest.mark.waits

LEFT, RIGHT = "left", "right"
APART = 0.3  # of the dead worker's silence: longest of the other arm's, however slow the machine


def alive(process: int) -> bool:
    try:
        os.kill(process, 0)
    except ProcessLookupError:
        return False
    return True


@pytest.mark.slow("starts five processes: twenty seconds")
def test_a_killed_worker_is_back_and_the_other_arm_does_not_notice(
    store: ModelStore, network: Network, tmp_path: Path
) -> None:
    heard = tmp_path / "heard.jsonl"
    arms = [f"--arm={arm}={store.root}" for arm in (LEFT, RIGHT)]
    with (
        open_session(config=network.here) as session,
        driven(session, LEFT),
        driven(session, RIGHT),
        heard.open("w") as output,
    ):
        left, right = Answers(session, LEFT), Answers(session, RIGHT)
        with served(network, *arms, "--json", "--fifo", stdout=output) as service:
            wait_for(lambda: bool(left.models and right.models))
            left.later(50)
            right.later(50)
            began = {event["arm"]: event for event in told(heard, "working")}
            victim = began[LEFT]["process"]
            before, count = len(right.sequences), len(left.sequences)
            os.kill(victim, signal.SIGKILL)
            wait_for(lambda: bool(told(heard, "worker")))
            wait_for(lambda: len(told(heard, "working")) == 3)
            left.later(count + 20 - len(left.sequences))
            right.later()
            silence = np.diff(left.sequences[count - 1 :]).max()
            assert np.diff(right.sequences[before - 1 :]).max() < APART * silence
            (death,) = told(heard, "worker")
            assert (death["arm"], death["process"]) == (LEFT, victim)
            assert "SIGKILL" in death["text"]
            workers = {event["process"] for event in told(heard, "working")} - {victim}
            assert all(map(alive, workers))
            service.kill()  # and nobody tells the workers to end
            service.wait(PATIENCE)
        wait_for(lambda: not any(map(alive, workers)))


def test_what_listens_at_a_port_of_its_own_is_one_process(tmp_path: Path) -> None:
    network = Network(tmp_path)
    assert listens("tcp/0.0.0.0:7447", None)
    assert listens((), network.here)
    assert not listens((), network.there)
    assert not listens((), None)
