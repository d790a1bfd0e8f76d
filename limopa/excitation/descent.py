"""A motion on its way to the least condition number: one descent after the other."""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import inf
from typing import TYPE_CHECKING, Protocol

import numpy as np
from scipy.optimize import minimize

from limo_driver.types import Motion

if TYPE_CHECKING:
    from collections.abc import Callable

    from scipy.optimize import OptimizeResult

    from limo_driver.types import FloatArray
    from limopa.excitation.excess import Excess
    from limopa.excitation.fourier import Fourier, Sampled

_MEMORY = 20  # steps that L-BFGS remembers


class Sensitivity(Protocol):
    """A smooth value of a motion and its derivative by the motion's samples, each (T, n)."""

    @property
    def value(self) -> float:
        """The value, to be made small."""
        ...

    @property
    def position(self) -> FloatArray:
        """Derivative by the positions."""
        ...

    @property
    def velocity(self) -> FloatArray:
        """Derivative by the velocities."""
        ...

    @property
    def acceleration(self) -> FloatArray:
        """Derivative by the accelerations."""
        ...


class Criterion(Protocol):
    """Objective that the motion minimises: a condition number."""

    def condition(self, motion: Motion) -> float:
        """Return the condition number."""
        ...

    def smooth(self, motion: Motion, sharpness: float) -> Sensitivity:
        """Return a smooth bound of its logarithm, the closer the greater `sharpness`."""
        ...


@dataclass(frozen=True)
class EvaluatedMotion:
    """A motion, and all that its value depends on."""

    fourier: Fourier
    time: FloatArray  # [s] of the samples that the criterion sees
    coarse: Sampled  # at these
    dense: Sampled  # where limits are looked at
    criterion: Criterion
    excess: Excess
    x: FloatArray
    value: float = inf

    def refined(
        self, sharpness: float, weight: float, iterations: int, watch: IterationProgress
    ) -> EvaluatedMotion:
        """Return the motion after a descent.

        Args:
            sharpness: Of the smooth bound of the condition number.
            weight: Of what exceeds a limit.
            iterations: At most; with 0, only the value changes.
            watch: Told of each.
        """

        def value(x: FloatArray) -> tuple[float, FloatArray]:
            wanted = self.criterion.smooth(self._motion(x), sharpness)
            over = self.excess.of(self.dense.states(x))
            by = np.stack(
                [wanted.position, wanted.velocity, wanted.acceleration, 0.0 * wanted.position]
            )
            slope = self.coarse.slope(by) + weight * self.dense.slope(over.states)
            return wanted.value + weight * over.value, slope

        if not iterations:
            return replace(self, value=value(self.x)[0])

        def report(intermediate_result: OptimizeResult) -> None:
            watch.step(self.criterion.condition(self._motion(intermediate_result.x)))

        options = {"maxiter": iterations, "maxcor": _MEMORY}
        found = minimize(
            value, self.x, jac=True, method="L-BFGS-B", options=options, callback=report
        )
        watch.end_stage(iterations)
        return replace(self, x=found.x, value=float(found.fun))

    def _motion(self, x: FloatArray) -> Motion:
        return Motion(self.time, *self.coarse.states(x)[:3])


class IterationProgress:
    """Count iterations and tell of them."""

    def __init__(self, tell: Callable[[int, int, float], None], most: int) -> None:
        self._tell, self._most = tell, most
        self._done = self._ended = 0
        self._condition = inf

    def step(self, condition: float) -> None:
        """Count an iteration that led to a condition number."""
        self._done, self._condition = self._done + 1, condition
        self._tell(min(self._done, self._most), self._most, condition)

    def end_stage(self, iterations: int) -> None:
        """Count what a stage had left, which may have come to its minimum early."""
        self._ended += iterations
        self._done = self._ended
        self._tell(self._done, self._most, self._condition)
