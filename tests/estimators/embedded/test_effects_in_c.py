"""Every effect as C: equal to its own law in Python, or refused by name."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pytest
from c_model import CModel, worst
from effect_examples import EXAMPLES, make

from estimators.embedded.export import export_c
from limo_driver.errors import ConfigError
from limo_driver.physics import Simulation
from limo_driver.physics.domain import Domain
from limo_driver.types import Motion

if TYPE_CHECKING:
    from pathlib import Path

RATE = 500.0  # [Hz], of samples that are a little uneven
REFUSED = [
    ("external_contact", EXAMPLES["external_contact"][0]),
    ("picked_up_load", EXAMPLES["picked_up_load"][0]),
    ("temperature_dependent_friction", {"per_kelvin": -0.1, "reference": 30.0}),
]
CASES = [(name, values) for name, given in EXAMPLES.items() for values in given]
EXPORTED = [case for case in CASES if case not in REFUSED]


@pytest.fixture(scope="module")
def motion() -> Motion:
    random = np.random.default_rng(0)
    t = np.cumsum(random.uniform(0.96, 1.04, 1200)) / RATE
    angle = 2 * np.pi * t[:, None] * random.uniform(0.3, 3.0, (2, 1, 7)) + np.arange(7)
    q = 0.2 + np.tensordot([0.04, 0.01], np.sin(angle), 1)
    dq = np.gradient(q, t, axis=0)
    return Motion(t, q, dq, np.gradient(dq, t, axis=0))


@pytest.mark.slow("compiles all effects")
def test_all_effects_at_once_equal_their_laws(motion: Motion, tmp_path: Path) -> None:
    """Sensors last; what displaces the links displaces them together."""
    simulation = Simulation("iiwa14", tuple(make(name, **values) for name, values in EXPORTED))
    found = CModel.of(simulation, tmp_path, RATE).along(motion)
    assert worst(found["torque"], simulation.predict(motion)) < 1e-9


@pytest.mark.slow("compiles many effects")
def test_friction_is_told_apart_from_other_torque(motion: Motion, tmp_path: Path) -> None:
    is_friction = [case for case in EXPORTED if make(case[0], **case[1]).is_friction]
    others = [("spring_load", {"stiffness": 20.0, "rest": 0.3}), ("armature", {"inertia": 0.4})]
    with_both = Simulation("iiwa14", tuple(make(n, **values) for n, values in is_friction + others))
    without = Simulation("iiwa14", tuple(make(n, **values) for n, values in others))
    found = CModel.of(with_both, tmp_path, RATE).along(motion)
    rubbed = with_both.predict(motion) - without.predict(motion)
    assert np.abs(found["friction"] - rubbed).max() < 1e-9


def test_beyond_their_domains_they_go_on_alike(motion: Motion, tmp_path: Path) -> None:
    near, slow = Domain(position=(0.19, 0.21)), Domain(speed=0.05, slope=1.5)
    limited = {
        "spring_load": near,
        "torque_ripple": near,
        "position_dependent_friction": near,
        "viscous_friction": slow,
        "quadratic_drag": Domain(speed=0.05),
    }
    effects = [make(name, **EXAMPLES[name][0], domain=own) for name, own in limited.items()]
    simulation = Simulation("iiwa14", tuple(effects))
    everywhere = Simulation("iiwa14", tuple(make(n, **EXAMPLES[n][0]) for n in limited))
    found = CModel.of(simulation, tmp_path, RATE).along(motion)["torque"]
    assert worst(found, simulation.predict(motion)) < 1e-9
    assert worst(found, everywhere.predict(motion)) > 1e-3


@pytest.mark.parametrize(("name", "values"), REFUSED, ids=[name for name, _ in REFUSED])
def test_what_has_no_form_in_c_is_refused_by_name(name: str, values: dict, tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=name):
        export_c(Simulation("iiwa14", (make(name, **values),)), tmp_path, RATE)
    assert not list(tmp_path.iterdir())


@pytest.mark.slow("compiles an arm")
def test_payload_and_gravity_are_told_apart(motion: Motion, tmp_path: Path) -> None:
    simulation = Simulation("iiwa14", (make("payload", **EXAMPLES["payload"][0]),))
    found = CModel.of(simulation, tmp_path, RATE).along(motion)
    without = simulation.without_effects().predict(motion)
    assert np.abs(found["payload"] - (simulation.predict(motion) - without)).max() < 1e-9
    still = np.zeros_like(motion.position)
    holding = simulation.body.inverse_dynamics(motion.position, still, still)
    assert np.abs(found["gravity"] - holding).max() < 1e-9
