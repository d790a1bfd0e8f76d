"""FRI, the Fast Robot Interface of the KUKA LBR: driver, codec and simulated controller.

The driver is imported when it is first used: the codec alone needs no robot model.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from backends.fri.robot import FriRobot

__all__ = ["FriRobot"]


def __getattr__(name: str) -> object:
    if name != "FriRobot":
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    from backends.fri.robot import FriRobot

    return FriRobot
