"""Values that cannot be are refused by name, in an effect and, with its line, in a sim.yaml."""

import numpy as np
import pytest

from limo_driver.errors import ConfigError
from limo_driver.physics import CATALOGUE, Simulation
from limo_driver.types import Motion

HYSTERESIS = "presliding_hysteresis, joint: 1, law"
WRONG = [
    ("viscous_friction, joint: 1, f_v_plus: 1", "lacks f_v, or f_v_plus and f_v_minus"),
    ("viscous_friction, joint: 1, f_v: 1, f_v_plus: 1", "give one or other"),
    (
        "asymmetric_friction, joint: 1, tau_plus: -1, tau_minus: 1",
        "tau_plus is -1 N m, expected a num",
    ),
    (
        "load_dependent_friction, joint: 1, coefficient: 1, variant: cubic",
        "expected one of absolute, posi",
    ),
    ("load_dependent_friction, joint: 1, coefficient: 1, variant: stribeck", "lacks v_s"),
    ("load_dependent_friction, joint: 1, coefficient: 1, v_s: 1", "has no v_s as absolute"),
    ("position_dependent_friction, joint: 1, positions: [0, 1], excess: [1]", "2 positions, 1 ex"),
    ("position_dependent_friction, joint: 1, positions: [], excess: []", "0 positions, 0 excess"),
    ("position_dependent_friction, joint: 1, positions: [1, 0], excess: [1, 2]", "0 after 1"),
    ("temperature_dependent_friction, joint: 1, excess: 1", "one form, whole"),
    ("temperature_dependent_friction, joint: 1", "lacks excess and time_constant, or per_kelvin"),
    ("temperature_dependent_friction, joint: 1, excess: 1, per_kelvin: 1", "give one form"),
    (
        "torque_drift, joint: 1, times: [0, 0], offset: [1, 2]",
        "times is [0, 0], expected numbers that increase, not 0 after 0",
    ),
    ("torque_crosstalk, joint: 1, source: 1, gain: 1", "source is 1, expected another joint"),
    ("torque_crosstalk, joint: 1, source: 8, gain: 1", "source is 8, expected a joint from 1 to 7"),
    ("joint_coupling, joint: 1, other: 1, f_v: 1", "other is 1, expected another joint"),
    ("joint_coupling, joint: 1, other: 9, f_v: 1", "other is 9, expected a joint from 1 to 7"),
    ("joint_coupling, joint: 1, other: 2, ratio: 0.5", "ratio is 0.5, expected 1 or -1"),
    ("joint_coupling, other: 2", "joint_coupling: lacks joint"),
    ("torque_ripple, joint: 1, cycles_per_rev: [1, 2], amplitude: [1], phase: [0]", "1 amplitude"),
    ("payload, mass: 1, com: [0, 0]", "com is [0, 0], expected a list of 3 numbers"),
    ("payload, joint: 7, mass: 1, com: [0, 0, 0]", "has no 'joint'"),
    ("payload, mass: 1, com: [0, 0, 0], inertia: [1, 0, 0, 0.1, 0, 0.1]", "no rigid body has"),
    ("payload, mass: 0, com: [0, 0, 0], inertia: [1, 0, 0, 1, 0, 1]", "no rigid body has"),
    ("gravity_direction, gravity: [0, 0, -99]", "gravity: number 3 is -99 m/s^2, expected"),
    ("external_contact, windows: [[1, 0]], wrench: [[0, 0, 0, 0, 0, 0]]", "has to end later"),
    (
        "external_contact, windows: [[0, 1]], wrench: [[0, 0, 1]]",
        "number 1 is [0, 0, 1], expected a list of 6 numbers",
    ),
    ("external_contact, windows: [[0, 1]], wrench: []", "1 windows, 0 wrench"),
    (
        "external_contact, windows: 3, wrench: []",
        "windows is '3', expected a list of rows of 2 numbers",
    ),
    (f"{HYSTERESIS}: duhem, tau_c: 1", "law is 'duhem', expected one of maxwell_slip, lugre"),
    (f"{HYSTERESIS}: maxwell_slip, stiffness: [1]", "law maxwell_slip lacks width"),
    (f"{HYSTERESIS}: lugre, tau_c: 1", "law lugre lacks sigma_0"),
    (f"{HYSTERESIS}: dahl, sigma_0: 1, tau_c: 1, v_s: 1", "law dahl has no v_s; it has sigma_0"),
    (
        f"{HYSTERESIS}: bouc_wen, sigma_0: 1, tau_c: 1, beta_ratio: 0.4",
        "beta_ratio is 0.4, expected a number from 0.5",
    ),
    (f"{HYSTERESIS}: preisach, up: [0], down: [1], weight: [1]", "up at 0 rad, below its down"),
]


@pytest.mark.parametrize(("entry", "message"), WRONG, ids=[entry for entry, _ in WRONG])
def test_a_wrong_entry_is_named_with_its_line(tmp_path, entry, message):
    path = tmp_path / "sim.yaml"
    path.write_text(f"robot: iiwa14\neffects:\n  - {{effect: {entry}}}\n")
    with pytest.raises(ConfigError) as caught:
        Simulation.load(path)
    assert message in str(caught.value)
    assert caught.value.line == 3


def test_an_effect_of_a_joint_that_the_robot_lacks_is_refused():
    crosstalk = CATALOGUE["torque_crosstalk"](joint=1, source=8, gain=0.1)
    with pytest.raises(ConfigError, match="torque_crosstalk: joint 8 does not exist"):
        Simulation("iiwa14", effects=(crosstalk,))


def test_a_motion_without_temperature_is_refused_where_it_is_needed():
    warm = CATALOGUE["temperature_dependent_friction"](joint=3, per_kelvin=-0.1)
    zero = np.zeros((2, 7))
    with pytest.raises(ConfigError, match=r"joint 3: per_kelvin needs the temperature of the joi"):
        Simulation("iiwa14", effects=(warm,)).predict(Motion(np.arange(2.0), zero, zero, zero))
