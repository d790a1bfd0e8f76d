"""The service of an arm opens at the rate of its states, with what can be served at it."""

import os
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

import limo_driver
from estimators.residual_model import SimulationOnly
from estimators.service.opening import PHYSICS, Opening
from estimators.service.settings import ServiceSettings
from limo_driver.errors import ConfigError
from limo_driver.physics import Simulation

pytestmark = pytest.mark.waits

FIRST_STATES = """
import sys
from types import SimpleNamespace
import numpy as np
from estimators.service.opening import Opening
from estimators.service.settings import ServiceSettings
from limo_driver.runtime.compiled import signatures
from limo_driver.network.messages import Attachment, JointStateCodec
from limo_driver.physics import Simulation

answered = []
outlet = SimpleNamespace(
    external_wanted=True,
    known_wanted=True,
    estimate=lambda payload, *_: answered.append(payload),
    external=lambda *_: None,
    known=lambda *_: None,
    contact=lambda *_: None,
    state=lambda *_: None,
    event=lambda *_, **__: None,
)
models = SimpleNamespace(physics=Simulation(sys.argv[1]), candidates=())
service = Opening("arm", models, ServiceSettings(bound=10.0), outlet).service(100.0)
before = signatures()
codec, still = JointStateCodec(service.arm.joint_names), np.zeros(2)
for first, torque in ((0, still), (5, still[:0])):
    for k in range(first, first + 5):
        state = codec.encode(10_000_000 * (k + 1), still, still, torque)
        service.handle(state, Attachment(k, k).encode())
assert len(answered) == 10
assert signatures() == before
"""


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


def test_physics_serve_at_the_bandwidth_that_was_found_for_them(two_links_urdf):
    found = Simulation(str(two_links_urdf), bandwidth=5.0)
    opened, _ = opening(found, delay=0.5, champion=10.0)
    assert opened.service(10.0).model.stream.model.bandwidth == 3.6
    opened, _ = opening(found, delay=0.5, champion=900.0)
    assert opened.service(1000.0).model.stream.model.bandwidth == 5.0


def test_a_delay_of_fewer_states_than_a_filter_takes_is_refused(two_links_urdf):
    opened, _ = opening(Simulation(str(two_links_urdf)), delay=0.1, champion=2.0)
    with pytest.raises(ConfigError, match=r"at least 0\.3 s, 3 samples, are needed"):
        opened.service(10.0)


@pytest.mark.slow("compiles in a process of its own")
def test_the_first_states_find_everything_compiled(two_links_urdf):
    # in a process of its own, since other tests compile here
    subprocess.run(
        [sys.executable, "-c", FIRST_STATES, str(two_links_urdf)],
        check=True,
        env=os.environ | {"PYTHONPATH": str(Path(limo_driver.__file__).parents[1])},
    )
