"""A cable that hangs slack on one side of a position, and pulls on the other."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from typing import ClassVar

import numpy as np

from limo_driver.physics import Confusion, Description, Hypothesis, TorqueEffect, parameter


@dataclass(frozen=True, kw_only=True)
class TautCable(TorqueEffect):
    """A cable along the arm, tau = stiffness max(position - taut_from, 0)."""

    name: ClassVar[str] = "taut_cable"
    description: ClassVar[Description] = Description(
        signature="torque sets in at one position, and grows beyond it",
        shown_by="wide_sweep",
        confusions=(
            Confusion("spring_load", "a spring pulls on both sides, a cable on one", "wide_sweep"),
        ),
    )
    stiffness: float = parameter("N m/rad", "of the taut cable", lower=0.0, upper=1e4)
    taut_from: float = parameter(
        "rad", "position from which it is taut", lower=-20.0, upper=20.0, deviation=1.0
    )

    def advance(self, state, motion):
        """Return the pull of the cable [N m], (T,)."""
        return self.stiffness * np.maximum(motion.position - self.taut_from, 0.0), state

    @classmethod
    def at_joint(cls, joint, recorded):
        """Yield cables that get taut at several places in the range of a joint."""
        q = recorded.position[:, joint - 1]
        low, *places, high = np.linspace(q.min(), q.max(), 13).tolist()
        for place in places:
            yield cls.of_unit_size(joint, (low, high), place)

    @classmethod
    def of_unit_size(cls, joint, within, taut_from):
        """Return a cable of 1 N m/rad; from where it is taut has to be found, too."""
        return Hypothesis.of_one(
            cls(joint=joint, stiffness=1.0, taut_from=taut_from),
            "stiffness",
            positive=True,
            settings=(taut_from,),
            family=partial(cls.of_unit_size, joint, within),
            bounds=(within,),
        )
