"""`limo diagnose` on short recordings of other makes, whose physics their authors measured."""

from __future__ import annotations

import json
import os
from pathlib import Path

import numpy as np
import pytest

from estimators.diagnosis import diagnose
from limo_driver.physics import Simulation
from limo_driver.recordings.recording import Recording

DATA = Path(os.environ.get("LIMO_DATA", Path(__file__).parents[2] / ".." / "shared" / "data"))
CASES = DATA / "real_cases"
SURE = 0.5  # confidence from which a name is one

pytestmark = [
    pytest.mark.slow("real recordings, which few have"),
    pytest.mark.skipif(
        not CASES.is_dir(), reason=f"no real cases in {DATA}; name their folder in LIMO_DATA"
    ),
]


def diagnosed(case):
    folder = CASES / case
    truth = json.loads((folder / "truth.json").read_text(encoding="utf-8"))
    recordings = [Recording.load(folder / name) for name in truth["recordings"]]
    return diagnose(Simulation.load(folder / "sim.yaml"), recordings)


def named(found):
    return {
        (item.effect, item.joints)
        for item in found.verdict.findings
        if item.effect != "unknown" and item.confidence >= SURE
    }


def test_an_arm_of_a_tonne_that_lacks_nothing_gets_no_name():
    assert named(diagnosed("kuka_kr300_null")) == set()


def test_the_gas_spring_of_an_arm_of_a_tonne_is_found_in_twenty_seconds():
    found = diagnosed("kuka_kr300_spring")
    assert ("spring_load", (2,)) in named(found)
    assert not {"payload", "gravity_direction", "torque_gain"} & {name for name, _ in named(found)}
    (spring,) = [effect for effect in found.after.effects if effect.name == "spring_load"]
    at_zero = spring.stiffness * -spring.rest - spring.cubic * spring.rest**3
    assert np.isfinite(at_zero)


def test_the_cogging_of_a_servo_is_found_line_by_line():
    """7 pole pairs, 12 slots: the authors measured 7, 12, 14, 28, 36 and 84 in a revolution."""
    found = diagnosed("odrive_cogging")
    assert ("torque_ripple", (1,)) in named(found)
    (ripple,) = [effect for effect in found.after.effects if effect.name == "torque_ripple"]
    lines = np.array(ripple.cycles_per_rev)
    assert all(np.abs(lines - N).min() < 0.2 for N in (7, 12, 14, 28, 36, 84))
