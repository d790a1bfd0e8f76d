"""Drives written into an MJCF file: an actuator of position or velocity for each servo."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from limo_driver.errors import ConfigError
from limo_driver.exports.xml_edits import as_attribute, differ
from limo_driver.physics.drives import as_described

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from limo_driver.descriptions.description import StatedServo
    from limo_driver.exports.changes.target import Target
    from limo_driver.exports.xml_edits import Element, XmlText


def write_servos(texts: Sequence[XmlText], target: Target, timestep: float, into: Path) -> None:
    """Write gains, limits and delays of servos.

    What these actuators have no attribute for (dead band, play, profile, integrator, motor,
    supply) is not written, and told by `unwritten`.

    Args:
        texts: Of the file and its includes.
        target: What has to change.
        timestep: Of the file's simulation [s]: a delay keeps so many commands.
        into: The file, for messages.

    Raises:
        ConfigError: A joint that has a servo is moved by another kind of actuator in the file.
    """
    names = target.model.joint_names
    new: list[str] = []
    for drive in target.simulation.drives:
        if (wanted := as_described(drive)) is None:
            continue
        name, tag = names[drive.joint - 1], "velocity" if wanted.kp == 0.0 else "position"
        stated = target.model.description.servos.get(name)
        if stated is not None and _alike(stated, wanted):
            continue
        values = _attributes(wanted, stated, timestep)
        text, element = _actuator(texts, name)
        if text is None or element is None:
            written = " ".join(f'{key}="{value}"' for key, value in values.items())
            new.append(f'<{tag} joint="{as_attribute(name)}" {written}/>')
        elif element.tag not in (tag, "general") or stated is None:
            raise ConfigError(
                f"joint {name} is moved by <{element.tag}>; expected <{tag}>, or no actuator, "
                "to write its servo",
                path=into,
            )
        else:
            if element.tag == "general":
                kp, kv = values.pop("kp", "0"), values.pop("kv")
                gain = kv if tag == "velocity" else kp
                values |= {"gainprm": gain, "biasprm": f"0 -{kp} -{kv}"}
            for key, value in values.items():
                text.set(element, key, value)
    if new:
        root = texts[0].root
        actuator = root.child("actuator")
        if actuator is None:
            texts[0].append(root, f"<actuator>{''.join(new)}</actuator>")
        else:
            texts[0].insert(actuator, "".join(new))


def _actuator(texts: Sequence[XmlText], joint: str) -> tuple[XmlText | None, Element | None]:
    """Return the actuator of a joint, and the text that it stands in."""
    for text in texts:
        for item in text.root.walk():
            within = item.parent is not None and item.parent.tag == "actuator"
            if within and item.attributes.get("joint") == joint:
                return text, item
    return None, None


def _attributes(servo: StatedServo, stated: StatedServo | None, timestep: float) -> dict[str, str]:
    values = {"kp": f"{servo.kp:.10g}", "kv": f"{servo.kd:.10g}"}
    if servo.kp == 0.0:
        del values["kp"]
    if servo.limit is not None:
        values["forcerange"] = f"{-servo.limit:.10g} {servo.limit:.10g}"
    elif stated is not None and stated.limit is not None:
        values["forcelimited"] = "false"
    if servo.delay == 0.0 and stated is not None and stated.delay > 0.0:
        values["delay"] = "0"
    if servo.delay > 0.0:
        values["delay"] = f"{servo.delay:.10g}"
        values["nsample"] = str(math.ceil(servo.delay / timestep) + 1)
    return values


def _alike(first: StatedServo, second: StatedServo) -> bool:
    pairs = (
        (first.kp, second.kp),
        (first.kd, second.kd),
        (first.limit or 0.0, second.limit or 0.0),
        (first.delay, second.delay),
    )
    return not any(differ(a, b) for a, b in pairs)
