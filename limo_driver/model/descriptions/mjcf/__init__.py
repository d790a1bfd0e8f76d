"""MJCF files as MuJoCo compiles them, read as the description of one arm."""

from limo_driver.model.descriptions.mjcf.arm import compile_mjcf, read_mjcf
from limo_driver.model.descriptions.mjcf.joints import (
    check_includes,
    is_passive_motor,
    joint_name,
    play_of,
)

__all__ = [
    "check_includes",
    "compile_mjcf",
    "is_passive_motor",
    "joint_name",
    "play_of",
    "read_mjcf",
]
