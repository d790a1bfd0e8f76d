"""Sites of an MJCF file: from where a payload is seen that stands in the frame of the last link."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from estimators.diagnosis.settings.afterwards import WORDING
from estimators.diagnosis.wording import listed
from limo_driver.model.descriptions.description import SITE

if TYPE_CHECKING:
    from limo_driver.model import RobotModel
    from limo_driver.model.descriptions.inertial import Inertial


def seen_by_sites(load: Inertial, model: RobotModel) -> str:
    """Say where the sites that the last link carries see a load; empty where there are none.

    Args:
        load: In the frame of the last link.
        model: The arm that carries it.
    """
    links = {str(link.get("name")) for link in model.description.root.findall("link")}
    places: list[str] = []
    for name, pose in model.last_frames.items():
        if f"{SITE}{name}" in links:
            at = ", ".join(
                f"{x:.3f}" for x in load.moved(np.linalg.inv(pose).astype(np.float64)).com
            )
            places.append(f"({at}) m from the site {name}")
    if not places:
        return ""
    return (
        f" Its centre is given in the frame of {model.link_names[-1]}; it is at "
        f"{listed(places[-WORDING.places :])}."
    )
