"""Start the service of one arm: find the rate of its states, then load and warm up a model."""

from __future__ import annotations

from contextlib import suppress
from typing import TYPE_CHECKING, Final

import numpy as np

from estimators.service.inference.arm_service import ArmService, ServedArm
from estimators.service.inference.contact import ContactWatchdog
from estimators.service.inference.live_model import LiveModel
from estimators.service.inference.rate import RateFinder
from estimators.service.inference.window import Window
from estimators.simulation_only import SimulationOnly
from estimators.stream import Stream
from limo_driver.errors import LimoError
from limo_driver.network.messages import Level
from limo_driver.recordings.bandwidth import bandwidth_at
from limo_driver.recordings.filters.causal_differentiation import RATE_TOLERANCE
from limo_driver.types import readonly

if TYPE_CHECKING:
    from estimators.service.inference.arm_service import Outlet
    from estimators.service.settings import ServiceSettings
    from estimators.service.store.served_models import ServedModels

PHYSICS: Final = "physics"  # version of estimates without a learned part
_USUAL_RATE: Final = 1000.0  # [Hz]


class Opening:
    """Opens the service of one arm, as often as its states come at another rate.

    Args:
        arm: Its name in keys.
        models: What can serve.
        settings: How.
        outlet: Of the arm; told which models are refused.
    """

    def __init__(
        self, arm: str, models: ServedModels, settings: ServiceSettings, outlet: Outlet
    ) -> None:
        self._arm, self._models, self._settings, self._outlet = arm, models, settings, outlet
        self._finder = RateFinder()

    def rate(self, sequence: int, stamp: int, *, first: bool) -> float | None:
        """Take a state, and return the rate to serve [Hz] once it is known.

        A stated one is believed until states came at another.

        Args:
            sequence: Number of the state.
            stamp: When it was measured [ns].
            first: Whether nothing was served yet.
        """
        stated = self._settings.rate
        if stated is not None and first:
            return stated
        found = self._finder.take(sequence, stamp)
        if stated is None or found is None:
            return found
        return stated if abs(found / stated - 1.0) <= RATE_TOLERANCE else None

    def service(self, rate: float) -> ArmService:
        """Return the service at a rate [Hz], with the champion or what stands in for it.

        Raises:
            LimoError: Not even the physics can be served at that rate.
        """
        simulation, settings = self._models.physics, self._settings
        bound = settings.bounds(simulation.model.limits)
        arm = ServedArm(
            self._arm, tuple(simulation.model.joint_names), rate, settings.history, bound
        )
        physics = SimulationOnly(simulation, bandwidth_at(rate))
        stream = Stream(physics, rate, settings.delay)
        warm_up(stream)
        service = ArmService(
            arm,
            LiveModel(PHYSICS, stream, bound, physics_only=True),
            ContactWatchdog(*settings.contact(simulation.model.n)),
            self._outlet,
        )
        service.model = self._first_model(service)
        return service

    def loaded(self, version: str, arm: ServedArm) -> LiveModel:
        """Load a version for an arm, with everything compiled that its first answer needs.

        Raises:
            LimoError: It cannot be read, or not be streamed at the arm's rate.
        """
        stream = Stream(self._models.load(version), arm.rate, self._settings.delay)
        warm_up(stream)
        return LiveModel(version, stream, arm.bound)

    def _first_model(self, service: ArmService) -> LiveModel:
        """Return the champion, or else a champion before it, or else the physics."""
        try:
            candidates = self._models.candidates
        except LimoError as error:
            self._outlet.event("refused", f"no champion is known: {error}", Level.ERROR)
            return service.model
        for candidate in candidates:
            try:
                return self.loaded(candidate, service.arm)
            except LimoError as error:
                self._outlet.event("refused", f"champion {candidate}: {error}", Level.ERROR)
        return service.model


def rehearse(models: ServedModels, settings: ServiceSettings) -> None:
    """Load what will likely serve, so that all is imported and compiled when joint states come."""
    with suppress(LimoError):  # which is told when it is to serve
        for model in (models.physics, *map(models.load, models.candidates[:1])):
            warm_up(Stream(model, settings.rate or _USUAL_RATE, settings.delay))


def warm_up(stream: Stream) -> None:
    """Answer a few states at rest, so that the first real one finds everything compiled.

    With torque and without, of arrays that are read-only, as those off the wire are.
    """
    n, rate = stream.model.n, stream.rate
    still = readonly(np.zeros(n))
    watchdog, window = ContactWatchdog(np.ones(n), np.ones(n)), Window(n)
    for torque in (still, None):
        model = LiveModel("", stream, np.ones(n))
        for k in range(3):
            answer = model.step(k / rate, still, torque)
            watchdog.step(k / rate, answer.external)
            window.add(answer, watchdog.active, watchdog.active, known=True)
        rows = None if torque is None else torque[None]
        stream.advance(model.state, np.array([3 / rate]), still[None], rows)
