"""States wait, few of them, whatever others send."""

from collections import deque
from contextlib import suppress
from types import SimpleNamespace

from estimators.service.inference.inbox import RING, WAITING, Inbox


class Sample(int):
    """A numbered state; those below 0 are of a source that is not followed."""

    @property
    def source_info(self):
        return SimpleNamespace(source_id="other" if self < 0 else "own")


class EndedError(Exception):
    """The subscription has ended."""


class Samples:
    """A handler at which everything is there already, or comes while others are answered."""

    def __init__(self, *samples):
        self.there = deque(samples)

    def recv(self):
        if not self.there:
            raise EndedError
        return Sample(self.there.popleft())

    def try_recv(self):
        return Sample(self.there.popleft()) if self.there else None


def answered(samples, coming=()):
    """Return what is answered, where some more come between one answer and the next."""
    told, more = [], iter(coming)
    foreign = []
    inbox = Inbox(samples, lambda source: source == "other" and not foreign.append(source))
    with suppress(EndedError):
        while True:
            told.append(inbox.next().sample)
            samples.there.extend(next(more, ()))
    return told, foreign


def test_states_are_answered_in_order():
    assert answered(Samples(1, 2, 3)) == ([1, 2, 3], [])


def test_of_too_many_the_oldest_go():
    assert answered(Samples(*range(1, 101)))[0] == list(range(101 - WAITING, 101))


def test_a_flood_of_others_costs_no_state_of_the_source():
    flood = [-1] * (RING // 2)
    told, foreign = answered(Samples(1), [[*flood, k, *flood] for k in range(2, 50)])
    assert told == list(range(1, 50))
    assert len(foreign) == 48 * RING


def test_a_flood_that_never_ends_does_not_keep_a_state_from_its_answer():
    class Endless(Samples):
        def try_recv(self):
            return super().try_recv() or Sample(-1)

    inbox = Inbox(Endless(5), lambda source: source == "other")
    assert inbox.next().sample == 5
