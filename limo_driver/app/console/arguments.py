"""Messages of the library in the words of the command line: options instead of arguments.

The library names its arguments in backticks. Who typed a command knows the option instead.
"""

from __future__ import annotations

import re
from typing import Final

OPTIONS: Final = {
    "Surroundings.self_collision": "--no-self-collision",
    "arms": "--arm",
    "bound": "--bound",
    "columns": "--columns",
    "config": "--zenoh-config",
    "connect": "--connect",
    "contact_duration": "--contact-for",
    "contact_torque": "--contact",
    "force": "--force",
    'link["config"]': "--config",
    'link["host"]': "--host",
    'link["port"]': "--port",
    'link["reset_faults"]': "--reset-faults",
    "into": "--into",
    "log": "--log",
    "mapping": "--mapping",
    "model": "--model",
    "out": "--out",
    "retraining": "--retrain",
    "robot": "--robot",
    "ros": "--ros",
    "ros_domain": "--ros",
    "sign": "--sign",
    "simulation": "--sim",
    "store": "--store",
    "topic": "--topic",
    "trajectory": "--trajectory",
    "trust": "--trust",
}


def in_options(message: str) -> str:
    """Return a message that names arguments in backticks with the options that set them."""
    return re.sub(r"`([^`\n]+)`", lambda found: OPTIONS.get(found[1], found[0]), message)
