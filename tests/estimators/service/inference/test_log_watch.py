"""A log that stops is told, shown, and tried again."""

from __future__ import annotations

import errno
import os
from typing import TYPE_CHECKING, Any

from sessions import wait_until

from estimators.service.inference.inbox import LogWatch
from limo_driver.logs.mcap_log import McapLog
from limo_driver.network.messages import LOG, Event, Level

if TYPE_CHECKING:
    from pathlib import Path

    import pytest


class Told:
    """The part of an outlet that is told."""

    def __init__(self) -> None:
        self.events: list[tuple[str, str, Level]] = []

    def event(self, kind: str, text: str, level: Level = Level.INFO, **_facts: object) -> None:
        self.events.append((kind, text, level))


def write(log: McapLog, number: int) -> None:
    log.write("events", LOG, Event(number, Level.INFO, "x", "y").encode(), number, number)


def full(*_: Any) -> None:
    raise OSError(errno.ENOSPC, "No space left on device")


def test_a_full_disk_is_told_once_and_logging_goes_on_when_there_is_room(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    told = Told()
    with McapLog(tmp_path) as log:
        watch = LogWatch(log, told)
        assert watch.look() == {"written": 0, "dropped": 0, "failure": None}
        with monkeypatch.context() as disk:
            disk.setattr(os, "fsync", full)
            write(log, 1)
            wait_until(lambda: log.failure is not None)
            status = watch.look()
            assert status["dropped"] == 1
            assert "No space left" in status["failure"]
            watch.look()
            assert log.failure is not None  # a minute has not passed
            disk.setattr("estimators.service.inference.inbox.PAUSE", 0.0)
            watch._next_try = 0.0
            watch.look()  # tries, and fails again
            write(log, 2)
            wait_until(lambda: log.failure is not None)
            assert len(list(tmp_path.iterdir())) == 1  # the try left nothing
        watch.look()
        monkeypatch.setattr(watch, "_next_try", 0.0)
        watch.look()
        write(log, 3)
        wait_until(lambda: log.written > 0)
        assert watch.look()["failure"] is None
    assert [(kind, level) for kind, _, level in told.events] == [
        ("log", Level.ERROR),
        ("log", Level.INFO),
    ]
    assert "No space left" in told.events[0][1]
