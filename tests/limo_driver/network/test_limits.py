"""Queries are answered so many a second, and the rest of a flood is dropped without us."""

import threading

import pytest
from sessions import sessions_of_two

from limo_driver.network.claims import PacedQueryable, RateLimit

pytestmark = pytest.mark.waits

KEY = "limo/arm/model/index"
OTHER = "limo/arm/other"


def test_some_may_come_together_and_then_a_few_a_second():
    times = [0.0]
    limit = RateLimit(10.0, 5, clock=lambda: times[0])
    assert [limit.take() for _ in range(7)] == pytest.approx([0, 0, 0, 0, 0, 0.1, 0.2])
    times[0] = 0.25
    assert limit.take() == pytest.approx(0.05)
    times[0] = 1000.0
    assert [limit.take() for _ in range(6)] == pytest.approx([0, 0, 0, 0, 0, 0.1])


@pytest.mark.parametrize("most", [32, 256])
def test_what_is_more_than_waits_is_dropped_and_the_latest_are_answered(tmp_path, most):
    """While one is answered, many more come: those that still waited then are the last of them."""
    answered, busy, free = [], threading.Event(), threading.Event()

    def answer(query):
        if not answered:
            busy.set()
            free.wait(60.0)
        answered.append(str(query.parameters))
        query.reply(KEY, b"")

    with sessions_of_two(tmp_path) as (here, there), PacedQueryable(here, KEY, answer, 1e6, most):
        while not busy.is_set():  # until the two know each other
            first = there.get(f"{KEY}?k=first", timeout=60.0)
            busy.wait(0.1)
        last = here.declare_queryable(OTHER, lambda query: query.reply(OTHER, b""))
        while not list(there.get(OTHER, timeout=60.0)):  # until they know of that one, too
            pass
        asked = [there.get(f"{KEY}?k={k}", timeout=60.0) for k in range(512)]
        assert list(there.get(OTHER, timeout=60.0))  # comes after those
        last.undeclare()
        free.set()
        got = [len(list(replies)) for replies in asked]
        assert len(list(first)) == 1
    assert got == [0] * (len(asked) - most) + [1] * most


def test_a_second_close_does_nothing(tmp_path):
    with sessions_of_two(tmp_path) as (here, _):
        queries = PacedQueryable(here, KEY, lambda query: query.drop(), 1.0, 1)
        queries.close()
        queries.close()
