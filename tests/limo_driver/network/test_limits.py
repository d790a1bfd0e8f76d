"""Peers that ask too often are not answered, and others are all the same."""

from limo_driver.network.limits import PeerLimits


def limits(times, rate=10.0, burst=5):
    return PeerLimits(rate, burst, clock=lambda: times[0])


def test_some_requests_may_come_together_and_then_a_few_a_second():
    times = [0.0]
    peers = limits(times)
    assert [peers.admits("a") for _ in range(7)] == [True] * 5 + [False] * 2
    times[0] = 0.25
    assert [peers.admits("a") for _ in range(4)] == [True, True, False, False]
    times[0] = 1000.0
    assert [peers.admits("a") for _ in range(6)] == [True] * 5 + [False]
    assert peers.refused == 5


def test_one_that_floods_costs_the_others_nothing():
    peers = limits([0.0])
    for _ in range(1000):
        peers.admits("flood")
    assert peers.admits("other")


def test_only_so_many_peers_are_remembered():
    peers = limits([0.0])
    for k in range(10_000):
        assert peers.admits(str(k))
    assert len(peers._left) <= 256
