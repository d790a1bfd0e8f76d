"""Arms for tests: configurations on a bus of their own."""

import itertools
import os
from dataclasses import replace

import numpy as np

from backends.can import ArmConfig
from backends.can.config import Bus, Cia402Joint, Temperature

NODES = tuple(range(11, 18))
COUNTS_PER_TURN = 524288
START = np.array([0.3, -0.5, 0.2, 1.0, -0.2, 0.6, 0.1])  # [rad]
_channels = itertools.count()


def virtual_bus():
    return Bus(interface="virtual", channel=f"limo-{os.getpid()}-{next(_channels)}")


def arm_config(**changes):
    joints = tuple(
        Cia402Joint(
            node=node,
            counts_per_turn=COUNTS_PER_TURN,
            rated_torque=100.0,
            direction=-1 if j % 2 else 1,
            offset=0.1 * j,
        )
        for j, node in enumerate(NODES)
    )
    config = ArmConfig(
        bus=virtual_bus(),
        robot="iiwa14",
        joints=joints,
        rate=100.0,
        watchdog=1.0,
        hold_after=20,  # the drives are threads of this process
        temperature=Temperature(object=0x2031),
    )
    return replace(config, **changes)


def counts_at(config, position):
    """Counts of the drives of an arm that stands at `position`."""
    return [
        round((q - joint.offset) * joint.counts_per_radian)
        for q, joint in zip(position, config.joints, strict=True)
    ]
