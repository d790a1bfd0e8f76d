"""The service of an arm opens at the rate of its states, with what can be served at it."""

from types import SimpleNamespace
from typing import Any

import pytest

from estimators.service.opening import PHYSICS, Opening
from estimators.service.settings import ServiceSettings
from estimators.simulation_only import SimulationOnly
from limo_driver.errors import ConfigError
from limo_driver.physics import Simulation


def opening(simulation: Simulation, delay: float, champion: float) -> tuple[Opening, list[str]]:
    """Return the opening of an arm whose champion has a bandwidth [Hz], and what it tells."""
    told: list[str] = []
    models: Any = SimpleNamespace(
        physics=simulation,
        candidates=("slow",),
        load=lambda _: SimulationOnly(simulation, champion),
    )
    outlet: Any = SimpleNamespace(event=lambda _kind, text, *_: told.append(text))
    return Opening("arm", models, ServiceSettings(delay=delay, bound=10.0), outlet), told


def test_a_model_of_low_bandwidth_serves_slow_states(two_links_urdf):
    opened, told = opening(Simulation(str(two_links_urdf)), delay=0.5, champion=2.0)
    assert opened.service(10.0).model.version == "slow"
    assert told == []


def test_where_the_champion_hears_too_much_physics_serve_with_what_states_can_bear(two_links_urdf):
    opened, told = opening(Simulation(str(two_links_urdf)), delay=0.5, champion=10.0)
    model = opened.service(10.0).model
    assert (model.version, model.stream.model.bandwidth) == (PHYSICS, 3.6)
    assert "a bandwidth of 10 Hz is too high for positions at 10 Hz" in told[0]
    assert opened.service(1000.0).model.stream.model.bandwidth == 10.0


def test_a_delay_of_fewer_states_than_a_filter_takes_is_refused(two_links_urdf):
    opened, _ = opening(Simulation(str(two_links_urdf)), delay=0.1, champion=2.0)
    with pytest.raises(ConfigError, match=r"at least 0\.3 s, 3 samples, are needed"):
        opened.service(10.0)
