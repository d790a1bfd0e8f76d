"""Score: how far a simulation's torque is from a recorded one."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from limo_driver.model.units import unit_of
from limo_driver.runtime.display import Displayed
from limo_driver.types import FloatArray


@dataclass(frozen=True, repr=False)
class Score(Displayed):
    """Errors of a predicted torque against a recorded one, behind one zero-phase filter.

    Args:
        rmse: Root mean square error of each joint, (n,) [N m]; NaN where no torque was measured.
        torque: Root mean square of the measured torque, (n,) [N m], to compare with.
        joint_names: Of the n joints.
        samples: That were scored: all but those near the end of a stretch without a gap.
        bandwidth: Of the filter [Hz].
        source: Where the recording is from.
        sliding: Which joints slide, (n,), and so are in N; empty if none does.
    """

    rmse: FloatArray
    torque: FloatArray
    joint_names: tuple[str, ...]
    samples: int
    bandwidth: float
    source: str = ""
    sliding: tuple[bool, ...] = ()

    def headline(self) -> str:
        """Say the largest error, and the motion on which it was found."""
        worst = int(np.nanargmax(self.rmse))
        of = f" of {self.source}" if self.source else ""
        unit = unit_of("N m", self.sliding, worst)
        return (
            f"RMSE up to {self.rmse[worst]:.4f} {unit} ({self.joint_names[worst]}) over "
            f"{self.samples} samples{of}, torque filtered at {self.bandwidth:g} Hz"
        )

    def figures(self) -> Mapping[str, Sequence[object]]:
        """Return error and measured torque of each joint."""
        unit = unit_of("N m", self.sliding)
        return {
            "joint": self.joint_names,
            f"RMSE [{unit}]": self.rmse.tolist(),
            f"measured torque, RMS [{unit}]": self.torque.tolist(),
        }
