"""States wait, few of them, whatever others send."""

from collections import deque
from contextlib import suppress
from types import SimpleNamespace

from estimators.service.inference.inbox import RING, WAITING, Inbox


class EndedError(Exception):
    """The subscription has ended."""


class Samples:
    """A handler at which everything is there already, or comes while others are answered.

    Samples are called by numbers, of which each below 0 is of another source.
    """

    def __init__(self, *numbers):
        self.there = deque()
        self.add(numbers)

    def add(self, numbers):
        for number in numbers:
            source = SimpleNamespace(source_id="other" if number < 0 else "followed")
            self.there.append(SimpleNamespace(number=number, source_info=source))

    def recv(self):
        if not self.there:
            raise EndedError
        return self.there.popleft()

    def try_recv(self):
        return self.there.popleft() if self.there else None


def answered(samples, coming=()):
    """Return what is answered, where some more come between one answer and the next."""
    numbers, more = [], iter(coming)
    foreign = []
    inbox = Inbox(samples, lambda source: source == "other" and not foreign.append(source))
    with suppress(EndedError):
        while True:
            sample, source = inbox.next()
            assert source == "followed"
            numbers.append(sample.number)
            samples.add(next(more, ()))
    return numbers, foreign


def test_states_are_answered_in_order():
    assert answered(Samples(1, 2, 3)) == ([1, 2, 3], [])


def test_of_too_many_the_oldest_go():
    assert answered(Samples(*range(1, 1001)))[0] == list(range(1001 - WAITING, 1001))


def test_a_flood_of_others_costs_no_state_of_the_source():
    flood = [-1] * (RING // 2)
    numbers, foreign = answered(Samples(1), [[*flood, k, *flood] for k in range(2, 50)])
    assert numbers == list(range(1, 50))
    assert len(foreign) == 48 * RING


def test_a_flood_that_never_ends_does_not_keep_a_state_from_its_answer():
    class Endless(Samples):
        def try_recv(self):
            self.add([-1])
            return super().try_recv()

    inbox = Inbox(Endless(5), lambda source: source == "other")
    assert inbox.next()[0].number == 5
