"""Ports that no other test gets: neither of another worker, nor of what the kernel gives away."""

import itertools
import os
import random
import socket

_FIRST, _EACH, _WORKERS = 10_000, 2_000, 10  # below what Linux hands out by itself, from 32768 on
_WORKER = int(os.environ.get("PYTEST_XDIST_WORKER", "gw0").removeprefix("gw")) % _WORKERS
_BEGIN = random.SystemRandom().randrange(_EACH)  # another run on this machine is elsewhere
_turns = itertools.count(_BEGIN)


def free_port():
    """Return a port that nobody uses, neither with TCP nor with UDP, each time another one."""
    for turn in itertools.islice(_turns, _EACH):
        port = _FIRST + _WORKER * _EACH + turn % _EACH
        if all(_is_free(port, kind) for kind in (socket.SOCK_STREAM, socket.SOCK_DGRAM)):
            return port
    raise AssertionError("no port is free")


def _is_free(port, kind):
    with socket.socket(socket.AF_INET, kind) as probe:
        try:
            probe.bind(("0.0.0.0", port))  # noqa: S104
        except OSError:
            return False
    return True
