"""Probation: a new champion goes back where it is worse than the old one was."""

from __future__ import annotations

from contextlib import closing
from itertools import islice
from types import SimpleNamespace

import numpy as np
import pytest

from estimators.service.gate import FEWEST_BLOCKS, compare
from estimators.service.retraining.judge import Judge, broken
from limo_driver.errors import LimoError

BLOCK = 50  # samples


def found(ratios: tuple[float, float], blocks: int = 40):
    """Compare errors of which those of the new champion have squares so many times as large."""
    old = np.random.default_rng(0).standard_normal((blocks * BLOCK, 2))
    new = np.random.default_rng(1).standard_normal((blocks * BLOCK, 2))
    return compare(old, np.sqrt(ratios) * new, BLOCK)


@pytest.mark.parametrize(
    ("ratios", "predicted", "told"),
    [
        ((0.25, 1.5), (0.25, 1.2), "worse on joint 2 than before and than predicted"),
        ((0.25, 1.5), (0.25, 2.0), ""),  # as the shadow said before it was promoted
        ((0.25, 0.8), (0.25, 0.5), ""),  # less of a gain than was promised is no harm
        ((0.25, 1.05), (0.25, 1.0), ""),  # which may be chance
        ((1.5, 1.5), (2.0, 2.0), "worse than before"),
    ],
)
def test_a_champion_is_broken_where_a_joint_is_worse_than_before_and_than_predicted(
    ratios, predicted, told
):
    said = broken(found(ratios), np.array(predicted))
    assert said.startswith(told) if told else not said


@pytest.mark.parametrize("blocks", [FEWEST_BLOCKS - 1, FEWEST_BLOCKS])
def test_few_blocks_of_motion_say_nothing(blocks):
    assert bool(broken(found((4.0, 4.0), blocks), np.ones(2))) == (blocks == FEWEST_BLOCKS)


class Stand:
    """A judge beside a server whose states come ten seconds a step, and what it does."""

    def __init__(self, monkeypatch, verdicts, serves):
        self.looks, self.events, self.seconds, self.verdicts = [], [], 0.0, list(verdicts)
        model = SimpleNamespace(version=serves, physics_only=False)
        self.history = SimpleNamespace(count=0)
        self.service = SimpleNamespace(
            model=model, history=self.history, arm=SimpleNamespace(rate=100.0)
        )
        server = SimpleNamespace(service=self.service, outlet=self, loaded=str, rollback=None)
        self.aliases = SimpleNamespace(champion="new", previous=["old"])
        lasts = SimpleNamespace(shadow=60.0, shadow_limit=300.0, probation=200.0)
        monkeypatch.setattr(
            "estimators.service.retraining.judge.Shadow",
            lambda *_: self,  # what it compares with
        )
        stage = SimpleNamespace(note=lambda **_: None)
        self.judge = Judge(server, SimpleNamespace(aliases=self.aliases), lasts, stage)

    def take(self, _stopped):
        self.seconds = self.history.count / 100.0

    def comparison(self, *looks):
        self.looks.append((self.seconds, *looks))
        return self.verdicts.pop(0) if self.verdicts else None

    def event(self, kind, _told, **_):
        self.events.append(kind)

    def run(self, steps):
        with closing(self.judge):
            for _ in islice(steps, 100):
                self.history.count += 1000


def said(*, promote=False, drop=False):
    return SimpleNamespace(promote=promote, drop=drop, reason="so", as_values=dict)


def test_a_challenger_is_looked_at_after_ever_longer_times_and_at_the_end(monkeypatch):
    stand = Stand(monkeypatch, [None, said()], "old")
    with pytest.raises(LimoError, match="undecided after 300 s: nothing could be judged"):
        stand.run(stand.judge.shadow("old", "new"))
    assert stand.looks == [(60.0, 4), (120.0, 4), (240.0, 4), (300.0, 4)]


@pytest.mark.parametrize("promote", [True, False])
def test_a_challenger_that_is_better_or_worse_is_judged_at_once(monkeypatch, promote):
    stand = Stand(monkeypatch, [None, said(promote=promote, drop=not promote)], "old")
    if promote:
        stand.run(stand.judge.shadow("old", "new"))
    else:
        with pytest.raises(LimoError, match="so"):
            stand.run(stand.judge.shadow("old", "new"))
    assert [at for at, _ in stand.looks] == [60.0, 120.0]
    assert stand.events == ["shadow"] * promote


def test_probation_is_looked_at_until_it_is_over(monkeypatch):
    stand = Stand(monkeypatch, [], "new")
    stand.run(stand.judge.probation("old", "new", np.ones(2)))
    assert stand.looks == [(60.0,), (120.0,), (200.0,)]
    assert stand.events == ["probation_passed"]


@pytest.mark.parametrize(
    ("serves", "champion", "previous", "told"),
    [
        ("other", "new", ["old"], "other serves by now"),
        ("new", "other", ["old"], "other is the champion by now"),
        ("new", "new", ["other"], "old is no longer what new came after"),
        ("new", "new", [], "old is no longer what new came after"),
    ],
)
def test_probation_ends_where_somebody_changed_what_serves(
    monkeypatch, serves, champion, previous, told
):
    stand = Stand(monkeypatch, [], serves)
    stand.aliases.champion, stand.aliases.previous = champion, previous
    with pytest.raises(LimoError, match=told):
        stand.run(stand.judge.probation("old", "new", np.ones(2)))
