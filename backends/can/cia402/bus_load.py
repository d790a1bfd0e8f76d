"""Bus load of an arm of CiA 402 drives."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from backends.can.frames import BusLoad, Traffic

if TYPE_CHECKING:
    from backends.can.config import ArmConfig

HEARTBEATS_PER_WATCHDOG: Final = 4


def bus_load(config: ArmConfig, *, torque: bool = False) -> BusLoad:
    """Return the load at the arm's rate, with worst stuffing.

    Args:
        config: The arm.
        torque: Whether drives are commanded torques, which takes a second frame for each.
    """
    n, rate = len(config.joints), config.rate
    slow = rate / config.status_every
    traffic = [Traffic("SYNC", 1, 0, rate), Traffic("RPDO1", n, 8, rate)]
    if torque:
        traffic.append(Traffic("RPDO2", n, 3, rate))
    traffic += [Traffic("TPDO1", n, 8, rate), Traffic("TPDO2", n, 7, slow)]
    if config.temperature is not None:
        traffic.append(Traffic("TPDO3", n, 2, slow))
    heartbeats = HEARTBEATS_PER_WATCHDOG / config.watchdog
    traffic.append(Traffic("heartbeats", n + 1, 1, heartbeats, cyclic=False))
    bus = config.bus
    return BusLoad(tuple(traffic), bus.bitrate, bus.data_bitrate if bus.fd else None)
