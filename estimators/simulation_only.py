"""A simulation as an estimator: what to fall back on when nothing learned can be trusted."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from estimators.base import Estimate
from limo_driver.recordings.bandwidth import BANDWIDTH

if TYPE_CHECKING:
    from estimators.base import State
    from limo_driver.physics import Simulation
    from limo_driver.types import Motion


@dataclass(frozen=True)
class SimulationOnly:
    """Predict tau_S and add nothing.

    Args:
        simulation: Gives tau_S.
        bandwidth: Of the filter on live motion [Hz].
    """

    simulation: Simulation
    bandwidth: float = BANDWIDTH

    @property
    def n(self) -> int:
        """Number of joints."""
        return self.simulation.model.n

    @property
    def memory(self) -> object:
        """The values besides the motion that determine memory: the simulation."""
        return self.simulation

    def init(self, rate: float | None = None) -> State:  # noqa: ARG002  # any will do
        """Return the memory before the first sample."""
        return self.simulation.init()

    def advance(self, state: State, motion: Motion) -> tuple[Estimate, State]:
        """Estimate T samples, see `LiveEstimator`; how sure that is, nobody knows.

        Raises:
            ShapeError: The motion has another number of joints.
        """
        torque, after = self.simulation.advance(state, motion)
        return Estimate.unsure(torque), after
