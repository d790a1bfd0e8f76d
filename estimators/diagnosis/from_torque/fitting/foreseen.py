"""Foreseen: how far a fitted simulation may be off on other motion, by what the rows left open.

A parameter that the recorded motion hardly shows keeps most of what its tolerance allows. On motion
that shows it, it then adds an error, however good the fit. The covariance of all that was fitted
says how large that is to be expected:

    variance of the torque = x C xᵀ,   C = (X'ᵀ X' + S⁻²)⁻¹

with X' the whitened columns of the rows fitted, S what was known before them, and x the columns of
the other motion.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from estimators.diagnosis.from_torque.fitting.entries import found_in
from estimators.diagnosis.from_torque.fitting.linearised import Linearised

if TYPE_CHECKING:
    from collections.abc import Sequence

    from estimators.diagnosis.from_torque.residuals.observations import Observations
    from limo_driver.physics import Simulation
    from limo_driver.types import FloatArray

Place = tuple[str, "Sequence[int]", bool]


@dataclass(frozen=True)
class Foreseen:
    """What the fit of a simulation leaves open."""

    simulation: Simulation  # the fitted one
    given: Simulation  # whose values were known to its tolerances
    places: tuple[Place, ...]
    root: FloatArray  # R (c, c), with Rᵀ R the covariance of the coefficients of `Linearised`

    @classmethod
    def of(cls, fitted: Observations, given: Simulation, places: Sequence[Place]) -> Foreseen:
        """Take it from the recordings beside the simulation that was fitted to them.

        Args:
            fitted: The recordings beside that simulation.
            given: The simulation whose values were known to its tolerances.
            places: Of what was found: effect, joints (1-based), and whether it was missing.
        """
        around = _around(fitted, given, places)
        return cls(fitted.simulation, given, tuple(places), around.root())

    def rms(self, motion: Observations) -> FloatArray:
        """Return the error to be expected on other motion, (n,) [N m] RMS over its moving rows.

        Args:
            motion: Recordings of that motion; their torques do not matter.
        """
        around = _around(motion.beside(self.simulation), self.given, self.places)
        entered = around.entered
        result = np.zeros(motion.n)
        for joint in range(motion.n):
            values, at = around.columns.of_joint(joint)
            own = entered[at]
            rows = motion.moving[:, joint]
            spread = values[np.ix_(rows, own)] @ self.root[:, at[own]].T
            result[joint] = np.sqrt(np.sum(spread**2) / max(len(spread), 1))
        return result


def _around(observed: Observations, given: Simulation, places: Sequence[Place]) -> Linearised:
    own = [found_in(observed.simulation, name, on, missing=missing) for name, on, missing in places]
    some = tuple({id(effect): effect for effect in own if effect is not None}.values())
    bodies = [on[0] - 1 for name, on, _ in places if name == "link_inertia"]
    return Linearised.of(observed, some, bodies, given)
