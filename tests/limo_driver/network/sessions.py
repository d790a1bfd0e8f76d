"""Real Zenoh sessions on free ports of this machine."""

import json
import time
from contextlib import contextmanager

from ports import free_port

from limo_driver.network.streaming import open_session

PATIENCE = 120.0  # [s]; matters only where something is broken


def configurations_of_two(folder):
    """Write the configurations of two sessions that see each other and nobody else."""
    endpoints = {"endpoints": [f"tcp/127.0.0.1:{free_port()}"]}
    # By default a message that cannot leave within 1 ms is dropped, which depends on the machine.
    queue = {"congestion_control": {"drop": {"wait_before_drop": int(PATIENCE * 1e6)}}}  # [us]
    paths = folder / "here.json5", folder / "there.json5"
    for path, role in zip(paths, ("listen", "connect"), strict=True):
        alone = {"multicast": {"enabled": False}}
        transport = {"link": {"tx": {"queue": queue}}}
        given = {role: endpoints, "scouting": alone, "transport": transport}
        path.write_text(json.dumps(given))
    return paths


@contextmanager
def sessions_of_two(folder):
    """Two sessions that see each other and nobody else."""
    here, there = configurations_of_two(folder)
    with open_session(config=here) as first, open_session(config=there) as second:
        wait_until(lambda: all(session.info.peers_zid() for session in (first, second)))
        yield first, second


def wait_until(condition, seconds=PATIENCE):
    """Wait for what another thread or process brings about."""
    ends = time.monotonic() + seconds
    while not condition() and time.monotonic() < ends:
        time.sleep(0.005)
    assert condition()
