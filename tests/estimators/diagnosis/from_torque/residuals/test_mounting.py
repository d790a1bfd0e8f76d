"""Mounting: an arm on a wall is taken for what it is, and one that bears a load is not turned."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from noisy_recordings import NOISE, motion

from estimators.diagnosis.from_torque.pipeline import diagnose
from estimators.diagnosis.from_torque.residuals.body_fit import as_mounted
from estimators.diagnosis.from_torque.residuals.mistakes import mounted_otherwise
from estimators.diagnosis.from_torque.residuals.observations import Observations
from limo_driver.app.library.learning import identify
from limo_driver.physics import (
    CoulombFriction,
    Effect,
    GravityDirection,
    Payload,
    Simulation,
    SpringLoad,
)
from limo_driver.recordings.recording import Recording

BARE = Simulation("iiwa14")
RUBBING = tuple(CoulombFriction(joint=j, tau_c=0.4, v_eps=0.01) for j in range(1, 8))


def seen(*effects: Effect) -> Observations:
    """Record an arm with friction and some effects, beside its bare description."""
    moved = motion(1)
    truth = replace(BARE, effects=(*RUBBING, *effects))
    noise = NOISE * np.random.default_rng(3).standard_normal(moved.position.shape)
    recording = Recording.from_arrays(moved.time, moved.position, truth.predict(moved) + noise)
    return Observations.of(BARE, [recording], 10.0)


@pytest.mark.parametrize(
    ("gravity", "near"),
    [((9.81, 0.0, 0.0), 0.0), ((0.0, 0.0, 9.81), 0.0), ((0.0, 6.94, -6.94), 0.3)],
)
def test_a_base_that_hangs_otherwise_is_turned(
    gravity: tuple[float, float, float], near: float
) -> None:
    turned = as_mounted(seen(GravityDirection(gravity=gravity)))

    assert np.allclose(turned.simulation.body.gravity, gravity, atol=near)


@pytest.mark.parametrize(
    "effect",
    [
        GravityDirection(gravity=(0.6, 0.0, -9.8)),  # a small tilt is an effect among others
        Payload(mass=3.0, com=(0.1, 0.0, 0.1), inertia=(0.01, 0.0, 0.0, 0.01, 0.0, 0.01)),
        SpringLoad(joint=2, stiffness=60.0, rest=0.4),
    ],
)
def test_what_loads_an_arm_turns_no_base(effect: Effect) -> None:
    given = seen(effect)

    assert as_mounted(given) is given


@pytest.mark.slow("a whole diagnosis")
def test_a_diagnosis_says_how_the_arm_hangs_and_puts_no_other_name_in_its_place() -> None:
    given = seen(GravityDirection(gravity=(9.81, 0.0, 0.0)))

    verdict = diagnose(BARE, given.recordings).verdict

    turned, *others = verdict.findings
    assert (turned.effect, turned.kind) == ("gravity_direction", "missing")
    assert turned.parameters["gravity"].value == pytest.approx((9.81, 0.0, 0.0), abs=0.1)
    assert {item.effect for item in others} <= {"unknown"}
    assert verdict.fit.heldout_rmse_before[1] > 80.0  # beside the upright arm that was given
    assert np.all(np.array(verdict.fit.heldout_rmse_after[1:6]) < 1.2 * NOISE)


def test_an_arm_on_a_wall_is_identified_as_it_hangs() -> None:
    given = seen(GravityDirection(gravity=(9.81, 0.0, 0.0)))

    found = identify("iiwa14", given.recordings)

    assert found.simulation.body.gravity == (9.81, 0.0, 0.0)
    assert "gravity is (9.81, 0, 0) m/s² in the frame of its base" in found.warnings[0]
    assert np.all(found.rmse_consistent < 2.0 * NOISE)
    assert max(abs(link.mass / link.mass_nominal - 1.0) for link in found.links) < 0.1


def test_an_arm_that_stands_is_identified_as_described() -> None:
    given = seen()

    found = identify("iiwa14", given.recordings)

    assert not any(isinstance(item, GravityDirection) for item in found.simulation.effects)
    assert not any("mounted" in warning for warning in found.warnings)


def test_a_direction_is_named_by_its_axis_where_it_is_one() -> None:
    assert mounted_otherwise(np.array([0.0, -9.81, 0.0])).startswith("gravity acts along -y of")
    skew = mounted_otherwise(np.array([3.0, 0.0, -4.0]))
    assert skew.startswith("gravity acts along (0.6, 0, -0.8) of the base")
